"""What planning time grows with: one size of the workload changed at a time, each beside the floor."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

from humanpred_ros.evaluation.planner_bench.floor import Yardstick
from humanpred_ros.evaluation.planner_bench.timing import (
    Samples,
    Times,
    floor_of,
    median_ms,
    plan_all,
    plan_one,
    some_goals,
)
from humanpred_ros.evaluation.planner_bench.world import BenchWorld, BenchWorlds, Case

_ROUNDS = 3
GROWTH = {
    "goals": (1, 2, 4, 8, 16),
    "waypoints": (30, 60, 120, 240),
    "rollouts": (5, 10, 20, 40),
    "points": (75, 150, 300, 600),
}


@dataclass(frozen=True)
class GrowthRow:
    """One thing changed, all else as in the case: `size` of `what`.

    Attributes:
        lookups: in all.
        ours_ms: one plan on one thread; where goals grow, all of them.
        two_threads_ms: all goals on two threads, where goals grow.
        floor_ms, to_floor: for the same number of lookups on one thread, None without the yardstick.
    """

    what: str
    size: int
    lookups: int
    ours_ms: Times
    two_threads_ms: Times | None
    floor_ms: Times | None
    to_floor: Times | None


def measure_growth(
    case: Case,
    worlds: BenchWorlds,
    yardstick: Yardstick,
    pool: ThreadPoolExecutor,
    report: Callable[[str], None],
) -> tuple[GrowthRow, ...]:
    """Measure with one thing changed at a time; the sizes take turns."""
    rows = []
    for what, sizes in GROWTH.items():
        changed = [replace(case, **{what: size}, **({"reused": 0} if what == "rollouts" else {})) for size in sizes]
        made = [worlds.world(each) for each in changed]
        found = [Samples() for _ in sizes]
        for k in range(_ROUNDS):
            report(f"growth with {what}, round {k + 1} of {_ROUNDS}")
            for world, samples in zip(made, found, strict=True):
                _growth_round(samples, k, world, yardstick, pool, all_goals=what == "goals")
        for size, world, samples in zip(sizes, made, found, strict=True):
            rows.append(
                GrowthRow(
                    what=what,
                    size=size,
                    lookups=_lookups(world.case, all_goals=what == "goals"),
                    ours_ms=samples.times("ours"),
                    two_threads_ms=samples.times_or_none("two threads"),
                    floor_ms=samples.times_or_none("floor"),
                    to_floor=samples.ratio_or_none("ours", "floor"),
                )
            )
    return tuple(rows)


def _growth_round(
    samples: Samples, k: int, world: BenchWorld, yardstick: Yardstick, pool: ThreadPoolExecutor, *, all_goals: bool
) -> None:
    case = world.case
    if all_goals:
        samples.note("ours", median_ms(lambda _: plan_all(world, None), [0]))
        samples.note("two threads", median_ms(lambda _: plan_all(world, pool), [0]))
    else:
        samples.note("ours", median_ms(partial(plan_one, world), some_goals(k, case)))
    floor = floor_of(yardstick, case)
    if floor is not None:
        samples.note("floor", 1e-6 * floor.median_ns * _lookups(case, all_goals=all_goals))


def _lookups(case: Case, *, all_goals: bool) -> int:
    return case.lookups * (case.goals if all_goals else 1)
