"""Warm starts: an old path is not thrown away because the robot has moved off its beginning (P1 V-C).

The robot will be at q_t when the new plan takes over. A straight segment leads from there onto the old path;
the farther along it lands, the more of the detour the robot has already made unnecessary is cut off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.planning.timing.path import path_integral, path_parameter, point_at, resampled
from humanpred_ros.stomp.costs import CostTerm, HumanOccupancyCost, as_batch

#: Configurations a candidate segment is checked at.
SEGMENT_WAYPOINTS = 16


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
    weights: ArrayLike,
    step: float = 0.01,
    n_waypoints: int = 100,
    length_weight: float = 0.002,
) -> Reconnection:
    """Return the old path reached from q_t by a straight segment (P1 V-C; facts section 4).

    Segments to the old path at parameters 0, d, 2d, ... and to its end are tried. Of those whose every
    configuration is allowed and whose cost is at most that of the part of the old path they replace, the one
    that lands farthest along is kept. If there is none, the allowed one whose landing point is closest.

    Args:
        q_t: (D,) configuration the robot will have.
        old_path: (M, D) path to the same goal from an earlier step.
        terms: what may forbid configurations; the human term among them, if any, is what segments cost,
            integrated over configuration distance, plus `length_weight` per unit of distance.
        weights: (D,) of the configuration distance.
        step: d, in configuration distance (the authors' 0.05 per replanning step, divided by 5).
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
    human = np.zeros(batch.shape[:2])
    for term in terms:
        values, valid = term.evaluate(batch)
        if valid is not None:
            allowed &= valid.all(axis=1)
        if isinstance(term, HumanOccupancyCost):
            human = values.astype(np.float64)
    cost = path_integral(human, segments, weights) + length_weight * _lengths(start, landing, weights)
    replaced = _cost_up_to(at, old, along, terms, weights) + length_weight * at

    cheaper = np.flatnonzero(allowed & (cost <= replaced))
    distance = _lengths(start, landing, weights)
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


def _lengths(start: FloatArray, landing: FloatArray, weights: ArrayLike) -> FloatArray:
    lengths: FloatArray = np.linalg.norm((landing - start) * np.asarray(weights), axis=1)
    return lengths


def _cost_up_to(
    at: FloatArray, old: FloatArray, along: FloatArray, terms: Sequence[CostTerm], weights: ArrayLike
) -> FloatArray:
    """Return the integral of human cost over the old path from its start to each parameter."""
    human = np.zeros(len(old))
    for term in terms:
        if isinstance(term, HumanOccupancyCost):
            human = term.evaluate(as_batch(old[None]))[0][0].astype(np.float64)
    so_far = np.concatenate([[0.0], np.cumsum(0.5 * (human[1:] + human[:-1]) * np.diff(along))])
    up_to: FloatArray = np.interp(at, along, so_far)
    return up_to
