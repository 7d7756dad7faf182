"""The compiled planner gives the trajectory that plain NumPy gives from the same random bits."""

from __future__ import annotations

from dataclasses import replace

import cost_oracle
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning_worlds import ANY, COORDINATE, field_around, random_chain, random_points, random_spheres
from stomp_oracle import (
    OraclePlan,
    OracleTerm,
    StompOracle,
    human_term,
    joint_limit_term,
    obstacle_term,
    smoothness_term,
)

from humanpred_ros.geometry.chain import BodyPoints, KinematicChain
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.path import straight
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.costs import (
    CostTerm,
    HumanOccupancyCost,
    JointLimitCost,
    ObstacleCost,
    SmoothnessCost,
)
from humanpred_ros.stomp.planner import Plan, StompPlanner
from humanpred_ros.stomp.smoothness import accelerations_matrix

SEEDS = st.integers(0, 2**32 - 1)
DOFS = st.integers(3, 23)
AXES = st.sampled_from([COORDINATE, ANY])
#: What float32 may change of a trajectory, as a share of how far STOMP moved it: by the rounding of noise and sweeps,
#: and by that of costs, for each time they are larger than their range over rollouts.
SHARE, SHARE_OF_COSTS = 3e-4, 2e-6


def random_config(rng: np.random.Generator, n_joints: int, iterations: int, n: int, rollouts: int) -> StompConfig:
    return StompConfig(
        waypoints=n,
        iterations=iterations,
        rollouts=rollouts,
        reused=int(rng.integers(0, rollouts)),
        noise_std=tuple(rng.uniform(0.01, 0.05, n_joints)),
        noise_decay=float(rng.choice([1.0, 0.9])),
    )


def random_line(rng: np.random.Generator, n_joints: int, n: int) -> NDArray[np.float64]:
    start = rng.uniform(-2.0, 2.0, n_joints)
    return straight(start, start + rng.uniform(-0.8, 0.8, n_joints), n)


class Conditioned(StompOracle):
    """Notes how many times larger costs were than their range, which is what their rounding is magnified by."""

    magnified = 1.0

    def improved(
        self, theta: NDArray[np.float64], rollouts: NDArray[np.float64], S: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        spread = S.max(axis=0) - S.min(axis=0)
        times = np.divide(S.max(axis=0), spread, out=np.ones_like(spread), where=spread > 1e-12)
        self.magnified = max(self.magnified, float(times.max()))
        return super().improved(theta, rollouts, S)


def both(
    terms: list[CostTerm],
    theirs: list[OracleTerm],
    limits: tuple[NDArray[np.float64], NDArray[np.float64]],
    config: StompConfig,
    initial: NDArray[np.float64],
    seed: int,
) -> tuple[Plan, OraclePlan, float]:
    """Plan with both; return the plans and how far apart float32 may bring them, rad."""
    ours = StompPlanner(terms, *limits, config).plan(initial, np.random.default_rng(seed))
    subject = Conditioned(theirs, *limits, config)
    exact = subject.plan(initial, np.random.default_rng(seed))
    moved = float(np.abs(exact.waypoints - initial).max())
    return ours, exact, 1e-6 + moved * (SHARE + SHARE_OF_COSTS * subject.magnified)


def assert_same(ours: Plan, exact: OraclePlan, tolerance: float) -> None:
    np.testing.assert_allclose(ours.waypoints, exact.waypoints, atol=tolerance, rtol=0.0)
    np.testing.assert_allclose(ours.total, exact.total, rtol=5e-3, atol=1e-3)


@settings(max_examples=40)
@given(seed=SEEDS, n_joints=DOFS, axes=AXES, iterations=st.integers(1, 4), n=st.integers(5, 40))
def test_it_is_the_planner_among_obstacles_for_any_arm(
    seed: int, n_joints: int, axes: str, iterations: int, n: int
) -> None:
    rng = np.random.default_rng(seed)
    chain, spheres = random_chain(rng, n_joints, axes), random_spheres(rng, n_joints)
    field = field_around(rng.random((36, 31, 29)) < 1e-3, (-0.9, -0.8, -0.7), 0.05)
    config, initial = random_config(rng, n_joints, iterations, n, 5), random_line(rng, n_joints, n)
    lower, upper = initial.min(axis=0) - 0.1, initial.max(axis=0) + 0.1
    lower[rng.random(n_joints) < 0.3] = -np.inf
    upper[rng.random(n_joints) < 0.3] = np.inf
    ours, exact, tolerance = both(
        [
            ObstacleCost(chain, spheres, field),
            JointLimitCost(lower, upper, 10.0, 0.05),
            SmoothnessCost(100.0),
        ],
        [
            obstacle_term(chain, spheres, field, 100.0),
            joint_limit_term(lower, upper, 10.0, 0.05),
            smoothness_term(100.0),
        ],
        (lower, upper),
        config,
        initial,
        seed,
    )
    assert_same(ours, exact, tolerance)


class Watched:
    """The human's term, and everything that was asked of it."""

    def __init__(self, chain: KinematicChain, points: BodyPoints, occupancy: Occupancy) -> None:
        self.chain, self.points, self.occupancy = chain, points, occupancy
        self.asked: list[NDArray[np.float64]] = []
        inner = human_term(chain, points, occupancy, 1.0)

        def evaluate(q: NDArray[np.float64]) -> tuple[NDArray[np.float64], None]:
            self.asked.append(q)
            return inner.evaluate(q)[0], None

        self.term = OracleTerm("human", 1.0, evaluate)

    def undecided(self, tolerance_cells: float) -> bool:
        """Whether a point lay so near a border that float32 may look it up in the neighbouring voxel."""
        for q in self.asked:
            low, high = cost_oracle.human_bounds(self.chain, self.points, self.occupancy, q, tolerance_cells)
            if (low != high).any():
                return True
        return False


@settings(max_examples=30)
@given(seed=SEEDS, n_joints=DOFS, axes=AXES, iterations=st.integers(1, 3))
def test_it_is_the_planner_amid_occupancy_for_any_arm(seed: int, n_joints: int, axes: str, iterations: int) -> None:
    rng = np.random.default_rng(seed)
    chain, points = random_chain(rng, n_joints, axes), random_points(rng, n_joints, 10)
    grid = VoxelGrid((-1.0, -1.0, -1.0), 0.2, (10, 10, 10))
    occupancy = Occupancy(grid, rng.random(grid.shape).astype(np.float32))
    config, initial = random_config(rng, n_joints, iterations, 8, 3), random_line(rng, n_joints, 8)
    limits = np.full(n_joints, -np.inf), np.full(n_joints, np.inf)
    watched = Watched(chain, points, occupancy)
    ours, exact, tolerance = both(
        [HumanOccupancyCost(chain, points, occupancy, 1.0), SmoothnessCost(100.0)],
        [watched.term, smoothness_term(100.0)],
        limits,
        config,
        initial,
        seed,
    )
    assume(not watched.undecided(4e-5))
    assert_same(ours, exact, tolerance)


@settings(max_examples=40)
@given(seed=SEEDS, n_joints=DOFS, axes=AXES, iterations=st.integers(1, 4))
def test_it_is_the_planner_with_all_terms_of_the_arm(seed: int, n_joints: int, axes: str, iterations: int) -> None:
    """These three terms run in one compiled loop of their own."""
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, n_joints, axes)
    points, spheres = random_points(rng, n_joints, 10), random_spheres(rng, n_joints, 6)
    grid = VoxelGrid((-1.0, -1.0, -1.0), 0.2, (10, 10, 10))
    occupied = np.where(rng.random(grid.shape) < 0.5, rng.random(grid.shape), 0.0)
    occupancy = Occupancy(grid, occupied.astype(np.float32))
    field = field_around(rng.random((36, 31, 29)) < 1e-3, (-0.9, -0.8, -0.7), 0.05)
    config, initial = random_config(rng, n_joints, iterations, 8, 3), random_line(rng, n_joints, 8)
    limits = initial.min(axis=0) - 0.1, initial.max(axis=0) + 0.1
    watched = Watched(chain, points, occupancy)
    terms = [
        ObstacleCost(chain, spheres, field),
        HumanOccupancyCost(chain, points, occupancy, 1.0),
        SmoothnessCost(1.0),
    ]
    assert StompPlanner(terms, *limits, config).compiled_terms is not None
    theirs = [obstacle_term(chain, spheres, field, 100.0), watched.term, smoothness_term(1.0)]
    ours, exact, tolerance = both(terms, theirs, limits, config, initial, seed)
    assume(not watched.undecided(4e-5))
    assert_same(ours, exact, tolerance)


def arm_along_x(rng: np.random.Generator, n_joints: int) -> KinematicChain:
    """An arm whose joints all turn about x: whatever it does, x of every point stays what it was, exactly."""
    chain = random_chain(rng, n_joints)
    origin = chain.joint_origin_m.copy()
    origin[:, 0] = 0.25 * rng.integers(-1, 2, n_joints)
    return replace(
        chain,
        joint_origin_m=origin,
        joint_rotation=np.tile(np.eye(3), (n_joints, 1, 1)),
        joint_axis=np.tile([1.0, 0.0, 0.0], (n_joints, 1)),
        T_world_root=np.eye(4),
    )


@settings(max_examples=30)
@given(seed=SEEDS, n_joints=DOFS, iterations=st.integers(1, 3))
def test_points_exactly_on_cell_borders_are_looked_up_in_the_same_voxel(
    seed: int, n_joints: int, iterations: int
) -> None:
    """Neighbours along x are as different as can be, and every point lies exactly between two of them."""
    rng = np.random.default_rng(seed)
    chain, points = arm_along_x(rng, n_joints), random_points(rng, n_joints, 10)
    local = points.local_m.copy()
    local[:, 0] = 0.25 * rng.integers(-2, 3, len(local))
    points = BodyPoints(points.link, local)
    grid = VoxelGrid((-8.0, -1.0, -1.0), 0.25, (64, 8, 8))
    p = rng.uniform(0.0, 0.1, grid.shape)
    p[::2] += 0.9
    occupancy = Occupancy(grid, p.astype(np.float32))
    config, initial = random_config(rng, n_joints, iterations, 8, 3), random_line(rng, n_joints, 8)
    world = points.world_m(chain, initial)
    assert (world[..., 0] % 0.25 == 0.0).all()
    watched = Watched(chain, points, occupancy)
    ours, exact, tolerance = both(
        [HumanOccupancyCost(chain, points, occupancy, 1.0), SmoothnessCost(100.0)],
        [watched.term, smoothness_term(100.0)],
        (np.full(n_joints, -np.inf), np.full(n_joints, np.inf)),
        config,
        initial,
        seed,
    )
    # Along y and z points lie anywhere; only there may float32 differ.
    sideways = Watched(chain, points, Occupancy(grid, np.tile(p[:1], (64, 1, 1)).astype(np.float32)))
    sideways.asked = watched.asked
    assume(not sideways.undecided(4e-5))
    assert_same(ours, exact, tolerance)


def test_the_noise_has_the_covariance_it_should() -> None:
    config = StompConfig(waypoints=12, noise_std=0.5)
    subject = StompOracle([smoothness_term(1.0)], [-1.0], [1.0], config)
    bits = np.random.default_rng(0).integers(0, 2**16, 10 * 20000).astype(np.uint16)
    epsilon = subject.noise(bits, 20000)[:, :, 0]
    A = accelerations_matrix(12)[:, 1:-1]
    expected = 0.25 * np.linalg.inv(A.T @ A)
    np.testing.assert_allclose(np.cov(epsilon.T), expected, atol=0.03 * expected.max())


def test_a_waypoint_outside_the_limits_comes_back_smoothly_and_the_ends_stay() -> None:
    subject = StompOracle([smoothness_term(1.0)], [-1.0], [1.0], StompConfig(waypoints=20))
    bulge = np.sin(np.linspace(0.0, np.pi, 20))[:, None] * 1.2
    inside = subject.within_limits(bulge)
    assert inside.max() <= 1.0 + 1e-6
    assert np.array_equal(inside[[0, -1]], bulge[[0, -1]])
    assert np.abs(np.diff(inside, 2, axis=0)).max() < 0.1
    assert np.array_equal(subject.within_limits(inside), inside)


def test_it_ends_no_dearer_than_it_began() -> None:
    rng = np.random.default_rng(3)
    chain, spheres = random_chain(rng, 4), random_spheres(rng, 4)
    field = field_around(rng.random((36, 31, 29)) < 1e-2, (-0.9, -0.8, -0.7), 0.05)
    term = obstacle_term(chain, spheres, field, 100.0)
    initial = random_line(rng, 4, 20)
    config = StompConfig(waypoints=20, iterations=20, noise_std=0.02)
    unlimited = np.full(4, np.inf)
    plan = StompOracle([term], -unlimited, unlimited, config).plan(initial, rng)
    costs, allowed = term.evaluate(initial[None])
    assert allowed is not None
    assert (not plan.valid, plan.total) < (not allowed.all(), 100.0 * costs.sum())


@pytest.mark.parametrize("reused", [0, 3])
def test_reuse_means_the_same_in_both(reused: int) -> None:
    config = StompConfig(waypoints=30, iterations=6, rollouts=6, reused=reused, noise_std=0.02)
    initial = straight([0.0, 0.5, -0.5], [1.0, -0.5, 0.5], 30)
    limits = np.full(3, -2.0), np.full(3, 2.0)
    ours, exact, tolerance = both([SmoothnessCost(1.0)], [smoothness_term(1.0)], limits, config, initial, 5)
    assert_same(ours, exact, tolerance)
