"""How a velocity and an acceleration fade away: every joint for itself and as soon as its limits allow.

A joint's velocity follows the cubic in time that begins with its velocity and acceleration and ends with both
zero; a joint that is speeding up levels off first.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part

#: Time in which a joint that is speeding up stops doing so, s.
_LEVEL_OFF_S = 0.05
#: Stopping times tried per joint; the longest is some three times what braking at the limit takes.
_TIMES = 200


class ComingToRest:
    """The movement from a state to rest.

    Attributes:
        duration_s: when the last joint has come to rest.
        way: (D,) what each joint has moved by then, rad.
    """

    def __init__(
        self, v0: FloatArray, a0: FloatArray, v_limit: FloatArray, a_limit: FloatArray, shortest_s: float = 0.0
    ) -> None:
        """Take a state and limits, each (D,), and the least time to take.

        Where the state is beyond the limits already, or accelerates towards the velocity limit, the time
        that exceeds them least is taken.
        """
        self._v0, self._a0 = v0, a0
        # A joint that is speeding up first stops doing so: any gentler change would take it beyond its limit.
        speeding_up = v0 * a0 > 0.0
        self._first = np.where(speeding_up, _LEVEL_OFF_S, 0.0)
        self._v1, self._a1 = v0 + a0 * self._first / 3.0, np.where(speeding_up, 0.0, a0)
        moves = (self._v1 != 0.0) | (self._a1 != 0.0)
        self._then = np.where(moves, _stop_times(self._v1, self._a1, v_limit, a_limit, shortest_s), 0.0)
        self.duration_s = float((self._first + self._then).max())
        self.way: FloatArray = self.at(np.array([self.duration_s]))[0][0]

    def at(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the way made, velocity and acceleration (T, D) at times (T,) >= 0; at rest after the end."""
        q, v, a = np.zeros((3, len(t_s), len(self._v0)))
        _fade(t_s, self._v0, self._a0, self._first, self._v1, self._a1, self._then, q, v, a)
        return q, v, a


@exact
def _fade(
    t_s: NDArray[Any],
    v0: NDArray[Any],
    a0: NDArray[Any],
    first: NDArray[Any],
    v1: NDArray[Any],
    a1: NDArray[Any],
    then: NDArray[Any],
    q: NDArray[Any],
    v: NDArray[Any],
    a: NDArray[Any],
) -> None:
    """Write way, velocity and acceleration (T, D): levelling off for `first` seconds, coming down for `then`."""
    for j in range(len(v0)):
        for i in range(len(t_s)):
            t = t_s[i]
            way, speed, change = 0.0, 0.0, 0.0
            if first[j] > 0.0:
                # The acceleration vanishes as a0 (1 - u)².
                u = min(t / first[j], 1.0)
                w = 1.0 - u
                way = v0[j] * first[j] * u + a0[j] * first[j] ** 2 * (u / 3.0 - (1.0 - w**4) / 12.0)
                speed = v0[j] + a0[j] * first[j] * (1.0 - w**3) / 3.0
                change = a0[j] * w**2
            if t >= first[j] and then[j] > 0.0:
                # The velocity is the cubic w² ((1 + 2 u) v1 + u T a1).
                lasts = then[j]
                u = min((t - first[j]) / lasts, 1.0)
                w = 1.0 - u
                way += lasts * v1[j] * u * (1.0 - u**2 + 0.5 * u**3)
                way += lasts**2 * a1[j] * u**2 * (0.5 - 2.0 / 3.0 * u + 0.25 * u**2)
                speed = w**2 * ((1.0 + 2.0 * u) * v1[j] + u * lasts * a1[j])
                change = -6.0 * u * w * v1[j] / lasts + w * (1.0 - 3.0 * u) * a1[j]
            q[i, j], v[i, j], a[i, j] = way, speed, change


@exact_part
def _excess(v0: float, a0: float, lasts: float, v_limit: float, a_limit: float) -> float:
    """Return the largest share of a limit that coming down in `lasts` seconds uses; the state is excused."""
    # Acceleration a0 + b u + c u² and its extremum; the velocity's lies where the acceleration crosses 0.
    b, c = -6.0 * v0 / lasts - 4.0 * a0, 6.0 * v0 / lasts + 3.0 * a0
    peak_a, peak_v = abs(a0), abs(v0)
    if c != 0.0:
        u = -b / (2.0 * c)
        if 0.0 < u < 1.0:
            peak_a = max(peak_a, abs(a0 + b * u + c * u * u))
        u = a0 / c
        if 0.0 < u < 1.0:
            peak_v = max(peak_v, abs((1.0 - u) ** 2 * ((1.0 + 2.0 * u) * v0 + u * lasts * a0)))
    return max(peak_v / max(v_limit, abs(v0)), peak_a / max(a_limit, abs(a0)))


@exact
def _stop_times(
    v0: NDArray[Any], a0: NDArray[Any], v_limit: NDArray[Any], a_limit: NDArray[Any], shortest: float
) -> NDArray[Any]:
    """Return each joint's stopping time (D,): the shortest within the limits, or the one that exceeds them least."""
    times = np.zeros(len(v0))
    for j in range(len(v0)):
        longest = 4.0 * abs(v0[j]) / a_limit[j] + abs(a0[j]) / a_limit[j] + 0.05
        longest = max(longest, 2.0 * shortest)
        begin = max(0.02 * longest, shortest)
        least = np.inf
        for k in range(_TIMES):
            lasts = begin + (longest - begin) * k / (_TIMES - 1)
            over = _excess(v0[j], a0[j], lasts, v_limit[j], a_limit[j])
            if over < least:
                least, times[j] = over, lasts
            if over <= 1.0 + 1e-9:
                break
    return times
