"""A reader of the report can tell why the arm did what it did at every step, whatever version recorded it."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from humanpred_ros.robot.goals import Goal
from humanpred_ros.robot.scene import Scene
from humanpred_ros.viewing.analysis import analyse
from humanpred_ros.viewing.figures import report_style
from humanpred_ros.viewing.key_figures import key_figures, print_summary
from humanpred_ros.viewing.plots_decisions import cost_terms_plot, goal_costs_plot
from humanpred_ros.viewing.plots_space import top_view_plot
from humanpred_ros.viewing.plots_time import clearance_plot
from humanpred_ros.viewing.recorded import GoalPlan, RecordedDecision
from humanpred_ros.viewing.report import render_report, told_of_goals
from humanpred_ros.viewing.run import Run, read_run
from humanpred_ros.viewing.workcell import Workcell, load_workcell

SET_ASIDE = "the person is likely to come within 0.02 m of r_wrist_roll there"
WHY = "red costs 0.0100, blue 0.0900"
COMES = (
    "the person is likely (p >= 0.3) to come within {:.2f} m of r_forearm_roll there; no path can be executed (red: x)"
)


def with_goal(step: RecordedDecision, name: str, **changes: object) -> RecordedDecision:
    goals = tuple(dataclasses.replace(g, **changes) if g.name == name else g for g in step.goals)  # type: ignore[arg-type]
    return dataclasses.replace(step, goals=goals)


def replaced(run: Run, changed: dict[int, RecordedDecision]) -> Run:
    """Return the run with other replanning steps, by their number."""
    decisions = tuple(changed.get(d.step, d) if d.is_step else d for d in run.decisions)
    return dataclasses.replace(run, decisions=decisions)


@pytest.fixture(scope="module")
def told(full: Run) -> Run:
    """A run whose steps tell everything: 3 sets a goal aside, 4 switches, 6 to 8 get out of the way and stop."""
    steps = {step.step: with_goal(step, "red", rest=0.125, task_cost=0.0) for step in full.steps}
    steps = {number: with_goal(step, "blue", rest=0.25, task_cost=0.0375) for number, step in steps.items()}
    steps = {number: dataclasses.replace(step, margin=-0.0123) for number, step in steps.items()}
    steps[3] = with_goal(steps[3], "blue", set_aside=SET_ASIDE, message=SET_ASIDE, iterations=0)
    steps[4] = dataclasses.replace(with_goal(steps[4], "blue", revived=True, alternative=2), reason=WHY)
    for number, metres in ((6, 0.01), (7, 0.03)):
        steps[number] = dataclasses.replace(steps[number], action="evade", reason=COMES.format(metres))
    steps[8] = dataclasses.replace(steps[8], action="hold", reason="nowhere to go; no path can be executed (red: x)")
    return replaced(full, steps)


@pytest.fixture(scope="module")
def words(told: Run) -> str:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("humanpred_ros.viewing.report.draw_plots", lambda *parts: ())  # slow, and tested elsewhere
        return re.sub(r"<[^>]*>", " ", re.sub(r"<style>.*?</style>", "", render_report(analyse(told)), flags=re.S))


def test_report_tells_costs_margin_and_reasons(words: str) -> None:
    for text in (
        SET_ASIDE,
        WHY,
        COMES.format(0.01),
        "-0.0123",
        "0.125",
        "0.250",
        "0.0375",
        "chosen (considered again)",
    ):
        assert text.replace(">", "&gt;") in words
    for column in ("margin", "rest", "task", "STOMP: smoothness", "updates", "verdict"):
        assert column in words


def test_bags_that_do_not_tell_these_are_read_and_shown_without(full: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("humanpred_ros.viewing.report.draw_plots", lambda *parts: ())
    goal = full.steps[0].goals[0]
    assert np.isnan([goal.rest, goal.task_cost, full.steps[0].margin]).all()
    assert (goal.alternative, goal.set_aside, goal.revived, goal.eligible) == (0, "", False, True)
    columns = told_of_goals(full.steps)
    assert not any(columns[name] for name in ("rest", "task_cost", "alternative", "margin"))
    text = render_report(analyse(full))
    assert "<th>margin</th>" not in text
    assert "<th>rest</th>" not in text
    assert "no reason was recorded" in text


def test_summary_tells_margins_reasons_and_what_was_out_of_the_question(told: Run) -> None:
    summary = analyse(told).summary
    rows = {row.step: row for row in summary.steps}
    assert rows[3].out == {"blue": SET_ASIDE}
    assert rows[2].out == {"blue": "in collision with the table at waypoint 31"}
    assert (rows[4].margin, rows[4].reason) == (-0.0123, WHY)
    (switch,) = summary.switches
    assert switch.reason == WHY
    content = json.loads(summary.to_json())
    assert content["steps"][2]["out"] == {"blue": SET_ASIDE}
    assert sum(content["actions"].values()) == len(told.decisions)
    assert (content["actions"]["evade"], content["actions"]["hold"], content["actions"]["missed"]) == (2, 1, 1)
    stream = io.StringIO()
    print_summary(summary, Console(file=stream, width=80, color_system=None))
    assert "moves aside" in stream.getvalue()
    assert f"{rows[3].costs['blue']:.4f}×" in stream.getvalue()
    assert all(len(line) <= 80 for line in stream.getvalue().splitlines())


def test_getting_out_of_the_way_is_a_step_on_no_goal(told: Run, full: Run) -> None:
    summary = analyse(told).summary
    (evasion,), (hold,) = summary.evasions, summary.holds
    steps = {step.step: step for step in told.steps}
    # Distances inside a reason differ from one to the next: it is one evasion all the same.
    assert evasion.decisions == 2
    assert evasion.t_s == steps[6].t_switch_s
    assert evasion.until_s == hold.t_s == steps[8].t_switch_s
    assert hold.until_s == steps[10].t_switch_s  # the ninth was missed
    assert [row.lost_to for row in summary.steps[4:10]] == ["", "evade", "evade", "hold", "missed", ""]
    # A missed step leaves the arm at what it did.
    assert [row.instead for row in summary.steps[4:10]] == ["", "evade", "evade", "hold", "hold", ""]
    assert len(summary.steps) == len(full.steps)
    (tile,) = [figure for figure in key_figures(summary) if figure.name == "replanning steps"]
    assert tile.remark == "1 hold; moved out of the person's way once"


def test_evading_sends_a_trajectory_that_counts_as_an_answer(make_run: Callable[..., Path], full: Run) -> None:
    assert analyse(full).summary.evasions == ()
    run = read_run(make_run(evade_step=5, n_postures=60, held=0))
    plain = read_run(make_run(n_postures=60, held=0))
    assert [step.action for step in run.steps][4] == "evade"
    assert len(run.latencies[1]) == len(plain.latencies[1])


def test_a_run_that_ends_aside_says_so(full: Run) -> None:
    start = dataclasses.replace(full.robot, q=np.repeat(full.robot.q[:1], len(full.robot), axis=0))
    last = dataclasses.replace(full.decisions[-1], action="evade", reason="the person comes")
    summary = analyse(dataclasses.replace(full, robot=start, decisions=(*full.decisions[:-1], last))).summary
    assert summary.outcome == "The run ended while the arm moved out of the person's way: the person comes."


def legend(axes: object) -> set[str]:
    return {text.get_text() for text in axes.get_legend().get_texts()}  # type: ignore[attr-defined]


def test_plots_show_what_was_set_aside_and_when_the_arm_worked_on_no_goal(told: Run, full: Run) -> None:
    analysis = analyse(told)
    with report_style():
        costs = goal_costs_plot(analysis).axes[0]
        assert {"set aside", "arm moves aside", "arm stops", "step missed", "plan invalid"} <= legend(costs)
        assert not {"set aside", "arm moves aside", "arm stops"} & legend(goal_costs_plot(analyse(full)).axes[0])
        rings = [line for line in costs.lines if line.get_markersize() == 11]
        ringed = {int(x) for line in rings for x in line.get_xdata()}  # type: ignore[union-attr]
        assert ringed == {row.step for row in analysis.summary.steps} - {6, 7, 8, 9}
        strip = [text.get_text() for text in cost_terms_plot(analysis).axes[0].texts]
        assert strip.count("blue chosen") == 2  # before and after
        distances = clearance_plot(analysis)
        assert "arm moves aside" in {text.get_text() for text in distances.axes[0].texts}


@pytest.fixture
def several(full: Run, scene: Scene) -> Workcell:
    """The workcell with a goal that can be reached in three configurations; the arm ended in the last."""
    end = full.robot.q[-1]
    configurations = np.stack([end + 0.5, end - 0.5, end])
    goals = (scene.goals[0], Goal("blue", configurations))
    return dataclasses.replace(load_workcell(full), scene=dataclasses.replace(scene, goals=goals))


def test_a_goal_is_reached_in_any_of_its_configurations(full: Run, several: Workcell) -> None:
    reached = analyse(full, several).summary.reached
    assert reached is not None
    assert (reached.goal, reached.error_rad) == ("blue", 0.0)


def test_top_view_says_which_of_several_configurations_it_shows(full: Run, several: Workcell) -> None:
    with report_style():
        figure = top_view_plot(analyse(full, several))
    texts = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"goal red", "goal blue (preferred of 3)"} <= texts


def test_columns_come_with_the_first_goal_that_needs_them() -> None:
    plain = GoalPlan("a", True, "chosen", 1.0, 50, {"human": 0.1}, rest=0.0, task_cost=0.0)
    other = dataclasses.replace(plain, name="b", task_cost=0.5, alternative=1)

    def columns(*goals: GoalPlan) -> tuple[bool, bool, bool]:
        step = RecordedDecision(0.0, "replan", 1, "a", "", False, "", 0.1, 0.01, goals)
        found = told_of_goals((step,))
        return found["rest"], found["task_cost"], found["alternative"]

    assert columns(plain) == (True, False, False)
    assert columns(plain, other) == (True, True, True)


def test_keeping_to_the_way_aside_is_no_work_on_a_goal(told: Run) -> None:
    steps = {step.step: step for step in told.steps}
    steps[7] = dataclasses.replace(steps[7], action="keep", reason="on its way aside; no path can be executed (red: x)")
    summary = analyse(replaced(told, steps)).summary
    assert [row.instead for row in summary.steps[4:8]] == ["", "evade", "evade", "hold"]
    assert [evasion.decisions for evasion in summary.evasions] == [1]
