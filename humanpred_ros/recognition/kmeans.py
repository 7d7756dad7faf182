"""k-means gives the EM algorithm of the Gaussian mixtures compact, non-empty clusters to start from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray

#: Lloyd's algorithm ends long before on real motions; EM refines whatever is left.
MAX_ITERATIONS = 100


def kmeans(x: FloatArray, n_clusters: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Partition samples into exactly `n_clusters` non-empty clusters by Lloyd's iterations.

    The seeds are samples drawn at random, as for P1's published models (facts 3), not spread out on purpose.

    Args:
        x: (N, D) samples of which at least `n_clusters` are distinct; features are used as they are, unscaled.
        n_clusters: number of clusters K.
        rng: source of the seeds.

    Returns:
        (N,) cluster number of each sample, 0 to K - 1, each used at least once.
    """
    x = x - x.mean(axis=0)  # distances come from products below, which lose digits far from the origin
    square_norm = np.einsum("nd,nd->n", x, x)
    centres = x[rng.choice(len(x), n_clusters, replace=False)]
    labels = np.full(len(x), -1, dtype=np.int64)
    for _ in range(MAX_ITERATIONS):
        distance = _square_distances(x, square_norm, centres)
        nearest = _without_empty(np.argmin(distance, axis=1), distance, n_clusters)
        if np.array_equal(nearest, labels):
            break
        labels = nearest
        member = np.zeros((n_clusters, len(x)))
        member[labels, np.arange(len(x))] = 1.0
        centres = member @ x / member.sum(axis=1, keepdims=True)
    return labels


def _square_distances(x: FloatArray, square_norm: FloatArray, centres: FloatArray) -> FloatArray:
    """Return (N, K) squared distances; rounding may not make them negative."""
    distance: FloatArray = square_norm[:, None] - 2.0 * (x @ centres.T) + np.einsum("kd,kd->k", centres, centres)
    return np.maximum(distance, 0.0, out=distance)


def _without_empty(labels: NDArray[np.int64], distance: FloatArray, n_clusters: int) -> NDArray[np.int64]:
    """Give every empty cluster the sample that fits its own cluster worst, as a singleton."""
    count = np.bincount(labels, minlength=n_clusters)
    misfit = distance[np.arange(len(labels)), labels]
    for empty in np.flatnonzero(count == 0):
        # A cluster with one member may not be robbed, or the hole would only move.
        worst = int(np.argmax(np.where(count[labels] > 1, misfit, -1.0)))
        count[labels[worst]] -= 1
        labels[worst], count[empty], misfit[worst] = empty, 1, 0.0
    return labels
