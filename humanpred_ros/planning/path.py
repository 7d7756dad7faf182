"""Paths in configuration space: polylines, and their reconnection to a robot that has moved on.

Lengths are P1's: weighted configuration distance (docs/papers.md, 1.12).

An old path is not thrown away because the robot has moved off its beginning (P1 V-C): a straight segment leads from
where the robot will be onto the old path. The farther along it lands, the more of a detour that is not needed any more
is cut off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.stomp.costs import CostTerm, as_batch

#: Configurations a candidate segment is checked at.
SEGMENT_WAYPOINTS = 16


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
    """An old path that begins where the robot will be."""

    path: FloatArray  #: (N, D) waypoints, evenly spaced; the first is exactly q_t, the last exactly the old goal
    parameter: float  #: where on the old path the segment lands, in configuration distance
    #: "cheaper" if the segment costs no more than what it replaces, "closest" if none does, "blocked" if every segment
    #: is forbidden by some term and the closest is used all the same
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
