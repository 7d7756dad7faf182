"""The evaluation of recognition as tables in the terminal: classifiers side by side, figures below each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.evaluation.recognition.classifiers import REACHING
from humanpred_ros.evaluation.recognition.evaluation import REFUSAL_THRESHOLD
from humanpred_ros.evaluation.recognition.result import ClassifierResult, RecognitionEvaluation
from humanpred_ros.evaluation.recognition.scores import CurveFigures
from humanpred_ros.evaluation.target import targets_table
from humanpred_ros.evaluation.text import headline, line
from humanpred_ros.recognition.classifier import DEFAULT_CLASSIFIER

_Row = tuple[str, Callable[[ClassifierResult], str], Callable[[CurveFigures], str] | None]

_LEGEND = (
    "50 % recognised from: percent of the motion seen, from which on it stays so. Calibration error: mean over the "
    "motion; floor: what perfect calibration would show with so few motions. Points lost: at worst, beyond 40 % of "
    f"the motion. Refused: the probability of no class is at least {REFUSAL_THRESHOLD:g}. "
    "Excluded, suspect: flagged beside the library; all other figures count every motion."
)
_LEGEND_REACHING = (
    f"{REACHING} never saw any motion of the class it is tested on, only where its other motions go; the others "
    "learned from the class's other motions."
)
_LEGEND_UNKNOWN = f" Unknown motions: {REACHING} is not given the place."


def print_evaluation(evaluation: RecognitionEvaluation, console: Console) -> None:
    """Print all figures of every classifier, and the confusion of the default one, or else of the first."""
    library, results = evaluation.library, evaluation.classifiers
    shown = next((result for result in results if result.name == DEFAULT_CLASSIFIER), results[0])
    headline(console, f"{library['name']}: each of {library['n_motions']} motions left out in turn")
    console.print(_figures_table(evaluation))
    console.print(_LEGEND, style="dim", markup=False, highlight=False)
    if evaluation.unknown_left_out is not None:
        line(console, f"Without unknown motions: {evaluation.unknown_left_out}.")
    if any(result.name == REACHING for result in results):
        unknown = any(result.unknown is not None for result in results)
        console.print(_LEGEND_REACHING + _LEGEND_UNKNOWN * unknown, style="dim", markup=False, highlight=False)
    if evaluation.targets:
        console.print(targets_table(evaluation.targets))
    headline(console, f"{shown.name}: true class (rows) taken for, at 60 % of the motion")
    console.print(_confusion_table(evaluation, shown))


def _figures_table(evaluation: RecognitionEvaluation) -> Table:
    reference = evaluation.reference
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column()
    for result in evaluation.classifiers:
        table.add_column(escape(result.name), justify="right", no_wrap=True)
    if reference is not None:
        table.add_column("published", justify="right", no_wrap=True)
    for title, of_classifier, of_curve in _rows(evaluation):
        cells = [of_classifier(result) for result in evaluation.classifiers]
        if reference is not None:
            cells.append(of_curve(reference.figures) if of_curve else "")
        table.add_row(title, *cells)
    return table


def _rows(evaluation: RecognitionEvaluation) -> Iterator[_Row]:
    first = evaluation.classifiers[0]
    yield "known of the tested motion's class", lambda r: r.learned_of_class, None
    yield from _curve_rows("", lambda result: result.figures)
    if evaluation.reference is not None:
        yield "rms to the published curve", lambda r: _number(r.reference_rms), None
    for clip in first.log_loss:
        yield f"log-loss, clipped at {clip}", lambda r, clip=clip: f"{r.log_loss[clip]:.3f}", None  # type: ignore[misc]
    yield "Brier score", lambda r: f"{r.brier:.3f}", None
    yield (
        "calibration error (floor)",
        lambda r: _with_floor(r.calibration.error_mean, r.calibration.floor_mean),
        None,
    )
    yield (
        "  percents pooled (floor)",
        lambda r: _with_floor(r.calibration.error_pooled, r.calibration.floor_pooled),
        None,
    )
    yield (
        "  with no class counted (floor)",
        lambda r: _with_floor(r.calibration_with_unknown.error_mean, r.calibration_with_unknown.floor_mean),
        None,
    )
    for k, score in enumerate(first.speeds):
        yield f"points lost at {score.speed:g} x speed", lambda r, k=k: _drop(r, k), None  # type: ignore[misc]
    yield from _unknown_rows(first)
    for k, group in enumerate(first.groups):
        yield (
            f"at 60 %, {group.group} ({group.n_motions})",
            lambda r, k=k: _share(r.groups[k].figures.rate_at_60),  # type: ignore[misc]
            None,
        )
    yield "postures refused", lambda r: str(r.refused_postures), None
    yield "fit of the whole library", lambda r: f"{r.timing.fit_s:.2f} s", None
    yield (
        "one posture (99 % below)",
        lambda r: f"{r.timing.update_us:.0f} ({r.timing.update_us_p99:.0f}) µs",
        None,
    )
    yield (
        "evaluation (processor time)",
        lambda r: f"{r.timing.wall_s:.0f} ({sum(r.timing.cpu_s.values()):.0f}) s",
        None,
    )


def _curve_rows(suffix: str, figures: Callable[[ClassifierResult], CurveFigures]) -> Iterator[_Row]:
    parts: tuple[tuple[str, Callable[[CurveFigures], str]], ...] = (
        ("50 % recognised from", lambda f: _percent(f.first_50_percent)),
        ("90 % recognised from", lambda f: _percent(f.first_90_percent)),
        ("recognised at 60 %", lambda f: _share(f.rate_at_60)),
        ("least recognised from 80 % on", lambda f: _share(f.least_from_80)),
    )
    for title, text in parts:
        yield title + suffix, lambda r, text=text: text(figures(r)), text  # type: ignore[misc]


def _unknown_rows(first: ClassifierResult) -> Iterator[_Row]:
    percents = list(first.unknown_on_known)
    yield (
        f"no class, known, {'/'.join(map(str, percents))} %",
        lambda r: "/".join(f"{100 * value:.0f}" for value in r.unknown_on_known.values()) + " %",
        None,
    )
    if first.unknown is None:
        return
    yield "unknown: AUROC at 60 %", lambda r: _area(r), None
    yield (
        "  refused at 60 % (known ones)",
        lambda r: _refused(r),
        None,
    )


def _confusion_table(evaluation: RecognitionEvaluation, result: ClassifierResult) -> Table:
    counts = result.confusion_at_60
    labels = [str(label) for label in evaluation.labels]
    undecided = bool(counts[:, -1].any())
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", justify="right")
    for label in [*labels, "undecided"] if undecided else labels:
        table.add_column(label, justify="right", min_width=2)
    for k, label in enumerate(labels):
        row = counts[k] if undecided else counts[k, :-1]
        cells = [f"[bold]{n}[/bold]" if j == k else (str(n) if n else "·") for j, n in enumerate(row)]
        table.add_row(label, *cells)
    return table


def _percent(value: int | None) -> str:
    return "never" if value is None else f"{value} %"


def _share(value: float) -> str:
    return f"{100 * value:.1f} %"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _with_floor(value: float, floor: float) -> str:
    return f"{value:.3f} ({floor:.3f})"


def _drop(result: ClassifierResult, k: int) -> str:
    score = result.speeds[k]
    return f"{score.worst_drop_points:.1f} at {score.worst_drop_percent} %"


def _area(result: ClassifierResult) -> str:
    if result.unknown is None or result.unknown.auroc_at_60 is None:
        return "says nothing"
    return f"{result.unknown.auroc_at_60:.3f}"


def _refused(result: ClassifierResult) -> str:
    if result.unknown is None or not result.unknown.says_something:
        return "says nothing"
    return f"{100 * result.unknown.refused_unknown[5]:.1f} ({100 * result.unknown.refused_known[5]:.1f}) %"
