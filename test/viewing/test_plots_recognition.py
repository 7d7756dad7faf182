"""The plot of an evaluation shows every curve with its figures, whatever classifiers there are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.viewing.figures import report_style
from humanpred_ros.viewing.plots_recognition import RecognitionCurves, recognition_plot, save_recognition_plot

PERCENTS = np.arange(1, 101) / 100


def curves(name: str, *, speaks: bool, first: int | None = 30) -> RecognitionCurves:
    bins = np.arange(10)
    confidence = np.where(bins < 2, np.nan, bins / 10 + 0.05)
    quartiles = np.stack([0.2 * PERCENTS, 0.5 * PERCENTS, 0.8 * PERCENTS]) if speaks else None
    other = 0.2 * quartiles if quartiles is not None else None
    return RecognitionCurves(name, PERCENTS**0.5, first, confidence, confidence, bins * 10, 0.03, other, quartiles)


def test_curves_stand_beside_the_published_one() -> None:
    with report_style():
        figure = recognition_plot([curves("gmm", speaks=False), curves("new", speaks=True)], PERCENTS, 50)
    rates, reliability, unknown = figure.axes
    legend = [text.get_text() for text in rates.get_legend().get_texts()]
    assert legend == ["published: 50 %", "gmm: 30 %", "new: 30 %"]
    drawn = [line for line in rates.get_lines() if len(line.get_xdata()) == 100]
    np.testing.assert_allclose(drawn[0].get_ydata(), 100 * PERCENTS)
    np.testing.assert_allclose(drawn[1].get_ydata(), 100 * PERCENTS**0.5)
    assert "ECE 0.030" in reliability.get_legend().get_texts()[0].get_text()
    assert unknown.get_title("left").startswith("new")


@pytest.mark.parametrize("count", [1, 3])
def test_a_classifier_that_says_something_about_unknown_motions_has_a_panel(count: int) -> None:
    figure = recognition_plot([curves(f"c{k}", speaks=True) for k in range(count)])
    assert len(figure.axes) == 2 + count


def test_nothing_said_is_said_so_and_never_is_never(tmp_path: Path) -> None:
    figure = recognition_plot([curves("gmm", speaks=False, first=None)])
    assert "never" in figure.axes[0].get_legend().get_texts()[0].get_text()
    assert "no classifier" in figure.axes[2].texts[0].get_text()
    save_recognition_plot(tmp_path / "plot.png", [curves("gmm", speaks=False)])
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")
