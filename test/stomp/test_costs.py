"""Cost terms: the compiled kernels say what plain NumPy says, for any arm and any world."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cost_oracle
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_worlds import (
    ANY,
    COORDINATE,
    field_around,
    planar_arm,
    random_chain,
    random_points,
    random_spheres,
    random_trajectories,
    somebody_at,
)

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.chain import BodyPoints, BodySpheres
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.stomp.costs import (
    POINTS_OF_P1,
    HumanOccupancyCost,
    JointLimitCost,
    ObstacleCost,
    SmoothnessCost,
    as_batch,
)

SEEDS = st.integers(0, 2**32 - 1)
WORLD = VoxelGrid((-0.9, -0.8, -0.7), 0.05, (36, 31, 29))


def random_occupancy(rng: np.random.Generator, grid: VoxelGrid = WORLD) -> Occupancy:
    p = np.where(rng.random(grid.shape) < 0.5, rng.random(grid.shape), 0.0).astype(np.float32)
    cut = rng.integers(0, 12, 6)
    box = np.zeros(grid.shape, dtype=np.float32)
    inside = tuple(slice(cut[k], max(n - cut[k + 3], cut[k] + 1)) for k, n in enumerate(grid.shape))
    box[inside] = p[inside]
    return Occupancy(grid, box)


@settings(max_examples=40)
@given(seed=SEEDS, n_joints=st.integers(1, 9), axes=st.sampled_from([COORDINATE, ANY]), n=st.integers(1, 150))
def test_human_cost_is_the_oracles(seed: int, n_joints: int, axes: str, n: int) -> None:
    rng = np.random.default_rng(seed)
    chain, points = random_chain(rng, n_joints, axes), random_points(rng, n_joints)
    occupancy, q = random_occupancy(rng), random_trajectories(rng, n_joints, n=n)
    costs = HumanOccupancyCost(chain, points, occupancy).costs(q)
    # Float32 may look a point up in the neighbouring voxel if it is this close to it.
    low, high = cost_oracle.human_bounds(chain, points, occupancy, q, tolerance_cells=1e-3)
    assert costs.dtype == np.float32
    assert costs.shape == (3, n)
    assert (costs >= low - 1e-4).all()
    assert (costs <= high + 1e-4).all()


@settings(max_examples=40)
@given(seed=SEEDS, n_joints=st.integers(1, 9), axes=st.sampled_from([COORDINATE, ANY]), n=st.integers(2, 150))
def test_obstacle_cost_is_the_oracles(seed: int, n_joints: int, axes: str, n: int) -> None:
    rng = np.random.default_rng(seed)
    chain, spheres = random_chain(rng, n_joints, axes), random_spheres(rng, n_joints)
    # Some worlds are crowded, some almost empty, and arms reach out of all of them.
    occupied = rng.random((36, 31, 29)) < rng.choice([1e-4, 1e-3, 0.02])
    field, q = field_around(occupied, (-0.9, -0.8, -0.7), 0.05), random_trajectories(rng, n_joints, n=n)
    costs, nearest = ObstacleCost(chain, spheres, field).costs_and_distances(q)
    exact_costs, exact_nearest = cost_oracle.obstacle_costs(chain, spheres, field, q)
    np.testing.assert_allclose(costs, exact_costs, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(nearest, exact_nearest, atol=2e-5)


@settings(max_examples=30)
@given(seed=SEEDS, n_joints=st.integers(1, 23), n=st.integers(5, 120))
def test_smoothness_is_the_oracles(seed: int, n_joints: int, n: int) -> None:
    q = random_trajectories(np.random.default_rng(seed), n_joints, n=n)
    term = SmoothnessCost()
    np.testing.assert_allclose(term.evaluate(q)[0], cost_oracle.acceleration_costs(q), rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(term.costs(q), cost_oracle.acceleration_costs(q).sum(axis=2), rtol=1e-3, atol=1e-7)


@settings(max_examples=30)
@given(seed=SEEDS, margin=st.floats(0.0, 0.3))
def test_joint_limit_cost_is_the_oracles(seed: int, margin: float) -> None:
    q = random_trajectories(np.random.default_rng(seed), 3)
    lower, upper = np.array([-1.0, -np.inf, -2.0]), np.array([1.0, np.inf, 0.5])
    term = JointLimitCost(lower, upper, margin_rad=margin)
    exact = cost_oracle.joint_limit_costs(lower, upper, margin, q)
    np.testing.assert_allclose(term.evaluate(q)[0], exact, rtol=1e-4, atol=1e-5)
    assert np.array_equal(term.valid(q), ((q >= lower) & (q <= upper)).all(axis=2))


def test_a_point_on_a_border_belongs_to_one_of_its_neighbours() -> None:
    arm = planar_arm()
    grid = VoxelGrid((0.0, -1.0, -0.5), 0.25, (8, 8, 4))
    p = np.arange(grid.size, dtype=np.float32).reshape(grid.shape) / grid.size
    points = BodyPoints(np.zeros(3, dtype=np.int64), np.array([[0.25, 0.0, 0.0], [0.5, 0.25, 0.0], [0.75, 0.0, 0.25]]))
    q = np.zeros((1, 1, 3))
    cost = HumanOccupancyCost(arm.chain, points, Occupancy(grid, p)).costs(q)
    low, high = cost_oracle.human_bounds(arm.chain, points, Occupancy(grid, p), q, tolerance_cells=1e-4)
    assert low < high
    assert low - 1e-4 <= cost <= high + 1e-4


def test_points_outside_the_grid_cost_nothing() -> None:
    arm = planar_arm()
    full = Occupancy(VoxelGrid((5.0, 5.0, 5.0), 0.1, (3, 3, 3)), np.ones((3, 3, 3), dtype=np.float32))
    q = random_trajectories(np.random.default_rng(0), 3)
    assert not HumanOccupancyCost(arm.chain, arm.body_points(), full).costs(q).any()


def test_the_human_cost_does_not_depend_on_how_densely_the_arm_is_sampled() -> None:
    arm = planar_arm()
    points = arm.body_points()
    twice = BodyPoints(np.tile(points.link, 2), np.tile(points.local_m, (2, 1)))
    occupancy, q = somebody_at(0.5, 0.2), random_trajectories(np.random.default_rng(3), 3)
    once = HumanOccupancyCost(arm.chain, points, occupancy).costs(q)
    assert once.max() > 0.0
    np.testing.assert_allclose(HumanOccupancyCost(arm.chain, twice, occupancy).costs(q), once, rtol=1e-5)


def test_an_arm_wholly_inside_a_certain_human_costs_as_many_points_as_the_paper_has() -> None:
    arm = planar_arm()
    everywhere = Occupancy(VoxelGrid((-2.0, -2.0, -2.0), 0.5, (8, 8, 8)), np.ones((8, 8, 8), dtype=np.float32))
    costs = HumanOccupancyCost(arm.chain, arm.body_points(), everywhere).costs(np.zeros((1, 2, 3)))
    np.testing.assert_allclose(costs, POINTS_OF_P1, rtol=1e-6)


def test_the_obstacle_potential_is_the_published_one() -> None:
    """d >= .1: 0; 0 <= d < .1: (d - .1)² / .2; d < 0: .05 - d (docs/papers.md, 1.9), times speed."""
    arm = planar_arm()
    above_wall = -1.5 + 0.05 * np.arange(60) + 0.55  # a wall up to y = -0.55 m
    field = SignedDistanceField(np.full(3, -1.5), 0.05, np.tile(above_wall[None, :, None], (60, 1, 60)))
    for d, potential in ((0.12, 0.0), (0.05, 0.0125), (0.0, 0.05), (-0.03, 0.08)):
        # A sphere carried past the wall along x by the first joint.
        y = -0.55 + d + 0.04
        sphere = BodySpheres(np.array([0]), np.array([[0.0, y, 0.0]]), np.array([0.04]))
        swing = np.array([[[-0.001, 0.0, 0.0], [0.0, 0.0, 0.0], [0.001, 0.0, 0.0]]])
        costs, nearest = ObstacleCost(arm.chain, sphere, field, duration_s=2.0).costs_and_distances(swing)
        speed = abs(y) * 0.001 * 2 / 2.0  # two steps a trajectory of 2 s
        assert costs[0, 1] == pytest.approx(potential * speed, rel=0.02, abs=1e-9)
        assert nearest[0, 1] == pytest.approx(min(d, 0.1), abs=1e-4)


def test_validity_is_the_sign_of_the_clearance_whatever_the_cost() -> None:
    arm = planar_arm()
    wall = np.zeros((50, 50, 50), dtype=np.bool_)
    wall[36:, :, :] = True  # x from 0.55 m
    field = field_around(wall, (-1.25, -1.25, -1.25), 0.05)
    term = ObstacleCost(arm.chain, arm.spheres(), field, weight=0.0)
    through = np.linspace([np.pi / 2, 0.0, 0.0], [0.0, 0.0, 0.0], 30)[None]
    _, nearest = cost_oracle.obstacle_costs(arm.chain, arm.spheres(), field, through)
    valid = term.valid(through)
    assert valid[0, 0]
    assert not valid[0, -1]
    clear = np.abs(nearest) > 1e-4
    assert np.array_equal(valid[clear], nearest[clear] >= 0.0)


def test_turning_a_joint_all_the_way_round_changes_nothing() -> None:
    arm = planar_arm()
    term = HumanOccupancyCost(arm.chain, arm.body_points(), somebody_at(0.5, 0.2))
    q = random_trajectories(np.random.default_rng(5), 3)
    np.testing.assert_allclose(term.costs(q), term.costs(q + 2.0 * np.pi * np.array([3.0, -2.0, 1.0])), atol=0.5)


def test_threads_share_a_term() -> None:
    rng = np.random.default_rng(1)
    chain, points, occupancy = random_chain(rng, 7), random_points(rng, 7), random_occupancy(rng)
    term = HumanOccupancyCost(chain, points, occupancy)
    batches = [random_trajectories(rng, 7) for _ in range(16)]
    alone = [term.costs(q) for q in batches]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(term.costs, batches))
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.parametrize("bad", [np.zeros((2, 3)), np.zeros((1, 4, 5)), np.full((1, 4, 3), np.nan)])
def test_trajectories_that_cannot_be_costed_are_refused(bad: np.ndarray) -> None:
    arm = planar_arm()
    term = HumanOccupancyCost(arm.chain, arm.body_points(), somebody_at(0.5, 0.0))
    with pytest.raises(PlanningError, match="trajectories: wanted"):
        term.costs(bad)


def test_impossible_settings_are_refused() -> None:
    arm = planar_arm()
    field = field_around(np.ones((3, 3, 3), dtype=np.bool_), (0.0, 0.0, 0.0), 0.1)
    with pytest.raises(PlanningError, match="weight"):
        SmoothnessCost(weight=-1.0)
    with pytest.raises(PlanningError, match="margin < clearance"):
        ObstacleCost(arm.chain, arm.spheres(), field, clearance_m=0.1, margin_m=0.2)
    with pytest.raises(PlanningError, match="lower < upper"):
        JointLimitCost([1.0], [-1.0])
    with pytest.raises(PlanningError, match="5 waypoints"):
        SmoothnessCost().costs(np.zeros((1, 4, 3)))


def test_a_batch_is_float32_and_contiguous() -> None:
    q = np.zeros((3, 40, 7))[:, ::2]
    batch = as_batch(q)
    assert batch.dtype == np.float32
    assert batch.flags.c_contiguous
