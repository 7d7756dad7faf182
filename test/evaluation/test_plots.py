"""The plots of evaluations show every curve with its figures, whatever was compared."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from humanpred_ros.evaluation.occupancy_report import Moment, occupancy_plot
from humanpred_ros.evaluation.recognition_report import recognition_plot
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.viewing.figures import report_style

SHARES = np.arange(1, 101) / 100


def classifier(name: str, *, speaks: bool, first: int | None = 30) -> dict[str, Any]:
    bins = np.arange(10)
    confidence = np.where(bins < 2, np.nan, bins / 10 + 0.05)
    quartiles = np.stack([0.2 * SHARES, 0.5 * SHARES, 0.8 * SHARES])
    return {
        "name": name,
        "rate": SHARES**0.5,
        "figures": {"first_50_percent": first},
        "calibration": {"error_pooled": 0.03, "count": bins * 10, "confidence": confidence, "right": confidence},
        "unknown_quartiles": 0.2 * quartiles,
        "unknown": {"says_something": speaks, "quartiles": quartiles},
    }


def test_recognition_stands_beside_the_published_curve() -> None:
    published = {"rate": SHARES, "figures": {"first_50_percent": 50}}
    with report_style():
        figure = recognition_plot([classifier("gmm", speaks=False), classifier("new", speaks=True)], published)
    rates, reliability, unknown = figure.axes
    legend = [text.get_text() for text in rates.get_legend().get_texts()]
    assert legend == ["published: 50 %", "gmm: 30 %", "new: 30 %"]
    drawn = [line for line in rates.get_lines() if len(line.get_xdata()) == 100]
    np.testing.assert_allclose(drawn[0].get_ydata(), 100 * SHARES)
    np.testing.assert_allclose(drawn[1].get_ydata(), 100 * SHARES**0.5)
    assert "ECE 0.030" in reliability.get_legend().get_texts()[0].get_text()
    assert unknown.get_title("left").startswith("new")


@pytest.mark.parametrize("count", [1, 3])
def test_a_classifier_that_says_something_about_unknown_motions_has_a_panel(count: int) -> None:
    assert len(recognition_plot([classifier(f"c{k}", speaks=True) for k in range(count)]).axes) == 2 + count


def test_nothing_said_is_said_so_and_never_is_never() -> None:
    figure = recognition_plot([classifier("gmm", speaks=False, first=None)])
    assert "never" in figure.axes[0].get_legend().get_texts()[0].get_text()
    assert "no classifier" in figure.axes[2].texts[0].get_text()


PERCENTS = (10, 40, 70)


def predictor(name: str) -> dict[str, Any]:
    bins = np.arange(11) / 10 - 0.05
    count = np.where(bins < 0.3, 0.0, 100 * bins)
    return {
        "name": name,
        "at_percent": {"squared_error": np.array([300.0, 200.0, 100.0]), "missed": np.array([0.3, np.nan, 0.1])},
        "calibration": {"count": count, "mean_probability": bins, "observed": bins**2, "error_predicted": 0.07},
    }


def moment(*names: str, swept: float = 1.0, predicted: float = 0.4) -> Moment:
    above = np.zeros((2, 30, 40), dtype=np.float32)
    above[0, 12:18, 14:20] = swept
    above[1, 10:20, 15:22] = predicted
    above[1, 0, 0] = 0.01  # far away and next to nothing
    grid = VoxelGrid((1.0, -2.0, 0.0), 0.05, (30, 40, 8))
    return Moment("motion 3/4, 40 % seen", dict.fromkeys(names, above), grid)


def test_every_predictor_has_its_curves_and_its_picture() -> None:
    with report_style():
        figure = occupancy_plot(PERCENTS, [predictor("current"), predictor("p1")], moment("current", "p1"))
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


def test_without_a_moment_there_is_no_second_row_and_nothing_swept_can_be_drawn() -> None:
    assert len(occupancy_plot(PERCENTS, [predictor("current")], None).subfigs[0].axes) == 3
    nothing = moment("current", swept=0.0, predicted=0.0)
    occupancy_plot(PERCENTS, [predictor("current")], nothing).draw_without_rendering()
