"""`humanpred evaluate occupancy`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from rich.console import Console

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.occupancy.evaluation import (
    OccupancyEvaluationConfig,
    evaluate_occupancy,
    tested_motions,
)
from humanpred_ros.evaluation.occupancy.result import OccupancyEvaluation
from humanpred_ros.evaluation.occupancy.tables import print_occupancy_evaluation
from humanpred_ros.evaluation.options import (
    Outputs,
    add_jobs,
    add_library,
    add_outputs,
    names_in,
    progress_lines,
    read_library,
)
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.viewing.plots_occupancy import Moment, OccupancyCurves, save_occupancy_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate occupancy`."""
    default = OccupancyEvaluationConfig()
    add_library(parser)
    parser.add_argument(
        "--predictor",
        default="all",
        metavar="NAME",
        help=f"all, or some of {', '.join(plugins.names(plugins.PREDICTORS))} (commas between)",
    )
    parser.add_argument(
        "--classifier", default=default.classifier, help=f"one of {', '.join(plugins.names(plugins.CLASSIFIERS))}"
    )
    add_outputs(parser, plot="draw errors, calibration and one moment from above (.png)")
    parser.add_argument(
        "--until",
        default=default.until,
        help="where a motion ends: end (of the recording), or apex (palm farthest from its start)",
    )
    parser.add_argument("--scene", help="take grid and human placement from a scene; default: a grid of P1's size "
                        "around the library")  # fmt: skip
    parser.add_argument(
        "--resolution", type=float, default=default.resolution_m, metavar="M", help="edge of that grid's voxels"
    )
    parser.add_argument(
        "--shift",
        default="0,0,0",
        metavar="DX,DY,YAW_DEG",
        help="let the tested people stand elsewhere: metres, and degrees about the library's start pelvis; what was "
        "learned stays where it was",
    )
    parser.add_argument("--every", type=int, default=1, metavar="K", help="test only every K-th motion")
    parser.add_argument(
        "--clean-training",
        action="store_true",
        help="learn nothing from motions that are plainly mistracked; they are tested all the same",
    )
    parser.add_argument("--picture", metavar="MOTION", help="motion to draw, class/index; default: the middle one")
    add_jobs(parser)
    parser.add_argument("--seed", type=int, default=0)
    gmm = parser.add_argument_group("settings of the classifier gmm and of P1's expected motions")
    gmm.add_argument("--components", type=int, default=GmmSettings().n_components, help="Gaussians per class")
    gmm.add_argument("--evidence", default=GmmSettings().evidence, help="sum or mean of the postures' log densities")


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, or files that cannot be read or written.
    """
    outputs = Outputs.of(options)
    config = _config(options)
    _, library = read_library(options)
    with progress_lines(console) as begin:
        progress = begin("motions", len(tested_motions(library, config)))
        evaluation = evaluate_occupancy(library, config, jobs=options.jobs, progress=progress)
    print_occupancy_evaluation(evaluation, console)
    outputs.write(console, evaluation.to_json(), lambda path: _save_plot(evaluation, path))
    return 0


def _config(options: argparse.Namespace) -> OccupancyEvaluationConfig:
    dx, dy, turn_deg = _shift(options.shift)
    return OccupancyEvaluationConfig(
        predictors=names_in(options.predictor, plugins.names(plugins.PREDICTORS)),
        classifier=options.classifier,
        gmm=GmmSettings(n_components=options.components, evidence=options.evidence, seed=options.seed),
        until=options.until,
        scene=options.scene,
        resolution_m=options.resolution,
        every=options.every,
        shift_m=(dx, dy),
        turn_rad=math.radians(turn_deg),
        clean_training=options.clean_training,
        picture=options.picture,
    )


def _shift(text: str) -> tuple[float, float, float]:
    try:
        dx, dy, turn_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"shift: wanted DX,DY,YAW_DEG in metres and degrees, as in 0.3,0,20, got {text!r}") from None
    return dx, dy, turn_deg


def _save_plot(evaluation: OccupancyEvaluation, path: Path) -> None:
    curves, moment = [], None
    for result in evaluation.predictors:
        table, picture = result.calibration, result.picture
        curves.append(
            OccupancyCurves(
                result.name,
                result.at_percent.squared_error,
                result.at_percent.missed,
                table.mean_probability[1:],
                table.observed[1:],
                table.count[1:],
                table.error_predicted,
                None if picture is None else picture.predicted,
            )
        )
        if picture is not None:
            grid = evaluation.settings["grid"]
            title = f"motion {evaluation.settings['picture']}, {picture.percent} % seen, from above:"
            moment = Moment(title, picture.swept, grid.origin_m, grid.resolution_m)
    save_occupancy_plot(path, evaluation.percents, curves, moment)
