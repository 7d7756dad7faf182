"""What the reach forest learns from a library, as one immutable object that a file can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, unwrap_angles
from humanpred_ros.recognition.calibration import Calibration
from humanpred_ros.recognition.class_mixtures import check_trainable
from humanpred_ros.recognition.forest import Forest, IntArray, Tree, grow_tree
from humanpred_ros.recognition.forest_config import ForestSettings
from humanpred_ros.recognition.novelty import Novelty, distances_without, motion_distances
from humanpred_ros.recognition.reach_features import (
    N_FEATURES,
    REACHED,
    Float32Array,
    motion_features,
    point_links,
)
from humanpred_ros.recognition.standing_place import StandingPlace, start_pose

#: The link whose pose says where somebody stands.
PELVIS = "pelvis"


@dataclass(frozen=True, eq=False)
class Exemplars:
    """The library as the forest remembers it: some postures of each of K motions, M in all, motion by motion.

    Attributes:
        names: K motion names, `class/index`.
        label: (K,) number of each motion's class.
        first: (K + 1,) where each motion's postures begin.
        q: (M, D) postures, library frame, angles of a motion continuous.
        features: (M, N_FEATURES) of the reach up to each posture, library frame.
        start_pose: (K, 3) x, y and yaw of the pelvis at the start.
    """

    names: tuple[str, ...]
    label: NDArray[np.intp]
    first: NDArray[np.int64]
    q: FloatArray
    features: Float32Array
    start_pose: FloatArray

    def __post_init__(self) -> None:
        n_motions, n_postures = len(self.names), len(self.q)
        if (
            self.label.shape != (n_motions,)
            or self.first.shape != (n_motions + 1,)
            or self.first[-1] != n_postures
            or self.features.shape != (n_postures, N_FEATURES)
            or self.start_pose.shape != (n_motions, 3)
        ):
            raise ArrayError("exemplars: wanted arrays that agree on the numbers of motions and postures")
        for name in ("label", "first", "q", "features", "start_pose"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @classmethod
    def of_motions(cls, motions: tuple[Motion, ...], labels: tuple[int, ...], human: HumanModel, n: int) -> Exemplars:
        """Return `n` evenly spaced postures of each motion."""
        links, pelvis = point_links(human), human.link_names.index(PELVIS)
        q, features, starts = [], [], []
        for motion in motions:
            poses = human.link_poses(motion.q)
            kept = np.round(np.linspace(0, len(motion) - 1, min(n, len(motion)))).astype(np.intp)
            q.append(unwrap_angles(motion).q[kept])
            features.append(motion_features(poses[:, links][..., :3, 3])[kept].astype(np.float32))
            starts.append(start_pose(poses[:, pelvis]))
        return cls(
            tuple(motion.name for motion in motions),
            np.array([labels.index(motion.label) for motion in motions if motion.label is not None], dtype=np.intp),
            np.concatenate([[0], np.cumsum([len(part) for part in q])]).astype(np.int64),
            np.vstack(q),
            np.vstack(features),
            np.stack(starts),
        )

    def without(self, name: str) -> Exemplars:
        """Return all but one motion."""
        k = self.names.index(name)
        kept = np.ones(len(self.q), dtype=np.bool_)
        kept[self.first[k] : self.first[k + 1]] = False
        size = np.delete(np.diff(self.first), k)
        return Exemplars(
            self.names[:k] + self.names[k + 1 :],
            np.delete(self.label, k),
            np.concatenate([[0], np.cumsum(size)]).astype(np.int64),
            self.q[kept],
            self.features[kept],
            np.delete(self.start_pose, k, axis=0),
        )

    @cached_property
    def motion(self) -> NDArray[np.intp]:
        """(M,) number of the motion each posture belongs to."""
        return np.repeat(np.arange(len(self.names)), np.diff(self.first))


@dataclass(frozen=True, eq=False)
class ForestModel:
    """A trained reach forest: immutable.

    Attributes:
        config: settings it was trained with.
        labels: C class labels.
        exemplars: what it was trained on.
        trees: what was grown.
        forest: the trees joined, with their votes (`joined`).
        calibration: from votes to probabilities.
        novelty: from distances to the probability of no class.
        place: where the library's people stand.
    """

    config: ForestSettings
    labels: tuple[int, ...]
    exemplars: Exemplars
    trees: tuple[Tree, ...]
    forest: Forest
    calibration: Calibration
    novelty: Novelty
    place: StandingPlace

    @cached_property
    def motion_distances(self) -> Float32Array:
        """Distances between the exemplars' motions (`novelty.motion_distances`)."""
        return motion_distances(self.exemplars.features, self.exemplars.first)

    @cached_property
    def leaf_members(self) -> tuple[NDArray[np.int64], IntArray]:
        """Which exemplar postures fall into which leaf: (n_nodes + 1,) where each node's begin, and their numbers.

        All of them, also those a tree did not learn from: they are samples of the leaf's region like the others.
        """
        leaves = self.forest.sample_leaves
        n_nodes = len(self.forest.feature)
        begin = np.concatenate([[0], np.cumsum(np.bincount(leaves.ravel(), minlength=n_nodes))])
        order = np.argsort(leaves, axis=None, kind="stable")
        return begin.astype(np.int64), (order // self.forest.n_trees).astype(np.int32)


def fit_forest(library: MotionLibrary, human: HumanModel, config: ForestSettings) -> ForestModel:
    """Learn from a library; the same library, settings and seed give the same model.

    Raises:
        LibraryFormatError: motions without a label, one class only, a class of one motion, or one that does not move.
        HumanModelError: a library of other DoFs than the human's.
    """
    check_trainable(library)
    human.check_dofs(library.dof_names)
    exemplars = Exemplars.of_motions(library.motions, library.labels, human, config.n_postures)
    learned = drawn_motions(exemplars.names, config)
    trees = [_grow(exemplars, learned[:, b], b, config) for b in range(config.n_trees)]
    return _finished(library.labels, exemplars, trees, config)


def refit_without(model: ForestModel, name: str) -> ForestModel:
    """Return what `fit_forest` would without one motion: only trees that had learned from it are grown anew."""
    exemplars, config = model.exemplars.without(name), model.config
    before = drawn_motions(model.exemplars.names, config)
    learned = drawn_motions(exemplars.names, config)
    k = model.exemplars.names.index(name)
    changed = before[k] | (np.delete(before, k, axis=0) != learned).any(axis=0)
    trees = [_grow(exemplars, learned[:, b], b, config) if changed[b] else tree for b, tree in enumerate(model.trees)]
    distances = distances_without(model.motion_distances, model.exemplars.first, k)
    return _finished(model.labels, exemplars, trees, config, distances)


def drawn_motions(names: tuple[str, ...], config: ForestSettings) -> NDArray[np.bool_]:
    """Return (K, B) which motions each tree learns from: a motion's lot does not depend on the other motions."""
    lots = [np.random.default_rng([config.seed, *name.encode()]).random(config.n_trees) for name in names]
    drawn: NDArray[np.bool_] = np.array(lots) < config.motion_share
    drawn[:, ~drawn.any(axis=0)] = True  # of very few motions none may be drawn; better then to learn from all
    return drawn


def _grow(exemplars: Exemplars, drawn: NDArray[np.bool_], b: int, config: ForestSettings) -> Tree:
    mine = drawn[exemplars.motion]
    label = exemplars.label[exemplars.motion][mine]
    return grow_tree(exemplars.features[mine], label, config.seed + b, config)


def joined(labels: tuple[int, ...], exemplars: Exemplars, trees: Sequence[Tree], config: ForestSettings) -> Forest:
    """Return the forest of trees that were grown on these exemplars.

    Raises:
        ArrayError: another number of trees than the settings say, or classes without exemplars.
    """
    if len(trees) != config.n_trees or set(exemplars.label) != set(range(len(labels))):
        raise ArrayError(
            f"reach forest: wanted {config.n_trees} trees and exemplars of each of the {len(labels)} classes, "
            f"got {len(trees)} and those of classes {sorted(set(exemplars.label))}"
        )
    learned = drawn_motions(exemplars.names, config)[exemplars.motion]
    return Forest.of_trees(trees, exemplars.features, exemplars.label[exemplars.motion], learned, len(labels))


def _finished(
    labels: tuple[int, ...],
    exemplars: Exemplars,
    trees: list[Tree],
    config: ForestSettings,
    distances: Float32Array | None = None,
) -> ForestModel:
    forest = joined(labels, exemplars, trees, config)
    label = exemplars.label[exemplars.motion]
    learned = drawn_motions(exemplars.names, config)[exemplars.motion]
    some = slice(None, None, 4)  # neighbours say the same, and calibration has five parameters
    votes = forest.vote(forest.sample_leaves[some], ~learned[some])
    reached_m = exemplars.features[some, REACHED].astype(np.float64)
    return ForestModel(
        config,
        labels,
        exemplars,
        tuple(trees),
        forest,
        Calibration.fit(votes, reached_m, label[some]),
        Novelty.fit(exemplars.features, exemplars.first, exemplars.label, distances),
        StandingPlace.of_starts(exemplars.start_pose),
    )
