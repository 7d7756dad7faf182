"""The whole evaluation of switching on a small library: complete, repeatable, printed, drawn and written."""

from __future__ import annotations

import io
import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from csv_libraries import write_csv_library
from paths import shared_data
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.evaluation.framework import Report, present
from humanpred_ros.evaluation.simulation import RunSettings
from humanpred_ros.evaluation.switching import SwitchingSettings, draw_switching, measure, tasks_of
from humanpred_ros.evaluation.switching_runs import VARIANTS, Choosing, SwitchTask
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.stomp.config import StompConfig

RUNS = RunSettings(
    replanner=ReplannerConfig(threads=1, stomp=StompConfig(waypoints=30, iterations=40)),
    steps=5,
    gmm=GmmSettings(n_components=3, max_iterations=10),
    hold_out=1,
)


@cache
def library() -> MotionLibrary:
    """Reaches across the table of face_to_face, by people who stand opposite the arm."""
    made = small_library(2, 4, 20)
    away = np.zeros(12)
    away[:2] = -0.7, -1.35
    return MotionLibrary("small", tuple(motion.with_postures(motion.q + away) for motion in made))


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> SwitchingSettings:
    folder = tmp_path_factory.mktemp("data")
    (folder / "reference").mkdir()
    rows = [
        f"{variant},{step},{goal},{cup},{cost}"
        for variant, cost in (("prediction", 0.1), ("current_occupancy", 0.2))
        for step in range(1, 6)
        for goal, cup in enumerate(("red", "blue"))
    ]
    text = "\n".join(["variant,step,goal,cup,cost", *rows]) + "\n"
    (folder / "reference" / "fig9_costs.csv").write_text(text, encoding="utf-8")
    write_csv_library(library(), folder / "small")
    return SwitchingSettings(library=str(folder / "small"), trajectory="0/0", seeds=2, motions=1, hold_out=1, jobs=1)


@pytest.fixture(scope="module")
def report(settings: SwitchingSettings) -> Report:
    return measure(settings, lambda what, total: lambda done: None, RUNS)


def test_every_step_has_costs_and_a_choice(report: Report) -> None:
    person = report.figures["figure"]
    assert {(run.variant, run.seed) for run in person.runs} == {(v, s) for v in VARIANTS for s in (0, 1)}
    assert {person.right, person.default} <= {"red", "blue"}
    for run in person.runs:
        assert [step.step for step in run.steps] == [1, 2, 3, 4, 5]
        first = run.steps[0]
        assert first.chosen in ("red", "blue", None)
        able = {name: cost for name, cost in first.costs.items() if np.isfinite(cost) and name not in first.barred}
        if first.action == "replan":
            assert first.chosen == min(able, key=lambda name: able[name])


def test_with_nobody_there_the_nearest_goal_is_the_default(report: Report) -> None:
    scene = load_scene("face_to_face")
    nearest = min(scene.goals, key=lambda goal: scene.arm.configuration_distance(scene.start, goal.configuration))
    assert {person.default for person in report.figures["persons"]} == {nearest.name}


def test_another_process_chooses_the_same(report: Report) -> None:
    again = Choosing(library(), RUNS)(SwitchTask("face_to_face", "10/0", (0,)))
    (before,) = (person for person in report.figures["persons"] if person.motion == "10/0")
    assert repr(again.run("ours").steps) == repr(before.run("ours").steps)
    assert again.right == before.right


def test_summaries_are_over_the_motions_shown(report: Report) -> None:
    first = report.figures["summaries"][0]
    assert first["persons"] == 2
    assert [figures["variant"] for figures in first["variants"]] == list(VARIANTS)
    assert all(figures["persons"] == 2 for figures in first["variants"])


def test_printed_written_and_drawn(report: Report, settings: SwitchingSettings, tmp_path: Path) -> None:
    text, file = io.StringIO(), tmp_path / "x.json"
    wanted = settings.replaced(json=file, plot=tmp_path / "x.png")
    present(wanted, Console(file=text, width=200), lambda *_: report)
    for word in ("Fig. 9", "published", "Step of the first switch", "returned"):
        assert word in text.getvalue()
    value = json.loads(file.read_text("utf-8"))
    assert value["persons"][0]["runs"][0]["steps"][0]["costs"].keys() == {"red", "blue"}
    assert value["published"]["prediction"][0] == [0.1, 0.1]
    assert (tmp_path / "x.png").read_bytes()[:4] == b"\x89PNG"
    assert len(draw_switching(None, ("red", "blue"), None, (), 5).axes) == 1


def test_tasks(settings: SwitchingSettings) -> None:
    everything = tasks_of(library(), settings.replaced(motions=None))
    assert len(everything) == len(library())
    assert everything[0] == SwitchTask("face_to_face", "0/0", (0, 1))  # most runs first
    assert tasks_of(library(), settings.replaced(motions=0, trajectory="")) == []


def test_impossible_settings_are_refused(settings: SwitchingSettings) -> None:
    with pytest.raises(UsageError, match="two goals or more"):
        measure(settings.replaced(scene="side_by_side"), lambda what, total: lambda done: None, RUNS)
    with pytest.raises(SettingsError, match="seeds"):
        settings.replaced(seeds=0)
    with pytest.raises(UsageError, match="no trajectory"):
        tasks_of(library(), settings.replaced(trajectory="99"))


def test_fig9_of_the_papers_recordings() -> None:
    """With P1's predictor the arm chooses the right goal for good in step 4 or earlier, as P1 shows in Fig. 9."""
    folder = shared_data("iros2013/library_a")
    settings = SwitchingSettings(library=str(folder), seeds=1, motions=0)
    person = measure(settings, lambda what, total: lambda done: None).figures["figure"]
    decided = person.run("ours_p1").figures.decided
    assert decided is not None
    assert decided <= 4
