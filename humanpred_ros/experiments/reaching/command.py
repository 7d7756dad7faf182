"""`humanpred evaluate reaching`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from humanpred_ros.errors import UsageError
from humanpred_ros.experiments.evaluation_files import check_writable, replacing, write_json
from humanpred_ros.experiments.parallel import usable_cores
from humanpred_ros.experiments.reaching.evaluation import ReachingConfig, evaluate_reaching, steps_of
from humanpred_ros.experiments.reaching.predictors import REACHING_PREDICTORS
from humanpred_ros.experiments.reaching.recovery import RecoveryConfig
from humanpred_ros.experiments.reaching.tables import print_reaching
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import load_reach_recordings

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
    parser.add_argument(
        "--runs", type=int, default=default.runs, metavar="N", help="of each recording, where chance plays a part"
    )
    parser.add_argument(
        "--samples",
        default=",".join(map(str, default.recovery.samples)),
        metavar="A,B",
        help="numbers of samples from which known weights are learned again (P2 Fig. 7; with the predictor learned "
        "only); none to leave that out",
    )
    parser.add_argument("--jobs", type=int, default=usable_cores(), help="processes; default: one for each core")
    parser.add_argument("--seed", type=int, default=default.seed)
    parser.add_argument("--json", metavar="FILE", help="write every figure to FILE")
    parser.add_argument(
        "--plot", metavar="FILE", help="draw predicted and real wrist paths, the comparison and the weights (.png)"
    )


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, unusable recordings, or files that cannot be written.
    """
    json_path = check_writable(options.json) if options.json else None
    plot_path = check_writable(options.plot, ".png") if options.plot else None
    config = _config(options)
    model = HumanModel.mocap23()
    recordings = load_reach_recordings(options.demos, model)
    folder = _interference(options.demos, options.interference)
    interference = load_reach_recordings(folder, model) if folder is not None else ()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        bar_line = bar.add_task("learned, then predicted", total=steps_of(recordings, interference, config))
        evaluation = evaluate_reaching(
            recordings,
            interference,
            config,
            model=model,
            progress=lambda done: bar.update(bar_line, completed=done),
        )
    print_reaching(evaluation, console)
    if json_path is not None:
        write_json(json_path, evaluation.to_json())
        console.print(f"figures  {json_path}", markup=False, highlight=False, soft_wrap=True)
    if plot_path is not None:
        from humanpred_ros.experiments.reaching.drawing import draw_reaching

        with replacing(plot_path) as temporary:
            draw_reaching(evaluation, temporary)
        console.print(f"plot     {plot_path}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _config(options: argparse.Namespace) -> ReachingConfig:
    names = tuple(dict.fromkeys(name.strip() for name in options.predictor.split(",") if name.strip()))
    return ReachingConfig(
        predictors=tuple(REACHING_PREDICTORS) if names == ("all",) else names,
        runs=options.runs,
        recovery=RecoveryConfig(samples=_numbers(options.samples)),
        seed=options.seed,
        jobs=options.jobs,
    )


def _numbers(text: str) -> tuple[int, ...]:
    if text.strip() == "none":
        return ()
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError as trouble:
        raise UsageError(f"--samples: wanted none, or whole numbers with commas between, got {text!r}") from trouble


def _interference(demos: str, given: str | None) -> Path | None:
    if given is not None:
        return None if given == "none" else Path(given)
    beside = Path(demos).resolve().parent / INTERFERENCE_BESIDE_DEMOS
    return beside if beside.is_dir() else None
