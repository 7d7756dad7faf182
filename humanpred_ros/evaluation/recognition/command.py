"""`humanpred evaluate recognition`: from options to table, JSON and plot."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.options import (
    Outputs,
    add_jobs,
    add_library,
    add_outputs,
    names_in,
    progress_lines,
    read_library,
)
from humanpred_ros.evaluation.outputs import library_facts, machine_facts
from humanpred_ros.evaluation.recognition.classifiers import EVALUATED, ClassifierConfig
from humanpred_ros.evaluation.recognition.evaluation import EvaluationConfig, evaluate_classifier, n_tasks
from humanpred_ros.evaluation.recognition.reference import (
    ReferenceCurve,
    advice_beside,
    read_reference,
    reference_beside,
)
from humanpred_ros.evaluation.recognition.result import ClassifierResult, RecognitionEvaluation
from humanpred_ros.evaluation.recognition.runs import ClassifierChoice, check_evaluable, unknown_left_out
from humanpred_ros.evaluation.recognition.tables import print_evaluation
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.viewing.plots_recognition import RecognitionCurves, save_recognition_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate recognition`."""
    add_library(parser)
    parser.add_argument(
        "--classifier", default="all", metavar="NAME", help=f"all, or some of {', '.join(EVALUATED)} (commas between)"
    )
    add_outputs(parser, plot="draw recognition rate, reliability and unknown motions (.png)")
    parser.add_argument(
        "--reference",
        metavar="CSV",
        help="published curve to compare with (phase_percent,recognition_rate), or none; "
        "default: reference/authors_fig6_curve.csv beside the library, if it is there",
    )
    add_jobs(parser)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speeds", default="0.7,1,1.4", help="play the motions so many times as fast, too")
    parser.add_argument("--no-unknown", action="store_true", help="do not leave out whole classes")
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
    outputs = Outputs.of(options)
    choices = _choices(options)
    config = EvaluationConfig(_speeds(options.speeds), not options.no_unknown, options.seed, options.jobs)
    path, library = read_library(options)
    check_evaluable(library, [choice.name for choice in choices])
    reference = _reference(options.reference, path)
    advice = advice_beside(path, library.name)
    evaluation = RecognitionEvaluation(
        library=library_facts(library, by_class=True),
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
        unknown_left_out=unknown_left_out(library) if config.with_unknown else None,
    )
    print_evaluation(evaluation, console)
    outputs.write(console, evaluation.to_json(), lambda path: _save_plot(evaluation, path))
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
    with progress_lines(console) as begin:
        for choice in choices:
            progress = begin(choice.name, n_tasks(library, config))
            results.append(
                evaluate_classifier(choice, library, config, reference=reference, advice=advice, progress=progress)
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
    configs: dict[str, ClassifierConfig] = {"forest": ForestConfig(seed=options.seed), "gmm": gmm}
    choices = [ClassifierChoice(name, configs.get(name)) for name in names_in(options.classifier, EVALUATED) or ("",)]
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
    if reference is None:
        save_recognition_plot(path, curves)
    else:
        save_recognition_plot(path, curves, reference.rate, reference.figures.first_50_percent)
