"""How busy the machine was with other things while a benchmark ran: what its figures have to be read with."""

from __future__ import annotations

import os
import time
from pathlib import Path

_STAT = Path("/proc/stat")
#: Columns of the first line of /proc/stat in which no program runs: idle and waiting for a disk.
_IDLE_COLUMNS = (3, 4)
_COLUMNS = 8  # later ones (guests) are counted in the first two already


class OthersCores:
    """Counts the cores used by programs that are neither this process nor its finished children, from now on."""

    def __init__(self) -> None:
        self._busy_s, self._own_s, self._at_s = _busy_s(), _own_s(), time.perf_counter()

    def mean(self) -> float | None:
        """Return the mean number of cores used by others so far; None where the system does not tell."""
        busy_s = _busy_s()
        if busy_s is None or self._busy_s is None:
            return None
        elapsed_s = max(time.perf_counter() - self._at_s, 1e-9)
        return max(0.0, (busy_s - self._busy_s - (_own_s() - self._own_s)) / elapsed_s)


def _busy_s() -> float | None:
    """Return the processor time used by all programs since the machine started."""
    try:
        columns = [int(text) for text in _STAT.read_text(encoding="ascii").splitlines()[0].split()[1 : 1 + _COLUMNS]]
    except (OSError, ValueError, IndexError):
        return None
    return (sum(columns) - sum(columns[k] for k in _IDLE_COLUMNS)) / os.sysconf("SC_CLK_TCK")


def _own_s() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system
