"""How far a reach has got."""

from __future__ import annotations

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import HAND
from humanpred_ros.reaching.progress import ReachProgress

HUMAN = HumanModel.kinect12()


def followed(q: FloatArray) -> ReachProgress:
    progress = ReachProgress(HUMAN)
    for posture in q:
        progress.update(posture)
    return progress


def test_a_reach_goes_from_nothing_to_all_of_the_way() -> None:
    q = small_library(1).motions[0].q
    place = HUMAN.forward(q[-1])[HAND]
    shares = [followed(q[: n + 1]).way_to(place) for n in range(len(q))]
    assert shares[2] < 0.1
    assert shares[-1] > 0.95
    assert np.diff(shares).min() > -0.05
    assert not followed(q).turned
    assert followed(q).way_back == 0.0


def test_a_hand_that_comes_back_has_turned_and_the_apex_is_remembered() -> None:
    q = small_library(1, there_and_back=True).motions[0].q
    progress = followed(q)
    assert progress.turned
    assert progress.way_back > 0.8
    hand = HUMAN.forward(q)[HAND]
    away = np.linalg.norm(hand - progress.start_hand_m, axis=1)
    np.testing.assert_allclose(progress.apex, q[int(np.argmax(away))], atol=0.02)
    assert progress.reached_m == pytest.approx(away.max(), abs=0.01)


def test_noise_is_no_turn_and_a_place_elsewhere_is_not_come_nearer() -> None:
    q = small_library(1).motions[0].q
    progress = followed(q)
    start = progress.start_hand_m
    assert progress.way_to(start - (HUMAN.forward(q[-1])[HAND] - start)) == 0.0
    jitter = np.vstack([q, q[-1] + 0.003, q[-1] - 0.003])
    assert not followed(jitter).turned


def test_angles_follow_without_whole_turns_and_the_start_forgives_one_wild_posture() -> None:
    q = small_library(1).motions[0].q.copy()
    wrapped = q.copy()
    wrapped[20:, 9] -= 2.0 * np.pi
    np.testing.assert_allclose(followed(wrapped).posture, followed(q).posture)
    wild = q.copy()
    wild[1] += 1.0
    np.testing.assert_allclose(followed(wild).start_posture, followed(q).start_posture, atol=0.02)


def test_a_new_start_forgets() -> None:
    q = small_library(1, there_and_back=True).motions[0].q
    progress = followed(q)
    progress.start()
    assert not progress.seen
    progress.update(q[0])
    assert progress.seen
    assert not progress.turned
    np.testing.assert_array_equal(progress.start_posture, q[0])
