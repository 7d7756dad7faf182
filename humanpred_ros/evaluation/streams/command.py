"""`humanpred evaluate streams`: from options to tables and JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import asdict

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.evaluation.options import Outputs, add_jobs, add_library, add_outputs, progress_lines, read_library
from humanpred_ros.evaluation.outputs import library_facts, machine_facts
from humanpred_ros.evaluation.published import advice_beside
from humanpred_ros.evaluation.recognition_runs import EVALUATED
from humanpred_ros.evaluation.standing import StandingConfig
from humanpred_ros.evaluation.streams.composed import StreamConfig
from humanpred_ros.evaluation.streams.evaluation import (
    RecognitionResult,
    StreamEvaluation,
    StreamEvaluationConfig,
    VariantResult,
    check_rounds,
    evaluate_streams,
)
from humanpred_ros.evaluation.streams.scores import OnsetFigures
from humanpred_ros.evaluation.streams.truth import TruthConfig
from humanpred_ros.evaluation.text import headline
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.onset import OnsetConfig

#: Advice (in the file beside a library) that says a motion is mistracked, or may be.
_FLAGS = ("exclude", "suspect")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate streams`."""
    default = StreamEvaluationConfig()
    add_library(parser)
    parser.add_argument(
        "--classifier",
        default=DEFAULT_CLASSIFIER,
        metavar="NAME",
        help=f"one of {', '.join(EVALUATED)}; none: onsets and ends only",
    )
    add_outputs(parser)
    add_jobs(parser)
    parser.add_argument("--seed", type=int, default=default.seed, help="of the order, the pauses and the noise")
    parser.add_argument(
        "--standing",
        type=float,
        default=default.standing_s / 60.0,
        metavar="MIN",
        help="minutes of mere standing to count false starts in",
    )


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, or a file that cannot be written.
    """
    outputs = Outputs.of(options)
    config = StreamEvaluationConfig(
        classifier=None if options.classifier == "none" else options.classifier,
        seed=options.seed,
        standing_s=60.0 * options.standing,
        jobs=options.jobs,
    )
    path, library = read_library(options)
    flagged = frozenset(name for name, advice in advice_beside(path, library.name).items() if advice in _FLAGS)
    with progress_lines(console) as begin:
        progress = begin("rounds", len(check_rounds(library)))
        evaluation = evaluate_streams(library, config, flagged=flagged, progress=progress)
    _print(evaluation, library.name, config, console)
    settings = {
        "evaluation": config,
        "onset": OnsetConfig(),
        "standing": StandingConfig(),
        "truth": TruthConfig(),
        "streams": StreamConfig(),
    }
    facts = {"library": library_facts(library), "settings": settings, "machine": machine_facts()}
    outputs.write(console, {**facts, "flagged": sorted(flagged), **evaluation.to_json()})
    return 0


def _print(evaluation: StreamEvaluation, library: str, config: StreamEvaluationConfig, console: Console) -> None:
    recorded = evaluation.variants[0]
    tolerance = f"{config.tolerance_s:g} s"
    headline(console, f"{library}: motions in streams with pauses, {recorded.streams_s / 60:.0f} min; as recorded")
    groups = {name: figures for name, figures in recorded.groups.items() if figures is not None}
    if recorded.made is not None:
        groups["returns (made)"] = recorded.made
    console.print(_table(groups, tolerance))
    headline(
        console,
        "streams that differ from the recordings; false starts: recorded rest, after motions, in pauses; standing",
    )
    console.print(_variants_table(evaluation.variants, tolerance))
    if evaluation.recognition is not None:
        headline(console, f"{config.classifier}: share recognised at percent of the motion, in the stream / alone")
        console.print(_recognition_table(evaluation.recognition))
    median, top = evaluation.detector_us
    console.print(f"one posture: detection {median:.0f} µs (99 % below {top:.0f})", highlight=False, end="")
    if evaluation.stream_us is not None and evaluation.most_us is not None:
        median, top = evaluation.stream_us
        most = evaluation.most_us / 1000
        text = f"; with {config.classifier} {median:.0f} µs (99 % below {top:.0f}, longest {most:.1f} ms)"
        console.print(escape(text), highlight=False, end="")
    console.print(f"; this evaluation {evaluation.wall_s:.0f} s", highlight=False)


def _table(groups: dict[str, OnsetFigures], tolerance: str) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column()
    for name in groups:
        table.add_column(escape(name), justify="right")
    rows = [_rows(figures, tolerance) for figures in groups.values()]
    for cells in zip(*rows, strict=True):
        table.add_row(cells[0][0], *(cell for _, cell in cells))
    return table


def _rows(figures: OnsetFigures, tolerance: str) -> Iterator[tuple[str, str]]:
    yield "motions", str(figures.n_motions)
    yield f"onsets announced within {tolerance}", f"{100 * figures.in_time:.1f} %"
    yield "onsets missed", str(figures.missed)
    yield "  announced late by, median (95 %)", _seconds(figures.onset_delay_s)
    yield "  estimated onset off by, 5 %, median, 95 %", _seconds(figures.onset_error_s)
    yield "ends announced before the next motion", f"{100 * figures.ends_found:.1f} %"
    yield "  announced late by, median (95 %)", _seconds(figures.end_delay_s)
    yield "  estimated end off by, 5 %, median, 95 %", _seconds(figures.end_error_s)
    yield "onsets announced again during the motion", str(figures.split)


def _seconds(values: tuple[float, ...]) -> str:
    signed = [f"{value:+.2f}" for value in values]
    return f"{signed[0]} ({signed[1]}) s" if len(values) == 2 else f"{' '.join(signed)} s"


def _variants_table(variants: tuple[VariantResult, ...], tolerance: str) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("", f"within {tolerance}", "(odd rounds)", "missed", "late by (95 %)", "rest, after, pause",
                 "standing, per 10 min", "(odd rounds)"):  # fmt: skip
        table.add_column(name, justify="right" if name else "left")
    for variant in variants:
        everything, odd = variant.groups["all"], variant.groups["odd rounds"]
        if everything is None:
            continue
        table.add_row(
            escape(variant.name),
            f"{100 * everything.in_time:.1f} %",
            "" if odd is None else f"{100 * odd.in_time:.1f} %",
            str(everything.missed),
            _seconds(everything.onset_delay_s),
            "{} {} {}".format(*asdict(variant.false_starts).values()),
            f"{variant.per_ten_minutes():.2f}",
            f"{variant.per_ten_minutes('odd rounds'):.2f}" if variant.standing_s["odd rounds"] else "",
        )
    return table


def _recognition_table(result: RecognitionResult) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column()
    for percent in result.percents:
        table.add_column(f"{percent} %", justify="right")
    for group, n in result.n_motions.items():
        cells = [f"{a:.3f} / {b:.3f}" for a, b in zip(result.in_stream[group], result.alone[group], strict=True)]
        table.add_row(f"{escape(group)} (n = {n})", *cells)
    return table
