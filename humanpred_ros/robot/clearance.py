"""How far the arm is from obstacles and from a person: the verdict on goals, plans and executed trajectories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError, HumanModelError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.human.model import HumanModel
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


def nearest_approaches(
    arm: Pr2Arm, spheres: BodySpheres, obstacles: Sequence[Obstacle], q: FloatArray
) -> tuple[Approach, ...]:
    """Return where the arm comes closest to the obstacles at each of the configurations `q` (N, 7), exactly."""
    q = checked("configurations", q, ("N", arm.chain.n_joints))
    if not obstacles:
        raise ArrayError("nearest approach: wanted at least one obstacle, got none")
    centres = spheres.world_m(arm.chain, q)
    clearance = np.stack([obstacle.distance_m(centres) for obstacle in obstacles], axis=1) - spheres.radius_m
    found = []
    for one in clearance:
        which, sphere = divmod(int(np.argmin(one)), len(spheres))
        found.append(Approach(arm.link_names[spheres.link[sphere]], obstacles[which].name, float(one[which, sphere])))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Separation:
    """Least distance between arm and person at each of T moments.

    Attributes:
        distance_m: (T,) negative where they penetrate.
        part: (T,) number of the arm's sphere or point that is closest.
        body: (T,) number of the human's body it is closest to.
    """

    distance_m: FloatArray
    part: NDArray[np.int64]
    body: NDArray[np.int64]

    @property
    def least_m(self) -> float:
        """The least of all."""
        return float(self.distance_m.min())


class SeparationMeter:
    """Measures the distance between an arm and a human in given postures; what does not change is made once."""

    def __init__(self, arm: Pr2Arm, human: HumanModel, T_world_human: FloatArray, postures: FloatArray) -> None:
        """Take T postures (T, D) in the tracker's frame, placed in the world by `T_world_human` (4, 4).

        Raises:
            HumanModelError: postures of another shape, or a model without bodies.
        """
        if not human.bodies:
            raise HumanModelError(f"distance to {human.name}: wanted a model with at least one <collision>, got none")
        self.arm, self.human = arm, human
        self._spheres = arm.spheres()
        self._points = arm.body_points()
        poses = np.asarray(T_world_human) @ human.body_poses(postures)  # (T, B, 4, 4)
        self._R, self._p = poses[..., :3, :3], poses[..., :3, 3]

    def __len__(self) -> int:
        return len(self._p)

    def measure(self, q: FloatArray) -> Separation:
        """Return the distances (T,) from the arm at configurations (T, J) to the human in the T postures.

        Spheres that contain the arm's links stand for it, so the true distance is never smaller.
        """
        return self._distances(self._spheres, self._spheres.radius_m, q)

    def measure_surface(self, q: FloatArray) -> Separation:
        """Return the same for points on the arm's surface: the true distance is never larger."""
        return self._distances(self._points, np.zeros(len(self._points)), q)

    def _distances(self, parts: BodySpheres | BodyPoints, radius_m: FloatArray, q: FloatArray) -> Separation:
        q = checked("arm configurations", q, (len(self), self.arm.chain.n_joints))
        world = parts.world_m(self.arm.chain, q)  # (T, S, 3)
        least = np.empty((len(q), len(self.human.bodies), world.shape[1]))
        for b, body in enumerate(self.human.bodies):
            local = (world - self._p[:, b, None]) @ self._R[:, b]
            least[:, b] = body.shape.distance_m(local.reshape(-1, 3)).reshape(local.shape[:2]) - radius_m
        flat = least.reshape(len(q), -1)
        where = flat.argmin(axis=1)
        body_number, part = np.unravel_index(where, least.shape[1:])
        return Separation(flat[np.arange(len(q)), where], part.astype(np.int64), body_number.astype(np.int64))
