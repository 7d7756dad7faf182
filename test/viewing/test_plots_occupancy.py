"""The plot of an evaluation of occupancy draws every predictor, with and without a moment to show."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.viewing.figures import report_style
from humanpred_ros.viewing.plots_occupancy import Moment, OccupancyCurves, occupancy_plot, save_occupancy_plot

PERCENTS = (10, 40, 70)


def curves(name: str, *, drawn: bool = True) -> OccupancyCurves:
    bins = np.arange(10) / 10 + 0.05
    above = np.zeros((30, 40), dtype=np.float32)
    above[10:20, 15:22] = 0.4
    above[0, 0] = 0.01  # far away and next to nothing
    count = np.where(bins < 0.3, 0.0, 100 * bins)
    return OccupancyCurves(
        name, np.array([300.0, 200.0, 100.0]), np.array([0.3, np.nan, 0.1]), bins, bins**2, count, 0.07,
        above if drawn else None,
    )  # fmt: skip


def moment() -> Moment:
    swept = np.zeros((30, 40), dtype=np.float32)
    swept[12:18, 14:20] = 1.0
    return Moment("motion 3/4, 40 % seen", swept, (1.0, -2.0, 0.0), 0.05)


def test_every_predictor_has_its_curves_and_its_picture() -> None:
    with report_style():
        figure = occupancy_plot(PERCENTS, [curves("current"), curves("p1")], moment())
    upper, lower = figure.subfigs
    errors, missed, reliability = upper.axes
    assert [text.get_text() for text in upper.legends[0].get_texts()] == ["current", "p1"]
    np.testing.assert_array_equal(errors.get_lines()[0].get_ydata(), [300.0, 200.0, 100.0])
    np.testing.assert_array_equal(missed.get_lines()[1].get_ydata(), [30.0, np.nan, 10.0])
    assert "p1 (error 0.07)" in [text.get_text() for text in reliability.get_legend().get_texts()]
    titles = [axes.get_title("left") for axes in lower.axes]
    assert titles[:3] == ["motion 3/4, 40 % seen\nreally swept", "current", "p1"]
    # The picture is cut to what matters, in metres of the world.
    x0, x1, y0, y1 = lower.axes[1].get_images()[0].get_extent()
    assert (x0, x1, y0, y1) == pytest.approx((1.35, 2.15, -1.45, -0.75))


def test_without_a_moment_there_is_no_second_row(tmp_path: Path) -> None:
    figure = occupancy_plot(PERCENTS, [curves("current", drawn=False)], None)
    assert len(figure.subfigs[0].axes) == 3
    file = tmp_path / "plot.png"
    save_occupancy_plot(file, PERCENTS, [curves("current", drawn=False)], None)
    assert file.read_bytes().startswith(b"\x89PNG")


def test_one_predictor_and_nothing_swept(tmp_path: Path) -> None:
    nothing = Moment("gone", np.zeros((30, 40), dtype=np.float32), (0.0, 0.0, 0.0), 0.05)
    save_occupancy_plot(tmp_path / "plot.png", PERCENTS, [curves("current")], nothing)
