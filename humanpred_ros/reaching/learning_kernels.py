"""The compiled parts of learning: smooth noise by a banded solve, and the loss of P2.

Narrow bands and thin products are five times as fast here as in a linear-algebra library, whose threads cost more than
they gain.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import fast

#: Columns that are solved together, so that a band's rows stay in the cache: 8 rows of 16 kB.
_TOGETHER = 2048


@fast
def solve_upper(factor: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Write U^-1 x to `out` (R, N, L), x (N, R * L) is overwritten; U (N, N) in LAPACK's upper bands (K + 1, N)."""
    band, (n, columns), width = len(factor) - 1, x.shape, out.shape[2]
    for first in range(0, columns, _TOGETHER):
        last = min(first + _TOGETHER, columns)
        for i in range(n - 1, -1, -1):
            row = x[i, first:last]
            for k in range(1, min(band, n - 1 - i) + 1):
                known, factor_k = x[i + k, first:last], factor[band - k, i + k]
                for c in range(len(row)):
                    row[c] -= factor_k * known[c]
            inverse = 1.0 / factor[band, i]
            for c in range(len(row)):
                row[c] *= inverse
    for r in range(len(out)):
        for i in range(n):
            for c in range(width):
                out[r, i, c] = x[i, r * width + c]


@fast
def log_sums(
    differences: FloatArray, starts: NDArray[np.int64], w: FloatArray, one_more: bool, gradient: FloatArray
) -> float:
    """Return the sum over blocks of log sum exp(-differences . w), and add its gradient by w to `gradient` (F,).

    Args:
        differences: (M, F) rows of all blocks.
        starts: (B + 1,) first row of each block, and M.
        w: (F,) weights.
        one_more: whether each sum has one more term, exp(0).
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
