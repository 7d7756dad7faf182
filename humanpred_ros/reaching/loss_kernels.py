"""The compiled loss of P2's learning: threads of a linear-algebra library cost more than thin products gain."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import fast


@fast
def log_sums(
    differences: FloatArray, starts: NDArray[np.int64], w: FloatArray, one_more: bool, gradient: FloatArray
) -> float:
    """Return the sum over blocks of log sum exp(-differences . w), and add its gradient by w to `gradient` (F,).

    Args:
        differences: (M, F) rows of all blocks.
        starts: (B + 1,) first row of each block, and M.
        w: (F,) weights.
        one_more: whether each sum has one more member, exp(0).
        gradient: (F,), added to.
    """
    n_features = differences.shape[1]
    exponents = np.empty(len(differences))
    part = np.empty(n_features)
    loss = 0.0
    for b in range(len(starts) - 1):
        top = 0.0 if one_more else -1e300
        for m in range(starts[b], starts[b + 1]):
            exponent = 0.0
            for f in range(n_features):
                exponent -= differences[m, f] * w[f]
            exponents[m] = exponent
            top = max(top, exponent)
        total = np.exp(-top) if one_more else 0.0  # the largest is subtracted first, so that nothing overflows
        part[:] = 0.0
        for m in range(starts[b], starts[b + 1]):
            share = np.exp(exponents[m] - top)
            total += share
            for f in range(n_features):
                part[f] += share * differences[m, f]
        for f in range(n_features):
            gradient[f] -= part[f] / total
        loss += top + np.log(total)
    return loss
