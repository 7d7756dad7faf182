"""A drawn hand path starts, stops and moves as a hand does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.motion.hand_path import HandPath, HandPathConfig, Stroke, draw_hand_path

START, GOAL, REST = np.array([0.1, -1.7, 0.5]), np.array([0.4, -1.2, 0.6]), np.array([0.12, -1.72, 0.52])
#: One straight reach and a full return.
PLAIN = replace(
    HandPathConfig(), correction_share=0.0, rise_out=0.0, rise_back=0.0, bow_spread=0.0, skew_spread=0.0,
    tail_of_return=1.0,
)  # fmt: skip


def path(seed: int, config: HandPathConfig | None = None) -> HandPath:
    return draw_hand_path(START, GOAL, REST, config or HandPathConfig(), np.random.default_rng(seed))


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_the_hand_rests_reaches_the_goal_and_comes_back(seed: int) -> None:
    drawn = path(seed, replace(HandPathConfig(), tail_of_return=1.0))
    waits = drawn.strokes[0].start_s
    assert waits >= HandPathConfig().wait_least_s
    np.testing.assert_array_equal(drawn.at([0.0, waits]), [START, START])
    np.testing.assert_allclose(drawn.at([drawn.arrival_s])[0], GOAL, atol=1e-12)
    np.testing.assert_allclose(drawn.at([drawn.duration_s])[0], REST, atol=1e-12)


def test_a_recording_may_end_before_the_hand_is_back_but_not_at_the_goal() -> None:
    left = [np.linalg.norm(p.at([p.duration_s])[0] - REST) for p in map(path, range(100))]
    reach = np.linalg.norm(GOAL - START)
    assert max(left) < 0.25 * reach
    assert np.mean(np.array(left) > 0.01) > 0.3


def test_a_plain_reach_is_straight_with_a_bell_shaped_speed() -> None:
    drawn = path(3, PLAIN)
    out = drawn.strokes[0]
    t = np.linspace(out.start_s, out.start_s + out.duration_s, 201)
    place = drawn.at(t)
    assert np.linalg.norm(np.cross(place - START, GOAL - START), axis=1).max() < 1e-12
    speed = np.linalg.norm(np.diff(place, axis=0), axis=1) / np.diff(t)
    assert np.argmax(speed) == pytest.approx(100, abs=1)
    assert (np.diff(speed[:100]) > 0).all()
    assert (np.diff(speed[100:]) < 0).all()
    # A least-jerk movement's peak speed is 15/8 of its mean speed.
    assert speed.max() == pytest.approx(15 / 8 * np.linalg.norm(GOAL - START) / out.duration_s, rel=1e-3)


def test_a_correction_first_misses_the_goal() -> None:
    drawn = path(1, replace(PLAIN, correction_share=1.0))
    assert len(drawn.strokes) == 3
    aimed = START + drawn.strokes[0].step_m
    assert 0.005 < np.linalg.norm(aimed - GOAL) < 0.3


def test_the_bow_is_reached_half_way() -> None:
    stroke = Stroke(0.0, 2.0, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.2]))
    np.testing.assert_allclose(stroke.at(np.array([-1.0, 0.0, 1.0, 2.0, 5.0]))[:, 2], [0, 0, 0.2, 0, 0], atol=1e-15)


@pytest.mark.parametrize(
    "bad",
    [
        {"reach_s": 0.0}, {"return_s": -1.0}, {"correction_share": 1.5}, {"tail_of_return": 0.0},
        {"wait_s": (0.4, float("nan"))}, {"bow_spread": float("inf")},
    ],
)  # fmt: skip
def test_impossible_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(bad))):
        HandPathConfig(**bad)


def test_places_must_be_points() -> None:
    with pytest.raises(ArrayError, match="goal_m"):
        draw_hand_path(START, GOAL[:2], REST, HandPathConfig(), np.random.default_rng(0))
