"""Calibration makes votes as sure as they are right; a reach to where no motion of the library goes is noticed."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import ArrayError
from humanpred_ros.recognition.calibration import COLUMNS, Calibration, Novelty
from humanpred_ros.recognition.reach_features import N_FEATURES, REACHED


def drawn(power: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return votes, reached distances and classes: the true probabilities are the votes raised to `power`."""
    rng = np.random.default_rng(seed)
    votes = rng.dirichlet(np.ones(4), len(power))
    true = votes ** power[:, None]
    true /= true.sum(axis=1, keepdims=True)
    label = (true.cumsum(axis=1) < rng.random((len(power), 1))).sum(axis=1)
    return votes, rng.uniform(0.0, 0.6, len(power)), np.minimum(label, 3)


def expected_calibration_error(p: np.ndarray, label: np.ndarray) -> float:
    confidence, right = p.max(axis=1), p.argmax(axis=1) == label
    bins = np.minimum((confidence * 10).astype(int), 9)
    gaps = [abs(confidence[bins == b].mean() - right[bins == b].mean()) * (bins == b).mean() for b in set(bins)]
    return float(sum(gaps))


@pytest.mark.parametrize("power", [0.3, 2.5])
def test_calibrated_votes_are_right_as_often_as_they_say(power: float) -> None:
    votes, reached, label = drawn(np.full(4000, power))
    calibration = Calibration.fit(votes, reached, label)
    votes, reached, label = drawn(np.full(4000, power), seed=1)
    p = calibration(votes, reached)
    assert expected_calibration_error(votes, label) > 0.1
    assert expected_calibration_error(p, label) < 0.04


def test_the_power_follows_the_reach() -> None:
    rng = np.random.default_rng(2)
    reached = rng.uniform(0.0, 0.6, 6000)
    votes, _, label = drawn(np.where(reached > 0.3, 3.0, 0.2))
    calibration = Calibration.fit(votes, reached, label)
    vote = np.array([[0.4, 0.3, 0.2, 0.1]])
    near, far = calibration(vote, np.array([0.05]))[0], calibration(vote, np.array([0.5]))[0]
    assert near.max() < 0.32 < 0.5 < far.max()


def test_probabilities_are_proper_and_keep_the_order() -> None:
    votes, reached, label = drawn(np.ones(500))
    fitted = Calibration.fit(votes, reached, label).parameters
    for parameters in (fitted, np.zeros(5), np.full(5, 50.0), np.full(5, -50.0)):
        p = Calibration(parameters)(votes, reached)
        np.testing.assert_allclose(p.sum(axis=1), 1.0, atol=1e-12)
        assert (p >= 0).all()
        order = np.take_along_axis(p, np.argsort(votes, axis=1), axis=1)
        assert (np.diff(order, axis=1) >= -1e-12).all()


def test_votes_of_nought_stay_possible() -> None:
    votes, reached, label = drawn(np.ones(500))
    p = Calibration.fit(votes, reached, label)(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([0.5]))
    assert (p > 0).all()


def test_wrong_parameters_are_refused() -> None:
    with pytest.raises(ArrayError, match="calibration"):
        Calibration(np.zeros(4))


RNG = np.random.default_rng(0)


def reach_to(goal: np.ndarray, n: int = 25) -> np.ndarray:
    """Return (n, F) features of one straight reach; only the columns that novelty looks at are filled."""
    palm = np.linspace(0.0, 1.0, n)[:, None] * (goal + RNG.normal(0.0, 0.02, 3))
    features = np.zeros((n, N_FEATURES), dtype=np.float32)
    features[:, COLUMNS[:3]], features[:, COLUMNS[3:]] = palm, palm
    features[:, REACHED] = np.linalg.norm(palm, axis=1)
    return features


GOALS = np.array([[0.6, x, 0.0] for x in (-0.4, -0.15, 0.1, 0.35)])


def learned(wild: bool = False) -> Novelty:
    motions = [reach_to(goal) for goal in GOALS for _ in range(8)]
    if wild:  # a mistracked motion of the first class, that goes where no class is
        motions[0] = reach_to(np.array([0.2, 0.9, 0.5]))
    first = np.arange(0, 25 * len(motions) + 1, 25)
    return Novelty.fit(np.vstack(motions), first, np.repeat(np.arange(4), 8))


def test_known_reaches_are_known_and_others_are_not() -> None:
    novelty = learned()
    known = np.array([novelty.log_ratio(reach_to(goal))[-1] for goal in GOALS for _ in range(5)])
    elsewhere = np.array([novelty.log_ratio(reach_to(np.array([0.2, 0.7, 0.4])))[-1] for _ in range(10)])
    assert (known < -1.0).mean() >= 0.9
    assert (elsewhere > 2.0).all()


def test_before_the_reach_begins_nothing_is_known() -> None:
    ratio = learned().log_ratio(reach_to(GOALS[1]))
    assert abs(ratio[0]) < 1.0
    assert ratio[-1] < ratio[0]


def test_one_mistracked_motion_does_not_make_its_place_known() -> None:
    novelty = learned(wild=True)
    assert novelty.log_ratio(reach_to(np.array([0.2, 0.9, 0.5])))[-1] > 2.0


def test_the_distance_is_that_to_the_second_nearest_motion() -> None:
    novelty = learned()
    features = reach_to(np.array([0.5, 0.5, 0.1]))
    x = features[:, COLUMNS]
    nearest = [
        np.linalg.norm(novelty.points[a:b] - x[-1], axis=1).min() / np.sqrt(2.0)
        for a, b in zip(novelty.first[:-1], novelty.first[1:], strict=True)
    ]
    np.testing.assert_allclose(novelty.distance_m(features)[-1], sorted(nearest)[1], rtol=1e-5)
