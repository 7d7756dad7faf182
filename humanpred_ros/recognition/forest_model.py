"""What the reach forest learns from a library, as one immutable object that a file can hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.checks import FloatArray, frozen
from humanpred_ros.errors import ArrayError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.resampling import unwrap_angles
from humanpred_ros.recognition.calibration import Calibration
from humanpred_ros.recognition.class_mixtures import check_trainable
from humanpred_ros.recognition.forest import Forest, IntArray, Tree, grow_tree
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.novelty import Novelty
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
        calibration: from votes to probabilities.
        novelty: from distances to the probability of no class.
        place: where the library's people stand.
    """

    config: ForestConfig
    labels: tuple[int, ...]
    exemplars: Exemplars
    trees: tuple[Tree, ...]
    calibration: Calibration
    novelty: Novelty
    place: StandingPlace
    forest: Forest = field(init=False)

    def __post_init__(self) -> None:
        if {tree.share.shape[1] for tree in self.trees} != {len(self.labels)}:
            raise ArrayError(f"reach forest: wanted trees over the {len(self.labels)} classes {self.labels}")
        object.__setattr__(self, "forest", Forest.of_trees(list(self.trees)))

    @cached_property
    def leaf_members(self) -> tuple[NDArray[np.int64], IntArray]:
        """Which exemplar postures fall into which leaf: (n_nodes + 1,) where each node's begin, and their numbers.

        All of them, also those a tree did not learn from: they are samples of the leaf's region like the others.
        """
        leaves = self.forest.leaves(self.exemplars.features)
        n_nodes = len(self.forest.feature)
        begin = np.concatenate([[0], np.cumsum(np.bincount(leaves.ravel(), minlength=n_nodes))])
        order = np.argsort(leaves, axis=None, kind="stable")
        return begin.astype(np.int64), (order // self.forest.n_trees).astype(np.int32)


def fit_forest(library: MotionLibrary, human: HumanModel, config: ForestConfig) -> ForestModel:
    """Learn from a library; the same library, settings and seed give the same model.

    Raises:
        LibraryFormatError: motions without a label, one class only, a class of one motion, or one that does not move.
        HumanModelError: a library of other DoFs than the human's.
    """
    check_trainable(library)
    human.check_dofs(library.dof_names)
    exemplars = Exemplars.of_motions(library.motions, library.labels, human, config.n_postures)
    drawn = _drawn(exemplars.names, config)
    trees = [_grow(exemplars, drawn[:, b], len(library.labels), b, config) for b in range(config.n_trees)]
    return _finished(library.labels, exemplars, drawn, trees, config)


def refit_without(model: ForestModel, name: str) -> ForestModel:
    """Return what `fit_forest` would without one motion: only trees that had seen it are grown anew."""
    exemplars, config = model.exemplars.without(name), model.config
    had_seen = _drawn((name,), config)[0]
    drawn = _drawn(exemplars.names, config)
    trees = [
        _grow(exemplars, drawn[:, b], len(model.labels), b, config) if had_seen[b] else tree
        for b, tree in enumerate(model.trees)
    ]
    return _finished(model.labels, exemplars, drawn, trees, config)


def _drawn(names: tuple[str, ...], config: ForestConfig) -> NDArray[np.bool_]:
    """Return (K, B) which motions each tree learns from: a motion's lot does not depend on the other motions."""
    lots = []
    for name in names:
        rng = np.random.default_rng([config.seed, *name.encode()])
        lots.append(rng.random(config.n_trees) < config.motion_share)
    return np.array(lots)


def _grow(exemplars: Exemplars, drawn: NDArray[np.bool_], n_classes: int, b: int, config: ForestConfig) -> Tree:
    if not drawn.any():  # as few motions as that: better a tree that has seen all than none
        drawn = np.ones_like(drawn)
    mine = drawn[exemplars.motion]
    label = exemplars.label[exemplars.motion][mine]
    return grow_tree(exemplars.features[mine], label, n_classes, config.seed + b, config)


def _finished(
    labels: tuple[int, ...],
    exemplars: Exemplars,
    drawn: NDArray[np.bool_],
    trees: list[Tree],
    config: ForestConfig,
) -> ForestModel:
    forest = Forest.of_trees(trees)
    every_other = np.arange(0, len(exemplars.q), 2)  # neighbours say the same; calibration has five parameters
    motion = exemplars.motion[every_other]
    features = exemplars.features[every_other]
    votes = forest.vote(forest.leaves(features), ~drawn[motion])
    return ForestModel(
        config,
        labels,
        exemplars,
        tuple(trees),
        Calibration.fit(votes, features[:, REACHED].astype(np.float64), exemplars.label[motion]),
        Novelty.fit(exemplars.features, exemplars.first, exemplars.label),
        StandingPlace.of_starts(exemplars.start_pose),
    )
