"""A path a robot can follow without stopping at every waypoint: the waypoints rounded off into a cubic B-spline.

A polyline has corners, and a corner can only be passed at rest. A B-spline with points of the path as control
points is twice differentiable, keeps the ends exactly, stays within any box the path stays in (so within the
joint limits), and departs from the path by a fraction of the distance between control points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline

from humanpred_ros.checks import FloatArray
from humanpred_ros.planning.path import path_parameter, point_at

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
        spline = BSpline(_knots(), self.control, 3, extrapolate=False)
        inside = np.clip(s, 0.0, 1.0)
        return spline(inside), spline(inside, 1), spline(inside, 2)


def smooth_path(waypoints: FloatArray) -> SmoothPath:
    """Round off a polyline (N, D); on a straight one q(s) is even in s."""
    along = path_parameter(waypoints)
    # At the Greville abscissae a spline reproduces straight lines, parameter included.
    knots = _knots()
    greville = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    control = point_at(waypoints, along, greville * along[-1])
    control[0], control[-1] = waypoints[0], waypoints[-1]
    return SmoothPath(control, float(along[-1]))


@lru_cache(maxsize=1)
def _knots() -> FloatArray:
    inner = np.linspace(0.0, 1.0, CONTROL_POINTS - 2)
    return np.concatenate([np.zeros(3), inner, np.ones(3)])


@lru_cache(maxsize=4)
def _basis(n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    s = np.linspace(0.0, 1.0, n)
    spline = BSpline(_knots(), np.eye(CONTROL_POINTS), 3)
    return spline(s), spline(s, 1), spline(s, 2)
