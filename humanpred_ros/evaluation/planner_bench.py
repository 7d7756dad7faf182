"""How long planning takes beside the least it could take: ours and a C++ floor in one run.

Everything is repeated in turn, one round after the other, because machines are shared and slow down for seconds at a
time; ratios are formed within rounds, with the floor measured right before and right after. The floor is the C++
yardstick's time for the same number of lookups and nothing else: no noise, no update, no interpolation between the
eight nodes around a sphere, no speeds. What time grows with is measured by changing one size at a time.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.evaluation.framework import Begin, Column, OutputSettings, Report, Table
from humanpred_ros.evaluation.planner_bench_world import (
    LIVE_POINTS,
    LIVE_SOLIDS,
    BenchWorld,
    LiveWorld,
    Workload,
    bench_world,
    scenes_of_arms,
)
from humanpred_ros.evaluation.timing import MachineLoad, Spread, durations_ms, growth_plot
from humanpred_ros.resources import share_directory
from humanpred_ros.settings import setting
from humanpred_ros.stomp.planner import Plan

#: What the paper's STOMP took for one goal (P1, results).
PUBLISHED_MS = 500.0
THREADS = 2
#: Sizes that the workload is changed to, one at a time.
GROWTH = {
    "goals": (1, 2, 4, 8, 16),
    "waypoints": (30, 60, 120, 240),
    "rollouts": (5, 10, 20, 40),
    "points": (75, 150, 300, 600),
}
_GROWTH_ROUNDS = 3
#: Plans per measurement of what is fast; single calls are at the mercy of whatever else the machine does.
_CALLS = 3

_YARDSTICK = Path("shared", "yardsticks", "cost_floor.cpp")
_FLAGS = ("-O3", "-march=native", "-std=c++17", "-pthread")
#: The variant that computes as ours does: float32, 32 configurations side by side.
_LINE = r"^f32 W32\s+thr={threads}\b.*?\s([\d.]+) ns/lookup"
#: Configurations of one run: enough for a steady figure in 0.3 s; it handles 64 at a time on two threads.
_FLOOR_CONFIGURATIONS = 9600
_COMPILER_LIMIT_S, _RUN_LIMIT_S = 120.0, 60.0

#: Titles of the figures, by their keys in the JSON file; milliseconds where nothing else is said.
_TITLES = {
    "ours_ms": "one goal",
    "floor_ms": "  C++ floor, as many lookups",
    "ns_per_lookup": "    one lookup, ns",
    "to_floor": "one goal / floor",
    "one_thread_ms": "all goals",
    "two_threads_ms": "all goals, two threads",
    "floor_two_threads_ms": "  C++ floor, two threads",
    "speed_up": "one thread / two threads",
    "floor_speed_up": "  C++ floor",
}


class PlannerBenchSettings(OutputSettings, Workload):
    """Settings of `humanpred bench planner`."""

    rounds: int = setting(9, "measurements of everything", low=1)
    yardstick: Path | None = setting(None, f"C++ source of the floor; by default ../{_YARDSTICK}, if it is there")
    growth: bool = setting(True, "measure what the time grows with, too")
    arms: bool = setting(True, "measure other arms, and obstacles that are told of while the planner runs, too")

    def check(self) -> None:
        """Refuse a plot of what is not measured."""
        super().check()
        if self.plot is not None and not self.growth:
            raise SettingsError(f"{type(self).__name__} plot: draws what the time grows with; leave out --no-growth")


def measure(settings: PlannerBenchSettings, begin: Begin) -> Report:
    """Measure everything.

    Raises:
        UsageError: a yardstick that does not exist, is no C++, or prints something else than expected.
    """
    source, load, workload = find_yardstick(settings.yardstick), MachineLoad(), settings.part(Workload)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(THREADS) as pool:
        yardstick = Yardstick.compiled(source, Path(folder))
        world = bench_world(workload)
        plan_one(world, 0)  # compiles, or loads what was compiled
        found: defaultdict[str, list[float]] = defaultdict(list)
        advance = begin("rounds", settings.rounds)
        for k in range(settings.rounds):
            _round(found, k, world, yardstick, pool)
            advance(k + 1)
        growth = list(_growth(workload, yardstick, pool, begin)) if settings.growth else []
    arms = _arms(workload, settings.rounds, begin) if settings.arms else []
    figures = {key: Spread.of(found[key]) for key in _TITLES}
    facts = {"lookups": workload.lookups, **figures, "growth": growth, "arms": arms, "published_ms": PUBLISHED_MS}
    return Report(
        f"{workload.iterations} iterations x {workload.rollouts} rollouts x {workload.waypoints} waypoints, "
        f"{workload.points} body points, {workload.spheres} spheres, "
        + (f"{workload.reused} rollouts reused" if workload.reused else "fresh noise"),
        tuple(_tables(settings, figures, growth, arms)),
        {**facts, "other_cores": load.other_cores(), "no_floor": yardstick.missing},
        (*load.notes(), *([yardstick.missing] if yardstick.missing else [])),
        (lambda: growth_plot(_points(growth), "ms")) if growth else None,
    )


def _round(
    found: dict[str, list[float]], k: int, world: BenchWorld, yardstick: Yardstick, pool: ThreadPoolExecutor
) -> None:
    """Measure everything once; goals take turns."""
    workload, to_ms = world.workload, 1e-6 * world.workload.lookups
    before = yardstick.lookup(workload)
    ours = float(np.median(durations_ms(partial(plan_one, world), _goals_of_round(k, workload))))
    found["ours_ms"].append(ours)
    after = yardstick.lookup(workload)
    if before is not None and after is not None:
        floor = to_ms * (before.median_ns + after.median_ns) / 2.0
        found["to_floor"].append(ours / floor)
        found["floor_ms"].append(floor)
        found["ns_per_lookup"].append(after.median_ns)
        found["floor_two_threads_ms"].append(to_ms * workload.goals * after.two_threads_ns)
        found["floor_speed_up"].append(after.median_ns / after.two_threads_ns)
    one, two = _all_goals_ms(world, None), _all_goals_ms(world, pool)
    found["one_thread_ms"].append(one)
    found["two_threads_ms"].append(two)
    found["speed_up"].append(one / two)


def _growth(
    workload: Workload, yardstick: Yardstick, pool: ThreadPoolExecutor, begin: Begin
) -> Iterator[dict[str, Any]]:
    """Give the figures with one size changed; the sizes take turns."""
    for what, sizes in GROWTH.items():
        fresh = {"reused": 0} if what == "rollouts" else {}
        worlds = [bench_world(workload.replaced(**{what: size}, **fresh)) for size in sizes]
        found: list[defaultdict[str, list[float]]] = [defaultdict(list) for _ in sizes]
        advance = begin(f"rounds, growth with {what}", _GROWTH_ROUNDS)
        for k in range(_GROWTH_ROUNDS):
            for world, samples in zip(worlds, found, strict=True):
                lookups = world.workload.lookups
                if what == "goals":
                    lookups *= world.workload.goals
                    samples["ours_ms"].append(_all_goals_ms(world, None))
                    samples["two_threads_ms"].append(_all_goals_ms(world, pool))
                else:
                    durations = durations_ms(partial(plan_one, world), _goals_of_round(k, world.workload))
                    samples["ours_ms"].append(float(np.median(durations)))
                floor = yardstick.lookup(world.workload)
                if floor is not None:
                    samples["floor_ms"].append(1e-6 * floor.median_ns * lookups)
                    samples["to_floor"].append(samples["ours_ms"][-1] / samples["floor_ms"][-1])
            advance(k + 1)
        for size, world, samples in zip(sizes, worlds, found, strict=True):
            yield {
                "what": what,
                "size": size,
                "lookups": world.workload.lookups * (size if what == "goals" else 1),
                **{key: Spread.of(samples[key]) for key in ("ours_ms", "two_threads_ms", "floor_ms", "to_floor")},
            }


def _arms(workload: Workload, rounds: int, begin: Begin) -> list[dict[str, Any]]:
    """Return the figures of every arm that there is a scene of; the bench's own is the first.

    Ratios are of the shortest times: other programs lengthen some and never shorten one.
    """
    names = scenes_of_arms()
    worlds, live = [bench_world(workload, name) for name in names], [LiveWorld.of(name) for name in names]
    found: list[defaultdict[str, list[float]]] = [defaultdict(list) for _ in names]
    advance = begin("rounds, arms", rounds + 1)
    for k in range(rounds + 1):  # the first warms up
        for world, table, samples in zip(worlds, live, found, strict=True):
            durations = durations_ms(partial(plan_one, world), _goals_of_round(k, workload))
            samples["ours_ms"] += durations
            for what in ("solids", "cloud"):
                samples[f"{what}_ms"] += durations_ms(lambda k, w=what, t=table: t.update(k, w), [k])  # type: ignore[misc]
        advance(k + 1)
    return [
        {
            "arm": world.arm.robot.name,
            "joints": world.arm.chain.n_joints,
            "nodes": int(table.live.field().values.size),
            "to_first": min(samples["ours_ms"]) / min(found[0]["ours_ms"]),
            **{key: Spread.of(values[len(values) // (rounds + 1) :]) for key, values in samples.items()},
        }
        for world, table, samples in zip(worlds, live, found, strict=True)
    ]


def plan_one(world: BenchWorld, goal: int) -> Plan:
    """Plan to one goal, on this thread."""
    return world.planner.plan(world.paths[goal], np.random.default_rng(goal))


def _all_goals_ms(world: BenchWorld, pool: ThreadPoolExecutor | None) -> float:
    """Return the time of planning to every goal, in threads as the replanner does, or one after the other."""
    goals, plan = range(world.workload.goals), partial(plan_one, world)
    (duration,) = durations_ms(lambda how: list(how(plan, goals)), [map if pool is None else pool.map])
    return duration


def _goals_of_round(k: int, workload: Workload) -> list[int]:
    return [(_CALLS * k + i) % workload.goals for i in range(_CALLS)]


def find_yardstick(told: Path | None) -> Path | None:
    """Return the yardstick's source: the file told, else the one beside the repository or the current folder.

    Raises:
        UsageError: the file told does not exist.
    """
    if told is not None:
        if not told.is_file():
            raise UsageError(f"--yardstick: wanted the file cost_floor.cpp, there is no {told}")
        return told
    places = (base / _YARDSTICK for base in (share_directory().parent, Path.cwd().parent, Path.cwd()))
    return next((place for place in places if place.is_file()), None)


class Lookup(NamedTuple):
    """Time of one lookup in a run of the yardstick, ns: medians on one thread and on two."""

    median_ns: float
    two_threads_ns: float


@dataclass(frozen=True)
class Yardstick:
    """The compiled yardstick: what one lookup costs at least on this machine, measured beside our own times."""

    program: Path | None  #: the executable, None if there is none
    missing: str = ""  #: why not

    @classmethod
    def compiled(cls, source: Path | None, folder: Path, compiler: str = "g++") -> Yardstick:
        """Compile into `folder`; a machine without source or compiler gets one that says so.

        Raises:
            UsageError: the compiler refuses the source.
        """
        if source is None:
            return cls(None, f"No C++ floor: {_YARDSTICK} not found; name it with --yardstick FILE.")
        found = shutil.which(compiler)
        if found is None:
            return cls(None, f"No C++ floor: no {compiler} on this machine.")
        program = folder / "cost_floor"
        done = _run(_COMPILER_LIMIT_S, found, *_FLAGS, source, "-o", program)
        if done.returncode:
            raise UsageError(f"{source}: wanted a source that {compiler} compiles, got: {done.stderr.strip():.500}")
        return cls(program)

    def lookup(self, workload: Workload) -> Lookup | None:
        """Run it once with as many lookups per configuration; None without a program.

        Raises:
            UsageError: it prints something else.
        """
        if self.program is None:
            return None
        done = _run(_RUN_LIMIT_S, self.program, workload.points + workload.spheres, _FLOOR_CONFIGURATIONS)
        one, two = (re.search(_LINE.format(threads=n), done.stdout, re.MULTILINE) for n in (1, 2))
        if done.returncode or one is None or two is None:
            raise UsageError(f"yardstick: wanted lines 'f32 W32 thr=1 ... ns/lookup', got {done.stdout!r:.300}")
        return Lookup(float(one[1]), float(two[1]))


def _run(limit_s: float, *command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=limit_s, check=False)


def _tables(
    settings: PlannerBenchSettings,
    figures: Mapping[str, Spread],
    growth: Sequence[dict[str, Any]],
    arms: Sequence[dict[str, Any]],
) -> Iterator[Table]:
    yield Table(
        f"Milliseconds; {settings.goals} goals",
        list(figures),
        (
            Column("", lambda key: _TITLES[key]),
            Column("median", lambda key: figures[key].median, ".2f"),
            Column("least", lambda key: figures[key].least, ".2f"),
            Column("most", lambda key: figures[key].most, ".2f"),
            Column("n", lambda key: figures[key].n),
            Column("published", lambda key: PUBLISHED_MS if key == "ours_ms" else None, ".0f"),
        ),
        f"{settings.lookups:,} lookups per goal: each point and sphere at each waypoint of every new rollout and of "
        "the noiseless trajectory.",
    )
    if growth:
        yield Table(
            "Growth with one size, medians",
            growth,
            (
                Column("growth with", lambda row: f"{row['what']}, {row['size']}"),
                Column("lookups", lambda row: row["lookups"], ",d"),
                Column("ours", lambda row: row["ours_ms"].median, ".1f", "ms"),
                Column("two threads", lambda row: row["two_threads_ms"].median, ".1f", "ms"),
                Column("floor", lambda row: row["floor_ms"].median, ".1f", "ms"),
                Column("ours / floor", lambda row: row["to_floor"].median, ".2f"),
            ),
        )

    if arms:
        yield Table(
            "Other arms at equal points and spheres; obstacles told of while the planner runs, medians (most), ms",
            arms,
            (
                Column("arm", lambda row: row["arm"]),
                Column("joints", lambda row: row["joints"]),
                Column("one goal", lambda row: row["ours_ms"].median, ".2f"),
                Column("least", lambda row: row["ours_ms"].least, ".2f"),
                Column("to the first arm", lambda row: row["to_first"], ".2f"),
                Column("nodes of distances", lambda row: row["nodes"], ",d"),
                Column(f"{LIVE_SOLIDS} solids", lambda row: "{0.median:.0f} ({0.most:.0f})".format(row["solids_ms"])),
                Column(f"{LIVE_POINTS:,} points", lambda row: "{0.median:.0f} ({0.most:.0f})".format(row["cloud_ms"])),
            ),
            "Obstacles: from their coming to the planner's having the distances to everything, goals checked anew; "
            "the solids' time holds the cloud's, which stays.",
        )


def _points(growth: Sequence[dict[str, Any]]) -> Iterator[tuple[str, int, str, float]]:
    lines = {"ours_ms": "ours, one thread", "two_threads_ms": "ours, two threads", "floor_ms": "C++ floor, one thread"}
    for row in growth:
        for key, name in lines.items():
            if row[key].n:
                yield row["what"], row["size"], name, row[key].median
