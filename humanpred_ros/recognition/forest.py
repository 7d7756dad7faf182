"""Extremely randomised trees (Geurts, Ernst and Wehenkel 2006), each grown on some of the library's motions.

scikit-learn grows them; what it grew is kept as plain arrays, which a compiled loop reads in microseconds and a model
file can hold. Motions, not postures, are drawn: the postures of one motion resemble each other, so only a tree that has
seen no posture of a motion can tell how well the forest does on motions it does not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.recognition.forest_config import ForestSettings
from humanpred_ros.recognition.reach_features import Float32Array

IntArray = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Tree:
    """One tree of N nodes; the root is node 0.

    Attributes:
        feature: (N,) which feature a node asks for; -1 for a leaf.
        threshold: (N,) left if the feature is at most this.
        left, right: (N,) numbers of the nodes below; 0 for a leaf.
    """

    feature: IntArray
    threshold: FloatArray
    left: IntArray
    right: IntArray


@dataclass(frozen=True, eq=False)
class Forest:
    """B trees in one set of arrays, nodes numbered through.

    Attributes:
        first: (B + 1,) where each tree's nodes begin; the first of them is its root.
        feature, threshold, left, right: of all N nodes, as in `Tree`.
        share: (N, C) share of each class among the samples that a leaf's tree has learned from.
        sample_leaves: (M, B) the leaf each sample falls into, whether its tree has learned from it or not.
    """

    first: IntArray
    feature: IntArray
    threshold: FloatArray
    left: IntArray
    right: IntArray
    share: Float32Array
    sample_leaves: IntArray

    @classmethod
    def of_trees(
        cls, trees: Sequence[Tree], x: Float32Array, label: NDArray[np.intp], learned: NDArray[np.bool_], n_classes: int
    ) -> Forest:
        """Join trees, and count in their leaves the samples (M, F) of classes (M,) they have `learned` from (M, B)."""
        first = np.concatenate([[0], np.cumsum([len(tree.feature) for tree in trees])]).astype(np.int32)
        shift = np.repeat(first[:-1], np.diff(first))
        feature = np.concatenate([tree.feature for tree in trees])
        threshold = np.concatenate([tree.threshold for tree in trees])
        left = np.concatenate([tree.left for tree in trees]) + shift
        right = np.concatenate([tree.right for tree in trees]) + shift
        leaves = np.empty((len(x), len(trees)), dtype=np.int32)
        _find_leaves(x, first, feature, threshold, left, right, leaves)
        share = _leaf_shares(leaves, learned, label, len(feature), n_classes)
        return cls(first, feature, threshold, left, right, share, leaves)

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


def grow_tree(x: Float32Array, label: NDArray[np.intp], seed: int, config: ForestSettings) -> Tree:
    """Return a tree grown on samples (M, F) of the classes `label` (M,).

    The same samples and seed give the same tree.
    """
    from sklearn.tree import ExtraTreeClassifier  # takes half a second to import; only training needs it

    grown = ExtraTreeClassifier(min_samples_leaf=config.min_samples_leaf, max_features="sqrt", random_state=seed).fit(
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
            node = first[tree]
            while feature[node] >= 0:
                node = left[node] if x[m, feature[node]] <= threshold[node] else right[node]
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
