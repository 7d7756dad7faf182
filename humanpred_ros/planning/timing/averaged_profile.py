"""s(t) along a path from its speeds at nodes, averaged over time so that accelerations do not jump."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact

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
