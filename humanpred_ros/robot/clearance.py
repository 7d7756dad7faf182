"""How far the arm is from obstacles, from itself and from a person: the verdict on goals, plans and what was executed.

An arm can be driven into itself: within the joint limits of many arms about one configuration in twenty does so. Of
two links, boxes fill the inner one and spheres cover the surface of the outer one, so where the meshes overlap, a
sphere and a box overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError, HumanModelError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.chain_kernels import link_poses
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.geometry.solids import Obstacle, Sphere
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.arm import Arm, drawn
from humanpred_ros.robot.robot import Robot
from humanpred_ros.robot.semantics import pair_of

#: Random configurations that decide which bodies are neighbours: those never found apart.
_SAMPLES = 256
#: Angles of the first two joints at which the shoulder is looked at.
_SHOULDER_SAMPLES = (49, 25)


@dataclass(frozen=True)
class Approach:
    """Where the arm comes closest to an obstacle."""

    link: str  #: name of the link, as in the URDF
    obstacle: str  #: name of the obstacle
    clearance_m: float  #: distance between their surfaces, negative where they overlap


def nearest_approaches(
    arm: Arm, spheres: BodySpheres, obstacles: Sequence[Obstacle], q: FloatArray
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
    """Signed clearance between the bodies of one arm, and of those of its robot that stand next to it.

    Boxes that fill a link are compared with spheres that cover one farther out. Left out are pairs of links that the
    robot leaves out (of one joint, joined by one joint, or named in its file or SRDF), and those whose covers overlap
    wherever the joints are: the joint's own limits keep these apart.

    Attributes:
        pairs: pairs of links that are compared, the inner one first.
    """

    def __init__(self, arm: Arm) -> None:
        robot, chain, n = arm.robot, arm.chain, arm.chain.n_joints
        self._n_joints = n
        (boxes, moving), spheres, outer = robot.inner_boxes, robot.spheres, robot.sphere_links
        frame, centre, half, round_m = (list(part) for part in (boxes.link, boxes.local_m, boxes.half_m, boxes.round_m))
        inner, standing = list(moving), list[FloatArray]()
        for near, link, obstacles in arm.fixed_bodies:
            for obstacle in obstacles if near else ():
                ball = isinstance(obstacle.shape, Sphere)
                inner.append(link)
                frame.append(n + len(standing))
                standing.append(obstacle.T_world_shape)
                centre.append(np.zeros(3))
                half.append(np.full(3, 1e-9) if ball else np.array(obstacle.shape.half_m))
                round_m.append(obstacle.shape.half_m[0] if ball else 0.0)
        self._inner, self._outer = tuple(dict.fromkeys(inner)), tuple(dict.fromkeys(outer))
        joint = {link: robot.joint_of_link(link) for link in (*self._inner, *self._outer)}
        pairs = np.array(
            [[joint[a] < joint[b] and pair_of(a, b) not in robot.left_out for b in self._outer] for a in self._inner],
            dtype=np.bool_,
        )
        self._chain = (chain.joints, np.arange(1, n + 1), np.tile(np.eye(4), (n, 1, 1)))
        self._standing = np.array(standing).reshape(-1, 4, 4)
        body = np.array([self._inner.index(link) for link in inner], dtype=np.int64)
        used = np.any(pairs, axis=1)[body]
        frames, bodies, centres, halves, rounds = (
            np.array(part)[used] for part in (frame, body, centre, half, round_m)
        )
        self._boxes = (frames, bodies, centres, halves, rounds)
        outer_body = np.array([self._outer.index(link) for link in outer], dtype=np.int64)
        # Copies, because numba compiles once more for arrays that are read-only.
        self._spheres = (spheres.link.copy(), outer_body, spheres.local_m.copy(), spheres.radius_m.copy())
        self._pairs = self._sometimes_apart(chain, pairs)
        self.pairs = frozenset((self._inner[a], self._outer[b]) for a, b in np.argwhere(self._pairs).tolist())

    @classmethod
    def for_arm(cls, arm: Arm) -> SelfCollision:
        """Return the clearance of an arm from itself; arms of one robot share the work where they can."""
        # Where the robot stands does not matter, and its standing joints only for bodies that stand next to the arm.
        near = any(near for near, _, _ in arm.fixed_bodies)
        return _shared(arm.robot, tuple(sorted(arm.standing.items())) if near else ())

    def clearance(self, q: ArrayLike) -> FloatArray:
        """Return the least signed clearance of each configuration.

        Args:
            q: (..., J) configurations in rad.

        Returns:
            (...) metres, negative where covers overlap; never more than the meshes' true distance. inf where nothing
            is compared.

        Raises:
            ArrayError: for another last axis or angles that are not finite.
        """
        return self._least(q, self._pairs)[0]

    def nearest(self, q: ArrayLike) -> Approach:
        """Return which outer link (`link`) comes closest to which inner one (`obstacle`) at configuration `q` (J,)."""
        least, sphere, box = self._least(checked("configuration", q, (self._n_joints,)), self._pairs)
        return Approach(
            link=self._outer[self._spheres[1][sphere]],
            obstacle=self._inner[self._boxes[1][box]] if len(self._boxes[1]) else "nothing",
            clearance_m=float(least),
        )

    def _least(self, q: ArrayLike, pairs: NDArray[np.bool_]) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64]]:
        """Return least clearances (...) with the numbers of sphere and box (...)."""
        q = np.asarray(q)
        flat = checked("configurations", q.reshape(-1, q.shape[-1]) if q.ndim else q, ("T", self._n_joints))
        least, sphere, box = np.empty(len(flat)), np.zeros(len(flat), np.int64), np.zeros(len(flat), np.int64)
        poses = link_poses(np.array(flat), *self._chain)
        if len(self._standing):
            still = np.broadcast_to(self._standing, (len(flat), *self._standing.shape))
            poses = np.concatenate([poses, still], axis=1)
        _least_clearance(poses, *self._boxes, *self._spheres, pairs, least, sphere, box)
        shape = q.shape[:-1]
        return least.reshape(shape), sphere.reshape(shape), box.reshape(shape)

    def _sometimes_apart(self, chain: KinematicChain, pairs: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return those of the pairs (inner, outer) whose covers are found apart."""
        q = drawn(chain, _SAMPLES)
        found = np.zeros_like(pairs)
        for inner, outer in np.argwhere(pairs):
            one = np.zeros_like(pairs)
            one[inner, outer] = True
            found |= one & bool((self._least(q, one)[0] > 0.0).any())
        return found


@lru_cache(maxsize=8)
def _shared(robot: Robot, standing: tuple[tuple[str, float], ...]) -> SelfCollision:
    return SelfCollision(Arm(robot, np.eye(4), dict(standing)))


@exact
def _least_clearance(
    poses: FloatArray,
    box_frame: NDArray[np.int64],
    box_body: NDArray[np.int64],
    box_centre: FloatArray,
    box_half: FloatArray,
    box_round: FloatArray,
    sphere_frame: NDArray[np.int64],
    sphere_body: NDArray[np.int64],
    sphere_centre: FloatArray,
    radius: FloatArray,
    pairs: NDArray[np.bool_],
    least: FloatArray,
    nearest_sphere: NDArray[np.int64],
    nearest_box: NDArray[np.int64],
) -> None:
    """Write the least of all spheres' distances to all boxes of the pairs, per configuration; inf without pairs.

    Args:
        poses: (T, F, 4, 4) of the joints' frames, and of those that stand still.
    """
    centre, local = np.empty(3), np.empty(3)
    for t in range(len(poses)):
        least[t] = np.inf
        for s in range(len(sphere_frame)):
            outer = poses[t, sphere_frame[s]]
            for a in range(3):
                centre[a] = outer[a, 3]
                for b in range(3):
                    centre[a] += outer[a, b] * sphere_centre[s, b]
            frame = -1
            for k in range(len(box_frame)):
                if not pairs[box_body[k], sphere_body[s]]:
                    continue
                if box_frame[k] != frame:
                    frame = box_frame[k]
                    inner = poses[t, frame]
                    for a in range(3):
                        local[a] = 0.0
                        for b in range(3):
                            local[a] += inner[b, a] * (centre[b] - inner[b, 3])
                outside, deepest = 0.0, -np.inf
                for a in range(3):
                    beyond = abs(local[a] - box_centre[k, a]) - box_half[k, a]
                    outside += max(beyond, 0.0) ** 2
                    deepest = max(deepest, beyond)
                distance = np.sqrt(outside) + min(deepest, 0.0) - radius[s] - box_round[k]
                if distance < least[t]:
                    least[t], nearest_sphere[t], nearest_box[t] = distance, s, k


def nearest_contacts(arm: Arm, obstacles: Sequence[Obstacle], q: FloatArray) -> tuple[Approach, ...]:
    """Return where the arm comes closest to anything, at each of the configurations `q` (N, 7).

    The robot's own fixed bodies are among what is looked at, and the arm's own links: there the approach's
    `obstacle` is the name of a link.

    Args:
        obstacles: what else there is, may be empty.

    Raises:
        ArrayError: for configurations of another shape or not finite.
    """
    q = checked("configurations", q, ("N", arm.chain.n_joints))
    itself, everything = SelfCollision.for_arm(arm), (*obstacles, *arm.fixed_obstacles)
    if not everything:
        return tuple(itself.nearest(one) for one in q)
    outside = nearest_approaches(arm, arm.spheres(), everything, q)
    return tuple(
        itself.nearest(one) if inside < approach.clearance_m else approach
        for one, inside, approach in zip(q, itself.clearance(q), outside, strict=True)
    )


def shoulder_approach(arm: Arm, obstacles: Sequence[Obstacle]) -> Approach | None:
    """Return where the shoulder comes closest to obstacles, whatever the arm does; None without either.

    Planners leave the shoulder out (`Arm.spheres`); nothing may stand where it could get to.

    Args:
        obstacles: may be empty.

    Returns:
        A clearance no larger than the true one: covers and the steps between the sampled angles take
        up to 0.1 m of it.
    """
    chain, spheres = arm.chain, arm.robot.shoulder_spheres
    if spheres is None or not obstacles:
        return None
    # A joint that turns without end is sampled over one turn.
    lower, upper = np.where(chain.continuous, -np.pi, chain.lower), np.where(chain.continuous, np.pi, chain.upper)
    grids = [np.linspace(lower[j], upper[j], count) for j, count in enumerate(_SHOULDER_SAMPLES[: chain.n_joints])]
    q = np.zeros((int(np.prod([len(grid) for grid in grids])), chain.n_joints))
    q[:, : len(grids)] = np.stack(np.meshgrid(*grids, indexing="ij"), axis=-1).reshape(-1, len(grids))
    nearest = min(nearest_approaches(arm, spheres, obstacles, q), key=lambda approach: approach.clearance_m)
    # No point moves farther between a sampled angle and the middle of two than half the step times its arm.
    half_steps = sum(float(grid[1] - grid[0]) / 2.0 for grid in grids)
    between = float(np.linalg.norm(chain.joint_origin_m[1])) if len(grids) > 1 else 0.0
    lever = between + float((np.linalg.norm(spheres.local_m, axis=1) + spheres.radius_m).max())
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

    def __init__(self, arm: Arm, human: HumanModel, T_world_human: FloatArray, postures: FloatArray) -> None:
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
