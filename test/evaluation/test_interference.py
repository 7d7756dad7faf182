"""The whole evaluation on a small library: the same whoever runs it, complete, printed, drawn and written."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csv_libraries import write_csv_library
from paths import REPOSITORY, shared_data
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import HumanPredError, SettingsError, UsageError
from humanpred_ros.evaluation.framework import Report, present
from humanpred_ros.evaluation.interference import InterferenceSettings, draw_interference, measure, tasks_of
from humanpred_ros.evaluation.interference_runs import Runs, RunTask
from humanpred_ros.evaluation.run_figures import RunFigures
from humanpred_ros.evaluation.simulation import METHODS, RunSettings, World, training_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.stomp.config import StompConfig

RUNS = RunSettings(
    replanner=ReplannerConfig(threads=1, stomp=StompConfig(waypoints=30, iterations=60)),
    steps=5,
    hold_s=4.0,
    gmm=GmmSettings(n_components=3, max_iterations=10),
    hold_out=1,
)


@cache
def library() -> MotionLibrary:
    """Reaches of people who stand 1.4 m from the origin, beside the arm of side_by_side."""
    made = small_library(2, 4, 20)
    away = np.zeros(12)
    away[:2] = 0.2, -2.3
    return MotionLibrary("small", tuple(motion.with_postures(motion.q + away) for motion in made))


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> InterferenceSettings:
    """Settings for the small library, with a published table beside it."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "reference").mkdir()
    rows = ["human_traj_id,planner,run,cost", "0,least_penetration,0,0.4", "0,least_penetration,1,0.6"]
    rows += ["0,basic,0,15.0", "0,basic,1,25.0"]
    (folder / "reference" / "table1_runs.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    write_csv_library(library(), folder / "small")
    scene = folder / "own_scene.yaml"
    scene.write_text((REPOSITORY / "config" / "scenes" / "side_by_side.yaml").read_text("utf-8"), encoding="utf-8")
    return InterferenceSettings(
        library=str(folder / "small"), table_motions=("0/0",), table_runs=1, scenes=(str(scene),), motions=1,
        methods=("ours", "current", "wait"), hold_out=1, jobs=1,
    )  # fmt: skip


@pytest.fixture(scope="module")
def report(settings: InterferenceSettings) -> Report:
    return measure(settings, lambda what, total: lambda done: None, RUNS)


def runs_of(report: Report) -> dict[tuple[str, str], RunFigures]:
    return {(run.method, run.motion): run for run in report.figures["runs"]}


def untimed(run: RunFigures) -> RunFigures:
    return replace(run, step_ms=0.0)


def test_every_run_is_made_once_and_measured(report: Report) -> None:
    runs = report.figures["runs"]
    wanted = {(m, k) for m in ("ours", "current", "wait", "basic") for k in ("0/0", "10/0")}
    table = {(method, "0/0") for method in ("ours_p1", "ours", "basic")}
    assert {(run.method, run.motion) for run in runs} == wanted | table
    # The same scene under two names is two scenes.
    assert len(runs) == len(wanted) + len(table)
    for run in runs:
        assert run.cost >= 0.002 * run.length - 1e-12
        assert run.goal == "red" or run.time_to_goal_s == np.inf
        assert np.isfinite([run.cost, run.cost_swept, run.least_distance_m, run.clearance_m]).all()


def test_another_process_makes_the_same_figures(report: Report) -> None:
    runs = {key: untimed(run) for key, run in runs_of(report).items()}
    outcome = Runs(library(), RUNS)(RunTask("side_by_side", "10/0", (("basic", 0), ("ours", 0))))
    for run in outcome.runs:
        assert untimed(run) == runs[run.method, "10/0"]
        assert run.goal is None or run.least_distance_m <= outcome.bound_m + 1e-9


def test_wait_departs_after_the_motion_and_basic_does_not_see_anybody(report: Report) -> None:
    runs, duration_s = runs_of(report), library().find("0/0").duration_s
    wait, basic = runs["wait", "0/0"], runs["basic", "0/0"]
    assert wait.time_to_goal_s - wait.execution_s >= duration_s - 1e-9
    assert basic.time_to_goal_s - basic.execution_s < duration_s
    # The same arm beside somebody else: a planner that sees nobody does the same.
    assert basic.length == runs["basic", "10/0"].length


def test_comparison_and_table_have_their_runs(report: Report) -> None:
    (row,) = report.figures["table1"]
    assert (row["number"], row["motion"], row["published"]["ratio"]) == (0, "0/0", 40.0)
    assert {name: figures["runs"] for name, figures in row["methods"].items()} == {"ours_p1": 1, "ours": 1, "basic": 1}
    everywhere, of_scene, *_ = report.figures["comparison"]
    # A scene that is given as a file has its runs, too.
    assert everywhere["persons"] == of_scene["persons"] == 2
    assert [figures["method"] for figures in everywhere["methods"]] == ["ours", "current", "wait", "basic"]
    assert all(figures["runs"] == 2 for figures in everywhere["methods"])


def test_printed_written_and_drawn(report: Report, settings: InterferenceSettings, tmp_path: Path) -> None:
    text, files = io.StringIO(), {kind: tmp_path / f"x.{kind}" for kind in ("json", "csv")}
    wanted = settings.replaced(**files, plot=tmp_path / "x.png")
    present(wanted, Console(file=text, width=200), lambda *_: report)
    for word in ("Table I", "published ours", "0.500 +- 0.141", "median least distance", "wait"):
        assert word in text.getvalue()
    value = json.loads(files["json"].read_text("utf-8"))
    assert len(value["runs"]) == len(report.figures["runs"])
    assert value["settings"]["table_runs"] == 1
    with files["csv"].open(newline="", encoding="utf-8") as stream:
        assert {row["figure"] for row in csv.DictReader(stream)} >= {"ratio ours_p1", "runs with contact"}
    assert (tmp_path / "x.png").read_bytes()[:4] == b"\x89PNG"


def test_parts_can_be_left_out(settings: InterferenceSettings) -> None:
    assert tasks_of(library(), settings.replaced(table_runs=0, motions=0)) == []
    table_only = settings.replaced(motions=0, table_runs=3, table_motions=("0/0", "10/1"))
    tasks = tasks_of(library(), table_only)
    assert {task.motion for task in tasks} == {"0/0", "10/1"}
    seeds = [{seed for _, seed in task.runs} for task in tasks]
    assert not seeds[0] & seeds[1]  # basic STOMP, which sees nobody, is not run alike beside all
    nothing = draw_interference((), (), {"compared_motions": (), "runs": ()})
    assert len(nothing.axes) == 3


def test_nothing_is_learned_from_the_motion_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    taught: list[set[str]] = []
    shown: list[str] = []

    class Fold:
        def __init__(self, predictor: str, library: MotionLibrary, *_: Any, **settings: Any) -> None:
            taught.append({motion.name for motion in library})

        def without(self, name: str) -> Any:
            shown.append(name)
            raise LookupError

    monkeypatch.setattr("humanpred_ros.evaluation.simulation.LeaveOneOut", Fold)
    world = World(library(), replace(RUNS, hold_out=2))
    for name in ("0/0", "10/1", "0/2"):
        with pytest.raises(LookupError):
            world.predictions("forecast", world.scene("side_by_side"), library().find(name), 0)
    assert shown == ["0/0", "10/1", "0/2"]
    # Learned once for those that are held out together.
    assert taught == [{f"{label}/{k}" for label in (0, 10) for k in rest} for rest in ((2, 3), (0, 1))]
    assert len(training_library(library(), 0)) == len(library())  # then the motion is left out alone


def test_impossible_settings_are_refused_before_any_work(settings: InterferenceSettings) -> None:
    with pytest.raises(UsageError, match="methods: wanted all, or some of"):
        settings.replaced(methods=("ours", "theirs"))
    with pytest.raises(SettingsError, match="seeds"):
        settings.replaced(seeds=-1)
    assert settings.replaced(methods=("wait",)).compared_methods() == ("wait", "basic")
    assert settings.replaced(methods=("all",)).compared_methods() == tuple(METHODS)
    with pytest.raises(UsageError, match="no trajectory"):
        tasks_of(library(), settings.replaced(table_motions=("77",)))
    with pytest.raises(HumanPredError, match="nowhere"):
        measure(settings.replaced(scenes=("nowhere",)), lambda what, total: lambda done: None, RUNS)


def test_a_motion_of_another_human_is_refused(settings: InterferenceSettings, tmp_path: Path) -> None:
    motions = tuple(Motion(m.t_s, m.q[:, :2], m.dof_names[:2], m.label, m.index, m.frame_id) for m in library().motions)
    write_csv_library(MotionLibrary("two", motions), tmp_path / "two")
    with pytest.raises(HumanPredError, match=r"DoF|column"):
        measure(settings.replaced(library=str(tmp_path / "two")), lambda what, total: lambda done: None, RUNS)


def test_table1_of_the_papers_recordings() -> None:
    """P1's Table I, one run of one trajectory: ratio of at least 60, at the goal, free of table and person."""
    folder = shared_data("iros2013/library_a")
    settings = InterferenceSettings(library=str(folder), table_motions=("28",), table_runs=1, motions=0)
    (row,) = measure(settings, lambda what, total: lambda done: None).figures["table1"]
    assert row["published"]["ratio"] == pytest.approx(59, abs=0.5)
    for method in ("ours", "ours_p1"):
        figures = row["methods"][method]
        assert figures["ratio"] >= 60.0
        assert figures["reached"] == figures["runs"]
        assert figures["clearance_m"] > 0.0
        assert figures["least_distance_m"] > 0.0
