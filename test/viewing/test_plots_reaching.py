"""The plot of reaches is drawn for any number of recordings and predictors, and without the parts that were not run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from humanpred_ros.viewing.plots_reach_figures import (
    CostBySamples,
    DistanceBar,
    DistanceBars,
    WeightDots,
    draw_cost_by_samples,
    draw_distances,
    draw_weights,
)
from humanpred_ros.viewing.plots_reaching import ReachingPlot, WristPaths, save_reaching_plot

NOTHING = (float("nan"),) * 3


def bar(name: str, value: float, published: tuple[float, float, float] = NOTHING) -> DistanceBar:
    return DistanceBar(name, 0, (value,) * 3, (0.9 * value,) * 3, (1.1 * value,) * 3, published)


def bars(*values: float) -> DistanceBars:
    return DistanceBars("some", [bar(f"predictor {k}", value) for k, value in enumerate(values)], "predictor 0")


def paths(count: int) -> list[WristPaths]:
    path = np.cumsum(np.ones((30, 3)), axis=0)
    return [WristPaths(f"r{k}", path, {f"predictor {j}": path[: 20 + j] for j in range(9)}) for k in range(count)]


SAMPLES = CostBySamples((3, 10), {"learned": np.array([[3.0, 2.0, 4.0], [1.0, 0.5, 2.0]])}, 5.0, "line")
WEIGHTS = WeightDots(("a", "b"), np.ones((3, 2)), np.zeros(2), "authors")


@pytest.mark.parametrize(
    "plot",
    [
        ReachingPlot(paths(5), [bars(1.0, 2.0), bars(3.0)], SAMPLES, WEIGHTS),
        ReachingPlot(paths(1), [bars(1.0)], None, WEIGHTS),
        ReachingPlot([], [bars(1.0)]),
    ],
    ids=["all", "some", "few"],
)
def test_a_picture_is_written(tmp_path: Path, plot: ReachingPlot) -> None:
    save_reaching_plot(tmp_path / "plot.png", plot)
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_published_figures_are_marked_where_there_are_some() -> None:
    panels = list(Figure().subplots(1, 3))
    shown = DistanceBars("some", [bar("a", 2.0), bar("b", 3.0, (2.5, 3.5, float("nan")))], "nobody")
    draw_distances(panels, shown)
    marked = [[float(line.get_xdata()[0]) for line in axes.lines if line.get_marker() == "D"] for axes in panels]
    assert marked == [[2.5], [3.5], []]


def test_one_that_would_dwarf_all_others_is_cut_off_but_told() -> None:
    panels = list(Figure().subplots(1, 3))
    draw_distances(panels, bars(20.0, 22.0, 120.0))
    assert panels[0].get_xlim()[1] < 60.0
    assert "120.0" in [text.get_text().strip() for text in panels[0].texts]


def test_parts_that_were_not_run_say_so() -> None:
    first, second = Figure().subplots(1, 2)
    draw_cost_by_samples(first, None)
    draw_weights(second, None)
    assert [len(axes.texts) for axes in (first, second)] == [1, 1]
