"""The whole evaluation of switching on a small library: complete, repeatable, printed, drawn and written."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.interference.world import RunSettings
from humanpred_ros.evaluation.switching import command as switching_command
from humanpred_ros.evaluation.switching.evaluation import SwitchingConfig, evaluate_switching, tasks_of
from humanpred_ros.evaluation.switching.reference import PublishedCosts
from humanpred_ros.evaluation.switching.result import SwitchingEvaluation
from humanpred_ros.evaluation.switching.runs import VARIANTS, Choosing, SwitchTask
from humanpred_ros.evaluation.switching.tables import print_switching
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.stomp.config import StompConfig

SETTINGS = RunSettings(
    replanner=ReplannerConfig(threads=1, stomp=StompConfig(waypoints=30, iterations=40)),
    steps=5,
    gmm=GmmSettings(n_components=3, max_iterations=10),
    hold_out=1,
)
CONFIG = SwitchingConfig(figure_motion="0/0", figure_seeds=2, motions=1, runs=SETTINGS)


@cache
def library() -> MotionLibrary:
    """Reaches across the table of face_to_face, by people who stand opposite the arm."""
    made = small_library(2, 4, 20)
    away = np.zeros(12)
    away[:2] = -0.7, -1.35
    return MotionLibrary("small", tuple(motion.with_postures(motion.q + away) for motion in made))


@cache
def evaluation() -> SwitchingEvaluation:
    published = PublishedCosts(("red", "blue"), np.full((5, 2), 0.1), np.full((5, 2), 0.2))
    return evaluate_switching(library(), CONFIG, published=published, jobs=1)


def test_every_step_has_costs_and_a_choice() -> None:
    person = evaluation().figure
    assert person is not None
    assert {(run.variant, run.seed) for run in person.runs} == {(v, s) for v in VARIANTS for s in (0, 1)}
    assert {person.right, person.default} <= {"red", "blue"}
    for run in person.runs:
        assert [step.step for step in run.steps] == [1, 2, 3, 4, 5]
        first = run.steps[0]
        assert first.chosen in ("red", "blue", None)
        able = {name: cost for name, cost in first.costs.items() if np.isfinite(cost) and name not in first.barred}
        if first.action == "replan":
            assert first.chosen == min(able, key=lambda name: able[name])


def test_with_nobody_there_the_nearest_goal_is_the_default() -> None:
    scene = load_scene("face_to_face")
    nearest = min(scene.goals, key=lambda goal: scene.arm.configuration_distance(scene.start, goal.configuration))
    assert {person.default for person in evaluation().persons} == {nearest.name}


def test_another_process_chooses_the_same() -> None:
    again = Choosing(library(), SETTINGS)(SwitchTask("face_to_face", "10/0", (0,)))
    (before,) = (person for person in evaluation().persons if person.motion == "10/0")
    assert repr(again.run("ours").steps) == repr(before.run("ours").steps)
    assert again.right == before.right


def test_summaries_are_over_the_motions_shown() -> None:
    first = evaluation().summaries[0]
    assert first.persons == 2
    assert [figures.variant for figures in first.variants] == list(VARIANTS)
    assert all(figures.persons == 2 for figures in first.variants)


def test_printed_written_and_drawn(tmp_path: Path) -> None:
    console = Console(width=200, record=True, file=(tmp_path / "out").open("w", encoding="utf-8"))
    print_switching(evaluation(), console)
    text = console.export_text()
    for word in ("Fig. 9", "published prediction", "step of the first switch", "returned", "wanted"):
        assert word in text
    value = evaluation().to_json()
    assert json.loads(json.dumps(value)) == value
    assert value["persons"][0]["runs"][0]["steps"][0]["costs"].keys() == {"red", "blue"}
    assert value["published"]["prediction"][0] == [0.1, 0.1]
    plot = tmp_path / "plot.png"
    switching_command._save_plot(evaluation(), plot)
    assert plot.read_bytes()[:4] == b"\x89PNG"


def test_tasks() -> None:
    everything = tasks_of(library(), replace(CONFIG, motions=None))
    assert len(everything) == len(library())
    assert everything[0] == SwitchTask("face_to_face", "0/0", (0, 1))  # most runs first
    assert tasks_of(library(), replace(CONFIG, motions=0, figure_motion="")) == []


def test_impossible_settings_are_refused() -> None:
    with pytest.raises(UsageError, match="two goals or more"):
        SwitchingConfig(scene="side_by_side")
    with pytest.raises(UsageError, match="one seed or more"):
        SwitchingConfig(figure_seeds=0)
    with pytest.raises(UsageError, match="no trajectory"):
        tasks_of(library(), replace(CONFIG, figure_motion="99"))
