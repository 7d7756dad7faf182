"""The summary's figures agree with what happened, computed another way."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from human_distance import least_distance_m
from rich.console import Console

from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.scene import Scene
from humanpred_ros.viewing.analysis import GOAL_TOLERANCE_RAD, RunSummary, analyse
from humanpred_ros.viewing.key_figures import print_summary
from humanpred_ros.viewing.recorded import RecordedDecision
from humanpred_ros.viewing.run import POSTURE_TO_OCCUPANCY, Run, read_run
from humanpred_ros.viewing.workcell import load_workcell, measure_clearance

pytestmark = pytest.mark.core

PERIOD_S, REACH_S = 0.0825, 1.65


def refuse(constant: str) -> float:
    raise AssertionError(f"not strict JSON: {constant}")


def printed(summary: RunSummary) -> str:
    stream = io.StringIO()
    print_summary(summary, Console(file=stream, width=200, color_system=None))
    return stream.getvalue()


def test_one_row_per_replanning_step(full: Run, full_summary: RunSummary) -> None:
    assert [row.step for row in full_summary.steps] == list(range(1, 29))
    for row, decision in zip(full_summary.steps, full.steps, strict=True):
        assert row.t_s == decision.t_s
        assert row.costs == {goal.name: goal.selection_cost for goal in decision.goals}
        k = int(np.flatnonzero(full.posterior.t_s <= row.t_s + 1e-9)[-1])
        assert row.best_probability == full.posterior.probability[k].max()
        assert row.best_class == full.posterior.labels[int(full.posterior.probability[k].argmax())]
    assert full_summary.steps[10].percent == pytest.approx(100.0 * full_summary.steps[10].t_s / REACH_S)
    assert [row.step for row in full_summary.steps if row.missed] == [9]
    assert {row.action for row in full_summary.steps} == {"replan", "missed"}
    assert full_summary.missed == 1


def test_switch_is_numbered_from_one_and_acts_a_step_later(full_summary: RunSummary) -> None:
    (switch,) = full_summary.switches
    assert (switch.step, switch.step_in_effect, switch.goal_before, switch.goal_after) == (4, 5, "red", "blue")
    assert switch.t_effect_s == pytest.approx(switch.t_s + PERIOD_S)


def test_a_missed_step_switches_nothing(make_run: Callable[..., Path]) -> None:
    summary = analyse(read_run(make_run(switch_step=4, missed_step=4))).summary
    assert [switch.step for switch in summary.switches] == [5]


def test_first_choice_is_no_switch(make_run: Callable[..., Path]) -> None:
    assert analyse(read_run(make_run(switch_step=0, held=10))).summary.switches == ()


def test_closest_moment_agrees_with_a_distance_per_posture(
    full: Run, full_summary: RunSummary, human: HumanModel, scene: Scene
) -> None:
    spheres, to_human = scene.arm.spheres(), np.linalg.inv(scene.T_world_human)
    least = []
    for t_s, posture in zip(full.postures.t_s, full.postures.q, strict=True):
        q = [np.interp(t_s, full.robot.t_s, column) for column in full.robot.q.T]
        centres = spheres.world_m(scene.arm.chain, np.array(q)) @ to_human[:3, :3].T + to_human[:3, 3]
        least.append(least_distance_m(human, posture, centres, spheres.radius_m))
    clearance = measure_clearance(full, load_workcell(full))
    np.testing.assert_allclose(clearance.distance_m, least, atol=1e-9)
    closest = full_summary.closest
    assert closest is not None
    assert closest.distance_m == pytest.approx(min(least))
    assert closest.t_s == full.postures.t_s[int(np.argmin(least))]
    assert closest.robot_link in scene.arm.link_names
    assert closest.human_body in {body.name for body in human.bodies}


def test_distance_is_known_only_while_both_were_recorded(full: Run) -> None:
    workcell = load_workcell(full)
    half = dataclasses.replace(full.robot, t_s=full.robot.t_s[:100], q=full.robot.q[:100], v=full.robot.v[:100])
    clearance = measure_clearance(dataclasses.replace(full, robot=half), workcell)
    assert 0 < len(clearance) < len(full.postures)
    assert clearance.t_s[-1] <= half.t_s[-1]


def test_latency_figures_are_those_of_the_samples(full: Run, full_summary: RunSummary) -> None:
    delay_ms = sorted(1e3 * full.latencies[0].delay_s)
    figures = full_summary.latency[POSTURE_TO_OCCUPANCY]
    assert figures.count == 160
    assert figures.median_ms == pytest.approx((delay_ms[79] + delay_ms[80]) / 2)
    assert delay_ms[156] <= (figures.p99_ms or 0.0) <= delay_ms[159] == pytest.approx(figures.max_ms)


def test_goal_counts_as_reached_from_the_last_time_it_was_entered(
    full: Run, full_summary: RunSummary, scene: Scene
) -> None:
    reached = full_summary.reached
    assert reached is not None
    assert reached.goal == "blue"
    error = np.abs(full.robot.q - scene.goal("blue").configuration).max(axis=1)
    k = int(np.flatnonzero(full.robot.t_s == reached.t_s)[0])
    assert error[k - 1] > GOAL_TOLERANCE_RAD >= error[k:].max()
    assert reached.error_rad == pytest.approx(error[-1])


def test_full_turns_do_not_keep_from_the_goal(full: Run, scene: Scene) -> None:
    q = full.robot.q + 2 * np.pi * np.array([0, 0, 0, 0, -1, 0, 2])
    summary = analyse(dataclasses.replace(full, robot=dataclasses.replace(full.robot, q=q))).summary
    assert summary.reached is not None
    assert summary.reached.goal == "blue"


def test_an_arm_on_its_way_is_at_no_goal(make_run: Callable[..., Path]) -> None:
    run = read_run(make_run(n_postures=60, held=0))
    summary = analyse(run).summary
    assert summary.reached is None
    assert "interrupted after 60 % of the reach" in summary.outcome


def test_holds_in_a_row_are_one_hold_with_its_reason(make_run: Callable[..., Path]) -> None:
    summary = analyse(read_run(make_run(hold_from_s=0.9))).summary
    (hold,) = summary.holds
    assert hold.t_s >= 0.9
    assert hold.decisions > 50
    assert hold.reason.startswith("stale human data")
    assert "hold" in summary.outcome
    assert "stale human data" in printed(summary)


def test_a_hold_lasts_until_the_arm_is_sent_on(full: Run) -> None:
    def hold(k: int, reason: str) -> RecordedDecision:
        stop_s = full.decisions[k].t_s + 0.001
        return dataclasses.replace(full.decisions[k], action="hold", reason=reason, t_switch_s=stop_s, goals=())

    replans = [k for k, decision in enumerate(full.decisions) if decision.action == "replan"]
    first, second = replans[2], replans[3]
    changed = list(full.decisions)
    changed[first + 1], changed[first + 2] = hold(first + 1, "stale: 0.5 s"), hold(first + 2, "stale: 0.6 s")
    changed[-2], changed[-1] = hold(-2, "invalid"), hold(-1, "stale: 0.5 s")
    a, b, c = analyse(dataclasses.replace(full, decisions=tuple(changed))).summary.holds
    assert (a.decisions, a.reason) == (2, "stale: 0.5 s")
    assert a.t_s == full.decisions[first + 1].t_s + 0.001
    assert a.until_s == full.decisions[second].t_switch_s  # decisions to keep on do not send a stopped arm on
    assert b.until_s == c.t_s
    assert c.until_s == full.duration_s


def test_a_step_without_any_way_is_a_step_and_a_hold(full: Run) -> None:
    k = next(k for k, decision in enumerate(full.decisions) if decision.step == 6)
    goals = tuple(dataclasses.replace(goal, valid=False, message="in collision") for goal in full.decisions[k].goals)
    stuck = dataclasses.replace(full.decisions[k], action="hold", reason="no goal can be reached", goals=goals)
    summary = analyse(
        dataclasses.replace(full, decisions=(*full.decisions[:k], stuck, *full.decisions[k + 1 :]))
    ).summary
    assert len(summary.steps) == len(full.steps)
    assert [hold.reason for hold in summary.holds] == ["no goal can be reached"]


def test_recognition_counts_from_when_it_lasted(full: Run, full_summary: RunSummary) -> None:
    recognised = full_summary.recognised
    assert recognised is not None
    assert recognised.true_class == "3"
    best = full.posterior.probability.argmax(axis=1)
    k = int(np.flatnonzero(full.posterior.t_s == recognised.t_s)[0])
    assert (best[k:] == 3).all()
    assert best[k - 1] != 3


@pytest.mark.parametrize(("trajectory", "found"), [("5/1", "true class 5"), ("77", None), ("99/0", None)])
def test_recognition_needs_the_true_class(full: Run, trajectory: str, found: str | None) -> None:
    summary = analyse(dataclasses.replace(full, facts={**full.facts, "trajectory": trajectory})).summary
    if found is None:
        assert summary.recognised is None
    else:
        assert found in printed(summary)


def test_summary_tells_whether_the_occupancy_came_true(full_summary: RunSummary) -> None:
    content = json.loads(full_summary.to_json(), parse_constant=refuse)["calibration"]["human moving"]
    part = full_summary.calibration["human moving"]
    assert content["error"] == part.error
    assert len(content["bins"]) == 10
    assert sum(row["count"] for row in content["bins"]) == content["voxels"] == part.voxels > 0
    assert re.search(rf"calibration error of the occupancy +{part.error:.2f}", printed(full_summary))


def test_peak_velocity_is_a_share_of_the_limit(full: Run, full_summary: RunSummary, scene: Scene) -> None:
    steps = np.abs(np.diff(full.robot.q, axis=0)) / 0.01 / scene.arm.chain.velocity_limit
    assert full_summary.peak_velocity == pytest.approx(steps.max(), rel=0.02)


@pytest.mark.parametrize("facts", [{"scene": ""}, {"scene": "no_such_scene"}])
def test_a_run_without_its_scene_says_what_that_costs(full: Run, facts: dict[str, str]) -> None:
    summary = analyse(dataclasses.replace(full, facts={**full.facts, **facts})).summary
    assert summary.closest is None
    assert summary.reached is None
    assert len(summary.steps) == 28
    assert any("scene" in text for text in summary.notes)


def test_postures_of_another_model_are_told(full: Run) -> None:
    other = dataclasses.replace(full.postures, names=tuple(f"dof{k}" for k in range(12)))
    summary = analyse(dataclasses.replace(full, postures=other)).summary
    assert summary.closest is None
    assert any("human model" in text for text in summary.notes)


def test_json_is_strict_and_complete(full: Run, full_summary: RunSummary) -> None:
    content = json.loads(full_summary.to_json(), parse_constant=refuse)
    assert content["switches"][0]["step"] == 4
    assert set(content) == {field.name for field in dataclasses.fields(RunSummary)}
    endless = dataclasses.replace(full_summary, duration_s=float("inf"))
    assert json.loads(endless.to_json(), parse_constant=refuse)["duration_s"] is None


def test_an_empty_run_has_a_summary(make_run: Callable[..., Path]) -> None:
    summary = analyse(read_run(make_run(n_postures=0))).summary
    assert summary.steps == ()
    assert summary.closest is None
    assert summary.planning.median_ms is None
    assert "Nothing was recorded" in printed(summary)
    json.loads(summary.to_json(), parse_constant=refuse)


def test_printed_table_names_goals_and_survives_markup(full: Run, full_summary: RunSummary) -> None:
    text = printed(full_summary)
    assert "cost of every goal" in text
    assert "step 4" in text
    assert "1 of 28" in text
    odd = tuple(dataclasses.replace(d, action="hold", reason="[/bold] odd [reason") for d in full.decisions)
    assert "[/bold] odd [reason" in printed(analyse(dataclasses.replace(full, decisions=odd)).summary)
