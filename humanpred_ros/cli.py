"""`humanpred`: the front door for people without a ROS installation."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from humanpred_ros import __version__
from humanpred_ros.bags.salvage import BagReport, check_bag, salvage_bag
from humanpred_ros.errors import HumanPredError

#: Tables for a file or another program need not fit a terminal that nobody has.
_WIDTH_OF_FILES = 130
console = Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDTH_OF_FILES)


def main(arguments: list[str] | None = None) -> int:
    """Run one subcommand; return the exit status: 0 done, 1 a check found a problem, 2 bad input, 130 interrupted."""
    options = command_parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        with _interruptible():
            return command(options)
    except HumanPredError as error:
        print(f"humanpred: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("humanpred: interrupted", file=sys.stderr)
        return 130


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let Ctrl-C and a polite kill both raise KeyboardInterrupt, also where a shell had SIGINT ignored."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, signal.default_int_handler) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _demo(options: argparse.Namespace) -> int:
    from humanpred_ros.evaluation.demo import DemoOptions, run_demo

    run_demo(
        DemoOptions(
            scene=options.scene,
            library=options.library,
            trajectory=options.trajectory,
            model=options.model,
            hold_out=options.hold_out,
            seed=options.seed,
            rate=options.real_time,
            predictor=options.predictor,
            classifier=options.classifier,
            detect_onsets=not options.no_onsets,
            markers=options.markers,
            evidence=options.evidence,
            window_frames=options.window_frames,
            out=options.out,
        ),
        console,
    )
    return 0


def _train(options: argparse.Namespace) -> int:
    from humanpred_ros.human.model import human_with
    from humanpred_ros.motion.library_io import load_library
    from humanpred_ros.recognition.gmm_config import GmmConfig
    from humanpred_ros.recognition.model_file import save_model
    from humanpred_ros.recognition.training import train_model
    from humanpred_ros.resources import locate

    library = load_library(locate(options.library, "bags"), frame_period_s=options.frame_period)
    if options.hold_out:
        held_out = {m.name for label in library.labels for m in library.of_class(label)[: options.hold_out]}
        library = library.select(lambda motion: motion.name not in held_out)
    config = GmmConfig(n_components=options.components, phase_feature=not options.no_phase, seed=options.seed)
    with console.status(f"training on {len(library)} motions of {library.name}"):
        model = train_model(library, human_with(library.dof_names), config)
    save_model(model, Path(options.out))
    console.print(f"{options.out}: {len(model.labels)} classes from {len(library)} motions of {library.name}")
    return 0


def _import(options: argparse.Namespace) -> int:
    from collections import Counter

    from humanpred_ros.motion.bag_library import write_library_bag
    from humanpred_ros.motion.cleaning import clean_library, flag_library
    from humanpred_ros.motion.library_io import load_library

    for source in options.source:
        library = load_library(source, frame_period_s=options.frame_period)
        flags = flag_library(library)
        for reason, count in Counter(flag.reason for flag in flags).items():
            console.print(f"{source}: {count} flagged {reason}", markup=False, highlight=False)
        if options.show_flags:
            for flag in flags:
                console.print(f"  {flag}", markup=False, highlight=False)
        if options.clean or options.drop:
            library = clean_library(library, drop=options.drop)
        bag = write_library_bag(library, Path(options.out) / library.name, overwrite=options.overwrite)
        console.print(f"{source} -> {bag}: {len(library)} motions", markup=False, highlight=False, soft_wrap=True)
    return 0


def _generate(options: argparse.Namespace) -> int:
    from humanpred_ros.motion.bag_library import write_library_bag
    from humanpred_ros.motion.library_io import load_library
    from humanpred_ros.motion.library_statistics import comparison_markdown
    from humanpred_ros.motion.synthetic import ReachGeneratorConfig, generate_library

    other = load_library(options.compare) if options.compare else None
    config = ReachGeneratorConfig(motions_per_class=options.motions, name=Path(options.out).name)
    with console.status(f"generating {options.motions} motions per class"):
        library = generate_library(config, np.random.default_rng(options.seed))
    write_library_bag(library, options.out, overwrite=options.overwrite)
    console.print(f"{options.out}: {len(library)} motions, seed {options.seed}")
    if other is not None:
        print(comparison_markdown(library, other))
    return 0


def _report(options: argparse.Namespace) -> int:
    from humanpred_ros.viewing.report import write_report
    from humanpred_ros.viewing.run import read_run
    from humanpred_ros.viewing.summary import print_summary, summarise

    run = read_run(Path(options.run))
    summary = summarise(run)
    out = Path(options.out) if options.out else Path(options.run) / "report.html"
    write_report(run, summary, out)
    out.with_name("summary.json").write_text(summary.to_json(), encoding="utf-8")
    print_summary(summary, console)
    console.print(f"report  {out}")
    return 0


def _replay(options: argparse.Namespace) -> int:
    from humanpred_ros.evaluation.reproduce import replay_run

    out = Path(options.out) if options.out else Path(options.run) / "replayed_bag"
    with console.status("feeding the recorded occupancy to a fresh planner"):
        comparison = replay_run(Path(options.run), out)
    for difference in comparison.differing[:10]:
        console.print(difference, markup=False, highlight=False)
    console.print(
        f"{comparison.n_decisions} decisions, {comparison.n_trajectories} trajectories: "
        + (f"{len(comparison.differing)} differ" if comparison.differing else "reproduced bit for bit")
    )
    return 1 if comparison.differing else 0


def _print_bag(report: BagReport) -> None:
    table = Table(str(report.path), "messages", box=None)
    for topic, count in sorted(report.messages.items()):
        table.add_row(topic, str(count))
    console.print(table)
    for problem in report.problems:
        console.print(f"problem: {problem}", markup=False)
    console.print("all is well" if report.ok else "not all is well")


def _bag_check(options: argparse.Namespace) -> int:
    report = check_bag(options.bag)
    _print_bag(report)
    return 0 if report.ok else 1


def _bag_salvage(options: argparse.Namespace) -> int:
    _print_bag(salvage_bag(options.bag, options.out))
    return 0


#: Experiments: group -> (what it is, name -> (module with `add_arguments` and `run`, what it is)).
_EXPERIMENTS = {
    "evaluate": (
        "measure against recordings, leaving out what is tested",
        {
            "recognition": ("recognition.command", "how early and how surely a reach is recognised (P1 Fig. 6)"),
            "occupancy": ("occupancy.command", "predicted occupancy against the voxels really swept"),
            "streams": ("streams.command", "onsets, ends and recognition on long streams with pauses"),
            "interference": ("interference.command", "how much the arm disturbs the person (P1 Table I)"),
            "switching": ("switching.command", "when the arm changes its goal (P1 Fig. 9)"),
            "reaching": ("reaching.command", "predicted reaches against recorded (P2 Tables I to III, Figs. 7, 10)"),
        },
    ),
    "bench": (
        "measure how long things take",
        {
            "predictor": (
                "predictor_bench.command",
                "microseconds per posture, what they grow with, and occupancies a second over DDS on one core",
            ),
            "planner": ("planner_bench.command", "milliseconds per goal beside the C++ floor and NumPy"),
            "graph": ("graph_bench.command", "posture to trajectory over DDS at 30 Hz, per number of goals"),
        },
    ),
}


class _ExperimentParser(argparse.ArgumentParser):
    """Asks the module of an experiment for its options only when the experiment is called: imports take time."""

    def __init__(self, *, module: str, **settings: Any) -> None:
        super().__init__(**settings)
        self._module: str | None = module

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._module is not None:
            experiment = importlib.import_module(f"humanpred_ros.evaluation.{self._module}")
            self._module = None
            experiment.add_arguments(self)
            self.set_defaults(command=lambda options: experiment.run(options, console))
        return super().parse_known_args(args, namespace)


def command_parser() -> argparse.ArgumentParser:
    """Return the parser of every subcommand; `command` is the function it runs."""
    parser = argparse.ArgumentParser(prog="humanpred", description=__doc__)
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def add(name: str, command: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=text, description=text)
        added.set_defaults(command=command)
        return added

    demo = add("demo", _demo, "replay, predict and plan over DDS, recorded to MCAP, with a report at the end")
    demo.add_argument("--scene", default="four_places", help="scene name, or a YAML file")
    demo.add_argument("--library", default="synthetic_reaches", help="bag, CSV folder, or the name of a shipped one")
    demo.add_argument("--trajectory", default="3/2", help="class/index, or the running number over sorted classes")
    demo.add_argument("--model", help="model file made by `humanpred train`; default: train now")
    demo.add_argument("--hold-out", type=int, default=5, help="first motions of each class not trained on")
    demo.add_argument(
        "--predictor",
        default="forecast",
        help="forecast, swept_volume (P1), reaching (P2), or a baseline: current, current_accumulated, "
        "constant_velocity",
    )
    demo.add_argument("--classifier", default="forest", help="forest, or gmm (P1)")
    demo.add_argument("--no-onsets", action="store_true", help="the first posture begins the motion, as in P1")
    demo.add_argument("--evidence", default="sum", help="gmm: sum or mean of the postures' log densities")
    demo.add_argument("--window-frames", type=int, default=0, help="gmm: count only so many last postures; 0 all")
    demo.add_argument("--seed", type=int, default=0)
    demo.add_argument("--markers", action="store_true", help="record markers too, for viewers")
    demo.add_argument(
        "--real-time",
        type=float,
        nargs="?",
        const=1.0,
        metavar="RATE",
        help="do not wait for the planner after every posture: play at RATE times the recorded speed (1)",
    )
    demo.add_argument("--out", help="folder of the run; default: a new one below runs/")

    train = add("train", _train, "learn a model from a motion library")
    train.add_argument("library", help="bag, CSV folder, or the name of a shipped one")
    train.add_argument("--out", required=True, help="model file to write (.npz)")
    train.add_argument("--hold-out", type=int, default=0, help="first motions of each class not trained on")
    train.add_argument("--components", type=int, default=40, help="Gaussians per class")
    train.add_argument("--no-phase", action="store_true", help="leave the phase out of the features")
    train.add_argument("--seed", type=int, default=0)

    imported = add("import", _import, "turn CSV motion libraries into MCAP bags")
    imported.add_argument("source", nargs="+", help="folder with class_<k>.csv files")
    imported.add_argument("--out", required=True, help="folder for the bags, one per library")
    imported.add_argument("--overwrite", action="store_true", help="replace bags that exist")
    imported.add_argument("--show-flags", action="store_true", help="print everything that looks suspicious")
    imported.add_argument("--clean", action="store_true", help="unwrap angles; without it everything is kept as it is")
    imported.add_argument(
        "--drop", action="store_true", help="clean, and leave out motions that are wild or mislabelled"
    )
    for subparser in (train, imported):
        subparser.add_argument(
            "--frame-period", type=float, default=1 / 60, help="seconds between frames where a CSV has no times"
        )

    generate = add("generate", _generate, "make a synthetic motion library by simulation")
    generate.add_argument("--out", required=True, help="bag to write")
    generate.add_argument("--motions", type=int, default=25, help="motions per class")
    generate.add_argument("--seed", type=int, default=0)
    generate.add_argument("--compare", metavar="LIBRARY", help="print the statistics beside another library's")
    generate.add_argument("--overwrite", action="store_true", help="replace a bag that exists")

    report = add("report", _report, "write the HTML report of a recorded run")
    report.add_argument("run", help="folder of the run")
    report.add_argument("--out", help="HTML file; default: report.html in the run's folder")

    replay = add("replay", _replay, "feed a run's recorded occupancy to a fresh planner and compare its decisions")
    replay.add_argument("run", help="folder of the run")
    replay.add_argument("--out", help="bag to write; default: replayed_bag in the run's folder")

    for group, (text, members) in _EXPERIMENTS.items():
        parser_of_group = commands.add_parser(group, help=text, description=text)
        subjects = parser_of_group.add_subparsers(required=True, metavar="SUBJECT", parser_class=_ExperimentParser)
        for name, (module, what) in members.items():
            subjects.add_parser(name, help=what, description=what, module=module)

    bag = add("bag", _bag_check, "check or salvage a bag")
    actions = bag.add_subparsers(required=True, metavar="ACTION")
    check = actions.add_parser("check", help="read everything, with checksums")
    check.set_defaults(command=_bag_check)
    check.add_argument("bag")
    salvage = actions.add_parser("salvage", help="rescue what is intact into a new bag")
    salvage.set_defaults(command=_bag_salvage)
    salvage.add_argument("bag")
    salvage.add_argument("--out", required=True, help="bag to write")
    return parser


if __name__ == "__main__":
    sys.exit(main())
