"""The last half minute in charts of a page: posterior, cost of every task, least distance; holds are grey."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros.errors import printable
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.viewing.figures import CLASSES, MUTED

LASTS_S = 30.0
#: So often a sample is kept, and a chart is drawn anew: a browser draws a chart from the beginning each time.
SAMPLE_S, DRAWN_S = 0.2, 1.0
_HEIGHT_PX = 130
_HOLD = "hold"


class Sample(NamedTuple):
    """What is kept of a moment."""

    t_s: float
    posterior: Mapping[str, float]
    costs: Mapping[str, float]
    distance_m: float  #: NaN if it is not known
    held: bool


class Strip:
    """Three charts that share a time axis, which ends now."""

    def __init__(self, gui: Any, folder: Any, colour_of: Callable[[str], str]) -> None:
        """Add the charts to a folder of a page; `colour_of` says how what is called so is drawn, empty: anyhow."""
        self._gui, self._folder, self._colour_of = gui, folder, colour_of
        self._samples: deque[Sample] = deque()
        self._charts: dict[str, tuple[tuple[str, ...], Any]] = {}
        self._drawn_s = -np.inf

    def due(self, t_s: float) -> bool:
        """Return whether a moment is far enough from the last one to be kept."""
        return not self._samples or abs(t_s - self._samples[-1].t_s) >= SAMPLE_S

    def add(self, sample: Sample) -> None:
        """Keep a sample; one from before the last begins anew."""
        if self._samples and sample.t_s < self._samples[-1].t_s:
            self._samples.clear()
        self._samples.append(sample)
        while self._samples[0].t_s < sample.t_s - LASTS_S:
            self._samples.popleft()

    def draw(self, now_s: float) -> None:
        """Draw what was kept, if that was not done just now."""
        if not self._samples or abs(now_s - self._drawn_s) < DRAWN_S:
            return
        self._drawn_s = now_s
        for title, lines in (
            ("probability of each class", [sample.posterior for sample in self._samples]),
            ("cost of each task", [sample.costs for sample in self._samples]),
            ("least distance in cm", [{"distance": 100.0 * sample.distance_m} for sample in self._samples]),
        ):
            names = sorted({name for values in lines for name in values})
            if names:
                self._chart(title, {name: [values.get(name) for values in lines] for name in names})

    def _chart(self, title: str, lines: Mapping[str, list[float | None]]) -> None:
        t_s = np.array([sample.t_s for sample in self._samples])
        values = [_last_known([np.nan if v is None else v for v in line]) for line in lines.values()]
        top = max([float(v.max()) for v in values], default=1.0)
        held = np.where([sample.held for sample in self._samples], top, 0.0)
        data, names = (t_s - t_s[-1], held, *values), tuple(lines)
        before, chart = self._charts.get(title, ((), None))
        if chart is not None and before == names:
            chart.data = data
            return
        if chart is not None:
            chart.remove()
        series: list[dict[str, Any]] = [
            {"label": "s"},
            {"label": _HOLD, "stroke": MUTED, "fill": f"{MUTED}55", "width": 0, "points": {"show": False}},
            *(
                # The second cue, for those who do not see colours: dashes.
                {
                    "label": printable(name),
                    "stroke": self._colour_of(name) or CLASSES[k % len(CLASSES)],
                    "width": 2,
                    "dash": [[], [8, 3], [3, 3]][k % 3],
                }
                for k, name in enumerate(names)
            ),
        ]
        scales = {"x": {"time": False, "range": (-LASTS_S, 0.0)}}
        with self._folder:
            chart = self._gui.add_uplot(data, tuple(series), title=title, height=_HEIGHT_PX, scales=scales)
        self._charts[title] = names, chart


def _last_known(values: list[float]) -> FloatArray:
    """Return values (N,) with the last known one for each that is not; the first known before it, 0 if none is."""
    line = np.array(values, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(line))
    if not len(known):
        return np.zeros(len(line))
    filled: FloatArray = line[known[np.maximum(np.searchsorted(known, np.arange(len(line)), side="right") - 1, 0)]]
    return filled
