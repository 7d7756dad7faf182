"""`humanpred evaluate reaching`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.console import Console

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.options import Outputs, add_jobs, add_outputs, names_in, progress_lines
from humanpred_ros.evaluation.reaching.evaluation import ReachingConfig, evaluate_reaching, steps_of
from humanpred_ros.evaluation.reaching.evaluation_result import ReachingEvaluation
from humanpred_ros.evaluation.reaching.predictors import REACHING_PREDICTORS
from humanpred_ros.evaluation.reaching.recovery import RecoveryConfig
from humanpred_ros.evaluation.reaching.tables import print_reaching
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
    add_jobs(parser)
    parser.add_argument("--seed", type=int, default=default.seed)
    add_outputs(parser, plot="draw predicted and real wrist paths, the comparison and the weights (.png)")


def run(options: argparse.Namespace, console: Console) -> int:
    """Evaluate, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, unusable recordings, or files that cannot be written.
    """
    outputs = Outputs.of(options)
    config = _config(options)
    model = HumanModel.mocap23()
    recordings = load_reach_recordings(options.demos, model)
    folder = _interference(options.demos, options.interference)
    interference = load_reach_recordings(folder, model) if folder is not None else ()
    with progress_lines(console) as begin:
        progress = begin("learned, then predicted", steps_of(recordings, interference, config))
        evaluation = evaluate_reaching(recordings, interference, config, model=model, progress=progress)
    print_reaching(evaluation, console)
    outputs.write(console, evaluation.to_json(), lambda path: _save_plot(evaluation, path))
    return 0


def _config(options: argparse.Namespace) -> ReachingConfig:
    return ReachingConfig(
        predictors=names_in(options.predictor, REACHING_PREDICTORS),
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


def _save_plot(evaluation: ReachingEvaluation, path: Path) -> None:
    from humanpred_ros.evaluation.reaching.drawing import draw_reaching

    draw_reaching(evaluation, path)


def _interference(demos: str, given: str | None) -> Path | None:
    if given is not None:
        return None if given == "none" else Path(given)
    beside = Path(demos).resolve().parent / INTERFERENCE_BESIDE_DEMOS
    return beside if beside.is_dir() else None
