"""Every reach is predicted by somebody who did not see it, and judged beside what was published."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TypeVar

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, recording

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.reaching import learned as learned_module
from humanpred_ros.evaluation.reaching import predictors as predictors_module
from humanpred_ros.evaluation.reaching.entry import ReachingEntry, ReachingMaterial
from humanpred_ros.evaluation.reaching.evaluation import ReachingConfig, evaluate_reaching
from humanpred_ros.evaluation.reaching.predictors import REACHING_PREDICTORS
from humanpred_ros.evaluation.reaching.result import Statistic
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import Jump, ReachRecording, load_reach_recordings
from humanpred_ros.reaching.distances import ReachMetric
from humanpred_ros.reaching.reach_task import ReachTask
from humanpred_ros.reaching.trivial import TimedLine, minimum_jerk

T, U = TypeVar("T"), TypeVar("U")
RECORDINGS = [recording(seed, n_frames=40) for seed in range(3)]


class Shaky:
    """Adds noise to the line: a predictor that chance plays a part in."""

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        line = TimedLine(minimum_jerk).predict(task, rng)
        return line + 0.05 * rng.normal(size=line.shape[1])


def with_entry(monkeypatch: pytest.MonkeyPatch, name: str, entry: ReachingEntry) -> None:
    more: Mapping[str, ReachingEntry] = MappingProxyType({**REACHING_PREDICTORS, name: entry})
    monkeypatch.setattr(predictors_module, "REACHING_PREDICTORS", more)


def in_turn(
    function: Callable[[T], U], tasks: Sequence[T], jobs: int, progress: Callable[[int], None] | None = None
) -> list[U]:
    """Do in this process what an evaluation does in others."""
    return [function(task) for task in tasks]


def test_figures_are_those_of_the_metric() -> None:
    evaluation = evaluate_reaching(
        RECORDINGS, config=ReachingConfig(predictors=("hold", "minimum_jerk")), spread=in_turn
    )
    (demos,) = evaluation.sets
    assert demos.names == ("made_up_0", "made_up_1", "made_up_2")
    assert [figures.name for figures in demos.predictors] == ["hold", "minimum_jerk", "itself"]
    found = demos.predictor("minimum_jerk")
    assert found is not None
    metric, rng = ReachMetric(MODEL), np.random.default_rng(0)
    wanted = [
        metric.between(TimedLine(minimum_jerk).predict(ReachTask.of(entry), rng), entry.active.q)
        for entry in RECORDINGS
    ]
    assert [found.of(entry.name).joint_m.mean for entry in RECORDINGS] == [distance.joint_m for distance in wanted]
    assert found.average.task_m.mean == pytest.approx(np.mean([distance.task_m for distance in wanted]))
    itself = demos.predictor("itself")
    assert itself is not None
    assert itself.average.joint_m == Statistic(0.0, 0.0, 0.0, 0.0)
    assert not demos.published  # these are not P2's recordings
    assert not evaluation.targets


def test_nobody_learns_from_the_reach_to_predict(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, list[str]] = {}

    def prepare(material: ReachingMaterial):  # type: ignore[no-untyped-def]
        def without(name: str) -> TimedLine:
            asked[name] = [entry.name for entry in material.without(name)]
            return TimedLine(minimum_jerk)

        return without

    with_entry(monkeypatch, "watched", ReachingEntry("", prepare))
    case = recording(7, n_frames=40)
    evaluation = evaluate_reaching(RECORDINGS, [case], ReachingConfig(predictors=("watched",)), spread=in_turn)
    names = [entry.name for entry in RECORDINGS]
    assert asked == {**{name: [n for n in names if n != name] for name in names}, case.name: names}
    assert [entry.left_out for entry in evaluation.sets] == [True, False]


def test_chance_is_shown_over_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    with_entry(monkeypatch, "shaky", ReachingEntry("", lambda _: lambda name: Shaky(), by_chance=True))
    config = ReachingConfig(predictors=("shaky", "line"), runs=4)
    a, b = (evaluate_reaching(RECORDINGS, config=config, spread=in_turn).sets[0] for _ in range(2))
    shaky, line = a.predictors[0], a.predictors[1]
    assert (shaky.runs, line.runs) == (4, 1)
    joint = shaky.recordings[0].figures.joint_m
    assert joint.low < joint.mean < joint.high
    assert joint.sd > 0.0
    assert line.recordings[0].figures.joint_m.sd == 0.0
    assert [entry.figures for entry in shaky.recordings] == [entry.figures for entry in b.predictors[0].recordings]
    other = evaluate_reaching(RECORDINGS, config=dataclasses.replace(config, seed=1), spread=in_turn).sets[0]
    assert other.predictors[0].recordings[0].figures != shaky.recordings[0].figures


def test_what_learns_gets_weights_that_do_not_know_the_tested_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {
        how: config.replaced(sampling=config.sampling.replaced(n_samples=20), collisions=None, bootstrap=2)
        for how, config in learned_module.LEARNING.items()
    }
    monkeypatch.setattr(learned_module, "LEARNING", few)
    given: dict[str, FloatArray] = {}

    def prepare(material: ReachingMaterial):  # type: ignore[no-untyped-def]
        def without(name: str) -> TimedLine:
            given[name] = material.learned("improved").without(name)
            return TimedLine(minimum_jerk)

        return without

    with_entry(monkeypatch, "watched", ReachingEntry("", prepare, learns="improved"))
    case = recording(7, n_frames=40)
    names = ("watched", "own")
    config = ReachingConfig(predictors=names, runs=1)
    found = evaluate_reaching(RECORDINGS, [case], config, spread=in_turn)
    assert found.weights is not None
    (left_out,) = found.weights.left_out
    for name, weights in zip(left_out.recordings, left_out.weights, strict=True):
        np.testing.assert_array_equal(given[name], weights)
    np.testing.assert_array_equal(given[case.name], found.weights.columns[0].weights)
    # Who learns from the tested reach cannot be tested on one that nothing was learned from.
    assert [figures.name for figures in found.sets[0].predictors] == [*names, "itself"]
    assert [figures.name for figures in found.sets[1].predictors] == ["watched", "itself"]
    assert [entry.predictor for entry in found.times] == ["own"]


def test_statistics_are_averaged_as_in_the_paper() -> None:
    a, b = Statistic.of([1.0, 3.0]), Statistic.of([5.0])
    assert a == Statistic(2.0, 1.0, 1.0, 3.0)
    assert Statistic.average([a, b]) == Statistic(3.5, 0.5, 3.0, 4.0)


def test_recordings_with_jumps_are_tested_and_shown_apart() -> None:
    jumping = dataclasses.replace(RECORDINGS[0], jumps=(Jump("active", 20, "right_wrist", 7.0),))
    demos = evaluate_reaching(
        [jumping, *RECORDINGS[1:]], config=ReachingConfig(predictors=("line",)), spread=in_turn
    ).sets[0]
    line = demos.predictors[0]
    assert len(line.recordings) == 3
    assert line.average_fit is not None
    fit = [entry.figures.joint_m.mean for entry in line.recordings[1:]]
    assert line.average_fit.joint_m.mean == pytest.approx(np.mean(fit))
    assert demos.recordings[0]["unfit"]


def test_impossible_requests_are_refused() -> None:
    with pytest.raises(UsageError, match="crystal_ball"):
        ReachingConfig(predictors=("crystal_ball",))
    with pytest.raises(UsageError, match="at least one run"):
        ReachingConfig(runs=0)
    with pytest.raises(UsageError, match="leave one out"):
        evaluate_reaching(RECORDINGS[:1], config=ReachingConfig(predictors=("line",)))
    with pytest.raises(UsageError, match="made_up_1 again"):
        evaluate_reaching(RECORDINGS, RECORDINGS[1:2], ReachingConfig(predictors=("line",)))


def test_on_the_papers_recordings_all_reference_values_come_out() -> None:
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    case = load_reach_recordings(shared_data("icra2015/interference_case"))
    trivial = ("hold", "line", "cubic", "minimum_jerk", "time_profile")
    evaluation = evaluate_reaching(recordings, case, ReachingConfig(predictors=trivial), spread=in_turn)
    assert evaluation.sets[0].names[0] == "0446-0578"  # the paper's order
    assert len(evaluation.sets[0].published) == 7
    assert len(evaluation.sets[1].published) == 2
    assert len(evaluation.targets) >= 11
    assert all(target.met for target in evaluation.targets)
    seven = evaluation.sets[0]
    assert seven.better_than("minimum_jerk", "line", "joint_m") == 7
    assert seven.better_than("line", "minimum_jerk", "joint_m") == 0
    assert seven.better_than("line", "nobody", "joint_m") is None
    written = evaluation.to_json()
    assert written["table1"]["2711-2823"] == [25.56, 45.69]
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
    [
        lambda entries: [rested(entry, 1.0) for entry in entries],
        lambda entries: entries[:3],
    ],
    ids=["a second of rest before", "three to learn from"],
)
def test_the_default_beats_minimum_jerk_on_recordings_of_another_kind(
    change: Callable[[list[ReachRecording]], list[ReachRecording]],
) -> None:
    recordings = change(list(load_reach_recordings(shared_data("icra2015/demos"))))
    config = ReachingConfig(predictors=("minimum_jerk", "improved"), runs=2)
    found = evaluate_reaching(recordings, config=config, spread=in_turn).sets[0]
    line, improved = (found.predictor(name) for name in config.predictors)
    assert line is not None
    assert improved is not None
    assert improved.average.joint_m.mean < line.average.joint_m.mean
    assert improved.average.task_m.mean < line.average.task_m.mean


def test_recordings_with_jumps_are_learned_from_where_there_are_no_others(caplog: pytest.LogCaptureFixture) -> None:
    jumping = [dataclasses.replace(entry, jumps=(Jump("active", 20, "right_wrist", 7.0),)) for entry in RECORDINGS]
    one_fit = [RECORDINGS[0], *jumping[1:]]
    config = ReachingConfig(predictors=("improved",), runs=1)
    for entries in (jumping, one_fit):
        demos = evaluate_reaching(entries, config=config, spread=in_turn).sets[0]
        assert len(demos.predictors[0].recordings) == 3
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
    config = ReachingConfig(predictors=("line",))
    assert "table_top" in evaluate_reaching(RECORDINGS, config=config, spread=in_turn).settings["obstacles"]
    assert evaluate_reaching(moved, config=config, spread=in_turn).settings["obstacles"] == []
