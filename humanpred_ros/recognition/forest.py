"""Extremely randomised trees (Geurts, Ernst and Wehenkel 2006), each grown on some of the library's motions.

scikit-learn grows them; what it grew is kept as plain arrays, which a compiled loop reads in microseconds and a model
file can hold. Motions, not postures, are drawn: the postures of one motion resemble each other, so only a tree that has
seen no posture of a motion can tell how well the forest does on motions it does not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError, SettingsError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, unwrap_angles
from humanpred_ros.recognition.reach_features import N_FEATURES, Float32Array, motion_features, point_links
from humanpred_ros.recognition.standing_place import start_pose
from humanpred_ros.settings import LARGEST_SEED, Settings, setting

IntArray = NDArray[np.int32]
#: The link whose pose says where a person stands.
PELVIS = "pelvis"


class ForestSettings(Settings):
    """Settings of the classifier `forest`."""

    n_trees: int = setting(100, "number of trees; more are slower and not worse", low=1, high=10_000)
    motion_share: float = setting(
        0.632,
        "share of the motions each tree learns from; the others are its test, from which calibration and the "
        "probability of no class are learned",
        low=0.0,
        high=1.0,
    )
    min_samples_leaf: int = setting(3, "postures in a leaf, at least", low=1)
    n_postures: int = setting(50, "postures each motion contributes, evenly spaced", low=2, high=100_000)
    unknown_prior: float = setting(
        0.2,
        "how often a reach is of no class, before anything is seen; a judgement, because a library does not show what "
        "it lacks",
        low=0.0,
        high=1.0,
    )
    seed: int = setting(0, "seed of the motions and splits drawn", low=0, high=LARGEST_SEED)

    def check(self) -> None:
        for name in ("motion_share", "unknown_prior"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise SettingsError(
                    f"ForestSettings {name}: wanted a number between 0 and 1, got {getattr(self, name)}"
                )


@dataclass(frozen=True, eq=False)
class Exemplars:
    """The library as the forest remembers it: some postures of each of K motions, M in all, motion by motion.

    Raises:
        ArrayError: arrays that do not agree on the numbers of motions and postures.
    """

    names: tuple[str, ...]  #: K motion names, `class/index`
    label: NDArray[np.intp]  #: (K,) number of each motion's class
    first: NDArray[np.int64]  #: (K + 1,) where each motion's postures begin
    q: FloatArray  #: (M, D) postures, library frame, angles of a motion continuous
    features: Float32Array  #: (M, N_FEATURES) of the reach up to each posture, library frame
    start_pose: FloatArray  #: (K, 3) x, y and yaw of the pelvis at the start
    duration_s: FloatArray  #: (K,) how long each motion took, s; NaN where that is not known

    def __post_init__(self) -> None:
        n_motions, n_postures = len(self.names), len(self.q)
        if (
            self.label.shape != (n_motions,)
            or self.first.shape != (n_motions + 1,)
            or self.first[0] != 0
            or self.first[-1] != n_postures
            or (np.diff(self.first) < 1).any()
            or self.features.shape != (n_postures, N_FEATURES)
            or self.duration_s.shape != (n_motions,)
        ):
            raise ArrayError("exemplars: wanted arrays that agree on the numbers of motions and postures")
        object.__setattr__(self, "start_pose", checked("exemplars' start poses", self.start_pose, (n_motions, 3)))
        object.__setattr__(self, "duration_s", np.asarray(self.duration_s, dtype=np.float64))
        for name in ("label", "first", "q", "features", "start_pose", "duration_s"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @classmethod
    def of_motions(
        cls, motions: Sequence[Motion], labels: tuple[str, ...], human: HumanModel, n_postures: int
    ) -> Exemplars:
        """Return `n_postures` evenly spaced postures of each motion."""
        links, pelvis = point_links(human), human.link_names.index(PELVIS)
        q, features, starts = [], [], []
        for motion in motions:
            poses = human.link_poses(motion.q)
            kept = evenly_spaced(len(motion), n_postures)
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
            np.array([motion.duration_s for motion in motions]),
        )

    def without(self, name: str) -> Exemplars:
        """Return all but one motion."""
        k = self.names.index(name)
        kept = self.motion != k
        return Exemplars(
            self.names[:k] + self.names[k + 1 :],
            np.delete(self.label, k),
            np.concatenate([[0], np.cumsum(np.delete(np.diff(self.first), k))]).astype(np.int64),
            self.q[kept],
            self.features[kept],
            np.delete(self.start_pose, k, axis=0),
            np.delete(self.duration_s, k),
        )

    @cached_property
    def motion(self) -> NDArray[np.intp]:
        """(M,) number of the motion each posture belongs to."""
        return np.repeat(np.arange(len(self.names)), np.diff(self.first))


def evenly_spaced(n_recorded: int, n_wanted: int) -> NDArray[np.intp]:
    """Return the numbers of `n_wanted` postures of a motion, evenly spaced from first to last; all if it has fewer."""
    return np.round(np.linspace(0, n_recorded - 1, min(n_wanted, n_recorded))).astype(np.intp)


class Tree(NamedTuple):
    """One tree of N nodes; the root is node 0."""

    feature: IntArray  #: (N,) which feature a node asks for; -1 for a leaf
    threshold: FloatArray  #: (N,) left if the feature is at most this
    left: IntArray  #: (N,) numbers of the nodes below; 0 for a leaf
    right: IntArray


def grow_tree(x: Float32Array, label: NDArray[np.intp], seed: int, min_samples_leaf: int) -> Tree:
    """Return a tree grown on samples (M, F) of the classes `label` (M,).

    The same samples and seed give the same tree.
    """
    from sklearn.tree import ExtraTreeClassifier  # takes half a second to import; only training needs it

    grown = ExtraTreeClassifier(min_samples_leaf=min_samples_leaf, max_features="sqrt", random_state=seed).fit(
        np.ascontiguousarray(x, dtype=np.float32), label.astype(np.float64), check_input=False
    )
    nodes = grown.tree_
    leaf = nodes.children_left < 0
    return Tree(
        np.where(leaf, -1, nodes.feature).astype(np.int32),
        np.array(nodes.threshold, dtype=np.float64),
        np.where(leaf, 0, nodes.children_left).astype(np.int32),
        np.where(leaf, 0, nodes.children_right).astype(np.int32),
    )


@dataclass(frozen=True, eq=False)
class Forest:
    """B trees in one set of arrays, one tree after the other."""

    first: IntArray  #: (B + 1,) where each tree's nodes begin; the first of them is its root
    feature: IntArray  #: of all N nodes, as in `Tree`; `left` and `right` count from the tree's root
    threshold: FloatArray
    left: IntArray
    right: IntArray
    share: Float32Array  #: (N, C) share of each class among the samples that a leaf's tree has learned from
    sample_leaves: IntArray  #: (M, B) the leaf each sample falls into, whether its tree has learned from it or not

    @classmethod
    def of_trees(
        cls, trees: Sequence[Tree], x: Float32Array, label: NDArray[np.intp], learned: NDArray[np.bool_], n_classes: int
    ) -> Forest:
        """Join trees, and count in their leaves the samples (M, F) of classes (M,) they have `learned` from (M, B).

        Raises:
            ArrayError: nodes that ask for features there are not, or that lead to no later node of their tree.
        """
        for tree in trees:
            _check_nodes(tree)
        first = np.concatenate([[0], np.cumsum([len(tree.feature) for tree in trees])]).astype(np.int32)
        nodes = Tree(*(np.concatenate(part) for part in zip(*trees, strict=True)))
        leaves = np.empty((len(x), len(trees)), dtype=np.int32)
        x = np.require(x, requirements="W")  # numba compiles once more for what is read-only
        _find_leaves(x, first, *nodes, leaves)
        share = _leaf_shares(leaves, learned, label, len(nodes.feature), n_classes)
        return cls(first, *nodes, share, leaves)

    def tree(self, b: int) -> Tree:
        """Return one tree."""
        return Tree(*(getattr(self, name)[self.first[b] : self.first[b + 1]] for name in Tree._fields))

    @property
    def n_trees(self) -> int:
        """B."""
        return len(self.first) - 1

    def leaves(self, x: Float32Array) -> IntArray:
        """Return (M, B) the leaf each of the samples (M, F) falls into, per tree."""
        out = np.empty((len(x), self.n_trees), dtype=np.int32)
        _find_leaves(x, self.first, self.feature, self.threshold, self.left, self.right, out)
        return out

    def vote(self, leaves: IntArray, counts: NDArray[np.bool_] | None = None) -> FloatArray:
        """Return (M, C) the mean class shares of the leaves (M, B); with `counts` (M, B), of those trees only.

        A sample that no tree counts for gets equal shares.
        """
        return _mean_shares(leaves, np.ones((1, 1), dtype=np.bool_) if counts is None else counts, self.share)

    @cached_property
    def leaf_members(self) -> tuple[NDArray[np.int64], IntArray]:
        """Which samples fall into which leaf: (N + 1,) where each node's begin, and their numbers.

        All of them, also those a tree did not learn from: they are samples of the leaf's region like the others.
        """
        begin = np.concatenate([[0], np.cumsum(np.bincount(self.sample_leaves.ravel(), minlength=len(self.feature)))])
        order = np.argsort(self.sample_leaves, axis=None, kind="stable")
        return begin.astype(np.int64), (order // self.n_trees).astype(np.int32)


def _check_nodes(tree: Tree) -> None:
    """A compiled loop follows these numbers unchecked, without end if one leads back; below a node they must grow."""
    n = len(tree.feature)
    inner, number = tree.feature >= 0, np.arange(n)
    if {part.shape for part in tree} != {(n,)} or n == 0 or (tree.feature >= N_FEATURES).any():
        raise ArrayError("forest: wanted trees whose arrays agree on the number of nodes and features")
    for below in (tree.left, tree.right):
        if (below[inner] <= number[inner]).any() or (below[inner] >= n).any():
            raise ArrayError("forest: wanted trees whose nodes lead to later nodes of the same tree")


@exact
def _find_leaves(
    x: Float32Array,
    first: IntArray,
    feature: IntArray,
    threshold: FloatArray,
    left: IntArray,
    right: IntArray,
    out: IntArray,
) -> None:
    # Tree by tree, so that one tree's nodes stay in the cache while all samples pass.
    for tree in range(len(first) - 1):
        for m in range(len(x)):
            node = root = first[tree]
            while feature[node] >= 0:
                node = root + (left[node] if x[m, feature[node]] <= threshold[node] else right[node])
            out[m, tree] = node


@exact
def _leaf_shares(
    leaves: IntArray, learned: NDArray[np.bool_], label: NDArray[np.intp], n_nodes: int, n_classes: int
) -> Float32Array:
    """Return (N, C) the share of each class among the samples that fall into each node and were learned from."""
    share = np.zeros((n_nodes, n_classes), dtype=np.float32)
    n_samples, n_trees = leaves.shape
    for m in range(n_samples):
        for tree in range(n_trees):
            if learned[m, tree]:
                share[leaves[m, tree], label[m]] += 1.0
    for node in range(n_nodes):
        total = np.float32(0.0)
        for c in range(n_classes):
            total += share[node, c]
        if total > 0:
            for c in range(n_classes):
                share[node, c] /= total
    return share


@exact
def _mean_shares(leaves: IntArray, counts: NDArray[np.bool_], share: Float32Array) -> FloatArray:
    """Return (M, C) mean shares of leaves (M, B) over the trees that count (M, B), or over all for (1, 1)."""
    (n, n_trees), n_classes = leaves.shape, share.shape[1]
    mean = np.zeros((n, n_classes))
    for m in range(n):
        n_votes = 0
        for tree in range(n_trees):
            if counts.size == 1 or counts[m, tree]:
                n_votes += 1
                for c in range(n_classes):
                    mean[m, c] += share[leaves[m, tree], c]
        for c in range(n_classes):
            mean[m, c] = mean[m, c] / n_votes if n_votes else 1.0 / n_classes
    return mean


@exact
def add_resemblance(leaves: IntArray, begin: NDArray[np.int64], members: IntArray, weight: FloatArray) -> None:
    """Add to `weight` (M,) each sample's share of the leaves (B,), whose samples are members[begin[i]:begin[i + 1]]."""
    for leaf in leaves:
        n = begin[leaf + 1] - begin[leaf]
        for k in range(begin[leaf], begin[leaf + 1]):
            weight[members[k]] += 1.0 / (n * len(leaves))
