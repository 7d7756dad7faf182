"""`humanpred evaluate recognition`: from options to table, JSON and plot."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from humanpred_ros.errors import UsageError
from humanpred_ros.experiments.evaluation_files import check_writable, machine_facts, replacing, write_json
from humanpred_ros.experiments.parallel import usable_cores
from humanpred_ros.experiments.recognition.classifiers import EVALUATED, ClassifierConfig
from humanpred_ros.experiments.recognition.evaluation import EvaluationConfig, evaluate_classifier, n_tasks
from humanpred_ros.experiments.recognition.reference import (
    ReferenceCurve,
    advice_beside,
    read_reference,
    reference_beside,
)
from humanpred_ros.experiments.recognition.result import ClassifierResult, RecognitionEvaluation
from humanpred_ros.experiments.recognition.runs import ClassifierChoice, check_evaluable
from humanpred_ros.experiments.recognition.tables import print_evaluation
from humanpred_ros.motion.csv_library import DEFAULT_FRAME_PERIOD_S
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.resources import locate
from humanpred_ros.viewing.plots_recognition import RecognitionCurves, save_recognition_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate recognition`."""
    parser.add_argument("--library", required=True, help="bag, CSV folder, or the name of a shipped one")
    parser.add_argument(
        "--classifier", default="all", metavar="NAME", help=f"all, or some of {', '.join(EVALUATED)} (commas between)"
    )
    parser.add_argument("--json", metavar="FILE", help="write every figure to FILE")
    parser.add_argument("--plot", metavar="FILE", help="draw recognition rate, reliability and unknown motions (.png)")
    parser.add_argument(
        "--reference",
        metavar="CSV",
        help="published curve to compare with (phase_percent,recognition_rate), or none; "
        "default: reference/authors_fig6_curve.csv beside the library, if it is there",
    )
    parser.add_argument("--jobs", type=int, default=usable_cores(), help="processes; default: one for each core")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speeds", default="0.7,1,1.4", help="play the motions so many times as fast, too")
    parser.add_argument("--no-unknown", action="store_true", help="do not leave out whole classes")
    parser.add_argument(
        "--frame-period",
        type=float,
        default=DEFAULT_FRAME_PERIOD_S,
        metavar="S",
        help="seconds between frames where a CSV has no times",
    )
    gmm = parser.add_argument_group("settings of the classifier gmm")
    gmm.add_argument("--components", type=int, default=GmmConfig.n_components, help="Gaussians per class")
    gmm.add_argument("--no-phase", action="store_true", help="leave the phase out of the features")
    gmm.add_argument("--evidence", default=GmmConfig.evidence, help="sum or mean of the postures' log densities")
    gmm.add_argument("--window-frames", type=int, default=0, help="count only so many last postures; 0 counts all")


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, or files that cannot be read or written.
    """
    json_path = check_writable(options.json) if options.json else None
    plot_path = check_writable(options.plot, ".png") if options.plot else None
    choices = _choices(options)
    config = EvaluationConfig(_speeds(options.speeds), not options.no_unknown, options.seed, options.jobs)
    path = locate(options.library, "bags")
    library = load_library(path, frame_period_s=options.frame_period)
    check_evaluable(library, config.with_unknown)
    reference = _reference(options.reference, path)
    advice = advice_beside(path, library.name)
    evaluation = RecognitionEvaluation(
        library=_library_facts(library),
        labels=library.labels,
        settings={
            "seed": config.seed,
            "jobs": config.jobs,
            "speeds": (1.0, *config.further_speeds),
            "unknown_motions": config.with_unknown,
        },
        machine=machine_facts(),
        reference=reference,
        classifiers=tuple(_evaluate(choices, library, config, reference, advice, console)),
    )
    print_evaluation(evaluation, console)
    if json_path is not None:
        write_json(json_path, evaluation.to_json())
        console.print(f"figures  {json_path}", markup=False, highlight=False, soft_wrap=True)
    if plot_path is not None:
        _save_plot(evaluation, plot_path)
        console.print(f"plot     {plot_path}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _evaluate(
    choices: list[ClassifierChoice],
    library: MotionLibrary,
    config: EvaluationConfig,
    reference: ReferenceCurve | None,
    advice: Mapping[str, str],
    console: Console,
) -> list[ClassifierResult]:
    results = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        for choice in choices:
            line = bar.add_task(choice.name, total=n_tasks(library, config))
            results.append(
                evaluate_classifier(
                    choice,
                    library,
                    config,
                    reference=reference,
                    advice=advice,
                    progress=lambda done, line=line: bar.update(line, completed=done),  # type: ignore[misc]
                )
            )
    return results


def _choices(options: argparse.Namespace) -> list[ClassifierChoice]:
    gmm = GmmConfig(
        n_components=options.components,
        phase_feature=not options.no_phase,
        evidence=options.evidence,
        window_frames=options.window_frames or None,
        seed=options.seed,
    )
    names = list(EVALUATED) if options.classifier == "all" else options.classifier.split(",")
    configs: dict[str, ClassifierConfig] = {"forest": ForestConfig(seed=options.seed), "gmm": gmm}
    choices = [ClassifierChoice(name, configs.get(name)) for name in dict.fromkeys(map(str.strip, names))]
    for choice in choices:
        choice.make()
    return choices


def _speeds(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"speeds: wanted numbers with commas between, as in 0.7,1,1.4, got {text!r}") from None


def _reference(option: str | None, library: Path) -> ReferenceCurve | None:
    if option == "none":
        return None
    return read_reference(option) if option else reference_beside(library)


def _library_facts(library: MotionLibrary) -> dict[str, Any]:
    return {
        "name": library.name,
        "n_motions": len(library),
        "motions_per_class": {label: len(library.of_class(label)) for label in library.labels},
        "provenance": dict(library.provenance),
    }


def _save_plot(evaluation: RecognitionEvaluation, path: Path) -> None:
    curves = [
        RecognitionCurves(
            name=result.name,
            rate=result.rate,
            first_percent=result.figures.first_50_percent,
            confidence=result.calibration.confidence,
            right=result.calibration.right,
            count=result.calibration.count,
            error=result.calibration.error_pooled,
            unknown_of_known=result.unknown_quartiles if result.unknown and result.unknown.says_something else None,
            unknown_of_unknown=(result.unknown.quartiles if result.unknown and result.unknown.says_something else None),
        )
        for result in evaluation.classifiers
    ]
    reference = evaluation.reference
    with replacing(path) as temporary:
        if reference is None:
            save_recognition_plot(temporary, curves)
        else:
            save_recognition_plot(temporary, curves, reference.rate, reference.figures.first_50_percent)
