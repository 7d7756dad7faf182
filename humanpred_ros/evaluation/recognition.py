"""How early and how surely is a motion recognised that was not learned from (P1 results, Fig. 6)?

Each motion is left out of the library in turn, and each class as a whole, too. A classifier sees a left-out motion as a
sensor would show it, posture by posture with stamps; it does not know how long the motion is going to last. The
classifier `reaching` learns from no motion of a left-out motion's class and knows the class's place; with the class
left out, it does not know the place either.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console

from humanpred_ros.evaluation.framework import (
    Advance,
    Begin,
    Column,
    LibrarySettings,
    Report,
    Table,
    chosen_names,
    present,
)
from humanpred_ros.evaluation.leave_one_out import check_needs
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.plots import recognition_plot
from humanpred_ros.evaluation.published import ReferenceCurve, advice_beside, read_reference, reference_beside
from humanpred_ros.evaluation.recognition_runs import (
    REACHING,
    ClassifierChoice,
    LeftOutClass,
    LeftOutRuns,
    Outcome,
    Trace,
    evaluated_names,
    evaluated_type,
    learned_of_class,
    needs_of,
    tasks_for,
    unknown_left_out,
)
from humanpred_ros.evaluation.recognition_scores import (
    REFUSAL_THRESHOLD,
    BoolArray,
    ClassifierResult,
    CurveFigures,
    GroupScore,
    IntArray,
    SpeedScore,
    Timing,
    brier_score,
    calibration,
    confusion,
    curve_figures,
    decided_right,
    log_loss,
    quartiles,
    rms_difference,
    unknown_score,
    worst_drop,
)
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.settings import setting, setting_of

#: The least probabilities counted in a log-loss: scikit-learn's old default, and one at which a few motions that are
#: given up for certain do not drown all others.
LOG_LOSS_CLIPS = (1e-15, 1e-3)
_UNKNOWN_AT = (10, 30, 60, 90)


class RecognitionSettings(LibrarySettings):
    """Settings of `humanpred evaluate recognition`."""

    classifier: tuple[str, ...] = setting(("all",), "classifiers by name; all: those that are installed, and reaching")
    reference: str | None = setting(
        None,
        "published curve to compare with, a CSV file of phase_percent and recognition_rate; none for no curve; by "
        "default reference/authors_fig6_curve.csv beside the library, if it is there",
    )
    speeds: tuple[float, ...] = setting(
        (0.7, 1.0, 1.4), "play the motions at these factors of their speed, too", low=0.01, high=100.0
    )
    unknown: bool = setting(True, "leave out each class as a whole, too, if there are three classes or more")
    components: int = setting_of(GmmSettings, "n_components", description="gmm: Gaussians per class")
    phase: bool = setting_of(GmmSettings, "phase_feature", description="gmm: the phase is a feature beside the posture")
    evidence: Literal["sum", "mean"] = setting_of(
        GmmSettings, "evidence", description="gmm: sum or mean of the postures' log densities"
    )
    window_frames: int = setting(0, "gmm: count only so many last postures; 0 counts all", low=0)

    def check(self) -> None:
        """Raise UsageError for unknown classifiers."""
        _ = self.choices

    @property
    def further_speeds(self) -> tuple[float, ...]:
        """The speeds other than the recorded one, each once, ascending."""
        return tuple(sorted(set(self.speeds) - {1.0}))

    @property
    def choices(self) -> tuple[ClassifierChoice, ...]:
        """The classifiers, each with its settings: the seed, if it has one, and those of gmm."""
        gmm = {
            "n_components": self.components,
            "phase_feature": self.phase,
            "evidence": self.evidence,
            "window_frames": self.window_frames or None,
        }
        choices = []
        for name in chosen_names(self.classifier, evaluated_names(), "classifier"):
            kind = evaluated_type(name).settings_type
            values: dict[str, Any] = {"seed": self.seed} if "seed" in kind.model_fields else {}
            values.update(gmm if name == "gmm" else {})
            choices.append(ClassifierChoice(name, kind(**values) if values else None))
        return tuple(choices)


def evaluate_classifier(
    choice: ClassifierChoice,
    library: MotionLibrary,
    settings: RecognitionSettings,
    *,
    reference: ReferenceCurve | None = None,
    advice: Mapping[str, str] | None = None,
    progress: Advance | None = None,
) -> ClassifierResult:
    """Leave out each motion, and each class, in turn; return what the classifier said about them as figures.

    Args:
        choice: the classifier.
        library: all of it is evaluated.
        settings: speeds, seed, and how the work is done.
        reference: a published curve to compare with.
        advice: by motion, what somebody advised to do about it ("exclude", "suspect", "keep"). All motions count
            all the same; figures without those to exclude, and without the suspect ones too, are given beside.
        progress: is called with the number of tasks done, of `tasks_for`.

    Raises:
        LibraryFormatError: too few classes or motions for this classifier, or what the classifier cannot learn.
        MotionError: a speed at which less than two postures are left of a motion.
    """
    begun = time.perf_counter()
    check_needs(library, {choice.name: needs_of(choice.name)}, "--classifier")
    tasks = tasks_for(library, settings.unknown)
    runs = LeftOutRuns(choice, library, settings.further_speeds)
    outcomes = map_processes(runs, tasks, settings.jobs, progress, settings.scheduler)
    n_classes = len(tasks) - len(library)
    motions, classes = outcomes[n_classes:], outcomes[:n_classes]
    truth = np.array([library.labels.index(motion.label) for motion in library if motion.label is not None])
    recorded = [outcome.traces[0] for outcome in motions]
    known, unknown = np.stack([t.known for t in recorded]), np.stack([t.unknown for t in recorded])
    right = decided_right(known, truth)
    rate = right.mean(axis=0)
    losses = {f"{clip:g}": log_loss(known, truth, clip) for clip in LOG_LOSS_CLIPS}
    brier = brier_score(known, truth)
    rng = np.random.default_rng(settings.seed)
    confidence = known.max(axis=2)
    unknown_by_class = {
        task.label: np.stack([trace.unknown for trace in outcome.traces])
        for task, outcome in zip(tasks, classes, strict=False)
        if isinstance(task, LeftOutClass)
    }
    return ClassifierResult(
        name=choice.name,
        settings={} if choice.settings is None else choice.settings.model_dump(),
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
        speeds=tuple(_speed_scores(settings.further_speeds, motions, truth, rate)),
        unknown=unknown_score(unknown_by_class, unknown) if n_classes else None,
        groups=tuple(_group_scores(library, right, advice or {})),
        refused_postures=sum(trace.refused for trace in recorded),
        timing=_timing(outcomes, recorded, begun),
    )


def _speed_scores(
    speeds: Sequence[float], motions: Sequence[Outcome], truth: IntArray, rate: FloatArray
) -> Iterator[SpeedScore]:
    for k, speed in enumerate(speeds, start=1):
        at_speed = decided_right(np.stack([outcome.traces[k].known for outcome in motions]), truth).mean(axis=0)
        yield SpeedScore(speed, at_speed, *worst_drop(rate, at_speed))


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


def measure(settings: RecognitionSettings, begin: Begin) -> Report:
    """Evaluate every classifier that was asked for.

    Raises:
        HumanPredError: an unusable library or reference, or what a classifier cannot learn.
    """
    path, library = settings.library_path, settings.read_library()
    choices = settings.choices
    check_needs(library, {choice.name: needs_of(choice.name) for choice in choices}, "--classifier")
    reference = _reference(settings.reference, path)
    advice = advice_beside(path, library.name)
    n_tasks = len(tasks_for(library, settings.unknown))
    results = tuple(
        evaluate_classifier(
            choice, library, settings, reference=reference, advice=advice, progress=begin(choice.name, n_tasks)
        )
        for choice in choices
    )
    why_not = unknown_left_out(library) if settings.unknown else None
    return Report(
        f"{library.name}: each of {len(library)} motions left out in turn",
        tuple(_tables(results, library.labels, reference)),
        {
            "library": library_facts(library, by_class=True),
            "labels": library.labels,
            "reference": reference,
            "classifiers": results,
            "unknown_left_out": why_not,
        },
        () if why_not is None else (f"Without unknown motions: {why_not}.",),
        lambda: recognition_plot(results, reference),
    )


def run(settings: RecognitionSettings, console: Console) -> int:
    """Evaluate, print, write; return the exit status."""
    return present(settings, console, measure)


def _reference(option: str | None, library: Path) -> ReferenceCurve | None:
    if option == "none":
        return None
    return read_reference(option) if option else reference_beside(library)


def _tables(
    results: Sequence[ClassifierResult], labels: Sequence[int], reference: ReferenceCurve | None
) -> Iterator[Table]:
    yield _curve_table(results, reference)
    name = Column("classifier", lambda r: r.name)
    yield Table(
        "How good the probabilities are",
        results,
        (
            name,
            *(Column(f"log-loss, clipped at {clip}", _entry("log_loss", clip), ".3f") for clip in results[0].log_loss),
            Column("Brier score", lambda r: r.brier, ".3f"),
            Column("calibration error", lambda r: r.calibration.error_mean, ".3f"),
            Column("  its floor", lambda r: r.calibration.floor_mean, ".3f"),
            Column("  percents pooled", lambda r: r.calibration.error_pooled, ".3f"),
            Column("  floor of that", lambda r: r.calibration.floor_pooled, ".3f"),
            Column("  no class counted", lambda r: r.calibration_with_unknown.error_mean, ".3f"),
            Column("  its own floor", lambda r: r.calibration_with_unknown.floor_mean, ".3f"),
        ),
        "Calibration error: mean over the motion. Floor: what perfect calibration would show with so few motions.",
    )
    if results[0].speeds:
        yield Table.of_rows(
            "The same motions done faster or slower",
            ("classifier", ("speed", "g"), ("points lost", ".1f"), ("at", "d", "%")),
            [
                (result.name, score.speed, score.worst_drop_points, score.worst_drop_percent)
                for result in results
                for score in result.speeds
            ],
            "Points lost: percentage points below the rate at the recorded speed, at worst, beyond 40 % of the motion.",
        )
    yield Table(
        "Motions of no known class",
        results,
        (
            name,
            *(
                Column(f"p of no class, known motions, {p} %", _entry("unknown_on_known", p), ".0%")
                for p in _UNKNOWN_AT
            ),
            Column("AUROC at 60 %", lambda r: None if r.unknown is None else r.unknown.auroc_at_60, ".3f"),
            Column("unknown refused at 60 %", lambda r: _refused(r, "refused_unknown"), ".1%"),
            Column("known refused at 60 %", lambda r: _refused(r, "refused_known"), ".1%"),
        ),
        f"Refused: the probability of no class is at least {REFUSAL_THRESHOLD:g}.",
    )
    yield Table(
        "Times",
        results,
        (
            name,
            Column("postures refused", lambda r: r.refused_postures),
            Column("fit of the whole library", lambda r: r.timing.fit_s, ".2f", "s"),
            Column("one posture", lambda r: r.timing.update_us, ".0f", "µs"),
            Column("99 % below", lambda r: r.timing.update_us_p99, ".0f", "µs"),
            Column("evaluation", lambda r: r.timing.wall_s, ".0f", "s"),
            Column("processor time", lambda r: sum(r.timing.cpu_s.values()), ".0f", "s"),
        ),
    )
    shown = next((result for result in results if result.name == DEFAULT_CLASSIFIER), results[0])
    yield _confusion_table(labels, shown)


def _curve_table(results: Sequence[ClassifierResult], reference: ReferenceCurve | None) -> Table:
    rows: list[tuple[Any, ...]] = []
    for result in results:
        rows.append((result.name, result.learned_of_class, *_figures(result.figures), result.reference_rms))
        rows += [(f"{result.name}, {g.group} ({g.n_motions})", None, *_figures(g.figures), None) for g in result.groups]
    if reference is not None:
        rows.append(("published", None, *_figures(reference.figures), None))
    note = "Recognised from: percent of the motion seen, from which on it stays so."
    if results[0].groups:
        note += " Excluded, suspect: flagged in outliers.csv beside the library; all other figures count every motion."
    if any(result.name == REACHING for result in results):
        note += (
            f" {REACHING} has seen no motion of the class it is tested on, only where its other motions go; the others "
            "learned from the class's other motions. Unknown motions: it does not know the place either."
        )
    shares = ("half recognised from", "", "%"), ("90 % recognised from", "", "%"), ("recognised at 60 %", ".1%")
    heads = ("classifier", "known of the class", *shares, ("least from 80 % on", ".1%"), ("rms to published", ".3f"))
    return Table.of_rows("Motions recognised", heads, rows, note)


def _entry(name: str, key: Any) -> Callable[[ClassifierResult], Any]:
    """Return what gives one entry of a mapping among the figures of a classifier."""
    return lambda result: getattr(result, name)[key]


def _figures(figures: CurveFigures) -> tuple[Any, ...]:
    first = [percent or "never" for percent in (figures.first_50_percent, figures.first_90_percent)]
    return *first, figures.rate_at_60, figures.least_from_80


def _refused(result: ClassifierResult, of: str) -> float | None:
    """Return the share refused at 60 % of the motion; None of classifiers that give all motions one probability."""
    if result.unknown is None or not result.unknown.says_something:
        return None
    return float(getattr(result.unknown, of)[5])


def _confusion_table(labels: Sequence[int], result: ClassifierResult) -> Table:
    taken_for = [str(label) for label in labels] + ["undecided"] * bool(result.confusion_at_60[:, -1].any())
    return Table.of_rows(
        f"{result.name}: true class (rows) taken for, at 60 % of the motion",
        ("true class", *taken_for),
        [
            (f"class {label}", *row[: len(taken_for)].tolist())
            for label, row in zip(labels, result.confusion_at_60, strict=True)
        ],
    )
