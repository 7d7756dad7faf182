"""`humanpred evaluate interference`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from humanpred_ros.experiments.evaluation_files import check_writable, replacing, write_json
from humanpred_ros.experiments.interference.evaluation import InterferenceConfig, evaluate_interference, tasks_of
from humanpred_ros.experiments.interference.reference import table1_beside
from humanpred_ros.experiments.interference.result import InterferenceEvaluation
from humanpred_ros.experiments.interference.runs import METHODS
from humanpred_ros.experiments.interference.tables import print_interference
from humanpred_ros.experiments.interference.world import RunSettings
from humanpred_ros.experiments.parallel import usable_cores
from humanpred_ros.motion.csv_library import DEFAULT_FRAME_PERIOD_S
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.resources import locate
from humanpred_ros.viewing.plots_interference import CostBars, MethodDots, save_interference_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate interference`."""
    default = InterferenceConfig()
    parser.add_argument("--library", required=True, help="bag, CSV folder, or the name of a shipped one")
    parser.add_argument("--json", metavar="FILE", help="write every figure to FILE, one object for every run")
    parser.add_argument("--plot", metavar="FILE", help="draw costs beside the published, distances and times (.png)")
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
    parser.add_argument(
        "--hold-out",
        type=int,
        default=default.runs.hold_out,
        metavar="N",
        help="motions of every class that are held out together; 5 first ones in P1",
    )
    parser.add_argument("--jobs", type=int, default=usable_cores(), help="processes; default: one for each core")
    parser.add_argument("--seed", type=int, default=0, help="of training; runs have the seeds 0, 1, ...")
    parser.add_argument("--components", type=int, default=GmmConfig.n_components, help="gmm: Gaussians per class")
    parser.add_argument(
        "--frame-period",
        type=float,
        default=DEFAULT_FRAME_PERIOD_S,
        metavar="S",
        help="seconds between frames where a CSV has no times",
    )


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, or files that cannot be read or written.
    """
    json_path = check_writable(options.json) if options.json else None
    plot_path = check_writable(options.plot, ".png") if options.plot else None
    config = _config(options)
    source = locate(options.library, "bags")
    library = load_library(source, frame_period_s=options.frame_period)
    tasks = tasks_of(library, config)
    n_runs = sum(len(task.runs) for task in tasks)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        line = bar.add_task(f"{n_runs} runs beside persons", total=len(tasks))
        evaluation = evaluate_interference(
            library,
            config,
            published=table1_beside(Path(source)),
            jobs=options.jobs,
            progress=lambda done: bar.update(line, completed=done),
        )
    print_interference(evaluation, console)
    if json_path is not None:
        write_json(json_path, evaluation.to_json())
        console.print(f"figures  {json_path}", markup=False, highlight=False, soft_wrap=True)
    if plot_path is not None:
        _save_plot(evaluation, plot_path)
        console.print(f"plot     {plot_path}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _config(options: argparse.Namespace) -> InterferenceConfig:
    return InterferenceConfig(
        table_motions=_names(options.table_motions),
        table_runs=options.table_runs,
        methods=tuple(METHODS) if options.methods == "all" else _names(options.methods),
        scenes=_names(options.scenes),
        motions=options.motions,
        seeds=options.seeds,
        runs=RunSettings(gmm=GmmConfig(n_components=options.components, seed=options.seed), hold_out=options.hold_out),
    )


def _names(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))


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
    with replacing(path) as temporary:
        save_interference_plot(temporary, bars, dots)
