"""A hand is accepted where it can be, and nothing wrong is held on to for ever."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.hand_outliers import (
    FASTEST_M_S,
    N_STEADY,
    OUTLIER,
    PART,
    RECOVERED,
    RESTARTED,
    HandHistory,
    judge,
)


def reach(way_m: float = 0.6, duration_s: float = 1.0, rate_hz: float = 60.0) -> FloatArray:
    """Return the hand (T, 3) on a minimum-jerk way that begins after ten postures at rest."""
    s = np.concatenate([np.zeros(10), np.linspace(0.0, 1.0, round(duration_s * rate_hz) + 1)])[:, None]
    return (s**3 * (10 - 15 * s + 6 * s * s)) * np.array([way_m, 0.0, 0.0])


def conclusions(hand: FloatArray, rate_hz: float = 60.0, begun_at: int = 15) -> list[int]:
    belief = HandHistory.fresh()
    return [judge(belief, place, k / rate_hz, k >= begun_at) for k, place in enumerate(hand)]


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 60.0, 120.0])
def test_the_fastest_reach_that_people_can_do_is_accepted_in_the_noise_of_a_tracker(rate_hz: float) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.015, (10 + round(0.3 * rate_hz) + 1, 3))
    assert set(conclusions(reach(0.6, 0.3, rate_hz) + noise, rate_hz)) == {PART}


@pytest.mark.parametrize("n_lost", [1, 5, 20])
def test_a_lost_arm_is_left_out_and_found_again(n_lost: int) -> None:
    for shift in (np.array([0.0, 1.5, 0.9]), np.random.default_rng(1).normal(0.0, 0.5, (n_lost, 3))):
        hand = reach()
        hand[30 : 30 + n_lost] += shift
        said = conclusions(hand)
        back = 30 + n_lost + N_STEADY
        assert set(said[:30]) == {PART}
        assert set(said[30 : back - 1]) == {OUTLIER}
        assert said[back - 1] == RECOVERED
        assert set(said[back:]) == {PART}


def test_a_hand_that_stays_where_it_jumped_is_accepted_in_the_end() -> None:
    hand = np.vstack([reach(), np.tile(reach()[-1], (90, 1))])
    hand[40:] += [0.0, 5.0, 0.0]
    said = conclusions(hand)
    found = said.index(RECOVERED)
    assert 60 * 4.5 / FASTEST_M_S < found - 40 < 60 * 5.5 / FASTEST_M_S
    assert set(said[found + 1 :]) == {PART}


@pytest.mark.parametrize("n_wild", [1, 4, 9])
def test_a_reach_begins_where_the_hand_is_steady_first(n_wild: int) -> None:
    hand = reach()
    hand[:n_wild] += [0.0, 4.0, 0.0]
    said = conclusions(hand)
    assert said.index(RESTARTED) == n_wild + N_STEADY - 1
    assert set(said[n_wild + N_STEADY :]) == {PART}


def test_a_small_jump_to_and_fro_is_no_reason_to_stay_lost() -> None:
    hand = reach()
    hand[30] += [0.0, 0.2, 0.0]
    said = conclusions(hand)
    assert said.count(OUTLIER) <= N_STEADY
    assert RECOVERED in said


def test_frames_that_never_came_are_no_jump() -> None:
    hand, belief = reach(), HandHistory.fresh()
    assert judge(belief, hand[0], 0.0, False) == PART
    assert judge(belief, hand[-1], 1.0, True) == PART
    assert judge(belief, hand[-1] + [2.0 * FASTEST_M_S, 0.0, 0.0], 2.0, True) == OUTLIER
