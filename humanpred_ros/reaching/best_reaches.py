"""How the whole body would reach for a place: what the reach seen is compared with, point by point.

A hand alone is much the same for many places at first; shoulder and neck show earlier whether somebody leans or turns.
The best reach leads straight from the start posture to the one in which reaches to that place end (`end_postures`), in
the space of postures, as minimum jerk does; how fast it is passed through does not matter here.
"""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.recognition.reach_features import POINTS, point_links

#: Postures along a best reach, start and end among them: each point stays within 2 mm of the curve they stand for.
N_ALONG = 13

_N_POINTS = len(POINTS)
_SHARES = np.linspace(0.0, 1.0, N_ALONG)[:, None]


def best_reach(human: HumanModel, ends: EndPostures, start_q: FloatArray, place_m: FloatArray) -> FloatArray:
    """Return where palm, elbow, shoulder and neck are along the best reach to a place.

    Args:
        human: whose reach it is.
        ends: in which posture reaches end.
        start_q: (D,) the posture it begins in.
        place_m: (3,) where the palm goes, tracker's frame.

    Returns:
        (N_ALONG, 12) the coordinates of the four points, one after the other, metres, tracker's frame.
    """
    end_q = ends.mean(start_q, place_m)
    poses = human.link_poses(start_q + _SHARES * (end_q - start_q))
    points: FloatArray = poses[:, point_links(human)][..., :3, 3].reshape(N_ALONG, -1)
    return points


@exact
def distances_from(path: FloatArray, points: FloatArray) -> FloatArray:
    """Return (N,) how far four points (N, 12) are, all in all, from where they are at the path's nearest moment, m."""
    out = np.empty(len(points))
    for n in range(len(points)):
        nearest, found = np.inf, 0.0
        for k in range(len(path) - 1):
            size = ahead = 0.0
            for i in range(3 * _N_POINTS):
                step = path[k + 1, i] - path[k, i]
                size += step * step
                ahead += step * (points[n, i] - path[k, i])
            share = min(max(ahead / size, 0.0), 1.0) if size > 0.0 else 0.0
            squares = total = 0.0
            for p in range(_N_POINTS):
                square = 0.0
                for i in range(3 * p, 3 * p + 3):
                    away = points[n, i] - path[k, i] - share * (path[k + 1, i] - path[k, i])
                    square += away * away
                squares += square
                total += np.sqrt(square)
            if squares < nearest:
                nearest, found = squares, total
        out[n] = found
    return out
