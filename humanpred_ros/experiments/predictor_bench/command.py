"""`humanpred bench predictor`: from options to table and JSON."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table

from humanpred_ros.errors import UsageError
from humanpred_ros.experiments.evaluation_files import machine_facts, plain
from humanpred_ros.experiments.options import Outputs, add_library, add_outputs, read_library
from humanpred_ros.experiments.predictor_bench.bench import PredictorBench, Timing, bench_predictor


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred bench predictor`."""
    add_library(parser, "synthetic_reaches")
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
    with tempfile.TemporaryDirectory() as folder, console.status("measuring") as status:
        bench = bench_predictor(
            library,
            n_motions=options.motions,
            folder=None if options.no_node else Path(folder) / "run",
            report=lambda what: status.update(f"measuring: {what}"),
        )
    _print(bench, console)
    outputs.write(console, {**plain(bench), "machine": machine_facts()})
    return 0


def _print(bench: PredictorBench, console: Console) -> None:
    table = Table("microseconds per posture", "median", "99 %", "calls", box=None)
    for name, timing in bench.recognition.items():
        _add(table, f"recognition, {name}", timing)
    for name, timing in bench.update.items():
        _add(table, f"whole update, {name}", timing)
    for row in bench.growth:
        _add(table, f"{row.name}, {row.size} {row.what}", row.timing)
    if bench.node is not None:
        _add(table, "posture to occupancy over DDS, heard by the recorder", bench.node)
    console.print(table)


def _add(table: Table, name: str, timing: Timing) -> None:
    table.add_row(name, f"{timing.median_us:.0f}", f"{timing.p99_us:.0f}", str(timing.n))
