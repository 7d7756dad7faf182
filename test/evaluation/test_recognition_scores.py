"""Scores are what their definitions say, agree with scikit-learn where it has them, and honour ties."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from humanpred_ros.evaluation.recognition_scores import (
    auroc,
    brier_score,
    calibration,
    confusion,
    curve_figures,
    decided_right,
    log_loss,
    percent_indices,
    quartiles,
    settled_percent,
    worst_drop,
)
from humanpred_ros.geometry.checks import FloatArray

metrics = pytest.importorskip("sklearn.metrics", reason="needs scikit-learn: install the `test` extra")


def posteriors(rng: np.random.Generator, n: int = 60, n_percents: int = 100, n_classes: int = 4) -> FloatArray:
    return rng.dirichlet(np.full(n_classes, 0.4), (n, n_percents))


@given(st.integers(2, 500))
def test_a_percent_is_seen_when_that_share_of_the_postures_is(n_frames: int) -> None:
    expected = [math.ceil(Fraction(p, 100) * n_frames) - 1 for p in range(1, 101)]
    assert percent_indices(n_frames).tolist() == expected
    assert expected[-1] == n_frames - 1


def test_only_a_strict_maximum_recognises() -> None:
    probability = np.array([[[0.5, 0.3, 0.2], [0.4, 0.4, 0.2], [0.1, 0.2, 0.7]]])
    assert decided_right(probability, np.array([0])).tolist() == [[True, False, False]]
    assert decided_right(probability, np.array([1])).tolist() == [[False, False, False]]


def test_equal_probabilities_recognise_nothing() -> None:
    assert not decided_right(np.full((3, 5, 4), 0.25), np.array([0, 1, 3])).any()


def test_a_rate_settles_where_it_stays() -> None:
    rate = np.zeros(100)
    rate[[20, 21]] = 0.9
    rate[42:] = 0.5
    rate[60:] = 0.1 + 0.4  # rounding must not matter
    assert settled_percent(rate, 0.5) == 43
    assert settled_percent(rate, 0.0) == 1
    rate[-1] = 0.49
    assert settled_percent(rate, 0.5) is None


def test_figures_of_a_curve_are_read_at_the_right_percents() -> None:
    rate = np.arange(1, 101) / 100
    figures = curve_figures(rate)
    assert (figures["first_50_percent"], figures["first_90_percent"]) == (50, 90)
    assert (figures["rate_at_60"], figures["least_from_80"]) == (0.6, 0.8)


def test_the_worst_drop_counts_beyond_forty_percent_only() -> None:
    rate, other = np.full(100, 0.9), np.full(100, 0.88)
    other[39] = 0.1  # 40 %
    other[70] = 0.8
    assert worst_drop(rate, other) == (pytest.approx(10.0), 71)
    assert worst_drop(other, rate)[0] == pytest.approx(-2.0)


@pytest.mark.parametrize("clip", [1e-15, 1e-3, 0.2])
def test_log_loss_agrees_with_scikit_learn(clip: float) -> None:
    rng = np.random.default_rng(1)
    probability, truth = posteriors(rng, n_percents=3), rng.integers(0, 4, 60)
    probability[:5, 0] = np.eye(4)[(truth[:5] + 1) % 4]  # given up for certain
    for k in range(3):
        true = np.maximum(probability[np.arange(60), k, truth], clip)
        # Two classes that sum to 1, so that scikit-learn has no reason to normalise.
        expected = metrics.log_loss(np.ones(60), np.column_stack([1 - true, true]), labels=[0, 1])
        assert log_loss(probability, truth, clip)[k] == pytest.approx(expected)


def test_brier_score_is_twice_scikit_learns_for_two_classes() -> None:
    rng = np.random.default_rng(2)
    probability, truth = posteriors(rng, n_percents=2, n_classes=2), rng.integers(0, 2, 60)
    for k in range(2):
        expected = 2 * metrics.brier_score_loss(truth, probability[:, k, 1])
        assert brier_score(probability, truth)[k] == pytest.approx(expected)


def test_brier_score_of_certainties() -> None:
    certain = np.eye(3)[[0, 1]][:, None]
    assert brier_score(certain, np.array([0, 1])).tolist() == [0.0]
    assert brier_score(certain, np.array([1, 0])).tolist() == [2.0]


def test_calibration_error_by_hand() -> None:
    # Two motions, two percents: bins 0.6 (right) and 0.9 (wrong), then both 0.8 (one right).
    confidence = np.array([[0.62, 0.82], [0.92, 0.86]])
    right = np.array([[True, True], [False, False]])
    found = calibration(confidence, right, np.random.default_rng(0))
    np.testing.assert_allclose(found["error"], [(0.38 + 0.92) / 2, abs(1 - 0.82 - 0.86) / 2])
    assert found["error_mean"] == pytest.approx(found["error"].mean())
    assert found["error_pooled"] == pytest.approx((0.38 + 0.92 + 0.68) / 4)
    assert found["count"].tolist() == [0, 0, 0, 0, 0, 0, 1, 0, 2, 1]
    assert found["right"][8] == 0.5
    assert found["confidence"][8] == pytest.approx(0.84)
    assert np.isnan(found["right"][0])


def test_certainty_falls_into_the_last_bin() -> None:
    found = calibration(np.ones((4, 2)), np.ones((4, 2), bool), np.random.default_rng(0))
    assert found["count"][9] == 8
    assert (found["error_mean"], found["floor_mean"]) == (0.0, 0.0)


def test_a_calibrated_classifier_is_at_its_floor_and_an_overconfident_one_above() -> None:
    rng = np.random.default_rng(3)
    confidence = np.clip(rng.beta(2, 2, (200, 1)) + rng.normal(0, 0.1, (200, 100)), 0.2, 0.99)
    n_draws, mean, pooled = 40, [], []
    for _ in range(n_draws):
        found = calibration(confidence, rng.random((200, 1)) < confidence, rng, 20)
        mean.append(found["error_mean"])
        pooled.append(found["error_pooled"])
    assert np.mean(mean) == pytest.approx(found["floor_mean"], rel=0.1)
    assert np.mean(pooled) == pytest.approx(found["floor_pooled"], rel=0.25)
    assert found["floor_mean"] > 0.05  # 200 motions: the reason why the floor is reported
    overconfident = calibration(confidence, rng.random((200, 1)) < confidence - 0.2, rng, 20)
    assert overconfident["error_mean"] > 2 * overconfident["floor_mean"]


def test_calibration_is_reproducible() -> None:
    rng = np.random.default_rng(4)
    confidence = rng.random((30, 100))
    right = rng.random((30, 100)) < 0.5
    one, two = (calibration(confidence, right, np.random.default_rng(7)) for _ in range(2))
    assert (one["floor_mean"], one["floor_pooled"]) == (two["floor_mean"], two["floor_pooled"])


def test_confusion_agrees_with_scikit_learn_and_sets_ties_apart() -> None:
    rng = np.random.default_rng(5)
    probability, truth = posteriors(rng, n_percents=1)[:, 0], rng.integers(0, 4, 60)
    expected = metrics.confusion_matrix(truth, probability.argmax(axis=1), labels=range(4))
    np.testing.assert_array_equal(confusion(probability, truth)[:, :-1], expected)
    probability[3] = 0.25
    counts = confusion(probability, truth)
    assert counts[truth[3], -1] == counts[:, -1].sum() == 1
    assert counts.sum() == 60
    assert np.trace(counts) == decided_right(probability[:, None], truth).sum()


SCORES = hnp.arrays(np.float64, st.integers(1, 30), elements=st.sampled_from([0.0, 0.1, 0.5, 0.5000001, 1.0]))


@given(SCORES, SCORES)
def test_auroc_agrees_with_scikit_learn_ties_included(positive: FloatArray, negative: FloatArray) -> None:
    truth = np.concatenate([np.ones(len(positive)), np.zeros(len(negative))])
    expected = metrics.roc_auc_score(truth, np.concatenate([positive, negative]))
    assert auroc(positive, negative) == pytest.approx(expected)
    assert auroc(positive, negative) + auroc(negative, positive) == pytest.approx(1.0)


def test_quartiles_are_over_motions() -> None:
    values = np.column_stack([np.arange(5.0), np.zeros(5)])
    assert quartiles(values).tolist() == [[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]
