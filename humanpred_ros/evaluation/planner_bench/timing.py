"""How plans are timed, and what becomes of the measurements: shared by the tables and the growth curves."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from humanpred_ros.evaluation.planner_bench.floor import Lookup, Yardstick
from humanpred_ros.evaluation.planner_bench.world import BenchWorld, Case
from humanpred_ros.stomp.planner import Plan

#: Plans per measurement of what is fast; single calls are at the mercy of whatever else the machine does.
_CALLS = 3
#: Configurations of one run of the yardstick: enough for a steady figure in 0.3 s.
_FLOOR_CONFIGURATIONS = 9600


@dataclass(frozen=True)
class Times:
    """Milliseconds of `n` measurements; ratios have no unit."""

    median: float
    least: float
    most: float
    n: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Times:
        return cls(float(np.median(values)), min(values), max(values), len(values))


class Samples:
    """Measurements by name, one per round; what is left out of later rounds has fewer."""

    def __init__(self) -> None:
        self._values: dict[str, list[float]] = {}

    def note(self, name: str, value: float) -> None:
        self._values.setdefault(name, []).append(value)

    def times(self, name: str) -> Times:
        return Times.of(self._values[name])

    def ratio(self, name: str, over: str) -> Times:
        """Return the figures of the ratios within rounds."""
        return Times.of([a / b for a, b in zip(self._values[name], self._values[over], strict=False)])

    def times_or_none(self, name: str) -> Times | None:
        return self.times(name) if name in self._values else None

    def best_ratio_or_none(self, name: str, over: str) -> float | None:
        """Return the ratio of the least values."""
        if not {name, over} <= self._values.keys():
            return None
        return min(self._values[name]) / min(self._values[over])

    def ratio_or_none(self, name: str, over: str) -> Times | None:
        return self.ratio(name, over) if {name, over} <= self._values.keys() else None


def floor_of(yardstick: Yardstick, case: Case) -> Lookup | None:
    """Return the yardstick's time of a lookup now; None without one."""
    if yardstick.program is None:
        return None
    return yardstick.lookup(case.points + case.spheres, _FLOOR_CONFIGURATIONS)


def some_goals(k: int, case: Case) -> list[int]:
    """Return the goals planned to in round k; every goal has its turn."""
    return [(_CALLS * k + i) % case.goals for i in range(_CALLS)]


def plan_one(world: BenchWorld, goal: int) -> Plan:
    return world.planner.plan(world.paths[goal], generator(goal))


def plan_all(world: BenchWorld, pool: ThreadPoolExecutor | None) -> None:
    """Plan to every goal, in threads as the replanner does, or one after the other."""
    run = map if pool is None else pool.map
    for _ in run(lambda goal: plan_one(world, goal), range(world.case.goals)):
        pass


def overruns_ms(world: BenchWorld, goals: Sequence[int], share: float) -> list[float]:
    """Return how long after their deadline plans come back, if it falls after a share of the time they want."""
    wanted_s = 1e-3 * median_ms(lambda goal: plan_one(world, goal), goals)
    late = []
    for goal in goals:
        end = time.perf_counter() + share * wanted_s
        world.planner.plan(world.paths[goal], generator(goal), lambda end=end: time.perf_counter() >= end)  # type: ignore[misc]
        late.append(1e3 * (time.perf_counter() - end))
    return late


def generator(goal: int) -> np.random.Generator:
    return np.random.default_rng(goal)


def median_ms(call: Callable[[int], object], arguments: Sequence[int]) -> float:
    """Return the median duration of the calls."""
    return float(np.median(durations_ms(call, arguments)))


def durations_ms(call: Callable[[int], object], arguments: Sequence[int]) -> list[float]:
    durations = []
    gc.collect()
    for argument in arguments:
        begin = time.perf_counter()
        call(argument)
        durations.append(1e3 * (time.perf_counter() - begin))
    return durations
