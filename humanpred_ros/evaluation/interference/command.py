"""`humanpred evaluate interference`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from humanpred_ros.evaluation.interference.evaluation import InterferenceConfig, evaluate_interference, tasks_of
from humanpred_ros.evaluation.interference.reference import table1_beside
from humanpred_ros.evaluation.interference.result import InterferenceEvaluation
from humanpred_ros.evaluation.interference.runs import METHODS
from humanpred_ros.evaluation.interference.tables import print_interference
from humanpred_ros.evaluation.interference.world import RunSettings
from humanpred_ros.evaluation.options import (
    Outputs,
    add_hold_out,
    add_jobs,
    add_library,
    add_outputs,
    names_in,
    progress_lines,
    read_library,
)
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.viewing.plots_interference import CostBars, MethodDots, save_interference_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate interference`."""
    default = InterferenceConfig()
    add_library(parser)
    add_outputs(
        parser, each="one object for every run", plot="draw costs beside the published, distances and times (.png)"
    )
    parser.add_argument(
        "--table-motions",
        default=",".join(default.table_motions),
        metavar="A,B",
        help="human trajectories of Table I, class/index or running number",
    )
    parser.add_argument(
        "--table-runs", type=int, default=default.table_runs, metavar="N", help="of each; 0 leaves Table I out"
    )
    parser.add_argument("--scenes", default=",".join(default.scenes), metavar="A,B", help="of the comparison")
    parser.add_argument(
        "--motions",
        type=int,
        default=default.motions,
        metavar="N",
        help="first motions of every class in the comparison, each never learned from; 0 leaves it out",
    )
    parser.add_argument("--seeds", type=int, default=default.seeds, metavar="N", help="runs of each of these")
    parser.add_argument(
        "--methods", default="all", metavar="A,B", help=f"of the comparison: all, or some of {', '.join(METHODS)}"
    )
    add_hold_out(parser, default.runs.hold_out)
    add_jobs(parser)
    parser.add_argument("--seed", type=int, default=0, help="of training; runs have the seeds 0, 1, ...")
    parser.add_argument("--components", type=int, default=GmmSettings().n_components, help="gmm: Gaussians per class")


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, or files that cannot be read or written.
    """
    outputs = Outputs.of(options)
    config = _config(options)
    source, library = read_library(options)
    tasks = tasks_of(library, config)
    n_runs = sum(len(task.runs) for task in tasks)
    with progress_lines(console) as begin:
        evaluation = evaluate_interference(
            library,
            config,
            published=table1_beside(source),
            jobs=options.jobs,
            progress=begin(f"{n_runs} runs beside persons", len(tasks)),
        )
    print_interference(evaluation, console)
    outputs.write(console, evaluation.to_json(), lambda path: _save_plot(evaluation, path))
    return 0


def _config(options: argparse.Namespace) -> InterferenceConfig:
    return InterferenceConfig(
        table_motions=names_in(options.table_motions),
        table_runs=options.table_runs,
        methods=names_in(options.methods, METHODS),
        scenes=names_in(options.scenes),
        motions=options.motions,
        seeds=options.seeds,
        runs=RunSettings(
            gmm=GmmSettings(n_components=options.components, seed=options.seed), hold_out=options.hold_out
        ),
    )


def _save_plot(evaluation: InterferenceEvaluation, path: Path) -> None:
    bars = [
        CostBars(
            str(row.number),
            {name: (f.cost_mean, f.cost_sd) for name, f in row.methods.items()},
            None
            if row.published is None
            else {
                "ours": (row.published.ours_mean, row.published.ours_sd),
                "basic": (row.published.basic_mean, row.published.basic_sd),
            },
        )
        for row in evaluation.table1
    ]
    settings = evaluation.settings
    dots = []
    for figures in evaluation.comparison[0].methods if evaluation.comparison else ():
        mine = [
            run
            for run in evaluation.runs
            if run.method == figures.method
            and run.seed < settings["seeds"]
            and run.scene in settings["scenes"]
            and run.motion in settings["compared_motions"]
        ]
        dots.append(MethodDots(figures.method, [r.least_distance_m for r in mine], [r.time_to_goal_s for r in mine]))
    save_interference_plot(path, bars, dots)
