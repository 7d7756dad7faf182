"""`humanpred bench graph`: from options to tables and JSON."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.graph_bench.bench import TARGET_MS, TARGET_READY_S, GraphBench, GraphCase, bench_graph
from humanpred_ros.evaluation.graph_bench.latency import Delays
from humanpred_ros.evaluation.options import Outputs, add_outputs
from humanpred_ros.evaluation.outputs import machine_facts, plain
from humanpred_ros.evaluation.planner_bench.others import OthersCores


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred bench graph`."""
    case = GraphCase()
    add_outputs(parser)
    parser.add_argument("--goals", type=int, nargs="+", default=list(case.goals), metavar="K", help="numbers of goals")
    parser.add_argument("--waypoints", type=int, default=case.waypoints, metavar="N", help="of a path")
    parser.add_argument("--iterations", type=int, default=case.iterations, metavar="N", help="per goal and step")
    parser.add_argument("--rollouts", type=int, default=case.rollouts, metavar="N", help="per iteration")
    parser.add_argument("--threads", type=int, default=case.threads, metavar="N", help="goals planned at once")
    parser.add_argument("--period", type=float, default=case.period_s, metavar="S", help="length of a replanning step")
    parser.add_argument("--seconds", type=float, default=case.seconds, metavar="S", help="of postures in every run")
    parser.add_argument("--runs", type=int, default=case.runs, metavar="N", help="with each number of goals")
    parser.add_argument("--predictor", default=case.predictor, help="of the occupancy")
    parser.add_argument("--keep", metavar="DIR", help="keep bags and logs in the new folder DIR")


def run(options: argparse.Namespace, console: Console) -> int:
    """Measure, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, a node that failed, or a file that cannot be written.
    """
    case = GraphCase(
        goals=tuple(options.goals),
        waypoints=options.waypoints,
        iterations=options.iterations,
        rollouts=options.rollouts,
        threads=options.threads,
        period_s=options.period,
        seconds=options.seconds,
        runs=options.runs,
        predictor=options.predictor,
    )
    outputs = Outputs.of(options)
    if options.keep and Path(options.keep).exists():
        raise UsageError(f"--keep: wanted a folder that does not exist yet, {options.keep} does; choose another")
    others = OthersCores()
    with tempfile.TemporaryDirectory() as temporary, console.status("measuring") as status:
        folder = Path(options.keep or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        bench = bench_graph(case, folder, lambda what: status.update(f"measuring: {what}"))
    busy = others.mean()
    print_bench(bench, console)
    if busy is not None:
        console.print(f"other programs used {busy:.2f} cores meanwhile", highlight=False)
    facts = {"targets_p99_ms": TARGET_MS, "target_ready_s": TARGET_READY_S, "others": busy}
    outputs.write(console, {**plain(bench), **facts, "machine": machine_facts()})
    return 0


def print_bench(bench: GraphBench, console: Console) -> None:
    """Print the tables."""
    case = bench.case
    console.print(
        f"{case.rate_hz:.0f} postures a second, {case.waypoints} waypoints, {case.iterations} iterations x "
        f"{case.rollouts} rollouts, replanning every {1e3 * case.period_s:.0f} ms; {case.runs} runs of "
        f"{case.seconds:g} s\nfrom a posture's publication to the receipt of its answer by the recorder",
        highlight=False,
    )
    table = Table(Column("ms", no_wrap=True), "goals", "median", "99 %", "most", "n", "target (99 %)", box=None)
    for result in bench.results:
        target = f"<= {TARGET_MS[result.goals]:.0f}" if result.goals in TARGET_MS else ""
        _add(table, "posture to occupancy", result.goals, result.occupancy)
        _add(table, "posture to decision", result.goals, result.step)
        _add(table, "posture to trajectory", result.goals, result.trajectory, target)
        _add(table, "  planner's own part", result.goals, result.compute)
    console.print(table)
    steps = Table("goals", "replanning steps", "too late", "skipped", "target", "iterations, median", box=None)
    for result in bench.results:
        counts = (result.steps, result.late, result.skipped)
        steps.add_row(str(result.goals), *map(str, counts), "none missed", f"{result.iterations:.0f}")
    console.print(steps)
    usage = Table(Column("node", no_wrap=True), "goals", "processor, % of a core", "memory, MB", box=None)
    for result in bench.results:
        for node in result.usage:
            usage.add_row(node.node, str(result.goals), f"{node.cpu_percent:.0f}", f"{node.memory_mb:.0f}")
    console.print(usage)
    console.print(
        f"planner's node ready {bench.ready_s:.1f} s after its start, {bench.ready_cpu_s:.1f} s of them at work "
        f"(target {TARGET_READY_S:.0f} s, kernels cached)",
        highlight=False,
    )


def _add(table: Table, name: str, goals: int, delays: Delays, target: str = "") -> None:
    figures = (f"{value:.1f}" if delays.n else "-" for value in (delays.median_ms, delays.p99_ms, delays.most_ms))
    table.add_row(name, str(goals), *figures, str(delays.n), target)
