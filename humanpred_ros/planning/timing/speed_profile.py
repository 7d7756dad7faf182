"""How fast a path may be followed under velocity and acceleration limits of every joint.

On a path q(s) with ṡ² = x and s̈ = u, the limits read |q' ṡ| <= v and |q' u + q'' x| <= a: linear in (x, u) at
every s. Where something else moves the joints too, a limit may differ between a joint's two directions.
A backward pass finds the largest x from which the rest can still be done (so a stop is always
possible); a forward pass accelerates as much as that allows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.compiled import exact, exact_part

_TINY = 1e-12


@exact_part
def _range_of_u(
    d1: NDArray[Any], d2: NDArray[Any], a_low: NDArray[Any], a_high: NDArray[Any], x: float
) -> tuple[float, float]:
    """Return the smallest and largest u that every joint's acceleration limits allow at x."""
    low, high = -np.inf, np.inf
    for j in range(len(d1)):
        slope, offset = d1[j], d2[j] * x
        if abs(slope) < _TINY:
            if offset > a_high[j] or offset < a_low[j]:
                return 1.0, -1.0
            continue
        one, two = (a_low[j] - offset) / slope, (a_high[j] - offset) / slope
        low = max(low, min(one, two))
        high = min(high, max(one, two))
    return low, high


@exact
def controllable(
    d1: NDArray[Any],
    d2: NDArray[Any],
    v_low: NDArray[Any],
    v_high: NDArray[Any],
    a_low: NDArray[Any],
    a_high: NDArray[Any],
    ds: float,
) -> NDArray[Any]:
    """Return the largest x (M,) at each node from which the path's end can be reached at rest.

    Args:
        d1, d2: (M, D) first and second derivatives of the path by s.
        v_low, v_high, a_low, a_high: (M, D) limits at each node, below and above 0.
        ds: distance between nodes.
    """
    n, n_joints = d1.shape
    best = np.zeros(n)
    for i in range(n - 2, -1, -1):
        top = np.inf
        for j in range(n_joints):
            if abs(d1[i, j]) > _TINY:
                limit = v_high[i, j] if d1[i, j] > 0.0 else v_low[i, j]
                top = min(top, (limit / d1[i, j]) ** 2)
        # With x = 0 at the next node at the latest: x cannot exceed what the acceleration limits take away.
        low, high = 0.0, min(top, 1e12)
        for step in range(60):
            x = high if step == 0 else 0.5 * (low + high)
            u_low, u_high = _range_of_u(d1[i], d2[i], a_low[i], a_high[i], x)
            u_low = max(u_low, -x / (2.0 * ds))
            u_high = min(u_high, (best[i + 1] - x) / (2.0 * ds))
            if u_low <= u_high:
                low = x
                if step == 0:
                    break
            else:
                high = x
            if high - low <= 1e-8 * high:
                break
        best[i] = low
    return best


@exact
def fastest(
    d1: NDArray[Any],
    d2: NDArray[Any],
    a_low: NDArray[Any],
    a_high: NDArray[Any],
    ds: float,
    best: NDArray[Any],
    first: int,
    s0: float,
    x0: float,
) -> NDArray[Any]:
    """Return x (M,) of the fastest way to the end from s0 in the interval before node `first`.

    There x is x0, no more than `best` at both ends of the interval; x before it is x0 too.
    """
    n = len(best)
    x = np.zeros(n)
    for i in range(first):
        x[i] = x0
    for i in range(first - 1, n - 1):
        step = 2.0 * ((i + 1) * ds - s0) if i == first - 1 else 2.0 * ds
        u_low, u_high = _range_of_u(d1[i], d2[i], a_low[i], a_high[i], x[i])
        u = max(min(u_high, (best[i + 1] - x[i]) / step), max(u_low, -x[i] / step))
        x[i + 1] = min(max(x[i] + step * u, 0.0), best[i + 1])
    return x


@exact
def braking(d1: NDArray[Any], d2: NDArray[Any], a_limit: NDArray[Any], ds: float) -> NDArray[Any]:
    """Return x (M,) of stopping as soon as possible on a path that is followed at x = 1.

    Following it at x = 1 must be within the limits; then u = 0 is too at every smaller x.
    """
    n = len(d1)
    x = np.zeros(n)
    x[0] = 1.0
    for i in range(n - 1):
        u_low, _ = _range_of_u(d1[i], d2[i], -a_limit[i], a_limit[i], x[i])
        x[i + 1] = max(x[i] + 2.0 * ds * min(u_low, 0.0), 0.0)
    return x
