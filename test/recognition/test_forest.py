"""What is read from flattened trees equals what scikit-learn's trees say."""

from __future__ import annotations

import numpy as np
from sklearn.tree import ExtraTreeClassifier

from humanpred_ros.recognition.forest import Forest, add_resemblance, grow_tree

RNG = np.random.default_rng(0)
X = RNG.normal(size=(400, 6)).astype(np.float32)
LABEL = (X[:, 0] > 0).astype(np.intp) + 2 * (X[:, 1] + X[:, 2] > 0).astype(np.intp)
LEARNED = RNG.random((400, 5)) < 0.6


def grown() -> Forest:
    trees = [grow_tree(X[LEARNED[:, b]], LABEL[LEARNED[:, b]], b, 3) for b in range(5)]
    return Forest.of_trees(trees, X, LABEL, LEARNED, 4)


def test_votes_are_those_of_the_library_that_grew_the_trees() -> None:
    forest, unseen = grown(), RNG.normal(size=(300, 6)).astype(np.float32)
    oracle = np.mean(
        [
            ExtraTreeClassifier(min_samples_leaf=3, max_features="sqrt", random_state=b)
            .fit(X[LEARNED[:, b]], LABEL[LEARNED[:, b]])
            .predict_proba(unseen)
            for b in range(5)
        ],
        axis=0,
    )
    np.testing.assert_allclose(forest.vote(forest.leaves(unseen)), oracle, atol=1e-6)


def test_trees_that_do_not_count_have_no_vote() -> None:
    forest = grown()
    counts = np.zeros((400, 5), dtype=np.bool_)
    counts[:, 3] = True
    counts[7] = False
    votes = forest.vote(forest.sample_leaves, counts)
    np.testing.assert_allclose(votes[0], forest.share[forest.sample_leaves[0, 3]])
    np.testing.assert_array_equal(votes[7], np.full(4, 0.25))


def test_leaves_hold_at_least_as_many_as_asked_and_shares_sum_to_one() -> None:
    forest = grown()
    for tree in range(5):
        _, sizes = np.unique(forest.sample_leaves[LEARNED[:, tree], tree], return_counts=True)
        assert sizes.min() >= 3
    np.testing.assert_allclose(forest.share[forest.sample_leaves.ravel()].sum(axis=1), 1.0, atol=1e-6)


def test_a_sample_resembles_itself_most_and_resemblance_sums_to_one() -> None:
    forest = grown()
    for m in (0, 17, 399):
        weight = np.zeros(400)
        add_resemblance(forest.sample_leaves[m], *forest.leaf_members, weight)
        assert weight.sum() == 1.0 or abs(weight.sum() - 1.0) < 1e-12
        assert weight[m] == weight.max()
