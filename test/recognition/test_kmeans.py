"""k-means: every cluster has members, and clusters that are there are found."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.recognition.kmeans import _without_empty, kmeans


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    n_clusters=st.integers(1, 12),
    copies=st.integers(1, 5),
    offset=st.sampled_from([0.0, 1e4]),
)
def test_every_cluster_has_members_even_among_copies(seed: int, n_clusters: int, copies: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    distinct = rng.normal(size=(n_clusters, 2)) + offset
    x = np.repeat(distinct, copies, axis=0)
    labels = kmeans(x, n_clusters, rng)
    assert sorted(set(labels.tolist())) == list(range(n_clusters))


def test_well_separated_clusters_are_found_from_some_seeds() -> None:
    rng = np.random.default_rng(3)
    truth = np.repeat(np.arange(5), 40)
    x = rng.normal(scale=0.05, size=(200, 3)) + np.eye(5)[truth, :3] * 10 + truth[:, None]
    pure = 0
    for _ in range(20):
        labels = kmeans(x, 5, rng)
        pure += all(len(set(truth[labels == k].tolist())) == 1 for k in range(5))
    assert pure >= 1


def test_result_follows_from_the_generator() -> None:
    x = np.random.default_rng(0).normal(size=(100, 4))
    first, second = (kmeans(x, 7, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_each_sample_is_with_its_nearest_centre_at_the_end() -> None:
    x = np.random.default_rng(1).normal(size=(300, 2))
    labels = kmeans(x, 6, np.random.default_rng(2))
    centres = np.stack([x[labels == k].mean(axis=0) for k in range(6)])
    nearest = np.argmin(np.linalg.norm(x[:, None] - centres, axis=2), axis=1)
    np.testing.assert_array_equal(labels, nearest)


def test_an_empty_cluster_never_robs_a_singleton() -> None:
    distance = np.array([[1.0, 50.0, 60.0], [2.0, 50.0, 60.0], [50.0, 40.0, 60.0]])
    np.testing.assert_array_equal(_without_empty(np.array([0, 0, 1]), distance, 3), [0, 2, 1])
