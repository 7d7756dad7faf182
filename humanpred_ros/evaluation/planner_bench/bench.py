"""How long planning takes beside the least it could take: ours and a C++ floor in one run.

Everything is repeated in turn, one round after the other, because machines are shared and slow down for seconds at a
time; ratios are formed within rounds, with the floor measured right before and right after. The floor is the C++
yardstick's time for the same number of lookups and nothing else: no noise, no update, no interpolation between the
eight nodes around a sphere, no speeds.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from humanpred_ros.evaluation.planner_bench.floor import Yardstick
from humanpred_ros.evaluation.planner_bench.growth import GrowthRow, measure_growth
from humanpred_ros.evaluation.planner_bench.others import OthersCores
from humanpred_ros.evaluation.planner_bench.share import LookupShare, lookup_share
from humanpred_ros.evaluation.planner_bench.timing import (
    Samples,
    Times,
    durations_ms,
    floor_of,
    median_ms,
    overruns_ms,
    plan_all,
    plan_one,
    some_goals,
)
from humanpred_ros.evaluation.planner_bench.world import BenchWorld, BenchWorlds, Case

#: What is aimed at, and what the paper took.
TARGET_TO_FLOOR, TARGET_GOALS_MS, TARGET_THREADS, TARGET_OVERRUN_MS = 1.8, 45.0, 1.7, 2.0
PUBLISHED_MS = 500.0
THREADS = 2
#: Where deadlines fall, as a share of the time a whole plan wants.
_DEADLINES = (0.1, 0.5, 0.9)


@dataclass(frozen=True)
class PlannerBench:
    """All that `humanpred bench planner` measures.

    Attributes:
        case: what was planned.
        lookups: per goal; what the floor is charged for.
        share_first, share_last: of them that ours did in the first and around the finished plan; the others
            were links far from everything.
        ours_ms, full_ms, floor_ms: one goal on one thread; full: with nothing to skip.
        ns_per_lookup: of the floor.
        to_floor, full_to_floor: ratios within rounds.
        best_to_floor: least time of ours over the floor's least: what is left when nobody else used the machine.
        one_thread_ms, two_threads_ms, speed_up: all goals.
        floor_two_threads_ms, floor_speed_up: the yardstick's on two threads, which is what the machine allows; and its
            own gain from the second.
        overrun_ms: how long after its deadline a plan comes back.
        growth: by what grows and its size.
        others: cores that other programs used meanwhile, in the mean; None where that cannot be told.
        no_floor: why there is no floor; empty if there is.
    """

    case: Case
    lookups: int
    share_first: LookupShare
    share_last: LookupShare
    ours_ms: Times
    full_ms: Times
    floor_ms: Times | None
    ns_per_lookup: Times | None
    to_floor: Times | None
    full_to_floor: Times | None
    best_to_floor: float | None
    one_thread_ms: Times
    two_threads_ms: Times
    speed_up: Times
    floor_two_threads_ms: Times | None
    floor_speed_up: Times | None
    overrun_ms: Times
    growth: tuple[GrowthRow, ...]
    others: float | None
    no_floor: str


def bench_planner(
    case: Case,
    yardstick: Yardstick,
    *,
    rounds: int,
    growth: bool = True,
    report: Callable[[str], None] = lambda _: None,
) -> PlannerBench:
    """Measure everything.

    Args:
        case: what to plan.
        yardstick: compiled, or one without a program.
        rounds: how often each is measured.
        growth: whether the growth curves are measured too.
        report: told what is measured next.

    Raises:
        HumanPredError: an impossible case, or a yardstick that fails.
    """
    report("making the worlds")
    worlds = BenchWorlds()
    world, full = worlds.world(case), worlds.world(case, skippable=False)
    found, others = Samples(), OthersCores()
    with ThreadPoolExecutor(THREADS) as pool:
        finished = plan_one(world, 0)  # compiles, or loads what was compiled
        for k in range(rounds):
            report(f"round {k + 1} of {rounds}")
            _round(found, k, world, full, yardstick, pool)
        rows = measure_growth(case, worlds, yardstick, pool, report) if growth else ()
    return PlannerBench(
        case=case,
        lookups=case.lookups,
        share_first=lookup_share(world, world.paths[0]),
        share_last=lookup_share(world, finished.waypoints),
        ours_ms=found.times("ours"),
        full_ms=found.times("full"),
        floor_ms=found.times_or_none("floor"),
        ns_per_lookup=found.times_or_none("ns per lookup"),
        to_floor=found.times_or_none("ours / floor"),
        full_to_floor=found.times_or_none("full / floor"),
        best_to_floor=found.best_ratio_or_none("least of ours", "least of floor"),
        one_thread_ms=found.times("one thread"),
        two_threads_ms=found.times("two threads"),
        speed_up=found.ratio("one thread", "two threads"),
        floor_two_threads_ms=found.times_or_none("floor, two threads"),
        floor_speed_up=found.times_or_none("floor, speed-up"),
        overrun_ms=found.times("overrun"),
        growth=rows,
        others=others.mean(),
        no_floor=yardstick.missing,
    )


def _round(
    found: Samples,
    k: int,
    world: BenchWorld,
    full: BenchWorld,
    yardstick: Yardstick,
    pool: ThreadPoolExecutor,
) -> None:
    """Measure everything once."""
    case, some = world.case, some_goals(k, world.case)
    floors = [floor_of(yardstick, case)]
    for name, each in (("ours", world), ("full", full)):
        durations = durations_ms(partial(plan_one, each), some)
        ours = float(np.median(durations))
        found.note(name, ours)
        found.note(f"least of {name}", min(durations))
        floors.append(floor_of(yardstick, case))
        before, after = floors[-2:]
        if before is not None and after is not None:
            to_ms = 1e-6 * case.lookups
            floor = to_ms * (before.median_ns + after.median_ns) / 2.0
            found.note(f"{name} / floor", ours / floor)
            found.note("floor", floor)
            found.note("least of floor", to_ms * min(before.least_ns, after.least_ns))
            found.note("ns per lookup", after.median_ns)
            found.note("floor, two threads", to_ms * case.goals * after.two_threads_ns)
            found.note("floor, speed-up", after.median_ns / after.two_threads_ns)
    for share in _DEADLINES:
        for late in overruns_ms(world, some, share):
            found.note("overrun", late)
    found.note("one thread", median_ms(lambda _: plan_all(world, None), [0]))
    found.note("two threads", median_ms(lambda _: plan_all(world, pool), [0]))
