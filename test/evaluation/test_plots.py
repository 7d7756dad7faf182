"""The plots of evaluations show every curve with its figures, whatever was compared."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from humanpred_ros.evaluation.plots import recognition_plot
from humanpred_ros.evaluation.published import ReferenceCurve
from humanpred_ros.evaluation.recognition_scores import (
    Calibration,
    ClassifierResult,
    CurveFigures,
    UnknownScore,
)
from humanpred_ros.viewing.figures import report_style

SHARES = np.arange(1, 101) / 100
FIGURES = CurveFigures(30, None, 0.8, 0.9)


def classifier(name: str, *, speaks: bool, first: int | None = 30) -> ClassifierResult:
    bins = np.arange(10)
    confidence = np.where(bins < 2, np.nan, bins / 10 + 0.05)
    quartiles = np.stack([0.2 * SHARES, 0.5 * SHARES, 0.8 * SHARES])
    everything = {field.name: None for field in dataclasses.fields(ClassifierResult)}
    calibration = Calibration(0.04, 0.03, 0.0, 0.0, SHARES, bins * 10, confidence, confidence)
    unknown = UnknownScore(speaks, 0.5, SHARES, SHARES, SHARES, SHARES, 0.9, {}, {}, quartiles)
    figures = dataclasses.replace(FIGURES, first_50_percent=first)
    return ClassifierResult(  # type: ignore[arg-type]
        **{
            **everything,
            "name": name,
            "rate": SHARES**0.5,
            "figures": figures,
            "calibration": calibration,
            "unknown_quartiles": 0.2 * quartiles,
            "unknown": unknown,
        }
    )


def test_recognition_stands_beside_the_published_curve() -> None:
    published = ReferenceCurve("made up", SHARES, dataclasses.replace(FIGURES, first_50_percent=50))
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
