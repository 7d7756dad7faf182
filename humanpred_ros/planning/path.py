"""Paths in configuration space: polylines, their reconnection to a robot that has moved on, and their rounding.

Lengths are P1's: weighted configuration distance (docs/papers.md, 1.12).

An old path is not thrown away because the robot has moved off its beginning (P1 V-C): a straight segment leads from
where the robot will be onto the old path. The farther along it lands, the more of a detour that is not needed any more
is cut off.

A polyline has corners, and a corner can only be passed at rest. A cubic B-spline with points of the path as control
points is twice differentiable, keeps the ends exactly, stays within any box the path stays in (so within the
joint limits), and departs from the path by a fraction of the distance between control points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.stomp.costs import CostTerm, as_batch

#: Configurations a candidate segment is checked at.
SEGMENT_WAYPOINTS = 16
#: Control points of a smooth path: more of them follow corners more closely and take them more slowly.
CONTROL_POINTS = 40
NODES = 161


def path_parameter(path: FloatArray, weights: ArrayLike = 1.0) -> FloatArray:
    """Return the weighted length (N,) from the start of a path (N, D) to each of its waypoints.

    Args:
        path: waypoints, rad.
        weights: what a radian of each joint counts, one number or (D,).
    """
    steps = np.linalg.norm(np.diff(path, axis=0) * np.asarray(weights, dtype=np.float64), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def point_at(path: FloatArray, parameter: FloatArray, s: ArrayLike) -> FloatArray:
    """Return the points (..., D) of a path at path parameters `s` (...), given each waypoint's (N,).

    Parameters before the start or beyond the end give the start or the end.
    """
    s = np.asarray(s, dtype=np.float64)
    after = np.clip(np.searchsorted(parameter, s, side="right"), 1, len(parameter) - 1)
    before = after - 1
    step = parameter[after] - parameter[before]
    part = np.divide(s - parameter[before], step, out=np.zeros_like(s), where=step > 0.0)
    part = np.clip(part, 0.0, 1.0)[..., None]
    point: FloatArray = (1.0 - part) * path[before] + part * path[after]
    return point


def resampled(path: FloatArray, n_waypoints: int, weights: ArrayLike = 1.0) -> FloatArray:
    """Return a path as `n_waypoints` waypoints evenly spaced along it; its ends stay exactly where they are."""
    parameter = path_parameter(path, weights)
    even = point_at(path, parameter, np.linspace(0.0, parameter[-1], n_waypoints))
    even[0], even[-1] = path[0], path[-1]
    return even


def straight(start: ArrayLike, goal: ArrayLike, n_waypoints: int) -> FloatArray:
    """Return the straight line (N, D) between two configurations, ends exact."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(goal, dtype=np.float64)
    s = np.linspace(0.0, 1.0, n_waypoints)[:, None]
    line: FloatArray = (1.0 - s) * a + s * b
    return line


def path_integral(values: FloatArray, path: FloatArray, weights: ArrayLike = 1.0) -> FloatArray:
    """Return the integral of `values` (..., N) at the waypoints of paths (..., N, D), over weighted length.

    The trapezoid rule: sum of (c1 + c2) / 2 x dl (docs/papers.md, 1.12).
    """
    dl = np.linalg.norm(np.diff(path, axis=-2) * np.asarray(weights, dtype=np.float64), axis=-1)
    integral: FloatArray = (0.5 * (values[..., 1:] + values[..., :-1]) * dl).sum(axis=-1)
    return integral


@dataclass(frozen=True)
class Reconnection:
    """An old path that begins where the robot will be.

    Attributes:
        path: (N, D) waypoints, evenly spaced; the first is exactly q_t, the last exactly the old goal.
        parameter: where on the old path the segment lands, in configuration distance.
        kind: "cheaper" if the segment costs no more than what it replaces, "closest" if none does,
            "blocked" if every segment is forbidden by some term and the closest is used all the same.
    """

    path: FloatArray
    parameter: float
    kind: str


def reconnect(
    q_t: ArrayLike,
    old_path: ArrayLike,
    terms: Sequence[CostTerm],
    human: CostTerm,
    weights: ArrayLike,
    step: float = 0.01,
    n_waypoints: int = 100,
    length_weight: float = 0.002,
) -> Reconnection:
    """Return the old path reached from q_t by a straight segment (P1 V-C).

    Segments to the old path at parameters 0, d, 2d, ... and to its end are tried. Of those whose every
    configuration is allowed and whose cost is at most that of the part of the old path they replace, the one
    that lands farthest along is kept. If there is none, the allowed one whose landing point is closest.

    Args:
        q_t: (D,) configuration the robot will have.
        old_path: (M, D) path to the same goal from an earlier step.
        terms: what may forbid configurations.
        human: what segments cost, integrated over configuration distance, plus `length_weight` per unit of distance.
        weights: (D,) of the configuration distance.
        step: d, in configuration distance (P1: 0.05 per replanning step, divided by 5).
        n_waypoints: N of the result.
        length_weight: cost of a unit of distance.

    Raises:
        PlanningError: if the shapes do not fit or the step is not positive.
    """
    old = checked("old path", old_path, ("M", "D"), error=PlanningError)
    start = checked("configuration to reconnect", q_t, (old.shape[1],), error=PlanningError)
    if len(old) < 2 or not step > 0.0:
        raise PlanningError(f"reconnection: wanted 2 or more waypoints and a step > 0, got {len(old)} and {step}")
    along = path_parameter(old, weights)
    at = np.append(np.arange(0.0, along[-1], step), along[-1])
    landing = point_at(old, along, at)
    part = np.linspace(0.0, 1.0, SEGMENT_WAYPOINTS)[:, None]
    segments = (1.0 - part) * start + part * landing[:, None, :]

    batch = as_batch(segments)
    allowed = np.ones(len(at), dtype=np.bool_)
    for term in terms:
        valid = None if term is human else term.evaluate(batch)[1]
        if valid is not None:
            allowed &= valid.all(axis=1)
    distance = np.linalg.norm((landing - start) * np.asarray(weights), axis=1)
    cost = path_integral(human.costs(batch).astype(np.float64), segments, weights) + length_weight * distance
    on_old = human.costs(old[None])[0].astype(np.float64)
    so_far = np.concatenate([[0.0], np.cumsum(0.5 * (on_old[1:] + on_old[:-1]) * np.diff(along))])
    replaced = np.interp(at, along, so_far) + length_weight * at

    cheaper = np.flatnonzero(allowed & (cost <= replaced))
    if len(cheaper):
        which, kind = int(cheaper[-1]), "cheaper"
    elif allowed.any():
        which, kind = int(np.argmin(np.where(allowed, distance, np.inf))), "closest"
    else:
        which, kind = int(np.argmin(distance)), "blocked"
    rest = old[along > at[which]]
    joined = np.concatenate([start[None], landing[which][None], rest])
    joined[-1] = old[-1]
    return Reconnection(resampled(joined, n_waypoints, weights), float(at[which]), kind)


@dataclass(frozen=True)
class SmoothPath:
    """A twice differentiable path q(s), s in [0, 1].

    Attributes:
        control: (C, D) control points.
        length: of the polyline it rounds off, rad; 0 where the path is a single configuration.
    """

    control: FloatArray
    length: float

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Return first and second derivatives (NODES, D) at evenly spaced s."""
        _, first, second = _basis(NODES)
        return first @ self.control, second @ self.control

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return q and its first and second derivatives (T, D) at `s` (T,)."""
        q, d1, d2 = np.zeros((3, len(s), self.control.shape[1]))
        _evaluate(np.asarray(s, dtype=np.float64), _knots(), np.ascontiguousarray(self.control), q, d1, d2)
        return q, d1, d2

    def led_aside(self, by: FloatArray, until: float) -> SmoothPath:
        """Return a path that departs from this one until it is `by` (D,) beside it at s = `until` and beyond.

        Position and both derivatives at the start stay as they are.
        """
        part = np.clip(_greville() / until, 0.0, 1.0)
        part[:3] = 0.0
        part[-3:] = 1.0
        aside = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        return SmoothPath(self.control + aside[:, None] * by, self.length)


def smooth_path(waypoints: FloatArray) -> SmoothPath:
    """Round off a polyline (N, D); on a straight one q(s) is even in s."""
    along = path_parameter(waypoints)
    control = point_at(waypoints, along, _greville() * along[-1])
    control[0], control[-1] = waypoints[0], waypoints[-1]
    return SmoothPath(control, float(along[-1]))


@lru_cache(maxsize=1)
def _knots() -> FloatArray:
    inner = np.linspace(0.0, 1.0, CONTROL_POINTS - 2)
    return np.concatenate([np.zeros(3), inner, np.ones(3)])


@lru_cache(maxsize=1)
def _greville() -> FloatArray:
    """Return the parameters of the control points, at which a spline reproduces straight lines."""
    knots = _knots()
    greville: FloatArray = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    return greville


@lru_cache(maxsize=4)
def _basis(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    s = np.linspace(0.0, 1.0, n)
    spline = BSpline(_knots(), np.eye(CONTROL_POINTS), 3)
    return spline(s), spline(s, 1), spline(s, 2)


@exact
def _evaluate(
    s: NDArray[Any],
    knots: NDArray[Any],
    control: NDArray[Any],
    q: NDArray[Any],
    d1: NDArray[Any],
    d2: NDArray[Any],
) -> None:
    """Add the spline and its derivatives (T, D) at s (T,), clipped to [0, 1], to zeros.

    The basis of degree 3 is built from those of degree 1 and 2, which the derivatives need.
    """
    n = len(control)
    n_spans = n - 3
    basis = np.zeros((4, 4))
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
            q[i, j] = basis[3, 0] * c0 + basis[3, 1] * c1 + basis[3, 2] * c2 + basis[3, 3] * c3
            e0 = 3.0 * (c1 - c0) / (knots[k + 1] - knots[k - 2])
            e1 = 3.0 * (c2 - c1) / (knots[k + 2] - knots[k - 1])
            e2 = 3.0 * (c3 - c2) / (knots[k + 3] - knots[k])
            d1[i, j] = basis[2, 0] * e0 + basis[2, 1] * e1 + basis[2, 2] * e2
            f0 = 2.0 * (e1 - e0) / (knots[k + 1] - knots[k - 1])
            f1 = 2.0 * (e2 - e1) / (knots[k + 2] - knots[k])
            d2[i, j] = basis[1, 0] * f0 + basis[1, 1] * f1
