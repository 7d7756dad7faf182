"""A path a robot can follow without stopping at every waypoint: the waypoints rounded off into a cubic B-spline.

A polyline has corners, and a corner can only be passed at rest. A B-spline with points of the path as control
points is twice differentiable, keeps the ends exactly, stays within any box the path stays in (so within the
joint limits), and departs from the path by a fraction of the distance between control points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.planning.timing.path import path_parameter, point_at

#: More control points follow corners more closely and take them more slowly.
CONTROL_POINTS = 40
NODES = 161


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
