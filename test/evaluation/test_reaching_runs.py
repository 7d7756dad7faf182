"""Every reach is predicted by a predictor that has not seen it, and scored beside what was published."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation import reaching_predictors, reaching_runs, reaching_weights
from humanpred_ros.evaluation.outputs import plain
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.reach_distances import reach_distance
from humanpred_ros.evaluation.reaching_predictors import (
    BETTER,
    REACHING_PREDICTORS,
    Line,
    ReachingEntry,
    ReachingMaterial,
)
from humanpred_ros.evaluation.reaching_runs import (
    DISTANCES,
    INTERFERENCE_CASE,
    ReachingSettings,
    RecordingTask,
    evaluate,
    means,
    predict_recording,
    published_of,
    score_of,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import Jump, ReachRecording, load_reach_recordings
from humanpred_ros.reaching.between_ends import minimum_jerk
from humanpred_ros.reaching.planner import ReachTask

RECORDINGS = [recording(seed, n_frames=40) for seed in range(3)]
JOINT, AS_CODED, TASK = DISTANCES
LINE = Line(minimum_jerk)


class Shaky:
    """Adds noise to the line: a random predictor."""

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        line = LINE.predict(task, rng)
        return line + 0.05 * rng.normal(size=line.shape[1])


@pytest.fixture(autouse=True)
def _no_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do in this process what an evaluation does in others."""
    monkeypatch.setattr(reaching_runs, "map_processes", lambda function, tasks, *_: [function(task) for task in tasks])


def with_entry(monkeypatch: pytest.MonkeyPatch, name: str, entry: ReachingEntry) -> None:
    more: Mapping[str, ReachingEntry] = MappingProxyType({**REACHING_PREDICTORS, name: entry})
    monkeypatch.setattr(reaching_predictors, "REACHING_PREDICTORS", more)
    monkeypatch.setattr(reaching_runs, "REACHING_PREDICTORS", more)


def quick_learning(monkeypatch: pytest.MonkeyPatch, n_samples: int, **changes: Any) -> None:
    few = {
        how: settings.replaced(sampling=settings.sampling.replaced(n_samples=n_samples), bootstrap=0, **changes)
        for how, settings in reaching_weights.LEARNING.items()
    }
    monkeypatch.setattr(reaching_weights, "LEARNING", few)


def evaluated(
    recordings: list[ReachRecording], interference: list[ReachRecording] | None = None, **settings: Any
) -> dict[str, Any]:
    wanted = ReachingSettings(**{"demos": "", "samples": ("none",), **settings})
    return evaluate(recordings, interference or [], wanted, lambda what, total: lambda done: None, MODEL)[0]


def names_of(entry: dict[str, Any]) -> list[str]:
    return [predictor["name"] for predictor in entry["predictors"]]


def test_figures_are_those_of_the_metric() -> None:
    (demos,) = evaluated(RECORDINGS, predictor=("hold", "minimum_jerk"))["sets"]
    assert [facts["name"] for facts in demos["recordings"]] == ["made_up_0", "made_up_1", "made_up_2"]
    assert names_of(demos) == ["hold", "minimum_jerk", "itself"]
    found, itself = score_of(demos, "minimum_jerk"), score_of(demos, "itself")
    assert found is not None
    assert itself is not None
    rng = np.random.default_rng(0)
    wanted = [reach_distance(MODEL, LINE.predict(ReachTask.of(r), rng), r.active.q) for r in RECORDINGS]
    assert means(found, JOINT) == [distance.joint_m for distance in wanted]
    assert found["average"][TASK]["mean"] == pytest.approx(np.mean([distance.task_m for distance in wanted]))
    assert not any(itself["average"][JOINT].values())
    assert not demos["published"]  # these are not P2's recordings


def test_nothing_is_learned_from_the_reach_to_predict(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, list[str]] = {}

    def make(material: ReachingMaterial, tested: str) -> Line:
        asked[tested] = [entry.name for entry in material.without(tested)]
        return LINE

    with_entry(monkeypatch, "watched", ReachingEntry("", make))
    case = recording(7, n_frames=40)
    sets = evaluated(RECORDINGS, [case], predictor=("watched",))["sets"]
    names = [entry.name for entry in RECORDINGS]
    assert asked == {**{name: [n for n in names if n != name] for name in names}, case.name: names}
    assert [entry["left_out"] for entry in sets] == [True, False]


def test_randomness_is_shown_over_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    with_entry(monkeypatch, "shaky", ReachingEntry("", lambda material, tested: Shaky(), BETTER))
    a, b, other = (
        evaluated(RECORDINGS, predictor=("shaky", "line"), runs=4, seed=seed)["sets"][0]["predictors"]
        for seed in (0, 0, 1)
    )
    assert [each["runs"] for each in a[:2]] == [4, 1]
    joint = a[0]["recordings"][0]["figures"][JOINT]
    assert joint["low"] < joint["mean"] < joint["high"]
    assert joint["sd"] > 0.0
    assert a[1]["recordings"][0]["figures"][JOINT]["sd"] == 0.0
    assert a[0]["recordings"] == b[0]["recordings"]
    assert a[0]["recordings"][0] != other[0]["recordings"][0]


def test_what_learns_gets_weights_that_have_not_seen_the_tested_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    quick_learning(monkeypatch, 20, collisions=False)
    given: dict[str, FloatArray] = {}
    plan = reaching_predictors.improved_planner

    def improved_planner(known: Any, model: Any, weights: FloatArray, surroundings: Any) -> Any:
        (tested,) = {"made_up_0", "made_up_1", "made_up_2", "made_up_7"} - {*(r.name for r in known), *left} or {""}
        given[tested] = weights
        return plan(known, model, weights, surroundings)

    case, left = recording(7, n_frames=40), {"made_up_7"}
    monkeypatch.setattr(reaching_predictors, "improved_planner", improved_planner)
    figures = evaluated(RECORDINGS, [case], predictor=("improved", "own"), runs=1)
    (written,) = figures["weights"]["left_out"]
    assert written["how"] == "improved"
    for name, weights in zip(written["recordings"], written["weights"], strict=True):
        np.testing.assert_array_equal(given[name], weights)
    np.testing.assert_array_equal(given[""], figures["weights"]["columns"][0]["weights"])
    # Who learns from the tested reach cannot be tested on one that nothing was learned from.
    assert names_of(figures["sets"][0]) == ["improved", "own", "itself"]
    assert names_of(figures["sets"][1]) == ["improved", "itself"]


def test_impossible_requests_are_refused() -> None:
    with pytest.raises(UsageError, match="leave one out"):
        evaluated(RECORDINGS[:1], predictor=("line",))
    with pytest.raises(UsageError, match="made_up_1 again"):
        evaluated(RECORDINGS, RECORDINGS[1:2], predictor=("line",))


def test_any_number_of_processes_gives_the_same_figures_and_long_tasks_come_first() -> None:
    predict = partial(predict_recording, ReachingMaterial(RECORDINGS, MODEL), 3)
    tasks = [RecordingTask(name, entry, 2) for name in ("baseline_0", "line") for entry in RECORDINGS[:2]]
    for one, other in zip(map(predict, tasks), map_processes(predict, tasks, 2), strict=True):
        np.testing.assert_array_equal(one.distances_m, other.distances_m)
        np.testing.assert_array_equal(one.wrist_m, other.wrist_m)
        assert len(other.times_s) == 2
    short, long = recording(0, n_frames=40), recording(1, n_frames=90)
    ordered = [
        RecordingTask("learned_replanned", long, 10),
        RecordingTask("learned_replanned", short, 10),
        RecordingTask("learned", long, 10),
        RecordingTask("baseline_0", short, 2),
        RecordingTask("hold", long, 1),
    ]
    assert sorted(ordered[::-1], key=reaching_runs._length, reverse=True) == ordered


def test_recordings_with_jumps_are_learned_from_where_there_are_no_others(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_learning(monkeypatch, 20)
    jumping = [dataclasses.replace(entry, jumps=(Jump("active", 20, "right_wrist", 7.0),)) for entry in RECORDINGS]
    for entries in (jumping, [RECORDINGS[0], *jumping[1:]]):
        demos = evaluated(entries, predictor=("improved",), runs=1)["sets"][0]
        assert len(means(demos["predictors"][0], JOINT)) == 3
    assert "made_up_1, made_up_2: nothing else to learn from" in caplog.text


def test_a_table_is_there_only_where_the_papers_stood() -> None:
    far = np.zeros(23)
    far[:2] = 20.0, -10.0
    moved = [
        dataclasses.replace(
            entry,
            active=dataclasses.replace(entry.active, q=entry.active.q + far),
            passive=dataclasses.replace(entry.passive, q=entry.passive.q + far),
        )
        for entry in RECORDINGS
    ]
    assert "table_top" in evaluated(RECORDINGS, predictor=("line",))["obstacles"]
    assert evaluated(moved, predictor=("line",))["obstacles"] == []


def test_on_the_papers_recordings_p2_is_reproduced_and_the_default_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    quick_learning(monkeypatch, 150)
    recordings = list(load_reach_recordings(shared_data("icra2015/demos")))
    cases = list(load_reach_recordings(shared_data("icra2015/interference_case")))
    names = ("minimum_jerk", "line", "learned", "baseline_0", "baseline_1", "improved")
    figures = evaluated(recordings, cases, predictor=names, runs=1)
    demos, case = figures["sets"]
    assert demos["recordings"][0]["name"] == "0446-0578"  # the paper's order
    assert [facts["name"] for facts in case["recordings"]] == [INTERFERENCE_CASE]
    assert (len(demos["published"]), len(case["published"])) == (7, 2)
    mean = {each["name"]: {d: each["average"][d]["mean"] for d in DISTANCES} for each in demos["predictors"]}
    for distance in (AS_CODED, TASK):
        assert mean["learned"][distance] < mean["baseline_0"][distance] < mean["baseline_1"][distance]
    for distance in (JOINT, AS_CODED):
        assert mean["learned"][distance] == pytest.approx(published_of(demos, "learned")[distance], rel=0.15)
    assert mean["improved"][JOINT] <= 20.0
    assert mean["improved"][TASK] <= 16.5
    for distance in (JOINT, TASK):
        ours, theirs = (score_of(demos, name) for name in ("improved", "minimum_jerk"))
        assert ours is not None
        assert theirs is not None
        assert np.less(means(ours, distance), means(theirs, distance)).sum() >= 6  # of 7
    assert plain(figures)["table1"]["2711-2823"] == [25.56, 45.69]


def rested(entry: ReachRecording, rest_s: float) -> ReachRecording:
    """Return a recording whose people stand still for some time before it begins."""
    rng, step_s = np.random.default_rng(len(entry.active)), 0.01
    before = np.arange(round(rest_s / step_s)) * step_s

    def longer(motion: Motion) -> Motion:
        still = motion.q[0] + 0.0005 * rng.normal(size=(len(before), motion.q.shape[1]))
        t_s = np.concatenate([before, motion.t_s - motion.t_s[0] + rest_s])
        return dataclasses.replace(motion, t_s=t_s, q=np.concatenate([still, motion.q]))

    return dataclasses.replace(entry, active=longer(entry.active), passive=longer(entry.passive), jumps=())


@pytest.mark.parametrize(
    "change",
    [lambda entries: [rested(entry, 1.0) for entry in entries], lambda entries: entries[:3]],
    ids=["a second of rest before", "three to learn from"],
)
def test_the_default_beats_minimum_jerk_on_recordings_of_another_kind(
    change: Callable[[list[ReachRecording]], list[ReachRecording]], monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_learning(monkeypatch, 200)
    recordings = change(list(load_reach_recordings(shared_data("icra2015/demos"))))
    found = evaluated(recordings, predictor=("minimum_jerk", "improved"), runs=2)["sets"][0]
    line, improved = found["predictors"][:2]
    for distance in (JOINT, TASK):
        assert improved["average"][distance]["mean"] < line["average"][distance]["mean"]
