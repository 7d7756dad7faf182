"""The distance from points to a human, body by body and point by point: what faster code is compared with."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.human.model import HumanModel


def distances_m(human: HumanModel, q: np.ndarray, points_m: ArrayLike) -> np.ndarray:
    """Return the distance (N,) from points (N, 3) to the human in posture (D,), negative inside a body."""
    points = np.asarray(points_m, dtype=np.float64)
    bodies = zip(human.bodies, human.body_poses(q), strict=True)
    return np.min([body.shape.distance_m((points - T[:3, 3]) @ T[:3, :3]) for body, T in bodies], axis=0)


def least_distance_m(human: HumanModel, q: np.ndarray, points_m: ArrayLike, radii_m: ArrayLike) -> float:
    """Return the least distance from spheres at (N, 3) with radii (N,); negative when they penetrate."""
    return float((distances_m(human, q, points_m) - np.asarray(radii_m)).min())
