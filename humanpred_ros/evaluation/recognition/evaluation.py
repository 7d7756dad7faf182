"""How early and how surely is a motion recognised that was not learned from (P1 VI, Fig. 6)?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.recognition.classifiers import learned_of_class
from humanpred_ros.evaluation.recognition.reference import ReferenceCurve
from humanpred_ros.evaluation.recognition.result import ClassifierResult, GroupScore, SpeedScore, Timing, UnknownScore
from humanpred_ros.evaluation.recognition.runs import (
    ClassifierChoice,
    LeftOutClass,
    LeftOutRuns,
    Outcome,
    Task,
    Trace,
    check_evaluable,
    tasks_for,
    unknown_left_out,
)
from humanpred_ros.evaluation.recognition.scores import (
    BoolArray,
    IntArray,
    auroc,
    brier_score,
    calibration,
    confusion,
    curve_figures,
    decided_right,
    log_loss,
    quartiles,
    rms_difference,
    worst_drop,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import MotionLibrary

#: A posterior this probable of no class counts as a refusal.
REFUSAL_THRESHOLD = 0.5
#: The least probabilities counted in a log-loss: scikit-learn's old default, and one at which a few motions that are
#: given up for certain do not drown all others.
LOG_LOSS_CLIPS = (1e-15, 1e-3)
_UNKNOWN_AT = (10, 30, 60, 90)
_TENTHS = np.arange(10, 101, 10)


@dataclass(frozen=True)
class EvaluationConfig:
    """How to evaluate a classifier.

    Attributes:
        speeds: factors of the recorded speed; 1 need not be among them.
        with_unknown: leave out each class in turn, too, if there are classes enough.
        seed: of the floors of the calibration errors; a classifier has its own in its settings.
        jobs: number of processes; changes times only.

    Raises:
        UsageError: a speed that is not positive, or a negative seed.
    """

    speeds: tuple[float, ...] = (0.7, 1.0, 1.4)
    with_unknown: bool = True
    seed: int = 0
    jobs: int = 1

    def __post_init__(self) -> None:
        if not all(0 < speed < float("inf") for speed in self.speeds):
            raise UsageError(f"speeds: wanted positive factors, got {', '.join(map(str, self.speeds))}")
        if self.seed < 0:
            raise UsageError(f"seed: wanted a number of at least 0, got {self.seed}")

    def leaves_out_classes(self, library: MotionLibrary) -> bool:
        """Return whether classes are left out of this library: wanted, and possible."""
        return self.with_unknown and unknown_left_out(library) is None

    @property
    def further_speeds(self) -> tuple[float, ...]:
        """The speeds other than the recorded one, each once, ascending."""
        return tuple(sorted(set(self.speeds) - {1.0}))


def evaluate_classifier(
    choice: ClassifierChoice,
    library: MotionLibrary,
    config: EvaluationConfig,
    *,
    reference: ReferenceCurve | None = None,
    advice: Mapping[str, str] | None = None,
    progress: Callable[[int], None] | None = None,
) -> ClassifierResult:
    """Leave out each motion, and each class, in turn; return what the classifier said about them as figures.

    No class is left out of two, which would leave nothing to tell apart.

    A classifier sees a left-out motion as a sensor would show it: posture by posture, with stamps; it is not told how
    long the motion is going to last. Goal inference learns from no motion of a left-out motion's class, and is told the
    class's place; with the class left out, it is not told the place either.

    Args:
        choice: the classifier.
        library: all of it is evaluated.
        config: how.
        reference: a published curve to compare with.
        advice: by motion, what somebody advised to do about it ("exclude", "suspect", "keep"). All motions count
            all the same; figures without those to exclude, and without the suspect ones too, are given beside.
        progress: called with the number of tasks done, of `n_tasks`.

    Raises:
        LibraryFormatError: too few classes or motions for this classifier, or what the classifier cannot learn.
        MotionError: a speed at which less than two postures are left of a motion.
        UsageError: an unknown classifier.
    """
    begun = time.perf_counter()
    check_evaluable(library, [choice.name])
    choice.make()  # an unknown name shows before any process is started
    tasks = tasks_for(library, config.leaves_out_classes(library))
    outcomes = map_processes(LeftOutRuns(choice, library, config.further_speeds), tasks, config.jobs, progress)
    n_classes = len(tasks) - len(library)
    motions, classes = outcomes[n_classes:], outcomes[:n_classes]
    truth = np.array([library.labels.index(motion.label) for motion in library if motion.label is not None])
    recorded = [outcome.traces[0] for outcome in motions]
    known, unknown = np.stack([t.known for t in recorded]), np.stack([t.unknown for t in recorded])
    right = decided_right(known, truth)
    rate = right.mean(axis=0)
    losses = {f"{clip:g}": log_loss(known, truth, clip) for clip in LOG_LOSS_CLIPS}
    brier = brier_score(known, truth)
    rng = np.random.default_rng(config.seed)
    confidence = known.max(axis=2)
    return ClassifierResult(
        name=choice.name,
        settings=choice.settings,
        learned_of_class=learned_of_class(choice.name),
        rate=rate,
        figures=curve_figures(rate),
        reference_rms=None if reference is None else rms_difference(rate, reference.rate),
        log_loss={clip: float(loss.mean()) for clip, loss in losses.items()},
        log_loss_curve=losses[f"{max(LOG_LOSS_CLIPS):g}"],
        brier=float(brier.mean()),
        brier_curve=brier,
        calibration=calibration(confidence, right, rng),
        calibration_with_unknown=calibration(confidence * (1.0 - unknown), right, rng),
        confusion_at_60=confusion(known[:, 59], truth),
        unknown_on_known={percent: float(unknown[:, percent - 1].mean()) for percent in _UNKNOWN_AT},
        unknown_quartiles=quartiles(unknown),
        speeds=tuple(_speed_scores(config.further_speeds, motions, truth, rate)),
        unknown=unknown_score(_by_class(tasks, classes), unknown) if n_classes else None,
        groups=tuple(_group_scores(library, right, advice or {})),
        refused_postures=sum(trace.refused for trace in recorded),
        timing=_timing(outcomes, recorded, begun),
    )


def n_tasks(library: MotionLibrary, config: EvaluationConfig) -> int:
    """Return how many tasks the evaluation of one classifier has."""
    return len(tasks_for(library, config.leaves_out_classes(library)))


def _speed_scores(
    speeds: Sequence[float], motions: Sequence[Outcome], truth: IntArray, rate: FloatArray
) -> Iterator[SpeedScore]:
    for k, speed in enumerate(speeds, start=1):
        at_speed = decided_right(np.stack([outcome.traces[k].known for outcome in motions]), truth).mean(axis=0)
        yield SpeedScore(speed, at_speed, *worst_drop(rate, at_speed))


def _by_class(tasks: Sequence[Task], classes: Sequence[Outcome]) -> dict[int, FloatArray]:
    labels = [task.label for task in tasks if isinstance(task, LeftOutClass)]
    return {
        label: np.stack([trace.unknown for trace in outcome.traces])
        for label, outcome in zip(labels, classes, strict=True)
    }


def unknown_score(by_class: Mapping[int, FloatArray], known: FloatArray) -> UnknownScore:
    """Compare the probability of no class on motions of classes left out with that on motions of known ones.

    Args:
        by_class: (N_c, 100) of the motions of each class, by classifiers that have not learned it.
        known: (N, 100) of motions of learned classes.
    """
    unknown = np.concatenate(list(by_class.values()))
    says_something = bool(np.ptp(np.concatenate([unknown, known])) > 0)
    areas = np.array([auroc(unknown[:, p - 1], known[:, p - 1]) for p in _TENTHS])
    refused_unknown, refused_known = (
        (scores[:, _TENTHS - 1] >= REFUSAL_THRESHOLD).mean(axis=0) for scores in (unknown, known)
    )
    area_by_class = {label: auroc(scores[:, 59], known[:, 59]) for label, scores in by_class.items()}
    return UnknownScore(
        says_something=says_something,
        threshold=REFUSAL_THRESHOLD,
        tenths=_TENTHS,
        auroc=areas if says_something else None,
        refused_unknown=refused_unknown,
        refused_known=refused_known,
        auroc_at_60=float(areas[5]) if says_something else None,
        auroc_at_60_by_class=area_by_class if says_something else None,
        refused_at_60_by_class={
            label: float((scores[:, 59] >= REFUSAL_THRESHOLD).mean()) for label, scores in by_class.items()
        },
        quartiles=quartiles(unknown),
    )


def _group_scores(library: MotionLibrary, right: BoolArray, advice: Mapping[str, str]) -> Iterator[GroupScore]:
    flags = np.array([advice.get(motion.name, "") for motion in library])
    bad, doubtful = flags == "exclude", flags == "suspect"
    for group, members in (
        ("without excluded", ~bad),
        ("without suspect too", ~bad & ~doubtful),
        ("excluded only", bad),
        ("suspect only", doubtful),
    ):
        if members.any() and (bad | doubtful).any():
            yield GroupScore(group, int(members.sum()), curve_figures(right[members].mean(axis=0)))


def _timing(outcomes: Sequence[Outcome], recorded: Sequence[Trace], begun: float) -> Timing:
    fits = [time_s for outcome in outcomes for time_s in outcome.fit_s]
    updates_us = np.concatenate([trace.update_ns for trace in recorded]) * 1e-3
    parts = sorted({part for outcome in outcomes for part in outcome.cpu_s})
    return Timing(
        fit_s=float(np.median(fits)),
        n_fits=len(fits),
        update_us=float(np.median(updates_us)),
        update_us_p99=float(np.quantile(updates_us, 0.99)),
        wall_s=time.perf_counter() - begun,
        cpu_s={part: sum(outcome.cpu_s.get(part, 0.0) for outcome in outcomes) for part in parts},
    )
