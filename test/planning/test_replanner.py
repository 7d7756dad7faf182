"""The replanner: the right goal, one step late, continuous, repeatable, and safe when nothing works."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_worlds import field_around, free_space, nobody, planar_arm, somebody_at

from humanpred_ros.errors import GoalUnreachableError, PlanningError, SceneError, SettingsError
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE
from humanpred_ros.robot.goals import Goal
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.planner import TURN

pytestmark = pytest.mark.core

ARM = planar_arm()
FREE = free_space()
START = np.array([0.0, 0.3, 0.3])
LEFT, RIGHT = np.array([1.2, 0.3, 0.3]), np.array([-1.2, 0.3, 0.3])
GOALS = (Goal("left", LEFT), Goal("right", RIGHT))
CONFIG = ReplannerConfig(threads=1, human_margin_m=0.0, stomp=StompConfig(waypoints=40, iterations=15, noise_std=0.01))


def replanner(config: ReplannerConfig = CONFIG, goals: tuple[Goal, ...] = GOALS, **parts: object) -> Replanner:
    subject = Replanner(ARM, goals, parts.get("field", FREE), config)
    subject.start(START, 0.0)
    return subject


def on_the_way_to(goal: str, t_s: float = 0.0, share: float = 0.5) -> object:
    """A person where the arm's outer half is when it has gone `share` of the way to a goal."""
    q = START + share * (dict((g.name, g.configuration) for g in GOALS)[goal] - START)
    x, y, _ = ARM.chain.link_poses(q)[-1, :3, 3]
    return somebody_at(x, y, t_s, radius_m=0.15)


def steps(subject: Replanner, worlds: list, period: float = 0.1) -> list[Decision]:
    decisions = []
    for k, world in enumerate(worlds):
        decisions.append(subject.plan(world(k * period)))
        subject.commit(decisions[-1])
    return decisions


@pytest.mark.parametrize(("blocked", "free"), [("left", "right"), ("right", "left")])
def test_a_person_on_the_way_to_one_goal_makes_it_choose_the_other(blocked: str, free: str) -> None:
    decision = replanner().plan(on_the_way_to(blocked))
    assert decision.action == "replan"
    assert decision.chosen == free
    assert decision.report(blocked).human > 10 * max(decision.report(free).human, 1e-6)
    assert {"obstacle", "human", "smoothness"} == set(decision.report(free).cost)


def test_a_person_who_steps_in_the_way_makes_it_switch() -> None:
    worlds = [nobody] * 4 + [lambda t: on_the_way_to("left", t, 0.9)] * 4
    subject = replanner(goals=(Goal("left", LEFT), Goal("right", RIGHT * 1.4)))
    decisions = steps(subject, worlds)
    assert [d.chosen for d in decisions[:4]] == ["left"] * 4
    assert [d.chosen for d in decisions[4:]] == ["right"] * 4
    assert [d.switched for d in decisions] == [False] * 4 + [True] + [False] * 3
    assert decisions[4].report("right").warm_start in ("cheaper", "closest")


def test_a_plan_takes_over_one_period_after_its_occupancy() -> None:
    subject = replanner()
    decision = subject.plan(nobody(0.4))
    assert decision.t_switch_s == pytest.approx(0.5)
    assert decision.trajectory is not None
    assert decision.trajectory.start_s == pytest.approx(0.5)
    subject.commit(decision)
    assert np.array_equal(subject.state_at(0.5)[0], START)
    assert not np.array_equal(subject.state_at(0.8)[0], START)


def test_planning_changes_nothing_until_committed() -> None:
    subject = replanner()
    first, again = subject.plan(nobody()), subject.plan(nobody())
    assert first == again
    assert np.array_equal(subject.state_at(1.0)[0], START)
    assert subject.due(0.1)
    subject.commit(first)
    assert not np.array_equal(subject.state_at(1.0)[0], START)


@pytest.mark.parametrize("selection", ["human_and_length", "total"])
def test_threads_and_repetition_change_no_bit(selection: str) -> None:
    worlds = [lambda t: on_the_way_to("left", t, 0.3 + t)] * 6
    config = CONFIG.replaced(selection=selection)
    runs = [steps(replanner(config.replaced(threads=n)), worlds) for n in (1, 2, 3, 1)]
    assert runs[0] == runs[1] == runs[2] == runs[3]
    assert runs[0] != steps(replanner(config.replaced(seed=1)), worlds)


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_robot_never_jumps_and_keeps_its_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    subject = replanner(CONFIG.replaced(min_improvement=0.0, seed=seed % 1000))
    for k in range(10):
        world = somebody_at(*rng.uniform(-0.8, 0.8, 2), t_s=0.1 * k, radius_m=rng.uniform(0.05, 0.3))
        before = [subject.state_at(0.1 * (k + 1))]
        if rng.random() < 0.15:
            t = 0.1 * k + 0.05
            before = [subject.state_at(t)]
            decision = subject.hold(t, "test")
            at = t
        else:
            decision = subject.plan(world)
            subject.commit(decision)
            at = decision.t_switch_s if decision.trajectory is not None else 0.1 * (k + 1)
        if decision.trajectory is not None:
            for was, begins in zip(before[0], subject.state_at(at), strict=True):
                np.testing.assert_allclose(begins, was, atol=1e-9)
    states = [subject.state_at(t) for t in np.arange(0.3, 4.0, 0.005)]
    v, a = np.array([s[1] for s in states]), np.array([s[2] for s in states])
    assert (np.abs(v) <= subject.problem.velocity_limit * (1.0 + LIMIT_TOLERANCE)).all()
    assert (np.abs(a) <= subject.problem.acceleration_limit * (1.0 + 2.0 * LIMIT_TOLERANCE)).all()


def test_it_arrives_and_stays() -> None:
    subject = replanner()
    decisions = steps(subject, [nobody] * 40)
    assert decisions[0].action == "replan"
    assert "keep" in {d.action for d in decisions}
    assert decisions[-1].action == "arrived"
    goal = dict(left=LEFT, right=RIGHT)[decisions[-1].chosen]
    q, v, a = subject.state_at(10.0)
    assert np.array_equal(q, goal)
    assert not v.any()
    assert not a.any()
    # A person at the arm's side does not make it leave; one who comes to where it is does.
    tool = ARM.chain.link_poses(goal)[-1, :3, 3]
    assert subject.plan(somebody_at(tool[0] + 0.5, tool[1], t_s=4.1)).action == "arrived"
    assert subject.respond(nobody(4.15)).action == "arrived"
    crowded = subject.respond(somebody_at(tool[0], tool[1], t_s=4.2))
    assert crowded.action in ("replan", "evade")
    assert crowded.switched or crowded.action == "evade"
    assert "the person is likely" in crowded.reason


def test_a_path_that_is_hardly_better_is_not_taken() -> None:
    decisions = steps(replanner(CONFIG.replaced(min_improvement=0.5)), [nobody] * 5)
    assert [d.action for d in decisions] == ["replan"] + ["keep"] * 4
    assert all(d.trajectory is None for d in decisions[1:])
    assert all(d.report(d.chosen).warm_start == "executing" for d in decisions[1:])


def test_continuous_joints_go_the_shorter_way() -> None:
    turned = START + np.array([0.0, 0.0, 2.0 * np.pi - 0.5])
    subject = replanner(goals=(Goal("turned", turned),))
    path = subject.plan(nobody()).report("turned").path
    assert np.array_equal(path[0], START)
    np.testing.assert_allclose(path[-1], START + np.array([0.0, 0.0, -0.5]), atol=1e-12)


def test_steps_are_due_once_a_period() -> None:
    subject = replanner(CONFIG.replaced(period_s=0.1))
    # The first period only watches (P1: 5 % of the motion).
    assert not subject.due(0.0)
    assert subject.due(0.1 - 1e-9)
    subject.commit(subject.plan(nobody(0.1)))
    assert not subject.due(0.15)
    assert subject.due(0.2)
    kept = subject.keep(nobody(0.15))
    assert (kept.action, kept.stamp_s, kept.trajectory) == ("keep", 0.15, None)
    assert kept.step == 1


def test_a_hold_stops_the_robot_and_the_next_plan_moves_it_again() -> None:
    subject = replanner()
    subject.commit(subject.plan(nobody(0.0)))
    moving = subject.state_at(0.5)
    hold = subject.hold(0.5, "stale human data")
    assert (hold.action, hold.reason, hold.t_switch_s) == ("hold", "stale human data", 0.5)
    assert hold.trajectory is not None
    for was, begins in zip(moving, subject.state_at(0.5), strict=True):
        np.testing.assert_allclose(begins, was, atol=1e-12)
    assert not subject.state_at(hold.trajectory.end_s)[1].any()
    assert hold.trajectory.end_s < 2.0
    assert not subject.at_rest(0.5)
    assert subject.at_rest(hold.trajectory.end_s)
    assert subject.hold(0.55, "still stale").trajectory is None
    assert subject.keep(nobody(0.56)).action == "hold"
    assert subject.due(0.57)
    resumed = subject.plan(nobody(0.6))
    subject.commit(resumed)
    assert resumed.action == "replan"
    assert subject.state_at(1.5)[1].any()


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("how", ["hold", "correct"])
def test_a_plan_from_before_a_stop_is_not_executed(moving: bool, how: str) -> None:
    subject = replanner()
    if moving:
        subject.commit(subject.plan(nobody(0.0)))
    stops: list[Decision] = []

    def stop_once() -> bool:  # asked in the middle of a step
        if not stops and how == "hold":
            stops.append(subject.hold(0.31, "stale human data"))
        elif not stops:
            stops.append(subject.correct(START, np.zeros(3), 0.31, "the arm does not follow"))
        return False

    decision = subject.respond(nobody(0.3), lambda: 0.3, stop_once)
    assert stops
    assert (decision.action, decision.reason) == ("hold", stops[0].reason)
    assert decision.trajectory is None
    assert subject.held == stops[0].reason
    assert subject.at_rest(3.0)
    subject.regain(START, 0.4)
    assert subject.respond(nobody(0.5), lambda: 0.5).action == "replan"


def test_a_hold_forgets_a_plan_that_has_not_taken_over_yet() -> None:
    subject = replanner()
    subject.commit(subject.plan(nobody(0.0)))
    hold = subject.hold(0.05, "too close")
    assert hold.trajectory is not None
    assert np.array_equal(subject.state_at(1.0)[0], START)


def test_a_plan_that_came_too_late_is_not_executed() -> None:
    subject = replanner()
    late = subject.missed(subject.plan(nobody(0.0)))
    assert (late.action, late.trajectory, late.chosen) == ("missed", None, None)
    assert len(late.goals) == 2
    assert np.array_equal(subject.state_at(1.0)[0], START)
    assert subject.plan(nobody(0.2)).step == late.step + 1


def test_nothing_is_executed_through_an_obstacle() -> None:
    x, y = np.meshgrid(np.arange(50) * 0.05 - 1.25, np.arange(50) * 0.05 - 1.25, indexing="ij")
    angle = np.arctan2(y, x)
    walls = ((angle > 0.55) & (angle < 0.95)) | ((angle > -0.6) & (angle < -0.25))  # between the start and the goals
    occupied = np.zeros((50, 50, 50), dtype=np.bool_)
    occupied[walls & (np.hypot(x, y) < 1.2) & (np.hypot(x, y) > 0.12)] = True
    subject = replanner(field=field_around(occupied, (-1.25, -1.25, -1.25), 0.05))
    decision = subject.plan(nobody())
    assert decision.action == "hold"
    assert decision.trajectory is None  # it rests already
    assert not any(report.valid for report in decision.goals)
    assert "obstacle" in decision.reason
    subject.commit(decision)
    assert np.array_equal(subject.state_at(5.0)[0], START)
    with pytest.raises(GoalUnreachableError, match=r"goal left: .* from obstacle"):
        replanner(field=field_around(np.ones((50, 50, 50), dtype=np.bool_), (-1.25, -1.25, -1.25), 0.05))


def test_a_deadline_too_short_for_one_update_is_a_hold_with_a_reason() -> None:
    subject = replanner()
    decision = subject.plan(nobody(), deadline=lambda: True)
    assert (decision.action, decision.trajectory) == ("hold", None)
    assert "no time for a single update" in decision.reason
    assert {report.iterations for report in decision.goals} == {0}
    # What is being executed goes on if it still can.
    subject.commit(subject.plan(nobody(0.1)))
    assert subject.plan(nobody(0.2), deadline=lambda: True).action == "keep"


def test_a_late_deadline_is_not_blamed_where_the_person_takes_every_goal() -> None:
    subject = replanner(goals=GOALS[:1])
    x, y, _ = ARM.chain.link_poses(LEFT)[-1, :3, 3]
    decision = subject.plan(somebody_at(x, y, radius_m=0.1), deadline=lambda: True)
    assert decision.action == "hold"
    assert "the person is likely" in decision.reason
    assert "single update" not in decision.reason


def test_goals_share_the_time_there_is() -> None:
    goals = tuple(Goal(f"place {k}", START + np.array([0.2 * k - 0.7, 0.1, 0.0])) for k in range(8))
    for threads in (1, 2):
        asked = iter([False] * 30 + [True] * 1000)
        long = CONFIG.replaced(threads=threads, prune_after=0, stomp=CONFIG.stomp.replaced(iterations=400))
        decision = replanner(long, goals=goals).plan(nobody(), deadline=lambda asked=asked: next(asked))
        done = [report.iterations for report in decision.goals]
        assert sum(done) > 0
        assert max(done) - min(done) <= 2 * TURN


def test_a_far_too_expensive_goal_is_set_aside_with_a_reason_and_comes_back() -> None:
    keen = CONFIG.replaced(prune_after=3, prune_factor=1.5, prune_cost=0.0, min_separation_m=0.0, min_improvement=0.0)
    subject = replanner(keen)
    decisions = steps(subject, [lambda t: on_the_way_to("left", t, 0.9), nobody])
    left, right = (decisions[0].report(name) for name in ("left", "right"))
    assert left.set_aside.startswith("far too expensive: costs")
    assert "right" in left.set_aside
    assert (left.iterations, right.iterations) == (3, 15)
    again = decisions[1].report("left")
    assert again.revived
    assert not again.set_aside
    assert again.iterations == 15


def test_a_goal_that_the_person_comes_to_is_set_aside() -> None:
    x, y, _ = ARM.chain.link_poses(LEFT)[-1, :3, 3]
    decision = replanner().plan(somebody_at(x, y, radius_m=0.1))
    assert decision.chosen == "right"
    assert "the person is likely (p >= 0.3) to come within" in decision.report("left").set_aside
    assert decision.report("left").iterations == 0
    # One who is hardly likely to come does not.
    unlikely = replanner().plan(somebody_at(x, y, radius_m=0.1, probability=0.2)).report("left")
    assert "person" not in unlikely.set_aside
    assert unlikely.iterations > 0


def test_of_a_goals_configurations_the_one_that_disturbs_least_is_planned_to() -> None:
    either = Goal("either", np.stack([LEFT, RIGHT]))
    x, y, _ = ARM.chain.link_poses(LEFT)[-1, :3, 3]
    worlds = {0: nobody, 1: lambda: somebody_at(x, y, radius_m=0.1)}
    for alternative, world in worlds.items():
        report = replanner(goals=(either,)).plan(world()).report("either")
        assert report.alternative == alternative
        np.testing.assert_array_equal(report.path[-1], either.configurations[alternative])
    # On the way to one it stays with it, until the person comes there.
    subject = replanner(goals=(either,))
    decisions = steps(subject, [nobody] * 3 + [lambda t: somebody_at(x, y, t, radius_m=0.1)] * 2)
    assert [d.report("either").alternative for d in decisions] == [0, 0, 0, 1, 1]


def test_tasks_need_not_be_equal() -> None:
    assert replanner(goals=(Goal("near", LEFT), Goal("far", 1.4 * RIGHT))).plan(nobody()).chosen == "near"
    dear = (Goal("near", LEFT, task_cost=1.0), Goal("far", 1.4 * RIGHT))
    decision = replanner(goals=dear).plan(nobody())
    assert decision.chosen == "far"
    assert decision.report("near").task_cost == 1.0
    with_cost, without = decision.report("near"), replanner().plan(nobody()).report("left")
    assert with_cost.selection_cost == pytest.approx(1.0 + without.selection_cost, rel=0.05)


def test_it_does_not_dither_between_equal_goals() -> None:
    # Each step one of two places is a little worse than the other, by turns.
    worlds = [lambda t, k=k: on_the_way_to("left" if k % 2 else "right", t, 0.97) for k in range(8)]
    soft = CONFIG.replaced(min_separation_m=0.0, prune_after=0)
    habitual = steps(replanner(soft.replaced(switch_cost=10.0)), worlds)
    assert sum(d.switched for d in habitual) == 0
    fickle = steps(replanner(soft.replaced(switch_cost=0.0, switch_improvement=0.0)), worlds)
    assert sum(d.switched for d in fickle) > 2


def test_a_motion_that_has_become_bad_is_replanned_at_once() -> None:
    subject = replanner(CONFIG.replaced(min_improvement=0.5), goals=(Goal("left", LEFT),))
    assert [subject.respond(nobody(t)).action for t in (0.1, 0.2, 0.21)] == ["replan", "keep", "keep"]
    x, y, _ = ARM.chain.link_poses(LEFT)[-1, :3, 3]
    # No step is due before 0.3 s.
    decision = subject.respond(somebody_at(x, y, t_s=0.23, radius_m=0.1))
    assert (decision.step, len(decision.goals)) == (3, 1)
    assert decision.report("left").set_aside
    assert subject.due(0.3)  # nor is that one put off


def test_it_stops_before_it_comes_too_close() -> None:
    subject = replanner(CONFIG.replaced(period_s=0.3), goals=(Goal("left", LEFT),))
    subject.commit(subject.plan(nobody(0.0)))
    t = 0.6
    q = subject.state_at(t + 0.15)[0]
    x, y, _ = ARM.chain.link_poses(q)[-1, :3, 3]
    decision = subject.respond(somebody_at(x, y, t_s=t, radius_m=0.1, probability=1.0), now=lambda: t)
    assert decision.action == "hold"
    assert decision.reason.startswith("too close: ")
    assert decision.trajectory is not None
    assert decision.t_switch_s == t
    # A person who is only predicted to come there does not stop it at once.
    again = replanner(CONFIG.replaced(period_s=0.3), goals=(Goal("left", LEFT),))
    again.commit(again.plan(nobody(0.0)))
    assert again.respond(somebody_at(x, y, t_s=t, radius_m=0.1, probability=0.9), now=lambda: t).action != "hold"


def test_an_arm_at_rest_gets_out_of_the_way() -> None:
    walls = (Goal("left", LEFT), Goal("right", RIGHT))
    subject = replanner(goals=walls)
    x, y, _ = ARM.chain.link_poses(START)[-1, :3, 3]
    everywhere = [somebody_at(*ARM.chain.link_poses(q)[-1, :2, 3], t_s=0.1, radius_m=0.15) for q in (LEFT, RIGHT)]
    here = somebody_at(x, y, t_s=0.1, radius_m=0.15)
    probability = np.maximum.reduce([o.probability for o in (*everywhere, here)])
    decision = subject.respond(Occupancy(here.grid, probability, 0.1))
    assert decision.action == "evade"
    assert not any(report.eligible for report in decision.goals)
    assert decision.trajectory is not None
    # Farther from the person than before, and it stays there while nothing changes.
    points = ARM.spheres().world_m(ARM.chain, np.stack([START, decision.trajectory.q[-1]]))
    gap = np.hypot(points[..., 0] - x, points[..., 1] - y).min(axis=1)
    assert gap[1] > gap[0] + 0.1
    later = [subject.respond(Occupancy(here.grid, probability, 0.1 * k)) for k in range(2, 40)]
    assert {d.action for d in later} <= {"keep", "hold"}
    # Once they have gone, the work goes on.
    assert subject.respond(nobody(4.0)).action == "replan"


def test_an_occupancy_of_another_lattice_is_refused() -> None:
    subject = Replanner(ARM, GOALS, FREE, CONFIG, grid=nobody().grid)
    subject.start(START, 0.0)
    assert subject.plan(nobody()).action == "replan"
    other = VoxelGrid((-1.0, -1.0, -0.1), 0.1, (20, 20, 2))
    with pytest.raises(PlanningError, match="lattice"):
        subject.respond(Occupancy(other, np.zeros(other.shape, dtype=np.float32)))


def test_selection_is_the_authors_by_default_and_the_total_if_asked() -> None:
    decision = replanner().plan(on_the_way_to("left"))
    for report in decision.goals:
        assert report.selection_cost == pytest.approx(report.human + 0.002 * report.length + 0.2 * report.rest)
    total = replanner(CONFIG.replaced(selection="total")).plan(on_the_way_to("left"))
    for report in total.goals:
        assert report.selection_cost == pytest.approx(report.total)


def test_misuse_is_refused() -> None:
    subject = Replanner(ARM, GOALS, FREE, CONFIG)
    with pytest.raises(PlanningError, match="start"):
        subject.plan(nobody())
    subject.start(START, 0.0)
    decision = subject.plan(nobody(1.0))
    subject.commit(decision)
    with pytest.raises(PlanningError, match="plan again"):
        subject.commit(decision)
    with pytest.raises(PlanningError, match="clock jumps back"):
        subject.plan(nobody(0.5))
    subject.start(START, 0.0)
    assert subject.plan(nobody(0.5)).step == 1
    with pytest.raises(PlanningError, match="different names"):
        replanner(goals=(GOALS[0], GOALS[0]))
    with pytest.raises(GoalUnreachableError, match="two"):
        replanner(goals=(Goal("far", np.array([0.0, 2.7, 0.0])),))
    with pytest.raises(SettingsError, match="selection"):
        CONFIG.replaced(selection="cheapest")
    for change in (
        {"period_s": 0.0},
        {"min_separation_m": -0.1},
        {"rest_weight": np.nan},
        {"switch_improvement": 1.0},
        {"likely_probability": 0.0},
        {"prune_factor": 0.5},
    ):
        with pytest.raises(SettingsError, match=f"{next(iter(change))}: wanted"):
            CONFIG.replaced(**change)
    with pytest.raises(PlanningError, match="start configuration: wanted two within"):
        replanner().start(np.array([0.0, 2.7, 0.0]), 0.0)


def with_noise(noise_std: float) -> ReplannerConfig:
    return CONFIG.replaced(stomp=CONFIG.stomp.replaced(noise_std=noise_std))


def test_settings_can_be_changed_between_steps() -> None:
    subject, other = replanner(), replanner()
    other.change(with_noise(1e-6))
    assert subject.plan(nobody()) != other.plan(nobody())
    other.change(with_noise(CONFIG.stomp.noise_std))
    assert subject.plan(nobody()) == other.plan(nobody())
    for error, wrong in (
        (SceneError, {"task_costs": {"left": -1.0}}),
        (PlanningError, {"task_costs": {"middle": 1.0}}),
        (PlanningError, {"disabled": ["middle"], "config": with_noise(1e-6)}),
    ):
        with pytest.raises(error):
            other.change(**wrong)
        assert subject.plan(nobody()) == other.plan(nobody())


def test_another_speed_is_taken_on_the_way() -> None:
    subject = replanner()
    for t_s in np.arange(0.1, 0.75, 0.1):
        subject.respond(nobody(t_s))
    assert np.abs(subject.state_at(0.8)[1]).max() > 0.7
    subject.change(CONFIG.replaced(velocity_scale=0.2))
    decisions = [subject.respond(nobody(t_s)) for t_s in np.arange(0.8, 1.25, 0.1)]
    assert decisions[0].action == "replan"
    assert {decision.action for decision in decisions[1:]} == {"keep"}  # once, not at every step
    v = np.abs([subject.state_at(t_s)[1] for t_s in np.arange(1.4, 1.8, 0.02)])
    assert (v <= 1.02 * 0.2 * ARM.chain.velocity_limit).all()
    assert v.max() > 0.1


def test_costs_of_tasks_and_disabled_tasks_count_from_the_next_step() -> None:
    subject = replanner()
    steps_s = iter(np.arange(0.1, 20.0, 0.1))

    def step() -> Decision:
        return subject.respond(nobody(next(steps_s)))

    first = step()
    other = {"left": "right", "right": "left"}[first.chosen]
    subject.change(task_costs={first.chosen: 5.0})
    assert step().chosen == other
    subject.change(task_costs={first.chosen: 0.0}, disabled=[other])
    left = step()
    assert (left.action, left.chosen, left.report(other).set_aside) == ("replan", first.chosen, "disabled")
    assert left.report(other).iterations == 0
    while step().action != "arrived":
        pass
    subject.change(disabled=[first.chosen])  # it leaves a goal that it is at, too
    left = step()
    assert (left.chosen, left.reason) == (other, f"leaves {first.chosen}: disabled")
    subject.change(disabled=["left", "right"])
    held = step()
    assert (held.action, held.reason.split(":")[0]) == ("hold", "no task is enabled")
    subject.change(disabled=[])
    assert step().action == "replan"


def test_who_is_paused_holds_and_a_plan_may_be_asked_for() -> None:
    subject = replanner()
    assert subject.respond(nobody(0.1)).goals
    assert not subject.respond(nobody(0.13)).goals
    subject.plan_now()
    assert subject.respond(nobody(0.16)).goals
    subject.paused = "lunch"
    assert [subject.respond(nobody(t)).reason for t in (0.19, 0.5)] == ["lunch", "lunch"]
    subject.paused = ""
    assert subject.respond(nobody(0.53)).action == "replan"


def test_rollouts_are_kept_on_request_only() -> None:
    subject = replanner()
    subject.plan(nobody())
    assert subject.rollouts == {}
    subject.keep_rollouts = True
    subject.plan(nobody())
    assert {name: paths.shape for name, paths in subject.rollouts.items()} == {
        "left": (10, 40, 3),
        "right": (10, 40, 3),
    }
    paths = subject.rollouts["left"]
    assert np.abs(paths[:, 20] - paths[0, 20]).max() > 1e-3
    np.testing.assert_allclose(paths[:, 0], np.tile(START, (10, 1)), atol=1e-6)


def test_warming_up_does_not_disturb() -> None:
    subject = replanner()
    before = subject.plan(nobody())
    subject.warm_up()
    assert subject.plan(nobody()) == before
    assert subject.tool_path(before.report("left").path).shape == (40, 3)
    assert subject.joint_names == ARM.chain.joint_names
    subject.close()
