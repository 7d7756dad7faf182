"""Plots of evaluations of planning are drawn from whatever part of the figures there is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.viewing.plots_interference import CostBars, MethodDots, save_interference_plot
from humanpred_ros.viewing.plots_switching import CandidateCosts, StepsEarlier, save_switching_plot

BARS = CostBars("25", {"ours": (0.002, 0.001), "basic": (0.2, 0.5)}, {"ours": (0.4, 0.2), "basic": (24.0, 7.0)})
DOTS = MethodDots("ours", [0.1, -0.02, 0.3], [2.0, np.inf, 3.0])
COSTS = CandidateCosts("ours", ("red", "blue"), np.array([[1.0, 2.0], [np.nan, 0.0], [3.0, 0.1]]), 2)


@pytest.mark.parametrize(
    ("bars", "dots"),
    [([BARS], [DOTS]), ([], [DOTS]), ([CostBars("0", BARS.methods, None)], []), ([], []),
     ([BARS], [MethodDots("ours", [0.1], [np.inf])])],
)  # fmt: skip
def test_interference(tmp_path: Path, bars: list[CostBars], dots: list[MethodDots]) -> None:
    save_interference_plot(tmp_path / "plot.png", bars, dots)
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("panels", "gained"),
    [([COSTS] * 5, [StepsEarlier("ours", [3, 5, -1])]), ([COSTS], []), ([], [StepsEarlier("ours", [])]), ([], []),
     ([CandidateCosts("none", ("a", "b"), np.full((2, 2), np.nan), None)], [StepsEarlier("ours", [4])])],
)  # fmt: skip
def test_switching(tmp_path: Path, panels: list[CandidateCosts], gained: list[StepsEarlier]) -> None:
    save_switching_plot(tmp_path / "plot.png", panels, gained)
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"
