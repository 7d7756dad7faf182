"""How far the arm is from what it must not touch: the verdict on goals, plans and executed trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.chain import BodySpheres
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.shapes import Obstacle
from humanpred_ros.robot.pr2 import Pr2Arm


@dataclass(frozen=True)
class Approach:
    """Where the arm comes closest to an obstacle.

    Attributes:
        link: name of the link, as in the URDF.
        obstacle: name of the obstacle.
        clearance_m: distance between their surfaces, negative where they overlap.
    """

    link: str
    obstacle: str
    clearance_m: float


def arm_clearance(arm: Pr2Arm, spheres: BodySpheres, field: SignedDistanceField, q: FloatArray) -> FloatArray:
    """Return the least signed clearance of each configuration of a trajectory.

    Spheres cover the meshes, so the true clearance is never less, apart from the field's interpolation
    error. It may be more: the spheres stick out by 8 mm on average and 0.06 m at most.

    Args:
        q: (T, 7) configurations in rad.

    Returns:
        (T,) metres, negative in collision.
    """
    q = checked("robot trajectory", q, ("T", arm.chain.n_joints))
    clearance: FloatArray = field.distance(spheres.world_m(arm.chain, q)) - spheres.radius_m
    least: FloatArray = clearance.min(axis=1)
    return least


def nearest_approach(arm: Pr2Arm, spheres: BodySpheres, obstacles: Sequence[Obstacle], q: FloatArray) -> Approach:
    """Return where the arm at configuration `q` (7,) comes closest to the obstacles, exactly (no grid)."""
    return nearest_approaches(arm, spheres, obstacles, checked("configuration", q, (arm.chain.n_joints,))[None])[0]


def nearest_approaches(
    arm: Pr2Arm, spheres: BodySpheres, obstacles: Sequence[Obstacle], q: FloatArray
) -> tuple[Approach, ...]:
    """Return where the arm comes closest to the obstacles at each of the configurations `q` (N, 7), exactly."""
    q = checked("configurations", q, ("N", arm.chain.n_joints))
    if not obstacles:
        raise ArrayError("nearest approach: wanted at least one obstacle, got none")
    centres = spheres.world_m(arm.chain, q)
    clearance = np.stack([obstacle.shape.distance(centres) for obstacle in obstacles], axis=1) - spheres.radius_m
    found = []
    for one in clearance:
        which, sphere = divmod(int(np.argmin(one)), len(spheres))
        found.append(Approach(arm.link_names[spheres.link[sphere]], obstacles[which].name, float(one[which, sphere])))
    return tuple(found)
