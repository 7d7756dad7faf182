"""Predicts recorded reaches with every predictor and scores them: the work of `humanpred evaluate reaching`.

Every recorded reach is predicted from its first and last posture, its duration and the partner beside it, by a
predictor that may have learned from all other recordings (leave one out), and compared by time warping with what the
person did. Recordings with marker jumps are tested like the others.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from humanpred_ros.errors import GoalUnreachableError, SettingsError, UsageError
from humanpred_ros.evaluation.framework import Begin, EvaluationSettings, chosen_names
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.reach_distances import ReachMetric
from humanpred_ros.evaluation.reaching_predictors import (
    REACHING_PREDICTORS,
    REFERENCE,
    WRIST,
    ReachingMaterial,
    Without,
    reaching_entry,
)
from humanpred_ros.evaluation.reaching_scores import (
    DEMONSTRATIONS,
    DISTANCES,
    INTERFERENCE_CASE,
    ITSELF,
    PUBLISHED,
    PUBLISHED_INTERFERENCE,
    PublishedRow,
    ReachingSet,
    Scores,
)
from humanpred_ros.evaluation.reaching_weights import (
    LearnedWeights,
    Recovery,
    WeightColumn,
    feature_deviation,
    learn_all,
    recovery_figures,
    spread,
    weight_columns,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.features import N_FEATURES
from humanpred_ros.reaching.posture_bounds import PostureBounds
from humanpred_ros.reaching.prediction import ReachTask
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.settings import setting

#: Single predictions are timed on the reach nearest to this duration, s: so many, after so many to warm up.
_TIMED_DURATION_S, _TIMED, _WARM_UP = 1.3, 15, 2


class ReachingSettings(EvaluationSettings):
    """What is evaluated."""

    demos: str = setting(..., "folder of <name>_active.csv and <name>_passive.csv")
    interference: str | None = setting(
        None,
        "the same of reaches that the partner is in the way of; by default interference_case beside the "
        "demonstrations, if it is there; none to leave it out",
    )
    predictor: tuple[str, ...] = setting(("all",), f"all, or some of {', '.join(REACHING_PREDICTORS)}")
    runs: int = setting(10, "runs of each recording, where the predictor is random", low=1)
    samples: tuple[str, ...] = setting(
        ("3", "10", "30", "100", "300", "700"),
        "numbers of samples from which known weights are learned again (P2 Fig. 7; with the predictor learned only); "
        "none to leave that out",
    )
    repetitions: int = setting(10, "repetitions of learning known weights, with other demonstrations", low=1)

    def check(self) -> None:
        counts = self.sample_counts
        if any(count < 1 for count in counts) or list(counts) != sorted(set(counts)):
            raise SettingsError(f"samples: wanted numbers of at least 1, ascending, got {', '.join(self.samples)}")

    @property
    def predictors(self) -> tuple[str, ...]:
        """Names of `REACHING_PREDICTORS` (UsageError for others)."""
        return chosen_names(self.predictor, REACHING_PREDICTORS, "predictors")

    @property
    def sample_counts(self) -> tuple[int, ...]:
        """Numbers of samples; () for none."""
        if self.samples == ("none",):
            return ()
        try:
            return tuple(int(part) for part in self.samples)
        except ValueError:
            raise SettingsError(f"samples: wanted none, or whole numbers, got {', '.join(self.samples)}") from None


@dataclass(frozen=True, eq=False)
class ReachingResult:
    """All that the evaluation found.

    Attributes:
        obstacles: names of what stands where the reaches were recorded.
        sets: the demonstrations, predicted leaving one out, and the interference case if it is there.
        learned: weights by the names of `reaching_weights.LEARNING`.
        columns: weights side by side; empty if none were learned.
        deviation: (24,) standard deviation of each feature over samples; zeros without weights.
        recovery: P2 Fig. 7; None if it was left out.
        times: of one prediction alone in one process: predictor, recording, duration_s, median_ms, slowest_ms,
            processor_ms.
        elapsed_s: from recordings to figures.
    """

    obstacles: tuple[str, ...]
    sets: tuple[ReachingSet, ...]
    learned: Mapping[str, LearnedWeights]
    columns: tuple[WeightColumn, ...]
    deviation: FloatArray
    recovery: Mapping[str, Any] | None
    times: tuple[Mapping[str, Any], ...]
    elapsed_s: float


@dataclass(frozen=True)
class RecordingTask:
    """One recording to predict with one predictor, by name, `runs` times."""

    predictor: str
    recording: ReachRecording
    runs: int

    def __str__(self) -> str:
        return f"{self.predictor} on {self.recording.name}"


@dataclass(frozen=True, eq=False)
class RecordingOutcome:
    """Distances (3, runs) of one task, the wrist's path (n, 3) in the first run, and the time of each run, s."""

    distances_m: FloatArray
    wrist_m: FloatArray
    times_s: tuple[float, ...]


class RecordingRuns:
    """Does tasks; a worker process keeps it.

    Args:
        material: what predictors are made of.
        seed: of the runs; run k of any recording and predictor draws from (seed, k).
    """

    def __init__(self, material: ReachingMaterial, seed: int) -> None:
        self._material, self._seed = material, seed
        self._prepared: dict[str, Without] = {}

    def __reduce__(self) -> tuple[type[RecordingRuns], tuple[ReachingMaterial, int]]:
        """Leave out what was prepared: predictors need not be picklable."""
        return RecordingRuns, (self._material, self._seed)

    def __call__(self, task: RecordingTask) -> RecordingOutcome:
        """Predict and compare; the predictor has not seen the recording, unless it is one `of_tested`."""
        recording = task.recording
        if task.predictor not in self._prepared:
            self._prepared[task.predictor] = reaching_entry(task.predictor).prepare(self._material)
        predictor, reach = self._prepared[task.predictor](recording.name), ReachTask.of(recording)
        reaches, times_s = [], []
        for run in range(task.runs):
            rng = np.random.default_rng([self._seed, run])
            begin = time.perf_counter()
            reaches.append(predictor.predict(reach, rng))
            times_s.append(time.perf_counter() - begin)
        return _compared(reaches, recording, self._material.model, tuple(times_s))


def _compared(
    reaches: Sequence[FloatArray], recording: ReachRecording, model: HumanModel, times_s: tuple[float, ...]
) -> RecordingOutcome:
    metric = ReachMetric(model)
    found = [metric.between(q, recording.active.q) for q in reaches]
    distances = np.array([[getattr(distance, name) for distance in found] for name in DISTANCES])
    return RecordingOutcome(distances, model.forward(reaches[0])[WRIST], times_s)


def evaluate(
    recordings: Sequence[ReachRecording],
    interference: Sequence[ReachRecording],
    settings: ReachingSettings,
    begin: Begin,
    model: HumanModel | None = None,
) -> ReachingResult:
    """Predict all recordings with all predictors.

    Args:
        recordings: demonstrations, each predicted from the others.
        interference: reaches that the partner is in the way of, predicted from all demonstrations; may be none.
        settings: what is evaluated.
        begin: begins a line of progress.
        model: the human; P2's 23-DoF human if None.

    Raises:
        UsageError: fewer than two recordings, so that none could be left out, or unknown predictors.
        MotionError: recordings that nothing can be learned from.
    """
    began_s = time.perf_counter()
    if len(recordings) < 2:
        raise UsageError(
            f"evaluation: wanted at least 2 recordings, to leave one out, got {len(recordings)}; add others"
        )
    known = {recording.name for recording in recordings}
    if twice := [recording.name for recording in interference if recording.name in known]:
        raise UsageError(f"interference case: wanted recordings not learned from, got {', '.join(twice)} again")
    predictors, model = settings.predictors, model or HumanModel.mocap23()
    ordered = sorted(recordings, key=_papers_order)
    hands_m = [model.forward(recording.active.q)[WRIST] for recording in ordered]
    surroundings = Surroundings.around_hands(np.concatenate(hands_m))
    ways = [how for how in dict.fromkeys(reaching_entry(name).learns for name in predictors) if how is not None]
    learned = {how: learn_all(ordered, model, how, settings.seed, surroundings) for how in ways}
    material = ReachingMaterial(ordered, model, {how: each.table for how, each in learned.items()}, surroundings)
    times = tuple(_prediction_times(predictors, ordered, material))

    tasks = sorted(_tasks(ordered, interference, predictors, settings.runs), key=_length, reverse=True)
    outcomes = map_processes(
        RecordingRuns(material, settings.seed), tasks, settings.jobs, begin("predicted", len(tasks)), settings.scheduler
    )
    found = {(task.predictor, task.recording.name): done for task, done in zip(tasks, outcomes, strict=True)}
    recovery, counts = None, settings.sample_counts if "learned" in predictors else ()
    if counts:
        runs = map_processes(
            Recovery(ordered, model, counts, settings.seed), range(settings.repetitions), settings.jobs,
            begin("known weights learned", settings.repetitions), settings.scheduler,
        )  # fmt: skip
        recovery = recovery_figures(runs, counts)

    deviation = feature_deviation(ordered, model, settings.seed) if learned else np.zeros(N_FEATURES)
    make_set = partial(_set_of, found=found, predictors=predictors, learned_from=ordered, model=model)
    published = PUBLISHED if known == set(DEMONSTRATIONS) else ()
    sets = [make_set("each predicted from the others", ordered, published=published, left_out=True)]
    if interference:
        papers = [recording.name for recording in interference] == [INTERFERENCE_CASE]
        title = "partner in the way, predicted from all the demonstrations"
        sets.append(make_set(title, interference, published=PUBLISHED_INTERFERENCE if papers else (), left_out=False))
    return ReachingResult(
        obstacles=tuple(obstacle.name for obstacle in surroundings.obstacles),
        sets=tuple(sets),
        learned=learned,
        columns=weight_columns(learned, deviation) if learned else (),
        deviation=deviation,
        recovery=recovery,
        times=times,
        elapsed_s=time.perf_counter() - began_s,
    )


def _papers_order(recording: ReachRecording) -> tuple[int, str]:
    known = recording.name in DEMONSTRATIONS
    return (DEMONSTRATIONS.index(recording.name) if known else len(DEMONSTRATIONS), recording.name)


def _tasks(
    recordings: Sequence[ReachRecording], interference: Sequence[ReachRecording], predictors: Sequence[str], runs: int
) -> Iterator[RecordingTask]:
    """Yield every recording with every predictor that can be tested on it."""
    for name in predictors:
        entry = reaching_entry(name)
        for recording in (*recordings, *(() if entry.of_tested else interference)):
            yield RecordingTask(name, recording, runs if entry.by_chance else 1)


def _length(task: RecordingTask) -> float:
    """Return about how long a task takes; a single plan takes as long for any duration, re-plans come every 0.1 s."""
    entry = reaching_entry(task.predictor)
    return task.runs * (task.recording.active.duration_s if entry.replanned else 0.1 if entry.by_chance else 0.0)


def _prediction_times(
    names: Sequence[str], recordings: Sequence[ReachRecording], material: ReachingMaterial
) -> Iterator[dict[str, Any]]:
    """Yield the time of predictors that plan a reach once, in one process, while the evaluation does nothing else."""
    recording = min(recordings, key=lambda each: abs(each.active.duration_s - _TIMED_DURATION_S))
    reach = ReachTask.of(recording)
    for name in names:
        entry = reaching_entry(name)
        if not entry.by_chance or entry.replanned:
            continue
        predictor = entry.prepare(material)(recording.name)
        spent = []
        for run in range(_WARM_UP + _TIMED):
            rng = np.random.default_rng(run)
            begin = time.perf_counter(), time.process_time()
            predictor.predict(reach, rng)
            spent.append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
        timed_ms = 1e3 * np.array(spent[_WARM_UP:])
        yield {
            "predictor": name,
            "recording": recording.name,
            "duration_s": recording.active.duration_s,
            "median_ms": float(np.median(timed_ms[:, 0])),
            "slowest_ms": float(timed_ms[:, 0].max()),
            "processor_ms": float(np.median(timed_ms[:, 1])),
        }


def _set_of(
    title: str,
    recordings: Sequence[ReachRecording],
    *,
    found: Mapping[tuple[str, str], RecordingOutcome],
    predictors: Sequence[str],
    published: Sequence[PublishedRow],
    left_out: bool,
    learned_from: Sequence[ReachRecording],
    model: HumanModel,
) -> ReachingSet:
    """Return the scores of all predictors on some recordings, and of each recording compared with itself."""
    scores = []
    for name in predictors:
        entry = reaching_entry(name)
        if left_out or not entry.of_tested:
            outcomes = [found[name, recording.name] for recording in recordings]
            scores.append(_scores(name, entry.description, entry.group, outcomes))
    perfect = [_compared([recording.active.q], recording, model, (np.nan,)) for recording in recordings]
    scores.append(_scores(ITSELF, "the recording itself: a perfect prediction", REFERENCE, perfect))
    return ReachingSet(
        title=title,
        recordings=tuple(
            {
                "name": recording.name,
                "n_frames": len(recording.active),
                "duration_s": recording.active.duration_s,
                "unfit": recording.unfit,
                "notes": [*recording.notes, *_beyond(recording, learned_from, model)],
            }
            for recording in recordings
        ),
        wrist_m=tuple(outcome.wrist_m for outcome in perfect),
        scores=tuple(scores),
        published=tuple(published),
        left_out=left_out,
    )


def _scores(name: str, description: str, group: str, outcomes: Sequence[RecordingOutcome]) -> Scores:
    times_s = np.concatenate([outcome.times_s for outcome in outcomes])
    return Scores(
        name=name,
        description=description,
        group=group,
        runs=len(outcomes[0].times_s),
        values=np.array([spread(outcome.distances_m) for outcome in outcomes]),
        wrist_m=tuple(outcome.wrist_m for outcome in outcomes),
        predict_ms=1e3 * float(np.median(times_s)),
    )


def _beyond(recording: ReachRecording, learned_from: Sequence[ReachRecording], model: HumanModel) -> tuple[str, ...]:
    """Return notes on a goal that is beyond what predictors have seen; it is predicted all the same."""
    others = [other for other in learned_from if other.name != recording.name]
    if not others:
        return ()
    try:
        notes = PostureBounds.from_recordings(others, model).check_goal(recording.name, recording.active.q[-1])
    except GoalUnreachableError as far:
        notes = (str(far),)
    return tuple(text.removeprefix(f"{recording.name}: ") for text in notes)
