"""Every reach is predicted by a predictor that has not seen it, and scored beside what was published."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation import reaching_predictors, reaching_runs, reaching_weights
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.reach_distances import ReachMetric
from humanpred_ros.evaluation.reaching import json_of
from humanpred_ros.evaluation.reaching_predictors import (
    REACHING_PREDICTORS,
    ReachingEntry,
    ReachingMaterial,
    TimedLine,
)
from humanpred_ros.evaluation.reaching_runs import (
    ReachingResult,
    ReachingSettings,
    RecordingRuns,
    RecordingTask,
    evaluate,
)
from humanpred_ros.evaluation.reaching_scores import INTERFERENCE_CASE
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import Jump, ReachRecording, load_reach_recordings
from humanpred_ros.reaching.first_guess import minimum_jerk
from humanpred_ros.reaching.prediction import ReachTask

RECORDINGS = [recording(seed, n_frames=40) for seed in range(3)]
JOINT, AS_CODED, TASK = 0, 1, 2
MEAN, SD, LEAST, LARGEST = 0, 1, 2, 3


class Shaky:
    """Adds noise to the line: a random predictor."""

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        line = TimedLine(minimum_jerk).predict(task, rng)
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
    monkeypatch.setattr(reaching_runs, "_TIMED", 1)


def evaluated(
    recordings: list[ReachRecording], interference: list[ReachRecording] | None = None, **settings: Any
) -> ReachingResult:
    values = {"demos": "", "samples": ("none",), **settings}
    return evaluate(recordings, interference or [], ReachingSettings(**values), lambda what, total: lambda done: None)


def test_figures_are_those_of_the_metric() -> None:
    (demos,) = evaluated(
        RECORDINGS,
        predictor=(
            "hold",
            "minimum_jerk",
        ),
    ).sets
    assert demos.names == ("made_up_0", "made_up_1", "made_up_2")
    assert [scores.name for scores in demos.scores] == ["hold", "minimum_jerk", "itself"]
    found, itself = demos.of("minimum_jerk"), demos.of("itself")
    assert found is not None
    assert itself is not None
    metric, rng = ReachMetric(MODEL), np.random.default_rng(0)
    wanted = [
        metric.between(TimedLine(minimum_jerk).predict(ReachTask.of(entry), rng), entry.active.q)
        for entry in RECORDINGS
    ]
    assert found.values[:, MEAN, JOINT].tolist() == [distance.joint_m for distance in wanted]
    assert found.average[MEAN, TASK] == pytest.approx(np.mean([distance.task_m for distance in wanted]))
    assert not itself.average[:, JOINT].any()
    assert not demos.published  # these are not P2's recordings


def test_nothing_is_learned_from_the_reach_to_predict(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, list[str]] = {}

    def prepare(material: ReachingMaterial):  # type: ignore[no-untyped-def]
        def without(name: str) -> TimedLine:
            asked[name] = [entry.name for entry in material.without(name)]
            return TimedLine(minimum_jerk)

        return without

    with_entry(monkeypatch, "watched", ReachingEntry("", prepare))
    case = recording(7, n_frames=40)
    result = evaluated(RECORDINGS, [case], predictor=("watched",))
    names = [entry.name for entry in RECORDINGS]
    assert asked == {**{name: [n for n in names if n != name] for name in names}, case.name: names}
    assert [entry.left_out for entry in result.sets] == [True, False]


def test_randomness_is_shown_over_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    with_entry(monkeypatch, "shaky", ReachingEntry("", lambda _: lambda name: Shaky(), by_chance=True))
    a, b = (
        evaluated(
            RECORDINGS,
            predictor=(
                "shaky",
                "line",
            ),
            runs=4,
        ).sets[0]
        for _ in range(2)
    )
    shaky, line = a.scores[0], a.scores[1]
    assert (shaky.runs, line.runs) == (4, 1)
    joint = shaky.values[0, :, JOINT]
    assert joint[LEAST] < joint[MEAN] < joint[LARGEST]
    assert joint[SD] > 0.0
    assert line.values[0, SD, JOINT] == 0.0
    np.testing.assert_array_equal(shaky.values, b.scores[0].values)
    other = evaluated(
        RECORDINGS,
        predictor=(
            "shaky",
            "line",
        ),
        runs=4,
        seed=1,
    ).sets[0]
    assert (other.scores[0].values[0] != shaky.values[0]).any()


def test_what_learns_gets_weights_that_have_not_seen_the_tested_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    quick_learning(monkeypatch, 20, collisions=None)
    given: dict[str, FloatArray] = {}

    def prepare(material: ReachingMaterial):  # type: ignore[no-untyped-def]
        def without(name: str) -> TimedLine:
            given[name] = material.weights["improved"].without(name)
            return TimedLine(minimum_jerk)

        return without

    with_entry(monkeypatch, "watched", ReachingEntry("", prepare, learns="improved"))
    case = recording(7, n_frames=40)
    found = evaluated(
        RECORDINGS,
        [case],
        predictor=(
            "watched",
            "own",
        ),
        runs=1,
    )
    left_out = found.learned["improved"].table.left_out
    for name, weights in left_out.items():
        np.testing.assert_array_equal(given[name], weights)
    np.testing.assert_array_equal(given[case.name], found.columns[0].weights)
    written = json_of(found)["weights"]
    assert [entry["how"] for entry in written["left_out"]] == ["improved"]
    np.testing.assert_allclose(written["left_out"][0]["influence"].sum(axis=1), 1.0)
    # Who learns from the tested reach cannot be tested on one that nothing was learned from.
    assert [scores.name for scores in found.sets[0].scores] == ["watched", "own", "itself"]
    assert [scores.name for scores in found.sets[1].scores] == ["watched", "itself"]
    assert [each["predictor"] for each in found.times] == ["own"]


def test_the_reach_nearest_to_1_3_s_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reaching_runs, "_TIMED", 3)
    recordings = [recording(0, n_frames=40), recording(1, n_frames=120), recording(2, n_frames=300)]
    names = ("line", "baseline_0", "baseline_0_replanned")
    (found,) = reaching_runs._prediction_times(names, recordings, ReachingMaterial(recordings, MODEL))
    assert found["predictor"] == "baseline_0"
    assert (found["recording"], round(found["duration_s"], 2)) == ("made_up_1", 1.19)
    assert 0.0 < found["median_ms"] <= found["slowest_ms"]


def test_recordings_with_jumps_are_tested_and_shown_apart() -> None:
    jumping = dataclasses.replace(RECORDINGS[0], jumps=(Jump("active", 20, "right_wrist", 7.0),))
    demos = evaluated([jumping, *RECORDINGS[1:]], predictor=("line",)).sets[0]
    line = demos.scores[0]
    fit = demos.average_fit(line)
    assert fit is not None
    assert fit[MEAN, JOINT] == pytest.approx(line.values[1:, MEAN, JOINT].mean())
    assert demos.recordings[0]["unfit"]


def test_impossible_requests_are_refused() -> None:
    with pytest.raises(UsageError, match="leave one out"):
        evaluated(RECORDINGS[:1], predictor=("line",))
    with pytest.raises(UsageError, match="made_up_1 again"):
        evaluated(RECORDINGS, RECORDINGS[1:2], predictor=("line",))


def test_any_number_of_processes_gives_the_same_figures_and_long_tasks_come_first() -> None:
    runs = RecordingRuns(ReachingMaterial(RECORDINGS, MODEL), seed=3)
    tasks = [RecordingTask(name, entry, 2) for name in ("baseline_0", "bow") for entry in RECORDINGS[:2]]
    here, there = [runs(task) for task in tasks], map_processes(runs, tasks, 2)
    for one, other in zip(here, there, strict=True):
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
        demos = evaluated(entries, predictor=("improved",), runs=1).sets[0]
        assert len(demos.scores[0].values) == 3
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
    assert "table_top" in evaluated(RECORDINGS, predictor=("line",)).obstacles
    assert evaluated(moved, predictor=("line",)).obstacles == ()


def test_on_the_papers_recordings_p2_is_reproduced_and_the_default_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    quick_learning(monkeypatch, 150)
    recordings = list(load_reach_recordings(shared_data("icra2015/demos")))
    cases = list(load_reach_recordings(shared_data("icra2015/interference_case")))
    names = "minimum_jerk,line,learned,baseline_0,baseline_1,improved"
    result = evaluated(recordings, cases, predictor=tuple(names.split(",")), runs=1)
    demos, case = result.sets
    assert demos.names[0] == "0446-0578"  # the paper's order
    assert (len(demos.published), len(case.published), case.names) == (7, 2, (INTERFERENCE_CASE,))
    average = {scores.name: scores.average[MEAN] for scores in demos.scores}
    for distance in (AS_CODED, TASK):
        assert average["learned"][distance] < average["baseline_0"][distance] < average["baseline_1"][distance]
    published = demos.published_of("learned")
    assert published is not None
    wanted = (published.joint_m, published.task_as_coded_m)
    np.testing.assert_allclose(average["learned"][:TASK], wanted, rtol=0.15)
    assert average["improved"][JOINT] <= 20.0
    assert average["improved"][TASK] <= 16.5
    for distance in (JOINT, TASK):
        wins = demos.wins("improved", distance)
        assert wins is not None
        assert wins >= 6  # of 7
    assert demos.wins("line", JOINT) == 0
    assert demos.wins("nobody", JOINT) is None
    written = json_of(result)
    assert written["table1"]["2711-2823"] == (25.56, 45.69)
    assert "wrist_m" not in str(written)


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
    found = evaluated(
        recordings,
        predictor=(
            "minimum_jerk",
            "improved",
        ),
        runs=2,
    ).sets[0]
    line, improved = found.scores[:2]
    for distance in (JOINT, TASK):
        assert improved.average[MEAN, distance] < line.average[MEAN, distance]
