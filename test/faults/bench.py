"""Does the graph fail closed? Every fault is put into the running graph while the arm moves, twice.

The nodes are processes of their own that talk over DDS on this machine, in real time. A person reaches to two places in
turn, so that the arm is on its way from one to the other. A row fails if the planner does not hold with the reason that
is expected, if the arm does not rest in time, if a trajectory begins farther from the arm than the tolerance, or if the
arm does not work again afterwards. What only a guard outside the planner can catch is tried with one.
"""

from __future__ import annotations

import math
import tempfile
import textwrap
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from faults.catalogue import CLOCK, DIRECT, FAULTS, GUARD_S, GUARDED, MAX_AGE_S, RELAYED, SHORT, Fault
from faults.trials import GOES_ON, HOLDS, OPEN, STOPS, Bounds, Trial, judged
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.checkout_benches import FaultBenchSettings
from humanpred_ros.evaluation.framework import Begin, Column, Report, Table, chosen_names, present
from humanpred_ros.evaluation.outputs import check_writable
from humanpred_ros.evaluation.timing import MachineLoad
from humanpred_ros.resources import replacing

if TYPE_CHECKING:
    from faults.graph import FaultGraph

#: The fastest joint of the arm, rad/s, and the acceleration it brakes with, rad/s².
_FASTEST, _BRAKING = 0.36, 4.0
#: The arm's stopping time: it levels off, then takes 1.5 times what the acceleration limit allows; and the periods of
#: watchdog and joint states, s.
STOPPING_S = 0.05 + 1.5 * _FASTEST / _BRAKING + 0.03
#: A trajectory may begin so far from a moving arm: its tolerance and what it moves in the lag allowed, rad.
GAP_RAD = 0.05 + 0.15 * _FASTEST
#: A recorder that is killed loses at most so much, s.
_LOST_S = 1.0
#: A fault is put in while the arm is going to move for so long yet, s; how long that is waited for.
_UNDER_WAY_S, _MOVING_LIMIT_S = 1.5, 60.0
#: The graph works again so soon after a fault, s; on a busy machine a node takes long to start.
_RECOVERY_S = 60.0
_TRIALS = 2
#: What a fault leaves behind shows so soon, s.
_CALM_S = 0.5
_LONGEST_REASON = 120


@dataclass(frozen=True)
class Row:
    """A fault and what it led to, each time."""

    fault: Fault
    trials: tuple[Trial, ...]

    @property
    def verdict(self) -> str:
        """`passed`, `failed`, or `open`."""
        if any(trial.problems for trial in self.trials):
            return "failed"
        return "open" if self.fault.outcome == OPEN else "passed"

    @property
    def observed(self) -> str:
        """What happened, for people."""
        problems = [
            f"{trial.problems[0]}" + ("" if len(self.trials) == 1 else f" ({'first' if k == 0 else 'second'} time)")
            for k, trial in enumerate(self.trials)
            if trial.problems
        ]
        if problems:
            return "; ".join(problems)
        if self.fault.outcome == OPEN:
            return "nothing stops the arm; it goes on to the end of its trajectory"
        if self.fault.outcome in (HOLDS, STOPS):
            return "hold" if self.fault.outcome == HOLDS else "the arm is stopped"
        return "the arm works on"

    @property
    def reason(self) -> str:
        """The reason that was given first; the JSON file has it whole."""
        said = next((trial.reason for trial in self.trials if trial.reason), "")
        said = said.replace("where people are is not known: ", "")
        return textwrap.shorten(said, _LONGEST_REASON, placeholder=" ...")

    @property
    def again(self) -> str:
        """Whether the same fault was caught once more."""
        if self.fault.outcome == OPEN or len(self.trials) < 2:
            return "–"
        return "no" if self.trials[1].problems else "yes"

    def figures(self, name: str, spec: str = ".2f") -> str:
        """Return a figure of each trial, with commas between; an arm that works on is not asked to hold or rest."""
        if self.fault.outcome == GOES_ON and name in ("hold_s", "rest_s"):
            return "–"
        values = [getattr(trial, name) for trial in self.trials]
        return ", ".join("–" if value is None else f"{value:{spec}}" for value in values)


def run(settings: FaultBenchSettings, console: Console) -> int:
    """Carry out `humanpred bench faults`; status 1 if the graph did not do what it must."""
    rows: list[Row] = []

    def measure(chosen: FaultBenchSettings, begin: Begin) -> Report:
        return _measured(chosen, begin, rows)

    present(settings, console, measure)
    return int(any(row.verdict == "failed" for row in rows))


def _measured(settings: FaultBenchSettings, begin: Begin, rows: list[Row]) -> Report:
    """Try the faults, add a row for each, and return what was found.

    Raises:
        UsageError: an unknown fault, no ROS, a file that cannot be written, or nodes that do not get ready.
    """
    names = chosen_names(SHORT if settings.short else settings.only, [fault.name for fault in FAULTS], "--only")
    whole = len(names) == len(FAULTS)
    if whole:
        check_writable(settings.page, ".md")
    if settings.keep is not None and settings.keep.exists():
        raise UsageError(f"--keep: wanted a folder that does not exist yet, {settings.keep} does; choose another")
    load = MachineLoad()
    with tempfile.TemporaryDirectory() as temporary:
        folder = (settings.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        chosen = [fault for fault in FAULTS if fault.name in names]
        if settings.short:  # one graph takes less time to start than two
            chosen = [replace(fault, graph=RELAYED) for fault in chosen]
        travelled_rad = _try_all(chosen, folder, begin, rows)
    rows.sort(key=lambda row: names.index(row.fault.name))  # they were tried graph by graph
    took_ms = [trial.took_ms for row in rows for trial in row.trials if math.isfinite(trial.took_ms)]
    notes = (
        f"The arm's joints moved {travelled_rad:.1f} rad meanwhile.",
        f"From the message that showed a fault to the planner's hold: {np.median(took_ms):.2f} ms in the median of "
        f"{len(took_ms)} holds, {np.percentile(took_ms, 95):.2f} ms in 95 %, {max(took_ms):.2f} ms at most."
        if took_ms
        else "The planner sent no hold.",
        *load.notes(),
    )
    if whole:
        with replacing(settings.page) as path:
            path.write_text(page(rows, notes), encoding="utf-8")
    return Report(
        f"{len(rows)} faults, each {_TRIALS} times: {_count(rows)}",
        (Table("", rows, _COLUMNS),),
        {
            "bound_s": MAX_AGE_S + STOPPING_S, "gap_rad": GAP_RAD, "travelled_rad": travelled_rad,
            "hold_ms": took_ms, "other_cores": load.other_cores(),
            "faults": [
                {"fault": row.fault.name, "expected": row.fault.expected, "observed": row.observed,
                 "verdict": row.verdict, "trials": row.trials}
                for row in rows
            ],
        },
        notes,
    )  # fmt: skip


def _try_all(faults: Sequence[Fault], folder: Path, begin: Begin, rows: list[Row]) -> float:
    """Try every fault, the graphs one after the other; return how far the arm moved, rad."""
    try:
        from faults.graph import FaultGraph, Inputs
    except ImportError as error:
        raise UsageError(f"bench faults: wanted ROS 2, got none ({error}); install the `ros` extra") from error
    advance = begin("faults", len(faults))
    inputs = Inputs(folder)
    travelled_rad, starts = 0.0, 0
    for kind in (DIRECT, RELAYED, CLOCK, GUARDED):
        left = [fault for fault in faults if fault.graph == kind]
        while left:
            starts, intact = starts + 1, True
            with FaultGraph(kind, inputs, folder / f"{starts}_{kind}") as graph:
                graph.wait_until_working()
                while left and intact:  # a graph that did not recover would spoil what comes next
                    fault = left.pop(0)
                    rows.append(Row(fault, tuple(_trials(fault, graph))))
                    intact = rows[-1].trials[-1].recovered_s is not None
                    advance(len(rows))
                travelled_rad += graph.wire.heard.travelled_rad
    return travelled_rad


def _trials(fault: Fault, graph: FaultGraph) -> Iterator[Trial]:
    for _ in range(_TRIALS):
        trial = tried(fault, graph)
        yield trial
        if trial.recovered_s is None:
            return


def tried(fault: Fault, graph: FaultGraph) -> Trial:
    """Put a fault in while the arm moves, take it away, and wait until the arm works again."""
    wire, heard = graph.wire, graph.wire.heard
    wire.wait(lambda: False, _CALM_S)  # what the last fault left behind shows by then
    if not wire.wait(lambda: heard.under_way(time.monotonic(), _UNDER_WAY_S), _MOVING_LIMIT_S):
        return Trial.not_begun(f"the arm was not on its way within {_MOVING_LIMIT_S:.0f} s")
    bounds = Bounds(
        fault.outcome,
        fault.reasons,
        fault.noticed_s + STOPPING_S if fault.rests else None,
        fault.data_age_s,
        GAP_RAD,
    )
    heard.forget()
    began_s = time.monotonic()
    try:
        fault.begin(graph)
        wire.wait(lambda: time.monotonic() >= began_s + fault.lasts_s, fault.lasts_s)
        wire.wait(lambda: heard.happened(bounds, began_s, time.monotonic()), fault.patience_s)
        ended_s = time.monotonic()
        fault.end(graph)
    except UsageError as error:
        return Trial.not_begun(str(error))
    recovered = wire.wait(
        lambda: heard.working_since(ended_s) and heard.spoken_since(ended_s, fault.joins), _RECOVERY_S
    )
    trial = judged(heard, bounds, began_s, ended_s, time.monotonic() if recovered else None)
    trial = replace(trial, reason=trial.reason.replace(f"{graph.logs}/", ""))
    lost_s = graph.lost_s()
    if lost_s is None:
        return trial
    said = f"the bag lacks the last {lost_s:.2f} s"
    problems = [*trial.problems, *([f"{said}, at most {_LOST_S:g} s are allowed"] if lost_s > _LOST_S else [])]
    return replace(trial, reason=trial.reason or said, problems=tuple(problems))


def _count(rows: Sequence[Row]) -> str:
    verdicts = Counter(row.verdict for row in rows)
    return ", ".join(f"{verdicts[verdict]} {verdict}" for verdict in ("passed", "failed", "open"))


_COLUMNS = (
    Column("fault", lambda row: row.fault.name),
    Column("expected", lambda row: row.fault.expected),
    Column("observed", lambda row: row.observed),
    Column("time to hold", lambda row: row.figures("hold_s"), unit="s"),
    Column("time to rest", lambda row: row.figures("rest_s"), unit="s"),
    Column("reason given", lambda row: row.reason),
    Column("recovered", lambda row: row.figures("recovered_s", ".1f"), unit="s"),
    Column("caught again", lambda row: row.again),
)


def page(rows: Sequence[Row], notes: Sequence[str]) -> str:
    """Return the table as a Markdown page."""
    lines = [
        "# Faults",
        "",
        "Made by `humanpred bench faults`, which puts every fault into the running graph (processes that talk over "
        "DDS, real time) while the arm moves, twice. Not safety-rated.",
        "",
        f"{_count(rows)}. Asked for: the reason that is expected; rest within {MAX_AGE_S + STOPPING_S:.2f} s, which is "
        f"{MAX_AGE_S:g} s without usable data and the arm's stopping time at the speed used (a tenth of the velocity "
        f"limits; more at more), and {GUARD_S + STOPPING_S:.2f} s where a guard counts; no "
        f"trajectory that begins farther than {GAP_RAD:.2f} rad from where the arm is; work "
        "again afterwards. Times are those of the first and the second time, from the moment the fault was put in. "
        "Where the fault itself stands the arm still, the time to hold tells. Recovery counts from the end of the "
        "fault, and includes the start of a node where one is started.",
        "",
        *notes,
        "",
        "| " + " | ".join(column.head for column in _COLUMNS) + " |",
        "|" + "---|" * len(_COLUMNS),
        *("| " + " | ".join(_cell(column.text(row)) for column in _COLUMNS) + " |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
