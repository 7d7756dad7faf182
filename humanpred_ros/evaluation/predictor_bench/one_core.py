"""What is promised of one core is measured on one core, where the system can hold a process to it."""

from __future__ import annotations

import os
from pathlib import Path


def hold_to_one_core(pid: int) -> None:
    """Let a process that has just started, and every thread it is going to start, use the last core of ours only.

    Where the system has no such thing nothing happens; `cores_of` tells.
    """
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(pid, {max(os.sched_getaffinity(0))})


def cores_of(pid: int) -> int | None:
    """Return how many cores the threads of a process may use together; None if it has ended or nobody can say."""
    if not hasattr(os, "sched_getaffinity"):
        return None
    try:
        threads = [int(thread.name) for thread in Path(f"/proc/{pid}/task").iterdir()]
        return len(set().union(*(os.sched_getaffinity(thread) for thread in threads)))
    except OSError:
        return None
