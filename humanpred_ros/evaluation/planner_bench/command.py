"""`humanpred bench planner`: from options to tables, JSON and plot."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.options import Outputs, add_outputs
from humanpred_ros.evaluation.outputs import machine_facts, plain
from humanpred_ros.evaluation.planner_bench.bench import (
    PUBLISHED_MS,
    TARGET_GOALS_MS,
    TARGET_OVERRUN_MS,
    TARGET_THREADS,
    TARGET_TO_FLOOR,
    PlannerBench,
    bench_planner,
)
from humanpred_ros.evaluation.planner_bench.floor import Yardstick, find_yardstick
from humanpred_ros.evaluation.planner_bench.share import LookupShare
from humanpred_ros.evaluation.planner_bench.timing import Times
from humanpred_ros.evaluation.planner_bench.world import Case
from humanpred_ros.viewing.plots_planner_bench import GrowthCurve, save_growth_plot

_SIZES = {
    "goals": "goals planned to on two threads",
    "waypoints": "waypoints of a trajectory",
    "rollouts": "noisy rollouts per iteration",
    "points": "body points looked up in the occupancy",
    "spheres": "spheres looked up in the distance field",
    "iterations": "STOMP iterations",
    "reused": "rollouts kept from the iteration before; 0: fresh noise",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `humanpred bench planner`."""
    add_outputs(parser, plot="draw the growth curves into FILE (PNG)")
    case = Case()
    for name, meaning in _SIZES.items():
        parser.add_argument(f"--{name}", type=int, default=getattr(case, name), metavar="N", help=meaning)
    parser.add_argument("--rounds", type=int, default=9, metavar="N", help="measurements of everything")
    parser.add_argument("--yardstick", metavar="FILE", help="cost_floor.cpp; else looked for in ../shared/yardsticks")
    parser.add_argument("--no-growth", action="store_true", help="leave the growth curves out")


def run(options: argparse.Namespace, console: Console) -> int:
    """Measure, print, write; return the exit status.

    Raises:
        HumanPredError: impossible options, a yardstick that fails, or a file that cannot be written.
    """
    case = Case(**{name: getattr(options, name) for name in _SIZES})
    if options.rounds < 1:
        raise UsageError(f"--rounds: wanted at least 1, got {options.rounds}")
    if options.plot and options.no_growth:
        raise UsageError("--plot draws the growth curves, --no-growth leaves them out; give one of the two")
    outputs = Outputs.of(options)
    source = find_yardstick(options.yardstick)
    with tempfile.TemporaryDirectory() as folder, console.status("measuring") as status:
        bench = bench_planner(
            case,
            Yardstick.compiled(source, Path(folder)),
            rounds=options.rounds,
            growth=not options.no_growth,
            report=lambda what: status.update(f"measuring: {what}"),
        )
    print_bench(bench, console)
    targets = {
        "to_floor": TARGET_TO_FLOOR,
        "all_goals_ms": TARGET_GOALS_MS,
        "speed_up": TARGET_THREADS,
        "overrun_ms": TARGET_OVERRUN_MS,
    }
    facts = {"targets": targets, "published_ms": PUBLISHED_MS, "machine": machine_facts()}
    outputs.write(console, {**plain(bench), **facts}, lambda path: save_growth_plot(path, growth_curves(bench)))
    return 0


def print_bench(bench: PlannerBench, console: Console) -> None:
    """Print the tables."""
    case = bench.case
    noise = f"{case.reused} rollouts reused" if case.reused else "fresh noise"
    console.print(
        f"{case.iterations} iterations x {case.rollouts} rollouts x {case.waypoints} waypoints, {case.points} body "
        f"points, {case.spheres} spheres, {noise}\n"
        f"{bench.lookups:,} lookups per goal: each point and sphere at each waypoint of every new rollout and of the "
        f"noiseless trajectory\nlookups really done: {_share(bench.share_first)} in the first iteration, "
        f"{_share(bench.share_last)} around the finished plan; the others were links far from everything",
        highlight=False,
    )
    first = Column("ms on one thread", no_wrap=True)
    table = Table(first, "median", "least", "most", "n", "target", "published", box=None)
    _add(table, "one goal", bench.ours_ms, published=f"{PUBLISHED_MS:.0f}")
    _add(table, "  nothing to skip", bench.full_ms)
    _add(table, "  C++ floor, as many lookups", bench.floor_ms)
    _add(table, "    one lookup, ns", bench.ns_per_lookup)
    _add(table, "one goal / floor", bench.to_floor, f"<= {TARGET_TO_FLOOR}")
    if bench.best_to_floor is not None:
        table.add_row("  the best of each", f"{bench.best_to_floor:.2f}")
    _add(table, "  nothing to skip / floor", bench.full_to_floor)
    _add(table, f"{case.goals} goals", bench.one_thread_ms)
    _add(table, "back after its deadline", bench.overrun_ms, f"<= {TARGET_OVERRUN_MS:.0f}")
    _add(
        table,
        f"{case.goals} goals, two threads",
        bench.two_threads_ms,
        f"<= {TARGET_GOALS_MS:.0f}" if case.goals == 8 else "",
    )
    _add(table, "  C++ floor, two threads", bench.floor_two_threads_ms)
    _add(table, "one thread / two threads", bench.speed_up, f">= {TARGET_THREADS}")
    _add(table, "  C++ floor", bench.floor_speed_up)
    console.print(table)
    if bench.others is not None:
        console.print(f"other programs used {bench.others:.2f} cores meanwhile", highlight=False)
    if bench.no_floor:
        console.print(bench.no_floor, highlight=False)
    if bench.growth:
        growth = Table("growth with", "", "lookups", "ours, ms", "two threads", "floor, ms", "ours / floor", box=None)
        for row in bench.growth:
            columns = (row.ours_ms, row.two_threads_ms, row.floor_ms)
            growth.add_row(
                row.what,
                str(row.size),
                f"{row.lookups:,}",
                *(f"{times.median:.1f}" if times else "" for times in columns),
                f"{row.to_floor.median:.2f}" if row.to_floor else "",
            )
        console.print(growth)


def growth_curves(bench: PlannerBench) -> list[GrowthCurve]:
    """Return what the plot draws, one curve per thing that grows."""
    curves = []
    for what in dict.fromkeys(row.what for row in bench.growth):
        rows = [row for row in bench.growth if row.what == what]
        lines = {"ours, one thread": [row.ours_ms.median for row in rows]}
        together = [row.two_threads_ms.median for row in rows if row.two_threads_ms]
        if together:
            lines["ours, two threads"] = together
        floor = [row.floor_ms.median for row in rows if row.floor_ms]
        if floor:
            lines["C++ floor, one thread"] = floor
        curves.append(GrowthCurve(what, [row.size for row in rows], lines))
    return curves


def _share(share: LookupShare) -> str:
    return f"{share.all:.0%} (points {share.points:.0%}, spheres {share.spheres:.0%})"


def _add(table: Table, name: str, times: Times | None, target: str = "", published: str = "") -> None:
    if times is None:
        table.add_row(name, "-", "", "", "", target, published)
        return
    figures = (f"{value:.2f}" for value in (times.median, times.least, times.most))
    table.add_row(name, *figures, str(times.n), target, published)
