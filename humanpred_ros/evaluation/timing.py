"""What the benchmarks share: figures of repeated measurements, what else the machine does, and the plot of growth."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator, ScalarFormatter, StrMethodFormatter

from humanpred_ros.viewing.figures import DASHES, MARKERS, SERIES, new_figure, plain_powers

_STAT = Path("/proc/stat")
#: Columns of the first line of /proc/stat: later ones (guests) are counted in the first two already; in these two no
#: program runs (idle, and waiting for a disk).
_COLUMNS, _IDLE_COLUMNS = 8, (3, 4)
_HEIGHT_IN = 3.2


@dataclass(frozen=True)
class Spread:
    """Figures of `n` measurements, in their unit; NaN where there are none."""

    median: float
    least: float
    most: float
    p99: float
    n: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        if not len(values):
            return cls(np.nan, np.nan, np.nan, np.nan, 0)
        median, p99 = np.quantile(values, (0.5, 0.99)).tolist()
        return cls(median, min(values), max(values), p99, len(values))


def durations_ms(call: Callable[[Any], object], arguments: Iterable[Any]) -> list[float]:
    """Return how long the call took with each argument."""
    durations = []
    gc.collect()
    for argument in arguments:
        begin = time.perf_counter()
        call(argument)
        durations.append(1e3 * (time.perf_counter() - begin))
    return durations


class MachineLoad:
    """Counts the cores used by programs that are neither this process nor its finished children, from now on."""

    def __init__(self) -> None:
        self._busy_s, self._own_s, self._at_s = _busy_s(), _own_s(), time.perf_counter()

    def other_cores(self) -> float | None:
        """Return the mean number of cores that others used so far; None where the system does not tell."""
        busy_s = _busy_s()
        if busy_s is None or self._busy_s is None:
            return None
        elapsed_s = max(time.perf_counter() - self._at_s, 1e-9)
        return max(0.0, (busy_s - self._busy_s - (_own_s() - self._own_s)) / elapsed_s)

    def notes(self) -> tuple[str, ...]:
        """Return what a reader of the times must know."""
        cores = self.other_cores()
        return () if cores is None else (f"Other programs used {cores:.2f} cores meanwhile.",)


def _busy_s() -> float | None:
    """Return the processor time used by all programs since the machine started."""
    try:
        columns = [int(text) for text in _STAT.read_text(encoding="ascii").splitlines()[0].split()[1 : 1 + _COLUMNS]]
    except (OSError, ValueError, IndexError):
        return None
    return (sum(columns) - sum(columns[k] for k in _IDLE_COLUMNS)) / os.sysconf("SC_CLK_TCK")


def _own_s() -> float:
    return sum(os.times()[:4])


def growth_plot(points: Iterable[tuple[str, int, str, float]], unit: str) -> Figure:
    """Return what times grow with, on axes where proportional is a diagonal.

    Args:
        points: what grows (a panel for each), how large it is, the name of the line, and the time.
        unit: of the times.
    """
    panels: dict[str, dict[str, list[tuple[int, float]]]] = {}
    for what, size, name, value in points:
        panels.setdefault(what, {}).setdefault(name, []).append((size, value))
    names = list(dict.fromkeys(name for lines in panels.values() for name in lines))
    figure = new_figure(_HEIGHT_IN)
    handles: dict[str, Any] = {}
    all_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (what, lines) in zip(all_axes, panels.items(), strict=True):
        axes.set_title(f"growth with {what}")
        for name, line in lines.items():
            k = names.index(name)
            style = {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % len(MARKERS)]}
            dashes = DASHES[k % len(DASHES)]
            handles[name] = axes.plot(*zip(*line, strict=True), linestyle=dashes, markersize=4.5, **style)[0]
        axes.set_xscale("log")
        axes.set_yscale("log")
        plain_powers(axes.xaxis)
        plain_powers(axes.yaxis)
        axes.set_xticks(sorted({size for line in lines.values() for size, _ in line}))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:.0f}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel(what)
    all_axes[0].set_ylabel(unit)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncol=min(len(handles), 3))
    return figure
