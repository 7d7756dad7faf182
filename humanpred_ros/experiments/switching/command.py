"""`humanpred evaluate switching`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from humanpred_ros.experiments.evaluation_files import check_writable, replacing, write_json
from humanpred_ros.experiments.interference.world import RunSettings
from humanpred_ros.experiments.parallel import usable_cores
from humanpred_ros.experiments.switching.evaluation import SwitchingConfig, evaluate_switching, tasks_of
from humanpred_ros.experiments.switching.measures import steps_earlier
from humanpred_ros.experiments.switching.reference import fig9_beside
from humanpred_ros.experiments.switching.result import CURRENT, SwitchingEvaluation
from humanpred_ros.experiments.switching.runs import VARIANTS
from humanpred_ros.experiments.switching.tables import print_switching
from humanpred_ros.motion.csv_library import DEFAULT_FRAME_PERIOD_S
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.resources import locate
from humanpred_ros.viewing.plots_switching import CandidateCosts, StepsEarlier, save_switching_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate switching`."""
    default = SwitchingConfig()
    parser.add_argument("--library", required=True, help="bag, CSV folder, or the name of a shipped one")
    parser.add_argument("--json", metavar="FILE", help="write every figure to FILE, one object for every motion")
    parser.add_argument("--plot", metavar="FILE", help="draw costs beside the published, and steps gained (.png)")
    parser.add_argument("--scene", default=default.scene, help="with two goals or more")
    parser.add_argument(
        "--trajectory", default=default.figure_motion, metavar="MOTION", help="of Fig. 9; empty leaves it out"
    )
    parser.add_argument("--seeds", type=int, default=default.figure_seeds, metavar="N", help="runs of Fig. 9")
    parser.add_argument(
        "--motions", type=int, metavar="N", help="show only the first N motions of every class; 0 none; default: all"
    )
    parser.add_argument(
        "--hold-out",
        type=int,
        default=default.runs.hold_out,
        metavar="N",
        help="motions of every class that are held out together; 5 first ones in P1",
    )
    parser.add_argument("--jobs", type=int, default=usable_cores(), help="processes; default: one for each core")
    parser.add_argument("--seed", type=int, default=0, help="of training")
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
    config = SwitchingConfig(
        scene=options.scene,
        figure_motion=options.trajectory,
        figure_seeds=options.seeds,
        motions=options.motions,
        runs=RunSettings(gmm=GmmConfig(n_components=options.components, seed=options.seed), hold_out=options.hold_out),
    )
    source = locate(options.library, "bags")
    library = load_library(source, frame_period_s=options.frame_period)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        line = bar.add_task("motions", total=len(tasks_of(library, config)))
        evaluation = evaluate_switching(
            library,
            config,
            published=fig9_beside(Path(source)),
            jobs=options.jobs,
            progress=lambda done: bar.update(line, completed=done),
        )
    print_switching(evaluation, console)
    if json_path is not None:
        write_json(json_path, evaluation.to_json())
        console.print(f"figures  {json_path}", markup=False, highlight=False, soft_wrap=True)
    if plot_path is not None:
        _save_plot(evaluation, plot_path)
        console.print(f"plot     {plot_path}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _save_plot(evaluation: SwitchingEvaluation, path: Path) -> None:
    panels = []
    published, figure = evaluation.published, evaluation.figure
    if figure is not None:
        for variant in VARIANTS:
            run = figure.run(variant)
            costs = np.array([[step.costs[goal] for goal in evaluation.goals] for step in run.steps])
            panels.append(CandidateCosts(f"{variant}, here", evaluation.goals, costs, run.figures.first_switch))
    if figure is not None and published is not None:
        for name, costs in (("prediction", published.prediction), ("current", published.current)):
            panels.append(CandidateCosts(f"{name}, published", published.goals, costs, published.switch(costs)))
    shown = [p for p in evaluation.persons if p.conflict and p.motion in evaluation.settings["shown_motions"]]
    n_steps = evaluation.settings["runs"]["steps"]
    gained = [
        StepsEarlier(
            variant,
            [steps_earlier(person.run(variant).figures, person.run(CURRENT).figures, n_steps) for person in shown],
        )
        for variant in VARIANTS
        if variant != CURRENT
    ]
    with replacing(path) as temporary:
        save_switching_plot(temporary, panels, gained)
