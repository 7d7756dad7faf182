"""Small arms, lattices and worlds that planning tests share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import distance_transform_edt

from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid

COORDINATE, ANY = "coordinate", "any"


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def random_chain(rng: np.random.Generator, n_joints: int, axes: str = COORDINATE) -> KinematicChain:
    """An arm with fixed rotations between its joints, about coordinate or any axes."""
    axis = np.eye(3)[rng.integers(0, 3, n_joints)]
    if axes == ANY:
        axis = rng.normal(size=(n_joints, 3))
        axis /= np.linalg.norm(axis, axis=1)[:, None]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(rng), rng.normal(size=3) * 0.2
    return KinematicChain(
        joint_names=tuple(f"joint_{j}" for j in range(n_joints)),
        joint_origin_m=rng.uniform(-0.25, 0.25, (n_joints, 3)),
        joint_rotation=np.stack([random_rotation(rng) if rng.random() < 0.7 else np.eye(3) for _ in range(n_joints)]),
        joint_axis=axis,
        T_world_root=T,
        T_last_tool=np.eye(4),
        lower=np.full(n_joints, -np.inf),
        upper=np.full(n_joints, np.inf),
        continuous=np.ones(n_joints, dtype=np.bool_),
        velocity_limit=np.ones(n_joints),
    )


def random_points(rng: np.random.Generator, n_joints: int, count: int = 30) -> BodyPoints:
    return BodyPoints(rng.integers(0, n_joints, count), rng.uniform(-0.1, 0.1, (count, 3)))


def random_spheres(rng: np.random.Generator, n_joints: int, count: int = 12) -> BodySpheres:
    return BodySpheres(
        rng.integers(0, n_joints, count), rng.uniform(-0.1, 0.1, (count, 3)), rng.uniform(0.02, 0.08, count)
    )


def random_trajectories(rng: np.random.Generator, n_joints: int, r: int = 3, n: int = 40) -> NDArray[np.float32]:
    """(R, N, D) random walks that start anywhere on the circle."""
    steps = rng.normal(0.0, 0.05, (r, n, n_joints)).cumsum(axis=1)
    return (rng.uniform(-3.0, 3.0, (r, 1, n_joints)) + steps).astype(np.float32)


def field_around(occupied: NDArray[np.bool_], origin_m: ArrayLike, resolution_m: float) -> SignedDistanceField:
    """The signed distance to a surface half-way between marked and free nodes of a lattice."""
    if occupied.any() and not occupied.all():
        cells = np.where(occupied, 0.5 - distance_transform_edt(occupied), distance_transform_edt(~occupied) - 0.5)
    else:
        cells = np.full(occupied.shape, -100.0 if occupied.all() else 100.0)
    return SignedDistanceField(np.asarray(origin_m, dtype=np.float64), resolution_m, resolution_m * cells)


PLANAR_REACH_M = 0.9


@dataclass
class PlanarArm:
    """Three links in the plane z = 0, 0.3 m each; the last joint turns without end."""

    chain: KinematicChain

    def body_points(self) -> BodyPoints:
        along = np.linspace(0.02, 0.28, 10)
        local = np.stack([np.tile(along, 3), np.zeros(30), np.zeros(30)], axis=1)
        return BodyPoints(np.repeat(np.arange(3), 10), local)

    def spheres(self) -> BodySpheres:
        along = np.linspace(0.04, 0.28, 5)
        centre = np.stack([np.tile(along, 3), np.zeros(15), np.zeros(15)], axis=1)
        return BodySpheres(np.repeat(np.arange(3), 5), centre, np.full(15, 0.03))

    def difference(self, q_from: ArrayLike, q_to: ArrayLike) -> NDArray[np.float64]:
        change = np.asarray(q_to, dtype=np.float64) - np.asarray(q_from, dtype=np.float64)
        return np.where(self.chain.continuous, (change + np.pi) % (2.0 * np.pi) - np.pi, change)

    def configuration_distance(self, a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
        return np.linalg.norm(self.difference(a, b) * np.array([0.9, 0.6, 0.3]), axis=-1)


def planar_arm() -> PlanarArm:
    step = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.0, 0.0]])
    limit = np.array([3.0, 2.6, np.inf])
    return PlanarArm(
        KinematicChain(
            joint_names=("one", "two", "three"),
            joint_origin_m=step,
            joint_rotation=np.stack([np.eye(3)] * 3),
            joint_axis=np.tile([0.0, 0.0, 1.0], (3, 1)),
            T_world_root=np.eye(4),
            T_last_tool=np.eye(4),
            lower=-limit,
            upper=limit,
            continuous=np.array([False, False, True]),
            velocity_limit=np.array([2.0, 2.0, 3.0]),
        )
    )


PLANE = VoxelGrid((-1.0, -1.0, -0.1), 0.05, (40, 40, 4))


def nobody(t_s: float = 0.0) -> Occupancy:
    return Occupancy(PLANE, np.zeros(PLANE.shape, dtype=np.float32), t_s)


def somebody_at(x_m: float, y_m: float, t_s: float = 0.0, radius_m: float = 0.2, probability: float = 0.8) -> Occupancy:
    """A round blob of occupancy in the arm's plane."""
    centres = PLANE.centres_m(np.arange(PLANE.size)).reshape(*PLANE.shape, 3)
    near = np.hypot(centres[..., 0] - x_m, centres[..., 1] - y_m) < radius_m
    return Occupancy(PLANE, np.where(near, probability, 0.0).astype(np.float32), t_s)


def free_space() -> SignedDistanceField:
    """A field with one obstacle far from a planar arm."""
    occupied = np.zeros((50, 50, 50), dtype=np.bool_)
    occupied[:, :, :2] = True
    return field_around(occupied, (-1.25, -1.25, -1.25), 0.05)
