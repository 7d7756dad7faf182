"""Scores of voxel probabilities: known values, agreement with scikit-learn, and what makes them comparable."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import average_precision_score, brier_score_loss
from sklearn.metrics import log_loss as sklearn_log_loss

from humanpred_ros.errors import ArrayError
from humanpred_ros.evaluation.occupancy_scores import (
    BIN_EDGES,
    LOG_CLIP,
    Reliability,
    average_precision,
    log_loss,
    missed_share,
    squared_error,
    voxel_scores,
)


@st.composite
def predictions(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Return probabilities, many of them equal, and truths."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = draw(st.integers(2, 300))
    p = np.round(rng.random(n), draw(st.integers(0, 3)))
    y = rng.random(n) < draw(st.sampled_from([0.05, 0.5, 0.95]))
    return p, y


@settings(max_examples=100)
@given(predictions())
def test_agrees_with_scikit_learn(prediction: tuple[np.ndarray, np.ndarray]) -> None:
    p, y = prediction
    n = len(p)
    assert squared_error(p, y) / n == pytest.approx(brier_score_loss(y, p, labels=[False, True]))
    assert log_loss(p, y) / n == pytest.approx(sklearn_log_loss(y, np.clip(p, *LOG_CLIP), labels=[False, True]))
    if y.any():
        assert average_precision(p, y) == pytest.approx(average_precision_score(y, p))
    else:
        assert math.isnan(average_precision(p, y))


@settings(max_examples=50)
@given(predictions(), st.integers(0, 2**32))
def test_the_order_of_voxels_does_not_matter(prediction: tuple[np.ndarray, np.ndarray], seed: int) -> None:
    p, y = prediction
    order = np.random.default_rng(seed).permutation(len(p))
    for score in (squared_error, log_loss, average_precision, missed_share):
        assert score(p, y) == pytest.approx(score(p[order], y[order]), nan_ok=True)


def test_known_values() -> None:
    y = np.array([True, True, False, False])
    assert squared_error([1.0, 0.5, 0.5, 0.0], y) == 0.5
    assert log_loss([0.0, 0.5, 0.5, 1.0], y) == pytest.approx(-2 * math.log(0.001) + 2 * math.log(2))
    assert average_precision([0.9, 0.8, 0.1, 0.0], y) == 1.0
    assert average_precision([0.5, 0.5, 0.5, 0.5], y) == 0.5
    # A binary prediction: what it finds at its precision, the rest at the base rate.
    assert average_precision([1.0, 0.0, 1.0, 0.0], y) == pytest.approx(0.5 * 0.5 + 0.5 * 0.5)
    assert missed_share([0.01, 0.0099, 0.0, 0.0], y) == 0.5
    assert math.isnan(missed_share([0.1], [False]))


def test_truth_told_with_certainty_is_perfect_and_the_opposite_is_the_worst() -> None:
    y = np.random.default_rng(0).random(1000) < 0.2
    region = np.ones(1000, dtype=bool)
    right, wrong = voxel_scores(y.astype(float), y, region), voxel_scores(1.0 - y, y, region)
    assert (right.brier, right.average_precision, right.missed) == (0.0, 1.0, 0.0)
    assert right.log_loss == pytest.approx(-math.log(0.999))
    assert right.reliability.error == 0.0
    assert (wrong.brier, wrong.missed) == (1.0, 1.0)
    assert wrong.log_loss == pytest.approx(-math.log(0.001))
    assert wrong.reliability.error == 1.0


def test_nothing_predicted_outside_the_region_is_lost() -> None:
    rng = np.random.default_rng(1)
    p, y = np.zeros(1000), np.zeros(1000, dtype=bool)
    p[:100], y[:100] = rng.random(100), rng.random(100) < 0.5
    p[500:520] = 0.5  # outside
    y[700] = True
    narrow, wide = np.arange(1000) < 100, np.arange(1000) < 400
    a, b = voxel_scores(p, y, narrow), voxel_scores(p, y, wide)
    assert a.squared_error == b.squared_error == pytest.approx(squared_error(p, y))
    assert a.brier == pytest.approx(a.squared_error / 100)
    assert b.brier == pytest.approx(b.squared_error / 400)
    assert a.missed == b.missed == missed_share(p, y)
    assert (a.n_swept, a.n_predicted) == (int(y.sum()), pytest.approx(p.sum()))
    # Ratios of Brier scores do not depend on the region.
    c, d = voxel_scores(y * 0.7, y, narrow), voxel_scores(y * 0.7, y, wide)
    assert a.brier / c.brier == pytest.approx(b.brier / d.brier)


def test_reliability_puts_edges_into_the_bin_above() -> None:
    table = Reliability.of(list(BIN_EDGES), [False] * len(BIN_EDGES))
    assert table.count.tolist() == [1] * 10 + [2]
    assert table.count.sum() == len(BIN_EDGES)


def test_reliability_of_what_happens_as_often_as_told() -> None:
    rng = np.random.default_rng(2)
    p = rng.random(200_000)
    table = Reliability.of(p, rng.random(len(p)) < p)
    np.testing.assert_allclose(table.observed[1:], table.mean_probability[1:], atol=0.015)
    assert table.error < 0.005
    too_sure = Reliability.of(np.sqrt(p), rng.random(len(p)) < p)
    assert too_sure.error > 0.1


def test_tables_add_up() -> None:
    rng = np.random.default_rng(3)
    p, y = rng.random(500), rng.random(500) < 0.3
    both = Reliability.of(p, y)
    added = Reliability.none() + Reliability.of(p[:200], y[:200]) + Reliability.of(p[200:], y[200:])
    np.testing.assert_array_equal(added.count, both.count)
    np.testing.assert_allclose(added.observed, both.observed)
    assert added.error == pytest.approx(both.error)
    assert math.isnan(Reliability.none().error)
    assert np.isnan(Reliability.none().observed).all()


def test_next_to_nothing_does_not_hide_errors_elsewhere() -> None:
    p, y = np.zeros(10_000), np.zeros(10_000, dtype=bool)
    p[:100] = 0.9
    table = Reliability.of(p, y)
    assert table.error == pytest.approx(0.009)
    assert table.error_predicted == pytest.approx(0.9)


@pytest.mark.parametrize("p", [[0.5, 1.5], [-0.1, 0.5], [np.nan, 0.5], [0.5]])
def test_what_is_no_probability_is_refused(p: list[float]) -> None:
    for score in (squared_error, log_loss, average_precision, missed_share, Reliability.of):
        with pytest.raises(ArrayError):
            score(p, [True, False])
    with pytest.raises(ArrayError):
        voxel_scores(p, [True, False], np.array([True, True]))


def test_an_empty_region_is_refused() -> None:
    with pytest.raises(ArrayError, match="region"):
        voxel_scores([0.5], [True], np.array([False]))
