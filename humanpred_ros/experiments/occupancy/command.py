"""`humanpred evaluate occupancy`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from humanpred_ros.errors import UsageError
from humanpred_ros.experiments.evaluation_files import check_writable, replacing, write_json
from humanpred_ros.experiments.occupancy.evaluation import (
    OccupancyEvaluationConfig,
    evaluate_occupancy,
    tested_motions,
)
from humanpred_ros.experiments.occupancy.result import OccupancyEvaluation
from humanpred_ros.experiments.occupancy.tables import print_occupancy_evaluation
from humanpred_ros.experiments.parallel import usable_cores
from humanpred_ros.motion.csv_library import DEFAULT_FRAME_PERIOD_S
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.predictors.factory import PREDICTORS
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.recognition.registry import CLASSIFIERS
from humanpred_ros.resources import locate
from humanpred_ros.viewing.plots_occupancy import Moment, OccupancyCurves, save_occupancy_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate occupancy`."""
    default = OccupancyEvaluationConfig()
    parser.add_argument("--library", required=True, help="bag, CSV folder, or the name of a shipped one")
    parser.add_argument(
        "--predictor",
        default="all",
        metavar="NAME",
        help=f"all, or some of {', '.join(PREDICTORS)} (commas between)",
    )
    parser.add_argument("--classifier", default=default.classifier, help=f"one of {', '.join(CLASSIFIERS)}")
    parser.add_argument("--json", metavar="FILE", help="write every figure to FILE")
    parser.add_argument("--plot", metavar="FILE", help="draw errors, calibration and one moment from above (.png)")
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
    parser.add_argument("--jobs", type=int, default=usable_cores(), help="processes; default: one for each core")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--frame-period",
        type=float,
        default=DEFAULT_FRAME_PERIOD_S,
        metavar="S",
        help="seconds between frames where a CSV has no times",
    )
    gmm = parser.add_argument_group("settings of the classifier gmm and of P1's expected motions")
    gmm.add_argument("--components", type=int, default=GmmConfig.n_components, help="Gaussians per class")
    gmm.add_argument("--evidence", default=GmmConfig.evidence, help="sum or mean of the postures' log densities")


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, or files that cannot be read or written.
    """
    json_path = check_writable(options.json) if options.json else None
    plot_path = check_writable(options.plot, ".png") if options.plot else None
    config = _config(options)
    library = load_library(locate(options.library, "bags"), frame_period_s=options.frame_period)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        line = bar.add_task("motions", total=len(tested_motions(library, config)))
        evaluation = evaluate_occupancy(
            library, config, jobs=options.jobs, progress=lambda done: bar.update(line, completed=done)
        )
    print_occupancy_evaluation(evaluation, console)
    if json_path is not None:
        write_json(json_path, evaluation.to_json())
        console.print(f"figures  {json_path}", markup=False, highlight=False, soft_wrap=True)
    if plot_path is not None:
        _save_plot(evaluation, plot_path)
        console.print(f"plot     {plot_path}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _config(options: argparse.Namespace) -> OccupancyEvaluationConfig:
    names = list(PREDICTORS) if options.predictor == "all" else options.predictor.split(",")
    dx, dy, turn_deg = _shift(options.shift)
    return OccupancyEvaluationConfig(
        predictors=tuple(dict.fromkeys(name.strip() for name in names)),
        classifier=options.classifier,
        gmm=GmmConfig(n_components=options.components, evidence=options.evidence, seed=options.seed),
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
    with replacing(path) as temporary:
        save_occupancy_plot(temporary, evaluation.percents, curves, moment)
