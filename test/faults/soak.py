"""How the running graph holds out: people at 30 postures a second for as long as is asked, and a fault now and then.

Asked for: memory that does not grow once the graph has settled, answers that do not become later, every fault caught
and named, and no hold without a reason in between. While other programs need the processor, answers that come later
and steps without time are no fault of the graph: they are told, and not counted.
"""

from __future__ import annotations

import os
import random
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from faults.bench import tried
from faults.catalogue import CLOCK, FAULTS, GUARDED, NODES, PLANNER, PREDICTOR, RECORDER, RELAYED, Fault
from faults.trials import WORKING, TimedText, Trial
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.checkout_benches import SoakSettings
from humanpred_ros.evaluation.framework import Begin, Column, Report, Table, present
from humanpred_ros.evaluation.timing import MachineLoad
from humanpred_ros.planning.replanner import NO_TIME

if TYPE_CHECKING:
    from faults.graph import FaultGraph

#: Memory counts after so long, or after this share of a short run; s.
_SETTLED_S, _SETTLED_SHARE = 300.0, 0.3
#: Memory may grow by this share, answers may become later by this factor.
_MOST_GROWTH, _MOST_DRIFT = 0.05, 1.25
_SAMPLE_PERIOD_S = 1.0
#: With more cores than this used by other programs the graph's own times cannot be judged.
_MOST_OTHER_CORES = 0.25
_OVERLOAD = "overload"
#: A hold this soon after a fault has ended still belongs to it, s.
_AFTER_S = 1.0
#: Part of the reason of a hold that the person themselves call for.
_THE_PERSON = ("the person", "no path can be executed", "nowhere to go")


@dataclass
class Seen:
    """What was seen between the faults."""

    memory_mb: dict[tuple[str, int], list[tuple[float, float]]] = field(default_factory=dict)  #: by node and process
    answers_ms: list[tuple[float, float]] = field(default_factory=list)  #: when, and age of the data answered
    unexplained: Counter[str] = field(default_factory=Counter)  #: holds, by reason
    explained: Counter[str] = field(default_factory=Counter)
    trials: list[tuple[Fault, Trial]] = field(default_factory=list)

    def take(self, decisions: Sequence[TimedText]) -> None:
        """Take decisions that follow each other; a hold is told with every occupancy, and counts once."""
        before = ""
        for entry in decisions:
            kind = entry.text.split(":")[0] if entry.name == "hold" else ""
            if entry.name in WORKING:
                self.answers_ms.append((entry.t_s, 1e3 * entry.value))
            # An arm that stands goes on standing when a step gets no time.
            elif kind and kind != before and not (before and kind == NO_TIME):
                person = any(part in entry.text for part in _THE_PERSON)
                (self.explained if person else self.unexplained)[entry.text] += 1
            before = kind


@dataclass(frozen=True)
class Memory:
    """Resident memory of a node, MB: once it had settled and at the end, medians."""

    node: str
    settled_mb: float
    end_mb: float

    @property
    def growth(self) -> float:
        """Share by which it grew."""
        return self.end_mb / self.settled_mb - 1.0


def run(settings: SoakSettings, console: Console) -> int:
    """Carry out `humanpred bench soak`; status 1 if something is not as asked."""
    bad: list[str] = []

    def measure(chosen: SoakSettings, begin: Begin) -> Report:
        return _measured(chosen, begin, bad)

    present(settings, console, measure)
    return int(bool(bad))


def _measured(settings: SoakSettings, begin: Begin, bad: list[str]) -> Report:
    """Run the graph and return what was found; what is not as asked is added to `bad`.

    Raises:
        UsageError: no ROS, or nodes that do not get ready or end.
    """
    try:
        from faults.graph import FaultGraph, Inputs
    except ImportError as error:
        raise UsageError(f"bench soak: wanted ROS 2, got none ({error}); install the `ros` extra") from error
    if settings.keep is not None and settings.keep.exists():
        raise UsageError(f"--keep: wanted a folder that does not exist yet, {settings.keep} does; choose another")
    load, seen, lasts_s = MachineLoad(), Seen(), 60.0 * settings.minutes
    advance = begin("seconds", round(lasts_s))
    with tempfile.TemporaryDirectory() as temporary:
        folder = (settings.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        inputs = Inputs(folder, seconds=lasts_s + 600.0)
        with FaultGraph(RELAYED, inputs, folder / "logs") as graph:
            graph.wait_until_working()
            began_s = time.monotonic()
            rng = random.Random(settings.seed)
            for fault in _in_any_order(rng):
                _watch(graph, seen, rng.uniform(0.5, 1.5) * settings.calm)
                trial = tried(fault, graph)
                seen.trials.append((fault, trial))
                past_s = time.monotonic() - began_s
                advance(min(round(past_s), round(lasts_s)))
                if trial.recovered_s is None or past_s >= lasts_s:
                    break
            _watch(graph, seen, settings.calm)
    settled_s = began_s + min(_SETTLED_S, _SETTLED_SHARE * lasts_s)
    memory, drift = list(memory_of(seen, settled_s)), drift_of(seen, settled_s)
    other_cores = load.other_cores()
    late = list(late_of(seen, drift))
    busy = other_cores is None or other_cores > _MOST_OTHER_CORES
    bad += [*bad_of(seen, memory), *(() if busy else late)]
    notes = [f"NOT AS ASKED: {text}" for text in bad] or ["As asked: nothing grew, every fault was caught and named."]
    notes += [f"On a machine that others use, not counted: {text}" for text in late if busy]
    ages_ms = [age_ms for _, age_ms in seen.answers_ms]
    notes += [
        f"{len(ages_ms)} answers between the faults, {np.median(ages_ms):.1f} ms after the posture's stamp in the "
        f"median, {np.percentile(ages_ms, 99):.1f} ms in 99 %; the second half's median is {drift:.2f} of the first's.",
        f"Holds between the faults: {sum(seen.explained.values())} because of the person, "
        f"{sum(seen.unexplained.values())} others.",
        *load.notes(),
    ]
    faults = sorted({fault.name for fault, _ in seen.trials})
    rows = [(name, [trial for fault, trial in seen.trials if fault.name == name]) for name in faults]
    return Report(
        f"{settings.minutes:g} minutes, {len(seen.trials)} faults of {len(faults)} kinds, seed {settings.seed}",
        (Table("Memory", memory, _MEMORY_COLUMNS), Table("Faults", rows, _FAULT_COLUMNS)),
        {
            "bad": bad, "latency_drift": drift, "answers_ms": ages_ms,
            "memory": [{"node": row.node, "settled_mb": row.settled_mb, "end_mb": row.end_mb} for row in memory],
            "unexplained_holds": dict(seen.unexplained), "holds_for_the_person": dict(seen.explained),
            "faults": [{"fault": fault.name, "trial": trial} for fault, trial in seen.trials],
        },
        notes,
    )  # fmt: skip


def _in_any_order(rng: random.Random) -> Iterator[Fault]:
    """Yield faults for ever, all of them before one comes again; not those that replace a node whose memory counts."""
    of_use = [
        replace(fault, graph=RELAYED)
        for fault in FAULTS
        if fault.graph not in (CLOCK, GUARDED) and fault.joins not in (PREDICTOR, PLANNER, RECORDER)
    ]
    while True:
        yield from rng.sample(of_use, len(of_use))


def _watch(graph: FaultGraph, seen: Seen, for_s: float) -> None:
    """Let the graph work for some time and note what it needs and says."""
    heard = graph.wire.heard
    since_s = time.monotonic() + _AFTER_S
    until_s = since_s + for_s
    while (now_s := time.monotonic()) < until_s:
        for process in graph.processes():
            memory_mb = _resident_mb(process.process.pid)
            if memory_mb is not None:
                seen.memory_mb.setdefault((process.name, process.process.pid), []).append((now_s, memory_mb))
        graph.wire.wait(lambda: False, _SAMPLE_PERIOD_S)
    seen.take([entry for entry in list(heard.decisions) if since_s <= entry.t_s <= until_s])


def _resident_mb(pid: int) -> float | None:
    """Return the memory a process holds now, MB; None if it has ended or the system does not tell."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def memory_of(seen: Seen, settled_s: float) -> Iterator[Memory]:
    """Yield what each process needed that was there from when the graph had settled until the end."""
    end_s = max(t_s for samples in seen.memory_mb.values() for t_s, _ in samples)
    fifth_s = max(0.2 * (end_s - settled_s), _SAMPLE_PERIOD_S)
    for (node, _), samples in sorted(seen.memory_mb.items()):
        first = [mb for t_s, mb in samples if settled_s <= t_s <= settled_s + fifth_s]
        last = [mb for t_s, mb in samples if t_s >= end_s - fifth_s]
        if first and last:
            yield Memory(node, float(np.median(first)), float(np.median(last)))


def drift_of(seen: Seen, settled_s: float) -> float:
    """Return how much later answers came in the second half of the time than in the first."""
    later = [(t_s, age_ms) for t_s, age_ms in seen.answers_ms if t_s >= settled_s]
    halves = np.array_split(np.array([age_ms for _, age_ms in later]), 2)
    return float(np.median(halves[1]) / np.median(halves[0])) if len(later) > 1 else float("nan")


def late_of(seen: Seen, drift: float) -> Iterator[str]:
    """Yield what is not as asked of the graph's times, in words."""
    if drift > _MOST_DRIFT:
        yield f"answers came {drift:.2f} times as late in the second half"
    times = sum(n for reason, n in seen.unexplained.items() if reason.startswith(_OVERLOAD))
    if times:
        yield f"hold without a fault, {times} times: {_OVERLOAD}"


def bad_of(seen: Seen, memory: Sequence[Memory]) -> Iterator[str]:
    """Yield what else is not as asked, in words."""
    for row in memory:
        if row.growth > _MOST_GROWTH:
            yield f"{row.node} grew by {row.growth:.1%}, at most {_MOST_GROWTH:.0%} are allowed"
    for reason, times in seen.unexplained.items():
        if not reason.startswith(_OVERLOAD):
            yield f"hold without a fault, {times} times: {reason}"
    for fault, trial in seen.trials:
        for problem in trial.problems:
            yield f"{fault.name}: {problem}"


_MEMORY_COLUMNS = (
    Column("node", lambda row: NODES.get(row.node, row.node)),
    Column("settled", lambda row: row.settled_mb, spec=".1f", unit="MB"),
    Column("at the end", lambda row: row.end_mb, spec=".1f", unit="MB"),
    Column("growth", lambda row: row.growth, spec=".1%"),
)
_FAULT_COLUMNS = (
    Column("fault", lambda row: row[0]),
    Column("times", lambda row: len(row[1])),
    Column("caught", lambda row: sum(not trial.problems for trial in row[1])),
    Column("longest to rest", lambda row: max((t.rest_s for t in row[1] if t.rest_s is not None), default=None),
           spec=".2f", unit="s"),
)  # fmt: skip
