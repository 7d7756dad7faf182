"""Polylines in configuration space, measured in P1's unit: weighted configuration distance (facts section 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray


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

    The trapezoid rule: sum of (c1 + c2) / 2 x dl (facts section 4, `cs_integral`).
    """
    dl = np.linalg.norm(np.diff(path, axis=-2) * np.asarray(weights, dtype=np.float64), axis=-1)
    integral: FloatArray = (0.5 * (values[..., 1:] + values[..., :-1]) * dl).sum(axis=-1)
    return integral
