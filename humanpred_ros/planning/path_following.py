"""A path with its corners rounded off, and how fast it may be followed under limits of every joint.

A corner can only be passed at rest. A cubic B-spline with points of the path as control points is twice differentiable,
keeps the ends exactly, stays within any box the path stays in (so within the joint limits), and departs from the path
by a fraction of the distance between control points.

On a path q(s) with ṡ² = x and s̈ = u, the limits read |q' ṡ| <= v and |q' u + q'' x| <= a: linear in (x, u) at
every s. Where something else moves the joints too, a limit may differ between a joint's two directions.
A backward pass finds the largest x from which the rest can still be done (so a stop is always
possible); a forward pass accelerates as much as that allows. Averaged over time, s(t) has no jumps of acceleration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.planning.path import path_parameter, point_at

#: Control points of a smooth path: more of them follow corners more closely and take them more slowly.
CONTROL_POINTS = 40
#: Places at which limits are looked at, evenly spaced in s, and their distance.
NODES = 161
NODE_STEP = 1.0 / (NODES - 1)
#: Accelerations are averaged over this long, s.
SMOOTHING_S = 0.08
_TINY = 1e-12

_KNOTS = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, CONTROL_POINTS - 2), np.ones(3)])
#: Parameters of the control points, at which a spline reproduces straight lines.
_GREVILLE = (_KNOTS[1:-3] + _KNOTS[2:-2] + _KNOTS[3:-1]) / 3.0


@dataclass(frozen=True)
class SmoothPath:
    """A twice differentiable path q(s), s in [0, 1]."""

    control: FloatArray  #: (C, D) control points
    length: float  #: of the polyline it rounds off, rad; 0 where the path is a single configuration

    @classmethod
    def rounding(cls, waypoints: FloatArray) -> SmoothPath:
        """Round off a polyline (N, D); on a straight one q(s) is even in s."""
        along = path_parameter(waypoints)
        control = point_at(waypoints, along, _GREVILLE * along[-1])
        control[0], control[-1] = waypoints[0], waypoints[-1]
        return cls(control, float(along[-1]))

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Return first and second derivatives (NODES, D) at the nodes."""
        return _basis(1) @ self.control, _basis(2) @ self.control

    def at(self, s: FloatArray) -> FloatArray:
        """Return q and its first and second derivatives, (3, T, D), at `s` (T,)."""
        found: FloatArray = _evaluate(np.asarray(s, dtype=np.float64), _KNOTS, np.ascontiguousarray(self.control))
        return found

    def led_aside(self, by: FloatArray, until: float) -> SmoothPath:
        """Return a path that departs from this one until it is `by` (D,) beside it at s = `until` and beyond.

        Position and both derivatives at the start stay as they are.
        """
        part = np.clip(_GREVILLE / until, 0.0, 1.0)
        part[:3] = 0.0
        part[-3:] = 1.0
        aside = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        return SmoothPath(self.control + aside[:, None] * by, self.length)


@lru_cache(maxsize=2)
def _basis(derivative: int) -> FloatArray:
    """Return a derivative of the basis functions at the nodes, (NODES, CONTROL_POINTS), by de Boor's recursion."""
    basis = np.zeros((NODES, CONTROL_POINTS))
    for row, x in zip(basis, np.linspace(0.0, 1.0, NODES), strict=True):
        k = min(int(np.searchsorted(_KNOTS, x, side="right")) - 1, CONTROL_POINTS - 1)
        values = [1.0, 0.0, 0.0, 0.0]
        for degree in range(1, 4):
            lower, values[0] = list(values), 0.0
            for r in range(1, degree + 1):
                right, left = _KNOTS[k + r], _KNOTS[k + r - degree]
                if degree <= 3 - derivative:
                    part = lower[r - 1] / (right - left)
                    values[r - 1] += part * (right - x)
                    values[r] = part * (x - left)
                else:
                    part = degree * lower[r - 1] / (right - left)
                    values[r - 1] -= part
                    values[r] = part
        row[k - 3 : k + 1] = values
    return basis


@exact
def _evaluate(s: FloatArray, knots: FloatArray, control: FloatArray) -> FloatArray:
    """Return the spline and its derivatives (3, T, D) at s (T,), clipped to [0, 1].

    The basis of degree 3 is built from those of degree 1 and 2, which the derivatives need.
    """
    n = len(control)
    n_spans = n - 3
    basis, out = np.zeros((4, 4)), np.empty((3, len(s), control.shape[1]))
    for i in range(len(s)):
        x = min(max(s[i], 0.0), 1.0)
        k = min(int(x * n_spans), n_spans - 1) + 3
        # Rounding may name the neighbouring span.
        if k > 3 and x < knots[k]:
            k -= 1
        elif k < n - 1 and x >= knots[k + 1]:
            k += 1
        basis[0, 0] = 1.0
        for degree in range(1, 4):
            saved = 0.0
            for r in range(degree):
                right, left = knots[k + r + 1], knots[k + 1 - degree + r]
                part = basis[degree - 1, r] / (right - left)
                basis[degree, r] = saved + (right - x) * part
                saved = (x - left) * part
            basis[degree, degree] = saved
        for j in range(control.shape[1]):
            c0, c1, c2, c3 = control[k - 3, j], control[k - 2, j], control[k - 1, j], control[k, j]
            out[0, i, j] = basis[3, 0] * c0 + basis[3, 1] * c1 + basis[3, 2] * c2 + basis[3, 3] * c3
            e0 = 3.0 * (c1 - c0) / (knots[k + 1] - knots[k - 2])
            e1 = 3.0 * (c2 - c1) / (knots[k + 2] - knots[k - 1])
            e2 = 3.0 * (c3 - c2) / (knots[k + 3] - knots[k])
            out[1, i, j] = basis[2, 0] * e0 + basis[2, 1] * e1 + basis[2, 2] * e2
            f0 = 2.0 * (e1 - e0) / (knots[k + 1] - knots[k - 1])
            f1 = 2.0 * (e2 - e1) / (knots[k + 2] - knots[k])
            out[2, i, j] = basis[1, 0] * f0 + basis[1, 1] * f1
    return out


class PathLimits(NamedTuple):
    """Limits (M, D) that the path may use at each node, below and above 0."""

    v_low: FloatArray
    v_high: FloatArray
    a_low: FloatArray
    a_high: FloatArray


@exact_part
def _range_of_u(d1: FloatArray, d2: FloatArray, a_low: FloatArray, a_high: FloatArray, x: float) -> tuple[float, float]:
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
def controllable(d1: FloatArray, d2: FloatArray, limits: PathLimits, ds: float) -> FloatArray:
    """Return the largest x (M,) at each node from which the path's end can be reached at rest.

    Args:
        d1, d2: (M, D) first and second derivatives of the path by s.
        limits: at each node.
        ds: distance between nodes.
    """
    n, n_joints = d1.shape
    best = np.zeros(n)
    for i in range(n - 2, -1, -1):
        top = np.inf
        for j in range(n_joints):
            if abs(d1[i, j]) > _TINY:
                limit = limits.v_high[i, j] if d1[i, j] > 0.0 else limits.v_low[i, j]
                top = min(top, (limit / d1[i, j]) ** 2)
        # With x = 0 at the next node at the latest: x cannot exceed what the acceleration limits take away.
        low, high = 0.0, min(top, 1e12)
        for step in range(60):
            x = high if step == 0 else 0.5 * (low + high)
            u_low, u_high = _range_of_u(d1[i], d2[i], limits.a_low[i], limits.a_high[i], x)
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
    d1: FloatArray, d2: FloatArray, limits: PathLimits, ds: float, best: FloatArray, first: int, s0: float, x0: float
) -> FloatArray:
    """Return x (M,) of the fastest way to the end from s0 in the interval before node `first`.

    There x is x0, no more than `best` (of `controllable`) at both ends of the interval; x before it is x0 too.
    """
    n = len(best)
    x = np.zeros(n)
    for i in range(first):
        x[i] = x0
    for i in range(first - 1, n - 1):
        step = 2.0 * ((i + 1) * ds - s0) if i == first - 1 else 2.0 * ds
        u_low, u_high = _range_of_u(d1[i], d2[i], limits.a_low[i], limits.a_high[i], x[i])
        u = max(min(u_high, (best[i + 1] - x[i]) / step), max(u_low, -x[i] / step))
        x[i + 1] = min(max(x[i] + step * u, 0.0), best[i + 1])
    return x


@exact
def braking(d1: FloatArray, d2: FloatArray, a_limit: FloatArray, ds: float) -> FloatArray:
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


@dataclass(frozen=True)
class Begin:
    """How a path is entered, and with that what the average at the switch looks back on."""

    speed: float  #: ṡ and s̈ at the switch
    change: float
    raw_speed: float  #: ṡ before averaging. The average only follows it, so it may not be beyond a limit either.

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
    """s(t) of a path followed with x = ṡ² at its nodes, averaged over the last `SMOOTHING_S`.

    Attributes:
        node_t_s: (M,) when s passes each node before averaging; after averaging it does `SMOOTHING_S` later at most.
        duration_s: when the end has been reached.
    """

    def __init__(self, x: FloatArray, begin: Begin, ds: float) -> None:
        """Take x (M,) at nodes `ds` apart, and how the path begins."""
        first = begin.node(ds)
        s = np.concatenate([[begin.lead], np.arange(first, len(x)) * ds])
        rate = np.concatenate([[begin.raw_speed], np.sqrt(x[first:])])
        step = 2.0 * np.diff(s) / np.maximum(rate[1:] + rate[:-1], 1e-9)
        at = np.concatenate([[0.0], np.cumsum(step)])
        self.node_t_s: FloatArray = np.concatenate([np.zeros(first), at[1:]])
        keep = np.concatenate([[True], step > 1e-12])
        at, s, rate, step = at[keep], s[keep], rate[keep], step[keep[1:]]
        u = np.append(np.diff(rate) / step, 0.0)
        pieces = s[:-1] * step + rate[:-1] * step**2 / 2.0 + u[:-1] * step**3 / 6.0
        # Rows: time, s, its rate, its acceleration and its integral, from where on the acceleration is constant.
        self._pieces = np.stack([at, s, rate, u, np.concatenate([[0.0], np.cumsum(pieces)])])
        self._begin = begin
        self.duration_s = float(at[-1]) + SMOOTHING_S

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return s, ṡ and s̈ (T,) at times (T,) >= 0."""
        s, rate, acceleration = (self._raw(t) - self._raw(t - SMOOTHING_S)) / SMOOTHING_S
        return np.clip(s, 0.0, 1.0), rate, acceleration

    def span(self, t: FloatArray) -> FloatArray:
        """Return the stretches of s (2, T), from and to, that the averages at times (T,) look at."""
        ends: FloatArray = np.stack([self._raw(t - SMOOTHING_S)[1], self._raw(t)[1]])
        return np.clip(ends, 0.0, 1.0)

    def _raw(self, t: FloatArray) -> FloatArray:
        """Return the integral of s, s and ṡ before averaging (3, T)."""
        raw: FloatArray = _on_pieces(t, self._pieces)
        early = t < 0.0
        if early.any():
            raw[:, early] = self._begin.before(t[early])
        return raw


@exact
def _on_pieces(t: FloatArray, pieces: FloatArray) -> FloatArray:
    """Return the integral of s, s and ṡ (3, T) at times (T,), at rest after the last piece."""
    out = np.empty((3, len(t)))
    for i in range(len(t)):
        k = min(max(np.searchsorted(pieces[0], t[i], side="right") - 1, 0), pieces.shape[1] - 1)
        s, rate, u, d = pieces[1, k], pieces[2, k], pieces[3, k], t[i] - pieces[0, k]
        out[0, i] = pieces[4, k] + d * (s + d * (rate / 2.0 + d * u / 6.0))
        out[1, i] = s + d * (rate + d * u / 2.0)
        out[2, i] = rate + u * d
    return out
