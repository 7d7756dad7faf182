"""What a node costs the machine, read from /proc, because a monitor of processes would be one more dependency."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from humanpred_ros.evaluation.processes import NodeProcess

_POLL_S = 0.05
#: A node that has used less than this share of a core for this long has finished starting.
_RESTING_SHARE, _RESTING_S = 0.25, 0.6
_LEAST_AGE_S = 1.0


@dataclass(frozen=True)
class Usage:
    """Processor time used so far, s, and the most memory held, MB (resident)."""

    cpu_s: float
    memory_mb: float


@dataclass(frozen=True)
class NodeUsage:
    """A node while postures came: mean share of one core, percent, and the most memory held, MB."""

    node: str
    cpu_percent: float
    memory_mb: float


def usage_of(pid: int) -> Usage | None:
    """Return what a process has used; None if it has ended or the system does not tell."""
    try:
        # The name in brackets may hold blanks; times are the 12th and 13th column after it.
        columns = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        status = Path(f"/proc/{pid}/status").read_text(encoding="ascii", errors="replace").splitlines()
        cpu_s = (int(columns[11]) + int(columns[12])) / os.sysconf("SC_CLK_TCK")
        peak_kb = next(int(line.split()[1]) for line in status if line.startswith(("VmHWM:", "VmRSS:")))
    except (OSError, ValueError, IndexError, StopIteration):
        return None
    return Usage(cpu_s, peak_kb / 1024.0)


class UsageMeter:
    """Measures nodes from `begin` on; `note` as often as possible, for nodes that end."""

    def __init__(self, nodes: Sequence[NodeProcess]) -> None:
        self._nodes = tuple(nodes)
        self._first: dict[str, tuple[float, Usage]] = {}
        self._last: dict[str, tuple[float, Usage]] = {}

    def note(self) -> None:
        """Measure once."""
        for node in self._nodes:
            usage = usage_of(node.process.pid) if node.running else None
            if usage is not None:
                entry = (time.perf_counter(), usage)
                self._first.setdefault(node.name, entry)
                self._last[node.name] = entry

    def result(self) -> tuple[NodeUsage, ...]:
        """Return what each node used between the first and the last measurement."""
        found = []
        for name, (begin_s, begin) in self._first.items():
            end_s, end = self._last[name]
            share = (end.cpu_s - begin.cpu_s) / (end_s - begin_s) if end_s > begin_s else float("nan")
            found.append(NodeUsage(name, 100.0 * share, end.memory_mb))
        return tuple(found)


def wait_until_resting(nodes: Sequence[NodeProcess], check: Callable[[], None], limit_s: float) -> None:
    """Return when every node has finished starting, which shows in that it uses next to no processor time.

    Args:
        nodes: that were started.
        check: raises if one has failed.
        limit_s: longest wait; at once where the system does not tell.
    """
    begun = time.monotonic()
    since: dict[str, tuple[float, float]] = {}  # when each was last busy, and its processor time then
    while time.monotonic() - begun < limit_s:
        check()
        now, busy = time.monotonic(), False
        for node in nodes:
            usage = usage_of(node.process.pid)
            if usage is None:
                continue
            since_s, then_s = since.setdefault(node.name, (now, usage.cpu_s))
            if usage.cpu_s - then_s > _RESTING_SHARE * _RESTING_S:
                since[node.name] = (now, usage.cpu_s)
                busy = True
            elif now - since_s < _RESTING_S:
                busy = True
        if not busy and now - begun > _LEAST_AGE_S:
            return
        time.sleep(_POLL_S)
