"""Bow and variation of reaches, and what is seen of one says about the rest."""

from __future__ import annotations

import numpy as np
import pytest
from small_library import REST, small_library

from humanpred_ros.errors import MotionError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import HAND, EndPosture, start_and_end
from humanpred_ros.reaching.reach_model import N_SHARES, ReachShape

HUMAN = HumanModel.kinect12()


def bowed(count: int, height: float, seed: int = 0) -> list[np.ndarray]:
    """Return reaches whose torso leans aside on the way, `height` radians in the middle for each metre."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, 60)[:, None]
    reaches = []
    for _ in range(count):
        end = REST.copy()
        end[8] += 0.8 + 0.3 * rng.random()
        way = np.linalg.norm(HUMAN.forward(end)[HAND] - HUMAN.forward(REST)[HAND])
        bow = np.zeros((60, 12))
        bow[:, 6] = (height * way * 4.0 * phase * (1.0 - phase))[:, 0]
        reaches.append(REST + phase * (end - REST) + bow)
    return reaches


def test_a_bow_common_to_all_is_found_and_ends_at_nothing() -> None:
    shape = ReachShape.learn(bowed(8, 0.2), HUMAN)
    bow = shape.bow_at(np.array([0.0, 0.5, 1.0]), 1.0)
    np.testing.assert_allclose(bow[[0, 2]], 0.0, atol=1e-12)
    assert bow[1, 6] == pytest.approx(0.2, abs=0.02)
    np.testing.assert_allclose(shape.bow_at(np.array([0.5]), 2.0), 2.0 * bow[1:2])


def test_variation_is_of_what_varies() -> None:
    same = ReachShape.learn(bowed(8, 0.2), HUMAN).variation
    mixed = ReachShape.learn([*bowed(4, 0.2), *bowed(4, -0.2, seed=1)], HUMAN).variation
    assert mixed[6, 6] > 10.0 * same[6, 6]
    assert (np.linalg.eigvalsh(mixed) > 0.0).all()


def test_somebody_who_leans_more_at_half_the_way_leans_more_at_its_end() -> None:
    shape = ReachShape(np.zeros((N_SHARES, 12)), 1e-4 * np.eye(12))
    start, end = small_library(1).motions[0].q[[0, -1]]
    usual = EndPosture(end, 0.01 * np.eye(12), 0.0)
    half = start + 0.5 * (end - start)
    half[4] += 0.05
    given = shape.given(usual, start, half, 0.5, 0.5)
    assert given.mean[4] - end[4] == pytest.approx(0.1, rel=0.15)
    np.testing.assert_allclose(np.delete(given.mean, 4), np.delete(end, 4), atol=1e-9)
    assert (np.diag(given.covariance) < np.diag(usual.covariance)).all()


def test_nothing_seen_says_nothing_and_all_seen_says_all() -> None:
    shape = ReachShape.learn(bowed(6, 0.1), HUMAN)
    usual = EndPosture(REST + 0.1, 0.01 * np.eye(12), 0.0)
    assert shape.given(usual, REST, REST, 0.0, 0.5) is usual
    done = shape.given(usual, REST, REST + 0.2, 1.0, 0.5)
    np.testing.assert_allclose(done.mean, REST + 0.2, atol=2e-3)


def test_a_hand_that_goes_nowhere_has_no_shape() -> None:
    with pytest.raises(MotionError, match="goes somewhere"):
        ReachShape.learn([np.tile(REST, (30, 1))], HUMAN)
    with pytest.raises(MotionError, match="reach 0"):
        ReachShape.learn([np.zeros((30, 3))], HUMAN)


def test_the_end_is_where_the_hand_is_farthest() -> None:
    q = small_library(1, there_and_back=True).motions[0].q
    start, end = start_and_end(q, HUMAN)
    hand = HUMAN.forward(q)[HAND]
    k = int(np.argmax(np.linalg.norm(hand - HUMAN.forward(start)[HAND], axis=1)))
    np.testing.assert_array_equal(end, q[k])
    assert 10 < k < 30
