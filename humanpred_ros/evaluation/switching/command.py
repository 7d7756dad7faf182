"""`humanpred evaluate switching`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.console import Console

from humanpred_ros.evaluation.interference.world import RunSettings
from humanpred_ros.evaluation.options import (
    Outputs,
    add_hold_out,
    add_jobs,
    add_library,
    add_outputs,
    progress_lines,
    read_library,
)
from humanpred_ros.evaluation.switching.evaluation import SwitchingConfig, evaluate_switching, tasks_of
from humanpred_ros.evaluation.switching.measures import steps_earlier
from humanpred_ros.evaluation.switching.reference import fig9_beside
from humanpred_ros.evaluation.switching.result import CURRENT, SwitchingEvaluation
from humanpred_ros.evaluation.switching.runs import VARIANTS
from humanpred_ros.evaluation.switching.tables import print_switching
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.viewing.plots_switching import CandidateCosts, StepsEarlier, save_switching_plot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred evaluate switching`."""
    default = SwitchingConfig()
    add_library(parser)
    add_outputs(
        parser, each="one object for every motion", plot="draw costs beside the published, and steps gained (.png)"
    )
    parser.add_argument("--scene", default=default.scene, help="with two goals or more")
    parser.add_argument(
        "--trajectory", default=default.figure_motion, metavar="MOTION", help="of Fig. 9; empty leaves it out"
    )
    parser.add_argument("--seeds", type=int, default=default.figure_seeds, metavar="N", help="runs of Fig. 9")
    parser.add_argument(
        "--motions", type=int, metavar="N", help="show only the first N motions of every class; 0 none; default: all"
    )
    add_hold_out(parser, default.runs.hold_out)
    add_jobs(parser)
    parser.add_argument("--seed", type=int, default=0, help="of training")
    parser.add_argument("--components", type=int, default=GmmSettings().n_components, help="gmm: Gaussians per class")


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, or files that cannot be read or written.
    """
    outputs = Outputs.of(options)
    config = SwitchingConfig(
        scene=options.scene,
        figure_motion=options.trajectory,
        figure_seeds=options.seeds,
        motions=options.motions,
        runs=RunSettings(
            gmm=GmmSettings(n_components=options.components, seed=options.seed), hold_out=options.hold_out
        ),
    )
    source, library = read_library(options)
    with progress_lines(console) as begin:
        evaluation = evaluate_switching(
            library,
            config,
            published=fig9_beside(source),
            jobs=options.jobs,
            progress=begin("motions", len(tasks_of(library, config))),
        )
    print_switching(evaluation, console)
    outputs.write(console, evaluation.to_json(), lambda path: _save_plot(evaluation, path))
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
    save_switching_plot(path, panels, gained)
