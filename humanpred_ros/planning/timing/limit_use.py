"""How much of its limits a trajectory uses between its knots too; asked several times for every plan."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.planning.timing.trajectory import TimedTrajectory

#: Moments looked at per knot: its own and those between it and the next.
MOMENTS = 8


def limit_use(trajectory: TimedTrajectory, v_limit: FloatArray, a_limit: FloatArray) -> FloatArray:
    """Return the largest share of any limit used (T, MOMENTS) at each knot and between it and the next.

    Args:
        v_limit, a_limit: (D,) rad/s and rad/s².
    """
    use: FloatArray = _use(trajectory.t_s, trajectory.q, trajectory.v, trajectory.a, v_limit, a_limit)
    return use


@exact
def _use(
    t: NDArray[Any],
    q: NDArray[Any],
    v: NDArray[Any],
    a: NDArray[Any],
    v_limit: NDArray[Any],
    a_limit: NDArray[Any],
) -> NDArray[Any]:
    use = np.zeros((len(t), MOMENTS))
    for j in range(q.shape[1]):
        per_v, per_a = 1.0 / v_limit[j], 1.0 / a_limit[j]
        for k in range(len(t) - 1):
            h = t[k + 1] - t[k]
            v0, a0 = v[k, j] * h, a[k, j] * h * h
            # The same quintic as `TimedTrajectory.sample`.
            d = q[k + 1, j] - q[k, j] - v0 - 0.5 * a0
            e = v[k + 1, j] * h - v0 - a0
            f = a[k + 1, j] * h * h - a0
            c3, c4, c5 = 10.0 * d - 4.0 * e + 0.5 * f, -15.0 * d + 7.0 * e - f, 6.0 * d - 3.0 * e + 0.5 * f
            for m in range(MOMENTS):
                u = m / MOMENTS
                speed = (v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h
                change = (a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / (h * h)
                use[k, m] = max(use[k, m], max(abs(speed) * per_v, abs(change) * per_a))
        last = len(t) - 1
        use[last, 0] = max(use[last, 0], max(abs(v[last, j]) * per_v, abs(a[last, j]) * per_a))
    return use
