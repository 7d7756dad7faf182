"""The plots of a run as files for a paper, and its table of decisions, with what they were made with."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from humanpred_ros import __version__
from humanpred_ros.errors import UsageError
from humanpred_ros.resources import replacing
from humanpred_ros.viewing.analysis import Analysis, RunSummary, analyse
from humanpred_ros.viewing.figures import WIDTH_IN, report_style
from humanpred_ros.viewing.reliability import reliability_plot
from humanpred_ros.viewing.report import PLOTS
from humanpred_ros.viewing.run import read_run

_DPI = 300


def save_figures(run: Path, folder: Path, kind: str, width_in: float, namespace: str | None = None) -> None:
    """Write every plot that has something to show, and `decisions.csv`.

    Args:
        run: folder of the run.
        folder: to write to; made if it is not there.
        kind: pdf, png or svg.
        width_in: of the widest plots; heights, letters and lines shrink with it.
        namespace: of the robot; only needed where the bag holds several.

    Raises:
        BagError: there is no complete run.
        UsageError: the files cannot be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as trouble:
        raise UsageError(f"--figures: wanted a folder to write to, got {folder} ({trouble.strerror})") from trouble
    analysis = analyse(read_run(run, namespace))
    drawn: dict[str, Callable[[Analysis], Figure]] = {
        **PLOTS,
        "calibration": lambda analysis: reliability_plot(analysis.summary.calibration),
    }
    keywords = {"svg": {"Date": None}, "pdf": {"CreationDate": None, "Subject": f"humanpred_ros {__version__}, {run}"}}
    for name, draw in drawn.items():
        with report_style():
            figure = draw(analysis)
            if figure.get_label():
                continue  # there is nothing to draw
            wide_in, high_in = (float(size) for size in figure.get_size_inches())
            scale = width_in / WIDTH_IN
            for text in figure.findobj(Text):
                text.set_fontsize(float(text.get_fontsize()) * scale)
            for line in figure.findobj(Line2D):
                line.set(linewidth=line.get_linewidth() * scale, markersize=line.get_markersize() * scale)
            figure.set_size_inches(wide_in * scale, high_in * scale)
            with replacing(folder / f"{name}.{kind}") as part:
                figure.savefig(
                    part, format=kind, dpi=_DPI, facecolor="white", bbox_inches="tight", metadata=keywords.get(kind)
                )
    with replacing(folder / "decisions.csv") as part, part.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(_rows(analysis.summary))


def _rows(summary: RunSummary) -> Iterator[list[Any]]:
    """Yield the steps, one a row, and below them what the run was made with."""
    names = ["step", "action", "t_s", "percent", "best_class", "best_probability", "chosen", "switched", "compute_ms",
             "margin", "reason"]  # fmt: skip
    yield [*names, *(f"cost {goal}" for goal in summary.goals)]
    for row in summary.steps:
        told = dataclasses.asdict(row)
        yield [*(told[name] for name in names), *(row.costs.get(goal) for goal in summary.goals)]
    for name, value in {"version": __version__, **summary.facts}.items():
        yield ["made with", name, value]
