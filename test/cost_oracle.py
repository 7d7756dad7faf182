"""Every cost once more in plain NumPy and float64: what the compiled kernels are tested against.

A body point that lies almost on the border between two voxels may be looked up in either by float32, so
`human_bounds` returns the smallest and largest cost over all voxels within a tolerance of each point.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.stomp.costs import POINTS_OF_P1
from humanpred_ros.stomp.smoothness import accelerations_matrix


def human_costs(chain: KinematicChain, points: BodyPoints, occupancy: Occupancy, q: ArrayLike) -> FloatArray:
    """Return what `HumanOccupancyCost` charges trajectories q (R, N, D): (R, N)."""
    return human_bounds(chain, points, occupancy, q, 0.0)[0]


def human_bounds(
    chain: KinematicChain, points: BodyPoints, occupancy: Occupancy, q: ArrayLike, tolerance_cells: float
) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest cost (R, N) with every point moved by up to `tolerance_cells` an axis."""
    grid = occupancy.grid
    padded = np.append(occupancy.probability.ravel().astype(np.float64), 0.0)  # index -1: outside
    world = points.world_m(chain, q)
    values = np.stack([padded[grid.flat_index(world + s)] for s in _shifts(tolerance_cells * grid.resolution_m)])
    return POINTS_OF_P1 * values.min(axis=0).mean(axis=-1), POINTS_OF_P1 * values.max(axis=0).mean(axis=-1)


def obstacle_costs(
    chain: KinematicChain,
    spheres: BodySpheres,
    field: SignedDistanceField,
    q: ArrayLike,
    clearance_m: float = 0.10,
    duration_s: float = 5.0,
) -> tuple[FloatArray, FloatArray]:
    """Return costs (R, N) and nearest distances cut off at the clearance (R, N), as `ObstacleCost` does."""
    world = spheres.world_m(chain, q)
    n = world.shape[1]
    continued = np.concatenate([world[:, :1], world, world[:, -1:]], axis=1)
    speed = np.linalg.norm(continued[:, 2:] - continued[:, :-2], axis=-1) / 2.0 * (n - 1) / duration_s
    d = field.distance(world) - spheres.radius_m
    near = (np.minimum(d, clearance_m) - clearance_m) ** 2 / (2.0 * clearance_m)
    potential = np.where(d < 0.0, clearance_m / 2.0 - d, near)
    return (potential * speed).sum(axis=-1), np.minimum(d.min(axis=-1), clearance_m)


def acceleration_costs(q: ArrayLike) -> FloatArray:
    """Return half the squared acceleration per joint, (R, N, D); rows outside count at the ends."""
    q = np.asarray(q, dtype=np.float64)
    rows = 0.5 * np.einsum("ij,rjd->rid", accelerations_matrix(q.shape[1]), q) ** 2
    costs: FloatArray = rows[:, 1:-1].copy()
    costs[:, 0] += rows[:, 0]
    costs[:, -1] += rows[:, -1]
    return costs


def joint_limit_costs(lower: ArrayLike, upper: ArrayLike, margin_rad: float, q: ArrayLike) -> FloatArray:
    """Return the squared depth into the margin before the limits, per joint (R, N, D)."""
    q = np.asarray(q, dtype=np.float64)
    deep = np.maximum(np.asarray(lower) + margin_rad - q, 0.0) + np.maximum(q - (np.asarray(upper) - margin_rad), 0.0)
    costs: FloatArray = deep**2
    return costs


def _shifts(amount_m: float) -> list[FloatArray]:
    if amount_m == 0.0:
        return [np.zeros(3)]
    return [amount_m * np.array(signs) for signs in itertools.product((-1.0, 0.0, 1.0), repeat=3)]
