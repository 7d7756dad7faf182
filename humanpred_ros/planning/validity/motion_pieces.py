"""Movements as Bézier curves of degree 5, whose control points bound what happens between two moments.

A piece is (6, D): control points of every joint's angle. A joint turns by at most the sum of their steps.
"""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.planning.timing.trajectory import TimedTrajectory


def curves(trajectory: TimedTrajectory, begin_s: float, end_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the control points (K, 6, D) of a stretch of a trajectory, and the times (K + 1,) between them."""
    t = trajectory.t_s
    inner = t[(t > begin_s) & (t < end_s)]
    times = np.concatenate([[begin_s], inner, [end_s]])
    q, v, a = trajectory.sample(times)
    # A part of a quintic is the quintic that agrees with it at both ends. The knots' own numbers are exact;
    # at the very end `sample` gives rest, which is the last knot.
    h = np.diff(times)[:, None]
    q0, v0, a0, q1, v1, a1 = q[:-1], v[:-1] * h, a[:-1] * h * h, q[1:], v[1:] * h, a[1:] * h * h
    controls = [
        q0, q0 + v0 / 5.0, q0 + 0.4 * v0 + a0 / 20.0,
        q1 - 0.4 * v1 + a1 / 20.0, q1 - v1 / 5.0, q1,
    ]  # fmt: skip
    return np.ascontiguousarray(np.stack(controls, axis=1)), times


def lines(points: FloatArray) -> FloatArray:
    """Return the pieces (N - 1, 6, D) of straight lines that join waypoints (N, D)."""
    part = np.linspace(0.0, 1.0, 6)[None, :, None]
    pieces: FloatArray = points[:-1, None] * (1.0 - part) + points[1:, None] * part
    return pieces


def place_on(piece: FloatArray, part: float) -> FloatArray:
    """Return the configuration (D,) at a part of a piece (6, D)."""
    points = piece
    while len(points) > 1:
        points = (1.0 - part) * points[:-1] + part * points[1:]
    place: FloatArray = points[0]
    return place


def halves(pieces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return both halves of pieces (K, 6, D), by de Casteljau."""
    early, late = np.empty_like(pieces), np.empty_like(pieces)
    points = pieces
    for i in range(6):
        early[:, i], late[:, 5 - i] = points[:, 0], points[:, -1]
        points = 0.5 * (points[:, :-1] + points[:, 1:])
    return early, late
