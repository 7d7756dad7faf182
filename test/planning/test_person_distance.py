"""Distance to the voxels a person occupies: cubes by brute force are the truth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning_worlds import planar_arm

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.planning.motion_check import MotionChecker
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.person import distance_to_voxels
from humanpred_ros.planning.time_parameterisation import time_parameterise

GRID = VoxelGrid((-1.0, -0.6, 0.2), 0.1, (20, 14, 11))
#: Interpolated distances exceed the true distance to cubes by at most this many voxels: in front of the corner of one.
OVERSTATED_VOXELS = 0.5
SEEDS = st.integers(0, 2**32 - 1)


def to_cubes(grid: VoxelGrid, flat: NDArray[np.int64], points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """True distance (P,) of points (P, 3) from the cubes of voxels (M,); 0 inside."""
    gap = np.maximum(np.abs(points_m[:, None] - grid.centres_m(flat)[None]) - 0.5 * grid.resolution_m, 0.0)
    return np.linalg.norm(gap, axis=2).min(axis=1, initial=np.inf)


@settings(max_examples=40)
@given(seed=SEEDS, count=st.sampled_from([0, 1, 3, 40, 600]), cap=st.sampled_from([0.12, 0.4]))
def test_distances_are_those_to_cubes(seed: int, count: int, cap: float) -> None:
    rng = np.random.default_rng(seed)
    lower = np.array([-0.9, -0.5, 0.0]) + rng.uniform(0.0, 0.6, 3)
    upper = lower + rng.uniform(0.3, 1.0, 3)
    flat = rng.choice(GRID.size, count, replace=False)
    field = distance_to_voxels(GRID, flat, lower, upper, cap)
    nodes = np.stack(np.meshgrid(*[np.arange(n) for n in field.values.shape], indexing="ij"), axis=-1).reshape(-1, 3)
    centres = field.origin_m + nodes * field.resolution_m
    wanted = np.minimum(to_cubes(GRID, flat, centres), cap)
    marked = np.isin(GRID.flat_index(centres), flat)
    np.testing.assert_allclose(field.values.ravel(), np.where(marked, -0.05, wanted), atol=1e-6)
    # Between the nodes, and outside the grid.
    points = rng.uniform(lower, upper, (300, 3))
    found = field.distance(points)
    assert (found <= np.minimum(to_cubes(GRID, flat, points), cap) + OVERSTATED_VOXELS * 0.1 + 1e-6).all()


def test_in_front_of_a_face_it_is_exact_and_in_front_of_a_corner_at_its_worst() -> None:
    flat = np.array([np.ravel_multi_index((10, 7, 5), GRID.shape)])
    centre = GRID.centres_m(flat)[0]
    field = distance_to_voxels(GRID, flat, [-1.0, -0.6, 0.2], [1.0, 0.8, 1.3], 0.4)
    out = np.linspace(0.0, 0.3, 50)
    for axis in np.eye(3):
        np.testing.assert_allclose(field.distance(centre + out[:, None] * axis), out - 0.05, atol=1e-6)
    rng = np.random.default_rng(0)
    points = centre + rng.uniform(-0.25, 0.25, (20000, 3))
    over = (field.distance(points) - to_cubes(GRID, flat, points)) / 0.1
    corner = field.distance(centre[None] + 0.05)[0] / 0.1
    assert over.max() <= corner + 1e-6 <= OVERSTATED_VOXELS
    assert corner > 0.45


def test_the_distance_along_a_movement_is_bounded() -> None:
    arm = planar_arm()
    grid = VoxelGrid((-1.0, -1.0, -0.1), 0.05, (40, 40, 4))
    centres = grid.centres_m(np.arange(grid.size))
    flat = np.flatnonzero(np.linalg.norm(centres[:, :2] - [0.5, 0.9], axis=1) < 0.25)
    person = distance_to_voxels(grid, flat, [-1.0, -1.0, -0.1], [1.0, 1.0, 0.1], 0.4)
    trajectory = time_parameterise(straight([0.0, 0.0, 0.0], [1.5, 0.3, 0.2], 20), 1.0, 3.0)
    checker = MotionChecker(arm.chain, arm.spheres(), person, 0.02, what="person")
    nearest = checker.nearest(trajectory)
    q = trajectory.sample(np.linspace(0.0, trajectory.end_s, 800))[0]
    spheres = arm.spheres()
    true = to_cubes(grid, flat, spheres.world_m(arm.chain, q).reshape(-1, 3)).reshape(len(q), -1) - spheres.radius_m
    assert nearest.at_least_m - OVERSTATED_VOXELS * 0.05 <= true.min()
    assert nearest.at_least_m >= true.min() - 0.03
    trouble = checker.first_trouble(trajectory)
    assert (trouble is None) == (nearest.clearance_m >= 0.02)


def test_what_makes_no_sense_is_refused() -> None:
    nothing, low, high = np.zeros(0, dtype=np.int64), np.array([-0.5, -0.5, 0.3]), np.array([0.5, 0.5, 1.0])
    with pytest.raises(PlanningError, match="cap"):
        distance_to_voxels(GRID, nothing, low, high, 0.0)
    with pytest.raises(PlanningError, match="box"):
        distance_to_voxels(GRID, nothing, high, low, 0.4)
    with pytest.raises(PlanningError, match="box"):
        distance_to_voxels(GRID, nothing, low + 50.0, high + 50.0, 0.4)
    with pytest.raises(PlanningError, match="voxels"):
        distance_to_voxels(GRID, np.array([GRID.size]), low, high, 0.4)
