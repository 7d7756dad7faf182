"""How fast a path may be followed under velocity and acceleration limits of every joint, and s(t) from that.

On a path q(s) with ṡ² = x and s̈ = u, the limits read |q' ṡ| <= v and |q' u + q'' x| <= a: linear in (x, u) at
every s. Where something else moves the joints too, a limit may differ between a joint's two directions.
A backward pass finds the largest x from which the rest can still be done (so a stop is always
possible); a forward pass accelerates as much as that allows. Averaged over time, s(t) has no jumps of acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
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


#: Accelerations are averaged over this long, s.
SMOOTHING_S = 0.08


@dataclass(frozen=True)
class Begin:
    """How a path is entered, and with that what the average at the switch looks back on.

    Attributes:
        speed, change: ṡ and s̈ at the switch.
        raw_speed: ṡ before averaging. The average only follows it, so it may not be beyond a limit either.
    """

    speed: float
    change: float
    raw_speed: float

    @classmethod
    def steady(cls, speed: float, change: float) -> Begin:
        """Return one that has been changing at the same rate for a while."""
        return cls(speed, change, speed + 0.5 * change * SMOOTHING_S)

    def slower(self, by: float) -> Begin:
        """Return a gentler one."""
        return Begin(by * self.speed, by * self.change, by * self.raw_speed)

    def below(self, raw_speed: float) -> Begin:
        """Return one of the same speed that does not go on to more than `raw_speed` (or its speed)."""
        raw = max(raw_speed, self.speed)
        return Begin(self.speed, min(self.change, raw / SMOOTHING_S), raw)

    @property
    def _bend(self) -> tuple[float, float]:
        """Coefficients of τ and τ² in ṡ before averaging, on τ = t / `SMOOTHING_S` from -1 to 0.

        Its mean is `speed`, and its rise to `raw_speed` makes the average change by `change`.
        """
        rise = self.change * SMOOTHING_S
        square = 6.0 * (self.raw_speed - self.speed - 0.5 * rise)
        return rise + square, square

    @property
    def lead(self) -> float:
        """Where s is before averaging at the switch, where its average is still 0."""
        slope, square = self._bend
        return SMOOTHING_S * (self.raw_speed / 2.0 - slope / 6.0 + square / 12.0)

    def before(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the integral of s, s and ṡ before averaging, at times (T,) from -`SMOOTHING_S` to 0."""
        slope, square = self._bend
        u = t / SMOOTHING_S
        area = self.lead * t + SMOOTHING_S**2 * u**2 * (self.raw_speed / 2.0 + u * (slope / 6.0 + u * square / 12.0))
        s = self.lead + SMOOTHING_S * u * (self.raw_speed + u * (slope / 2.0 + u * square / 3.0))
        return area, s, self.raw_speed + u * (slope + u * square)

    def node(self, ds: float) -> int:
        """Return the first node after the lead."""
        return int(self.lead / ds) + 1


class AveragedProfile:
    """s(t) of a path followed with x = ṡ² at its nodes, averaged over the last `SMOOTHING_S`."""

    def __init__(self, x: FloatArray, begin: Begin, ds: float) -> None:
        """Take x (M,) at nodes `ds` apart, and how the path begins."""
        first = begin.node(ds)
        #: (M,) when s passes each node before averaging; after averaging it does `SMOOTHING_S` later at most.
        self.node_t_s: FloatArray
        s = np.concatenate([[begin.lead], np.arange(first, len(x)) * ds])
        rate = np.concatenate([[begin.raw_speed], np.sqrt(x[first:])])
        step = 2.0 * np.diff(s) / np.maximum(rate[1:] + rate[:-1], 1e-9)
        at = np.concatenate([[0.0], np.cumsum(step)])
        self.node_t_s = np.concatenate([np.zeros(first), at[1:]])
        keep = np.concatenate([[True], step > 1e-12])
        self._t, self._s, self._rate, step = at[keep], s[keep], rate[keep], step[keep[1:]]
        self._u = np.append(np.diff(self._rate) / step, 0.0)
        pieces = self._s[:-1] * step + self._rate[:-1] * step**2 / 2.0 + self._u[:-1] * step**3 / 6.0
        self._area = np.concatenate([[0.0], np.cumsum(pieces)])
        self._begin = begin
        self.duration_s = float(self._t[-1]) + SMOOTHING_S

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return s, ṡ and s̈ (T,) at times (T,) >= 0."""
        now, before = self._raw(t), self._raw(t - SMOOTHING_S)
        s, rate, acceleration = ((x - y) / SMOOTHING_S for x, y in zip(now, before, strict=True))
        return np.clip(s, 0.0, 1.0), rate, acceleration

    def span(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the stretches of s (T,) to (T,) that the averages at times (T,) look at."""
        ends = self._raw(t - SMOOTHING_S)[1], self._raw(t)[1]
        return np.clip(ends[0], 0.0, 1.0), np.clip(ends[1], 0.0, 1.0)

    def _raw(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the integral of s, s and ṡ; what has been before the start, rest after the end."""
        area, s, rate = np.empty((3, len(t)))
        _pieces(t, self._t, self._s, self._rate, self._u, self._area, area, s, rate)
        early = t < 0.0
        if early.any():
            area[early], s[early], rate[early] = self._begin.before(t[early])
        return area, s, rate


@exact
def _pieces(
    t: NDArray[Any],
    knots: NDArray[Any],
    s: NDArray[Any],
    rate: NDArray[Any],
    u: NDArray[Any],
    area: NDArray[Any],
    area_out: NDArray[Any],
    s_out: NDArray[Any],
    rate_out: NDArray[Any],
) -> None:
    """Write the integral of s, s and ṡ at times (T,), constant acceleration between knots, rest after the last."""
    for i in range(len(t)):
        k = min(max(np.searchsorted(knots, t[i], side="right") - 1, 0), len(knots) - 1)
        d = t[i] - knots[k]
        area_out[i] = area[k] + d * (s[k] + d * (rate[k] / 2.0 + d * u[k] / 6.0))
        s_out[i] = s[k] + d * (rate[k] + d * u[k] / 2.0)
        rate_out[i] = rate[k] + u[k] * d
