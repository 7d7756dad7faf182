"""Lets threads that watch come before everything that merely computes, so that a busy machine still stops in time."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from humanpred_ros.settings import Settings, setting

#: What the names of the threads begin with that bring messages.
DDS = "dds."
_THREADS = Path("/proc/self/task")


class PrioritySettings(Settings):
    """How a node's watching threads share the processor."""

    real_time_priority: int = setting(
        20, "the threads that watch and stop come before all that are not of this kind, where the system allows it "
        "(SCHED_FIFO); 0 asks for nothing", low=0, high=99,
    )  # fmt: skip


def threads_named(prefix: str = "") -> list[int]:
    """Return the system's ids of the threads of this process whose names begin so; none where it does not tell."""
    found = []
    for task in _THREADS.iterdir() if _THREADS.exists() else ():
        with suppress(OSError):  # one that has just ended
            if (task / "comm").read_text().startswith(prefix):
                found.append(int(task.name))
    return found


def come_first(priority: int, threads: Iterable[int]) -> str:
    """Let threads come before those that are not of this kind; return what came of it.

    They must work little and briefly: whoever is pushed aside does not notice. What they start afterwards comes first
    as well.

    Args:
        priority: of SCHED_FIFO, 1 to 99; 0 lets them be like all others.
        threads: their ids in the system (`threading.get_native_id`).
    """
    try:
        for thread in threads:
            with suppress(ProcessLookupError):
                os.sched_setscheduler(thread, os.SCHED_FIFO if priority else os.SCHED_OTHER, os.sched_param(priority))
    except (OSError, AttributeError) as trouble:
        return f"not allowed: {trouble}"
    return f"priority {priority}" if priority else "not asked for"
