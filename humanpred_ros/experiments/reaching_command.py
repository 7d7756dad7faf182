"""`humanpred evaluate reaching`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from humanpred_ros.experiments.evaluation_files import check_writable, replacing, write_json
from humanpred_ros.experiments.reaching_evaluation import ITSELF, ReachingConfig, evaluate_reaching, steps_of
from humanpred_ros.experiments.reaching_predictors import REACHING_PREDICTORS
from humanpred_ros.experiments.reaching_result import ReachingEvaluation
from humanpred_ros.experiments.reaching_tables import print_reaching
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.viewing.plots_reaching import DistanceBar, WristPaths, save_reaching_plot

#: Where the papers' data folder keeps the interference case, relative to the folder of the demonstrations.
INTERFERENCE_BESIDE_DEMOS = "interference_case"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate reaching`."""
    default = ReachingConfig()
    parser.add_argument(
        "--demos", required=True, metavar="DIR", help="folder of <name>_active.csv and <name>_passive.csv"
    )
    parser.add_argument(
        "--interference",
        metavar="DIR",
        help=f"the same of reaches that the partner is in the way of; default: {INTERFERENCE_BESIDE_DEMOS} beside DIR, "
        "if it is there; none to leave it out",
    )
    parser.add_argument(
        "--predictor",
        default="all",
        metavar="NAME",
        help=f"all, or some of {', '.join(REACHING_PREDICTORS)} (commas between)",
    )
    parser.add_argument("--runs", type=int, default=default.runs, help="of each recording, where chance plays a part")
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--json", metavar="FILE", help="write every figure to FILE")
    parser.add_argument("--plot", metavar="FILE", help="draw predicted and real wrist paths and the comparison (.png)")


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, unusable recordings, or files that cannot be written.
    """
    json_path = check_writable(options.json) if options.json else None
    plot_path = check_writable(options.plot, ".png") if options.plot else None
    names = tuple(dict.fromkeys(name.strip() for name in options.predictor.split(",") if name.strip()))
    config = ReachingConfig(
        predictors=tuple(REACHING_PREDICTORS) if names == ("all",) else names, runs=options.runs, seed=options.seed
    )
    model = HumanModel.mocap23()
    recordings = load_reach_recordings(options.demos, model)
    folder = _interference(options.demos, options.interference)
    interference = load_reach_recordings(folder, model) if folder is not None else ()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        line = bar.add_task("predicted recordings", total=steps_of(len(recordings) + len(interference), config))
        evaluation = evaluate_reaching(
            recordings,
            interference,
            config,
            model=model,
            progress=lambda done: bar.update(line, completed=done),
        )
    print_reaching(evaluation, console)
    if json_path is not None:
        write_json(json_path, evaluation.to_json())
        console.print(f"figures  {json_path}", markup=False, highlight=False, soft_wrap=True)
    if plot_path is not None:
        _save_plot(evaluation, plot_path)
        console.print(f"plot     {plot_path}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _interference(demos: str, given: str | None) -> Path | None:
    if given is not None:
        return None if given == "none" else Path(given)
    beside = Path(demos).resolve().parent / INTERFERENCE_BESIDE_DEMOS
    return beside if beside.is_dir() else None


def _save_plot(evaluation: ReachingEvaluation, path: Path) -> None:
    paths = []
    for entry in evaluation.sets:
        for k, name in enumerate(entry.names):
            predicted = {f.name: f.recordings[k].wrist_m for f in entry.predictors if f.name != ITSELF}
            paths.append(WristPaths(name, entry.wrist_m[k], predicted))
    demos = evaluation.sets[0]
    bars = [DistanceBar(f"P2: {row.what}", (row.joint_m, row.task_as_coded_m, np.nan), True) for row in demos.published]
    bars += [DistanceBar(figures.name, figures.average.means, False) for figures in demos.predictors]
    with replacing(path) as temporary:
        save_reaching_plot(temporary, paths, bars)
