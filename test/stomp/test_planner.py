"""STOMP: exact ends, limits, repeatability, and that it does find a way round."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray
from planning_worlds import field_around, random_chain, random_points, random_spheres

from humanpred_ros.errors import ArrayError, PlanningError, SettingsError
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

pytestmark = pytest.mark.core


class Disc(CostTerm):
    """A point robot in the plane pays for entering a disc, and may not enter its core."""

    def __init__(self, centre: ArrayLike, radius: float, weight: float = 10.0, forbidden: float = 0.0) -> None:
        super().__init__("disc", weight)
        self.centre, self.radius, self.forbidden = np.asarray(centre), radius, forbidden

    def distance(self, q: ArrayLike) -> NDArray[np.float64]:
        return np.linalg.norm(np.asarray(q)[..., :2] - self.centre, axis=-1)

    def evaluate(self, q: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        distance = self.distance(q)
        return np.maximum(self.radius - distance, 0.0).astype(np.float32), distance >= self.forbidden


WIDE = np.full(2, 10.0)
LINE = straight([-1.0, 0.05], [1.0, -0.05], 60)
CONFIG = StompConfig(waypoints=60, iterations=60, noise_std=0.01)


def planner(config: StompConfig = CONFIG, disc: Disc | None = None, limit: ArrayLike = WIDE) -> StompPlanner:
    terms = [disc or Disc([0.0, 0.0], 0.4), SmoothnessCost(100.0)]
    return StompPlanner(terms, -np.asarray(limit), np.asarray(limit), config)


def same(one: Plan, other: Plan) -> bool:
    return np.array_equal(one.waypoints, other.waypoints) and one.cost == other.cost and one.total == other.total


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    n_joints=st.integers(1, 23),
    n=st.integers(5, 40),
    rollouts=st.integers(1, 7),
    data=st.data(),
)
def test_ends_are_exact_and_limits_hold_for_any_arm(
    seed: int, n_joints: int, n: int, rollouts: int, data: st.DataObject
) -> None:
    rng = np.random.default_rng(seed)
    limit = rng.uniform(0.1, 2.0, n_joints)
    limit[rng.random(n_joints) < 0.2] = np.inf
    inside = np.minimum(limit, 3.0)
    start, goal = rng.uniform(-inside, inside), rng.uniform(-inside, inside)
    config = StompConfig(
        waypoints=n,
        iterations=4,
        rollouts=rollouts,
        reused=data.draw(st.integers(0, rollouts - 1)),
        noise_std=tuple(rng.uniform(0.001, 0.3, n_joints)),
        noise_decay=data.draw(st.sampled_from([0.9, 1.0])),
    )
    limits = JointLimitCost(-limit, limit)
    plan = StompPlanner([limits, SmoothnessCost(1.0)], -limit, limit, config).plan(straight(start, goal, n), rng)
    assert np.array_equal(plan.waypoints[0], start)
    assert np.array_equal(plan.waypoints[-1], goal)
    assert (np.abs(plan.waypoints) <= limit + 1e-6).all()
    assert np.isfinite(plan.total)
    assert plan.iterations == 4
    assert set(plan.cost) == {"joint_limits", "smoothness"}
    assert plan.total == pytest.approx(sum(plan.cost.values()))


def test_it_goes_round_what_costs() -> None:
    before = planner().assess(LINE)
    plan = planner().plan(LINE, np.random.default_rng(0))
    assert plan.cost["disc"] < 0.1 * before.cost["disc"]
    assert Disc([0.0, 0.0], 0.4).distance(plan.waypoints).min() > 0.3


def test_it_is_never_worse_than_what_it_began_with() -> None:
    for seed in range(10):
        config = CONFIG.replaced(iterations=3, noise_std=0.5)
        plan = planner(config).plan(LINE, np.random.default_rng(seed))
        assert plan.total <= planner().assess(LINE).total * (1.0 + 1e-6)


@pytest.mark.parametrize("reused", [0, 5])
def test_the_same_seed_gives_the_same_plan_in_any_thread(reused: int) -> None:
    subject = planner(CONFIG.replaced(reused=reused))
    alone = [subject.plan(LINE, np.random.default_rng(seed)) for seed in range(6)]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda seed: subject.plan(LINE, np.random.default_rng(seed)), range(6)))
    assert all(same(one, other) for one, other in zip(alone, together, strict=True))
    assert not same(alone[0], alone[1])


class Temptation(Disc):
    """The straight way is the cheapest, and leads through the forbidden core."""

    def evaluate(self, q: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        return np.abs(q[..., 1]), super().evaluate(q)[1]


def test_an_allowed_trajectory_is_preferred_to_a_cheaper_forbidden_one() -> None:
    subject = planner(disc=Temptation([0.0, 0.0], 0.4, forbidden=0.2))
    straight_on = subject.assess(LINE)
    assert not straight_on.valid
    assert straight_on.reason.startswith("disc: waypoint")
    round_about = LINE + np.sin(np.pi * np.linspace(0.0, 1.0, 60))[:, None] * [0.0, 0.5]
    plan = subject.plan(round_about, np.random.default_rng(1))
    assert plan.valid
    assert plan.reason == ""
    assert straight_on.total < plan.total < subject.assess(round_about).total


def test_a_plan_says_why_it_is_not_valid() -> None:
    blocked = planner(disc=Disc([1.0, -0.05], 0.5, forbidden=0.2)).plan(LINE, np.random.default_rng(0))
    assert not blocked.valid
    assert "disc" in blocked.reason
    outside = planner(limit=[0.9, 1.0]).plan(LINE, np.random.default_rng(0))
    assert not outside.valid
    assert outside.reason.startswith("limits: joint 0 at waypoint 0")


def test_it_stays_within_limits_that_the_way_round_would_leave() -> None:
    # Round the disc one would swing out to 0.4; half of that is allowed.
    limit = [2.0, 0.2]
    plan = planner(limit=limit).plan(LINE, np.random.default_rng(0))
    assert plan.valid
    assert np.abs(plan.waypoints[:, 1]).max() <= 0.2 + 1e-6
    assert plan.cost["disc"] < planner().assess(LINE).cost["disc"]
    # Being pushed back from a limit must not leave a corner.
    assert np.abs(np.diff(plan.waypoints[:, 1], 2)).max() < 0.05


def test_a_deadline_ends_it_with_the_best_so_far() -> None:
    asked = iter([False, False, False, True])
    long = CONFIG.replaced(iterations=5000)
    plan = planner(long).plan(LINE, np.random.default_rng(0), deadline=lambda: next(asked))
    assert 3 <= plan.iterations < 5000
    # Nothing else was done than in a plan that was to end there.
    assert same(plan, planner(long.replaced(iterations=plan.iterations)).plan(LINE, np.random.default_rng(0)))
    none = planner().plan(LINE, np.random.default_rng(0), deadline=lambda: True)
    assert none.iterations == 0
    np.testing.assert_array_equal(none.waypoints, LINE)


@pytest.mark.parametrize("portions", [[60], [1] * 60, [7, 1, 30, 100], [59, 1]])
def test_portions_change_nothing(portions: list[int]) -> None:
    whole = planner().plan(LINE, np.random.default_rng(3))
    run = planner().begin(LINE, np.random.default_rng(3))
    for portion in portions:
        run.advance(portion)
    assert run.finished
    assert same(run.result(), whole)


def test_a_plan_that_becomes_no_better_ends_early_if_asked_to() -> None:
    patient = CONFIG.replaced(iterations=400, patience=20, tolerance=0.05)
    plan = planner(patient).plan(LINE, np.random.default_rng(0))
    assert 20 < plan.iterations < 400
    assert planner(patient.replaced(patience=0)).plan(LINE, np.random.default_rng(0)).iterations == 400
    # What is not allowed is never given up for good.
    blocked = Disc([0.0, 0.0], 5.0, forbidden=4.0)
    assert planner(patient, blocked).plan(LINE, np.random.default_rng(0)).iterations == 400


def test_noise_can_be_changed_for_one_plan() -> None:
    subject = planner()
    still = subject.plan(LINE, np.random.default_rng(0), noise_std=(0.01, 1e-9))
    assert np.abs(still.waypoints[:, 1] - LINE[:, 1]).max() < 1e-6
    louder = planner(CONFIG.replaced(noise_std=0.02)).plan(LINE, np.random.default_rng(0))
    assert same(subject.plan(LINE, np.random.default_rng(0), noise_std=0.02), louder)
    with pytest.raises(PlanningError, match="noise_std"):
        subject.plan(LINE, np.random.default_rng(0), noise_std=(0.1, 0.1, 0.1))


class Foreign(SmoothnessCost):
    """The same costs, of a class that the compiled loop does not know."""


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1), reused=st.sampled_from([0, 3]))
def test_the_compiled_loop_does_what_calling_term_by_term_does(seed: int, reused: int) -> None:
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, 5)
    occupied = rng.random((12, 12, 12)) < 0.05
    obstacles = ObstacleCost(chain, random_spheres(rng, 5), field_around(occupied, (-1.0, -1.0, -1.0), 0.15), 10.0)
    # Rising evenly: a point that rounding moves to the next voxel changes little.
    rising = np.linspace(0.0, 1.0, 20, dtype=np.float32)[:, None, None]
    occupancy = Occupancy(VoxelGrid((-1.0, -1.0, -1.0), 0.1, (20, 20, 20)), np.tile(rising, (1, 20, 20)))
    human = HumanOccupancyCost(chain, random_points(rng, 5), occupancy, 0.5)
    config = StompConfig(waypoints=30, iterations=4, rollouts=8, reused=reused, noise_std=0.01)
    terms = [obstacles, human, SmoothnessCost(10.0)]
    uncompiled = [*terms[:2], Foreign(10.0)]
    both = [StompPlanner(each, [-3.0] * 5, [3.0] * 5, config) for each in (terms, uncompiled)]
    assert both[0].compiled_terms is not None
    assert both[1].compiled_terms is None
    line = straight(rng.uniform(-2.0, 2.0, 5), rng.uniform(-2.0, 2.0, 5), 30)
    one, other = (subject.plan(line, np.random.default_rng(1)) for subject in both)
    assert one.iterations == other.iterations == 4
    moved = np.abs(one.waypoints - line).max()
    assert np.abs(one.waypoints - other.waypoints).max() <= 0.05 * moved
    assert one.total == pytest.approx(other.total, rel=0.02)


def test_shares_are_weighted_and_add_up() -> None:
    light, heavy = Disc([0.0, 0.0], 0.4, weight=1.0), Disc([0.0, 0.0], 0.4, weight=7.0)
    one, seven = planner(disc=light).assess(LINE), planner(disc=heavy).assess(LINE)
    assert seven.cost["disc"] == pytest.approx(7.0 * one.cost["disc"])
    assert seven.total == pytest.approx(seven.cost["disc"] + seven.cost["smoothness"])


@pytest.mark.parametrize(
    "change",
    [
        {"waypoints": 4},
        {"reused": 10},
        {"iterations": -1},
        {"noise_std": 0.0},
        {"noise_decay": 0.0},
        {"sharpness": 0.0},
        {"sharpness": 1000.0},
        {"patience": -1},
        {"tolerance": 1.0},
    ],
)
def test_impossible_settings_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=f"StompConfig {next(iter(change))}: wanted"):
        CONFIG.replaced(**change)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(PlanningError, match="cost terms of different names"):
        StompPlanner([SmoothnessCost(), SmoothnessCost()], [-1.0], [1.0])
    with pytest.raises(PlanningError, match="limits"):
        StompPlanner([SmoothnessCost()], [1.0], [-1.0])
    with pytest.raises(PlanningError, match="noise_std"):
        StompPlanner([SmoothnessCost()], [-1.0], [1.0], StompConfig(noise_std=(0.1, 0.1)))
    with pytest.raises(PlanningError, match="initial trajectory"):
        planner().plan(LINE[:-1], np.random.default_rng(0))
    with pytest.raises((PlanningError, ArrayError), match="finite"):
        planner().plan(np.where(LINE > 0.9, np.nan, LINE), np.random.default_rng(0))
