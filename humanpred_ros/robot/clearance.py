"""How far the arm is from obstacles, from itself and from a person: the verdict on goals, plans and what was executed.

Forearm and hand can be driven into turret, shoulder and upper arm: within the joint limits about one configuration in
twenty does so. Spheres cover the surface of what is outwards of the upper arm, boxes fill what is inwards of the
elbow, so where the meshes overlap, a sphere and a box overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError, HumanModelError
from humanpred_ros.geometry.chain import BodyBoxes, BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.chain_kernels import link_poses
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.pr2 import Pr2Arm

#: Random configurations that decide which bodies are neighbours: those never found apart.
_SAMPLES = 256


@dataclass(frozen=True)
class Approach:
    """Where the arm comes closest to an obstacle."""

    link: str  #: name of the link, as in the URDF
    obstacle: str  #: name of the obstacle
    clearance_m: float  #: distance between their surfaces, negative where they overlap


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


class SelfCollision:
    """Signed clearance between the bodies of one arm.

    Bodies of the same joint or of consecutive joints are never compared, nor are pairs whose covers overlap
    wherever the joints are (forearm against upper arm: the elbow's own limits keep these apart).

    Args:
        chain: the arm's kinematics.
        boxes: fill the inner bodies.
        spheres: cover the outer bodies; those of the same joint as a box, or the next, are left out.
        link_names: the link each joint moves.

    Attributes:
        pairs: (J, J) true where the bodies of joint i (boxes) and joint j (spheres) are compared.
    """

    def __init__(
        self, chain: KinematicChain, boxes: BodyBoxes, spheres: BodySpheres, link_names: tuple[str, ...]
    ) -> None:
        self._link_names = link_names
        n = chain.n_joints
        self._chain = (chain.joints, np.arange(1, n + 1), np.tile(np.eye(4), (n, 1, 1)))
        # Copies, because numba compiles once more for arrays that are read-only.
        self._boxes = (boxes.link.copy(), boxes.local_m.copy(), boxes.half_m.copy())
        self._spheres = (spheres.link.copy(), spheres.local_m.copy(), spheres.radius_m.copy())
        self.pairs = self._pairs(chain)

    @classmethod
    def for_arm(cls, arm: Pr2Arm) -> SelfCollision:
        """Return the clearance of the PR2's right arm from itself; arms of the same URDF share the work."""
        return _shared(arm.urdf)

    def clearance(self, q: ArrayLike) -> FloatArray:
        """Return the least signed clearance of each configuration.

        Args:
            q: (..., J) configurations in rad.

        Returns:
            (...) metres, negative where covers overlap; never more than the meshes' true distance.

        Raises:
            ArrayError: for another last axis or angles that are not finite.
        """
        return self._least(q, self.pairs)[0]

    def nearest(self, q: ArrayLike) -> Approach:
        """Return which outer link (`link`) comes closest to which inner one (`obstacle`) at configuration `q` (J,)."""
        least, sphere, box = self._least(checked("configuration", q, (len(self._link_names),)), self.pairs)
        return Approach(
            link=self._link_names[self._spheres[0][sphere]],
            obstacle=self._link_names[self._boxes[0][box]],
            clearance_m=float(least),
        )

    def _least(self, q: ArrayLike, pairs: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
        """Return least clearances (...) with the numbers of sphere and box (...)."""
        q = np.asarray(q)
        n = len(self._link_names)
        flat = checked("configurations", q.reshape(-1, q.shape[-1]) if q.ndim else q, ("T", n))
        least, sphere, box = np.empty(len(flat)), np.zeros(len(flat), np.int64), np.zeros(len(flat), np.int64)
        poses = link_poses(np.array(flat), *self._chain)
        _least_clearance(poses, *self._boxes, *self._spheres, pairs, least, sphere, box)
        shape = q.shape[:-1]
        return least.reshape(shape), sphere.reshape(shape), box.reshape(shape)

    def _pairs(self, chain: KinematicChain) -> NDArray[np.bool_]:
        """Return the pairs (J, J) of joints whose bodies are worth comparing."""
        lower = np.where(chain.continuous, -np.pi, chain.lower)
        upper = np.where(chain.continuous, np.pi, chain.upper)
        q = np.random.default_rng(0).uniform(lower, upper, (_SAMPLES, chain.n_joints))
        pairs = np.zeros((chain.n_joints, chain.n_joints), np.bool_)
        for inner in sorted(set(self._boxes[0].tolist())):
            for outer in sorted(set(self._spheres[0].tolist())):
                one = np.zeros_like(pairs)
                one[inner, outer] = outer > inner + 1
                pairs |= one & bool((self._least(q, one)[0] > 0.0).any())
        return pairs


@lru_cache(maxsize=2)
def _shared(urdf: Path) -> SelfCollision:
    arm = Pr2Arm(np.eye(4), urdf=urdf)
    return SelfCollision(arm.chain, arm.inner_boxes(), arm.spheres(), arm.link_names)


@exact
def _least_clearance(
    poses: FloatArray,
    box_link: NDArray[np.int64],
    box_centre: FloatArray,
    box_half: FloatArray,
    sphere_link: NDArray[np.int64],
    sphere_centre: FloatArray,
    radius: FloatArray,
    pairs: NDArray[np.bool_],
    least: FloatArray,
    nearest_sphere: NDArray[np.int64],
    nearest_box: NDArray[np.int64],
) -> None:
    """Write the least of all spheres' distances to all boxes of the pairs, per configuration; inf without pairs.

    Args:
        poses: (T, J, 4, 4) of the joints' frames.
    """
    centre, local = np.empty(3), np.empty(3)
    for t in range(len(poses)):
        least[t] = np.inf
        for s in range(len(sphere_link)):
            outer = poses[t, sphere_link[s]]
            for a in range(3):
                centre[a] = outer[a, 3]
                for b in range(3):
                    centre[a] += outer[a, b] * sphere_centre[s, b]
            link = -1
            for k in range(len(box_link)):
                if not pairs[box_link[k], sphere_link[s]]:
                    continue
                if box_link[k] != link:
                    link = box_link[k]
                    inner = poses[t, link]
                    for a in range(3):
                        local[a] = 0.0
                        for b in range(3):
                            local[a] += inner[b, a] * (centre[b] - inner[b, 3])
                outside, deepest = 0.0, -np.inf
                for a in range(3):
                    beyond = abs(local[a] - box_centre[k, a]) - box_half[k, a]
                    outside += max(beyond, 0.0) ** 2
                    deepest = max(deepest, beyond)
                distance = np.sqrt(outside) + min(deepest, 0.0) - radius[s]
                if distance < least[t]:
                    least[t], nearest_sphere[t], nearest_box[t] = distance, s, k


def nearest_contacts(arm: Pr2Arm, obstacles: Sequence[Obstacle], q: FloatArray) -> tuple[Approach, ...]:
    """Return where the arm comes closest to anything, at each of the configurations `q` (N, 7).

    The robot's own fixed bodies are among what is looked at, and the arm's own links: there the approach's
    `obstacle` is the name of a link.

    Args:
        obstacles: what else there is, may be empty.

    Raises:
        ArrayError: for configurations of another shape or not finite.
    """
    q = checked("configurations", q, ("N", arm.chain.n_joints))
    outside = nearest_approaches(arm, arm.spheres(), (*obstacles, *arm.fixed_obstacles), q)
    itself = SelfCollision.for_arm(arm)
    return tuple(
        itself.nearest(one) if inside < approach.clearance_m else approach
        for one, inside, approach in zip(q, itself.clearance(q), outside, strict=True)
    )


def shoulder_approach(arm: Pr2Arm, obstacles: Sequence[Obstacle]) -> Approach:
    """Return where turret and shoulder come closest to obstacles, whatever the arm does.

    Planners leave these two out (`Pr2Arm.spheres`); nothing may stand where they could get to.

    Args:
        obstacles: at least one.

    Returns:
        A clearance no larger than the true one: covers and the steps between the sampled angles take
        up to 0.1 m of it.
    """
    chain, counts = arm.chain, (49, 25)
    grids = [np.linspace(chain.lower[joint], chain.upper[joint], count) for joint, count in enumerate(counts)]
    q = np.zeros((counts[0] * counts[1], chain.n_joints))
    q[:, :2] = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, 2)
    spheres = arm.shoulder_spheres()
    nearest = min(nearest_approaches(arm, spheres, obstacles, q), key=lambda approach: approach.clearance_m)
    # No point moves farther between a sampled angle and the middle of two than half the step times its arm.
    half_steps = sum(float(grid[1] - grid[0]) / 2.0 for grid in grids)
    lever = float(np.linalg.norm(chain.joint_origin_m[1])) + float(
        (np.linalg.norm(spheres.local_m, axis=1) + spheres.radius_m).max()
    )
    return Approach(nearest.link, nearest.obstacle, nearest.clearance_m - half_steps * lever)


@dataclass(frozen=True, eq=False)
class Separation:
    """Least distance between arm and person at each of T moments."""

    distance_m: FloatArray  #: (T,) negative where they penetrate
    part: NDArray[np.int64]  #: (T,) number of the arm's sphere or point that is closest
    body: NDArray[np.int64]  #: (T,) number of the human's body it is closest to

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
