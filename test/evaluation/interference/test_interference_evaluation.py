"""The whole evaluation on a small library: the same whoever runs it, complete, printed, drawn and written."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.interference import command as interference_command
from humanpred_ros.evaluation.interference.evaluation import InterferenceConfig, evaluate_interference, tasks_of
from humanpred_ros.evaluation.interference.measures import RunFigures
from humanpred_ros.evaluation.interference.reference import PublishedRow
from humanpred_ros.evaluation.interference.result import InterferenceEvaluation
from humanpred_ros.evaluation.interference.runs import METHODS, Runs, RunTask
from humanpred_ros.evaluation.interference.tables import print_interference
from humanpred_ros.evaluation.interference.world import RunSettings, World, training_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.stomp.config import StompConfig

SETTINGS = RunSettings(
    replanner=ReplannerConfig(threads=1, stomp=StompConfig(waypoints=30, iterations=60)),
    steps=5,
    hold_s=4.0,
    gmm=GmmSettings(n_components=3, max_iterations=10),
    hold_out=1,
)
CONFIG = InterferenceConfig(
    table_motions=("0/0",), table_runs=1, scenes=("side_by_side",), motions=1, seeds=1, runs=SETTINGS,
    methods=("ours", "current", "wait"),
)  # fmt: skip


@cache
def library() -> MotionLibrary:
    """Reaches of people who stand 1.4 m from the origin, beside the arm of side_by_side."""
    made = small_library(2, 4, 20)
    away = np.zeros(12)
    away[:2] = 0.2, -2.3
    return MotionLibrary("small", tuple(motion.with_postures(motion.q + away) for motion in made))


@cache
def evaluation() -> InterferenceEvaluation:
    published = {0: PublishedRow(0.5, 0.1, 20.0, 5.0)}
    return evaluate_interference(library(), CONFIG, published=published, jobs=1)


def untimed(run: RunFigures) -> RunFigures:
    return replace(run, step_ms=0.0)


def test_every_run_is_made_once_and_judged() -> None:
    runs = evaluation().runs
    wanted = {(m, k) for m in ("ours", "current", "wait", "basic") for k in ("0/0", "10/0")} | {("ours_p1", "0/0")}
    assert {(run.method, run.motion) for run in runs} == wanted
    assert len(runs) == len(wanted)
    for run in runs:
        assert run.cost >= 0.002 * run.length - 1e-12
        assert run.goal == "red" or run.time_to_goal_s == np.inf
        assert np.isfinite([run.cost, run.cost_swept, run.least_distance_m, run.clearance_m]).all()


def test_another_process_makes_the_same_figures() -> None:
    runs = {(run.method, run.motion): untimed(run) for run in evaluation().runs}
    task = RunTask("side_by_side", "10/0", (("basic", 0), ("ours", 0)))
    outcome = Runs(library(), SETTINGS)(task)
    for run in outcome.runs:
        assert untimed(run) == runs[run.method, "10/0"]
        assert run.goal is None or run.least_distance_m <= outcome.bound_m + 1e-9


def test_who_waits_departs_after_the_motion_and_basic_does_not_see_anybody() -> None:
    runs = {(run.method, run.motion): run for run in evaluation().runs}
    duration_s = library().find("0/0").duration_s
    wait, basic = runs["wait", "0/0"], runs["basic", "0/0"]
    assert wait.time_to_goal_s - wait.execution_s >= duration_s - 1e-9
    assert basic.time_to_goal_s - basic.execution_s < duration_s
    # The same arm beside somebody else: a planner that sees nobody does the same.
    assert basic.length == runs["basic", "10/0"].length


def test_comparison_and_table_have_their_runs() -> None:
    (row,) = evaluation().table1
    assert (row.number, row.motion) == (0, "0/0")
    assert row.published is not None
    assert {name: figures.runs for name, figures in row.methods.items()} == {"ours_p1": 1, "ours": 1, "basic": 1}
    everywhere = evaluation().comparison[0]
    assert everywhere.persons == 2
    assert [figures.method for figures in everywhere.methods] == ["ours", "current", "wait", "basic"]
    assert all(figures.runs == 2 for figures in everywhere.methods)


def test_printed_written_and_drawn(tmp_path: Path) -> None:
    console = Console(width=200, record=True, quiet=False, file=(tmp_path / "out").open("w", encoding="utf-8"))
    print_interference(evaluation(), console)
    text = console.export_text()
    for word in ("Table I", "published ours", "0.500 +- 0.100", "median least distance", "wanted", "wait"):
        assert word in text
    value = evaluation().to_json()
    assert json.loads(json.dumps(value)) == value
    assert len(value["runs"]) == len(evaluation().runs)
    assert value["settings"]["runs"]["replanner"]["stomp"]["n_waypoints"] == 30
    plot = tmp_path / "plot.png"
    interference_command._save_plot(evaluation(), plot)
    assert plot.read_bytes()[:4] == b"\x89PNG"


def test_parts_can_be_left_out() -> None:
    assert tasks_of(library(), replace(CONFIG, table_runs=0, motions=0)) == []
    table_only = tasks_of(library(), replace(CONFIG, motions=0, table_runs=3, table_motions=("0/0", "10/1")))
    assert {task.motion for task in table_only} == {"0/0", "10/1"}
    seeds = [{seed for _, seed in task.runs} for task in table_only]
    assert not seeds[0] & seeds[1]  # basic STOMP, which sees nobody, is not run alike beside all


def test_nothing_is_learned_from_the_motion_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    taught: list[set[str]] = []
    shown: list[str] = []

    class Fold:
        def without(self, name: str) -> Any:
            shown.append(name)
            raise LookupError

    def fold(predictor: str, settings: Any) -> Fold:
        taught.append({motion.name for motion in settings.library})
        return Fold()

    monkeypatch.setattr("humanpred_ros.evaluation.interference.world.leave_one_out", fold)
    world = World(library(), replace(SETTINGS, hold_out=2))
    for name in ("0/0", "10/1", "0/2"):
        with pytest.raises(LookupError):
            world.told("forecast", world.scene("side_by_side"), library().find(name), 0)
    assert shown == ["0/0", "10/1", "0/2"]
    # Learned once for those that are held out together.
    assert taught == [{f"{label}/{k}" for label in (0, 10) for k in rest} for rest in ((2, 3), (0, 1))]
    assert len(training_library(library(), 0)) == len(library())  # then the motion is left out alone


def test_impossible_settings_are_refused_before_any_work() -> None:
    with pytest.raises(UsageError, match="methods: wanted some of"):
        InterferenceConfig(methods=("ours", "theirs"))
    with pytest.raises(UsageError, match="0 or more"):
        InterferenceConfig(seeds=-1)
    assert InterferenceConfig(methods=("wait",)).methods == ("wait", "basic")
    assert InterferenceConfig().methods == tuple(METHODS)
    with pytest.raises(UsageError, match="no trajectory"):
        tasks_of(library(), replace(CONFIG, table_motions=("77",)))


def test_command_checks_files_first(tmp_path: Path) -> None:
    import argparse

    parser = argparse.ArgumentParser()
    interference_command.add_arguments(parser)
    options = parser.parse_args(["--library", "synthetic_reaches", "--json", str(tmp_path / "no" / "x.json")])
    with pytest.raises(UsageError, match="folder that exists"):
        interference_command.run(options, Console())
    options = parser.parse_args(["--library", "x", "--methods", "ours, basic", "--hold-out", "3", "--seeds", "4"])
    config = interference_command._config(options)
    assert (config.methods, config.seeds, config.runs.hold_out) == (("ours", "basic"), 4, 3)


def test_a_motion_of_another_human_is_refused() -> None:
    motions = tuple(Motion(m.t_s, m.q[:, :2], m.dof_names[:2], m.label, m.index, m.frame_id) for m in library().motions)
    with pytest.raises(Exception, match="DoF"):
        evaluate_interference(MotionLibrary("two", motions), CONFIG)
