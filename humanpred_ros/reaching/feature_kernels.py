"""The compiled sums behind the features of reaches.

`y` are signals (R, N, C) of R reaches with N waypoints: postures, or positions of the wrist. `before` (H, C) came
before the first waypoint; with H = 0 the first waypoint is repeated there. After the last waypoint it is repeated.
"""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact_part, fast

#: How many waypoints a difference rule looks to each side.
REACH = 3


@fast
def differences(y: FloatArray, before: FloatArray, rules: FloatArray, out: FloatArray) -> None:
    """Fill `out` (R, N, 1 + K) with squares summed over C: of the step to the next waypoint, and of K rules (K, 7).

    The last waypoint has no step: 0.
    """
    n_reaches, n, n_signals = y.shape
    padded = np.empty((n + 2 * REACH, n_signals))
    for r in range(n_reaches):
        for i in range(-REACH, n + REACH):
            _fetch(y, before, r, i, padded[i + REACH])
        for i in range(n):
            step = 0.0
            for c in range(n_signals):
                # After the last waypoint comes its copy, so it has no step.
                d = padded[i + REACH + 1, c] - padded[i + REACH, c]
                step += d * d
            out[r, i, 0] = step
            for k in range(len(rules)):
                # Written out, so that the loop over signals is the inner one and is vectorised.
                a0, a1, a2, a3 = rules[k, 0], rules[k, 1], rules[k, 2], rules[k, 3]
                a4, a5, a6 = rules[k, 4], rules[k, 5], rules[k, 6]
                total = 0.0
                for c in range(n_signals):
                    value = (
                        a0 * padded[i, c]
                        + a1 * padded[i + 1, c]
                        + a2 * padded[i + 2, c]
                        + a3 * padded[i + 3, c]
                        + a4 * padded[i + 4, c]
                        + a5 * padded[i + 5, c]
                        + a6 * padded[i + 6, c]
                    )
                    total += value * value
                out[r, i, 1 + k] = total


@exact_part
def _fetch(y: FloatArray, before: FloatArray, r: int, i: int, out: FloatArray) -> None:
    n = y.shape[1]
    if i < 0 and len(before) > 0:
        out[:] = before[len(before) + i]
    else:
        out[:] = y[r, min(max(i, 0), n - 1)]


@fast
def closeness(
    points: FloatArray, partner: FloatArray, height: float, decay: float, cutoff: float, out: FloatArray
) -> None:
    """Fill `out` (M, A * B) with height exp(-decay d), 0 from the cutoff on, d between points (M, A, 3) and (B, 3)."""
    n_other = len(partner)
    for m in range(points.shape[0]):
        for a in range(points.shape[1]):
            for b in range(n_other):
                x = points[m, a, 0] - partner[b, 0]
                y = points[m, a, 1] - partner[b, 1]
                z = points[m, a, 2] - partner[b, 2]
                d = np.sqrt(x * x + y * y + z * z)
                out[m, a * n_other + b] = height * np.exp(-decay * d) if d < cutoff else 0.0
