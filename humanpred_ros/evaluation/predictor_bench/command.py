"""`humanpred bench predictor`: from options to table and JSON."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.options import Outputs, add_library, add_outputs, read_library
from humanpred_ros.evaluation.outputs import machine_facts, plain
from humanpred_ros.evaluation.planner_bench.others import OthersCores
from humanpred_ros.evaluation.predictor_bench.bench import PredictorBench, bench_predictor
from humanpred_ros.evaluation.predictor_bench.node import TARGET_HZ, NodeResult
from humanpred_ros.evaluation.predictor_bench.timing import Timing
from humanpred_ros.evaluation.target import targets_table
from humanpred_ros.motion.library_io import load_library


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred bench predictor`."""
    add_library(parser, "synthetic_reaches")
    parser.add_argument(
        "--demos",
        metavar="DIR",
        help="P2's recordings, or another library of its 23-DoF human: measure reaching with them, too",
    )
    add_outputs(parser)
    parser.add_argument("--motions", type=int, default=5, help="motions played for each figure")
    parser.add_argument("--no-node", action="store_true", help="do not start the node")


def run(options: argparse.Namespace, console: Console) -> int:
    """Measure, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, an unusable library, a node that failed, or a file that cannot be written.
    """
    if options.motions < 1:
        raise UsageError(f"--motions: wanted at least 1, got {options.motions}")
    outputs = Outputs.of(options)
    _, library = read_library(options)
    demos = load_library(options.demos) if options.demos else None
    others = OthersCores()
    with tempfile.TemporaryDirectory() as folder, console.status("measuring") as status:
        bench = bench_predictor(
            library,
            demos,
            n_motions=options.motions,
            folder=None if options.no_node else Path(folder) / "runs",
            report=lambda what: status.update(f"measuring: {what}"),
        )
    busy = others.mean()
    print_bench(bench, console)
    if busy is not None:
        console.print(f"other programs used {busy:.2f} cores meanwhile", highlight=False)
    outputs.write(console, {**plain(bench), "target_hz": TARGET_HZ, "others": busy, "machine": machine_facts()})
    return 0


def print_bench(bench: PredictorBench, console: Console) -> None:
    """Print the tables."""
    table = Table("microseconds per posture", "median", "99 %", "calls", box=None)
    for name, timing in bench.recognition.items():
        _add(table, f"recognition, {name}", timing)
    for name, timing in bench.update.items():
        _add(table, f"whole update, {name}", timing)
    for row in bench.growth:
        _add(table, f"{row.name}, {row.size} {row.what}", row.timing)
    console.print(table)
    if bench.nodes:
        _print_nodes(bench.nodes, console)


def _add(table: Table, name: str, timing: Timing) -> None:
    table.add_row(name, f"{timing.median_us:.0f}", f"{timing.p99_us:.0f}", str(timing.n))


def _print_nodes(nodes: tuple[NodeResult, ...], console: Console) -> None:
    console.print(
        f"occupancy_predictor over DDS, {nodes[0].sent_hz:.0f} postures a second; rate of occupancies, and time from a "
        "posture's publication to the receipt of its occupancy by the recorder",
        highlight=False,
    )
    table = Table(
        "", "places", "Hz, median", "1 %", "ms, median", "99 %", "postures", "skipped", "% of a core", "cores", box=None
    )
    for node in nodes:
        table.add_row(
            f"{node.predictor}, {node.human}",
            str(node.places or "-"),
            f"{node.median_hz:.1f}",
            f"{node.slow_hz:.1f}",
            f"{node.delay.median_ms:.1f}",
            f"{node.delay.p99_ms:.1f}",
            str(node.postures),
            str(node.skipped),
            f"{node.cpu_percent:.0f}",
            str(node.cores or "-"),
        )
    console.print(table)
    console.print(targets_table([node.target for node in nodes if node.target is not None]))
