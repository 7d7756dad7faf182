"""Drawn hands start, stop and move as hands do; bodies turn and lean with their hands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError, SettingsError
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.motion.synthetic import ReachGeneratorConfig
from humanpred_ros.motion.synthetic_person import (
    BodyConfig,
    HandPath,
    HandPathConfig,
    ReachingBody,
    Stroke,
    draw_hand_path,
    slow_noise,
)

START, GOAL, REST = np.array([0.1, -1.7, 0.5]), np.array([0.4, -1.2, 0.6]), np.array([0.12, -1.72, 0.52])
#: One straight reach and a full return.
PLAIN = HandPathConfig(
    correction_share=0.0, rise_out=0.0, rise_back=0.0, bow_spread=0.0, skew_spread=0.0,
    tail_of_return=1.0,
)  # fmt: skip


def path(seed: int, config: HandPathConfig | None = None) -> HandPath:
    return draw_hand_path(START, GOAL, REST, config or HandPathConfig(), np.random.default_rng(seed))


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_the_hand_rests_reaches_the_goal_and_comes_back(seed: int) -> None:
    drawn = path(seed, HandPathConfig().replaced(tail_of_return=1.0))
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
    drawn = path(1, PLAIN.replaced(correction_share=1.0))
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
    with pytest.raises(SettingsError, match=next(iter(bad))):
        HandPathConfig(**bad)


def test_places_must_be_points() -> None:
    with pytest.raises(ArrayError, match="goal_m"):
        draw_hand_path(START, GOAL[:2], REST, HandPathConfig(), np.random.default_rng(0))


REST_Q = np.array(ReachGeneratorConfig().rest_q)
GOALS = np.array(ReachGeneratorConfig().goals_m)
T = np.arange(0.0, 3.0, 0.05)
DOF = {name: k for k, name in enumerate(KINECT12_DOFS)}


def postures(goal: np.ndarray, config: BodyConfig | None = None, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the postures of a reach and where the palm should be."""
    body = ReachingBody(config=config or BodyConfig())
    rng = np.random.default_rng(seed)
    start = body.palm_m(REST_Q)
    path = draw_hand_path(start, goal, start, HandPathConfig().replaced(wait_s=(0.5, 0.0)), rng)
    return body.follow(path, T, REST_Q, rng), path.at(T)


@pytest.mark.parametrize("label", range(8))
def test_the_palm_follows_the_path_within_joint_limits(label: int) -> None:
    body = ReachingBody()
    q, hand = postures(GOALS[label], seed=label)
    assert np.linalg.norm(body.human.forward(q)["right_palm"] - hand, axis=1).max() < 0.005
    assert (q >= body.human.lower).all()
    assert (q <= body.human.upper).all()


def test_joints_move_without_jumps() -> None:
    q, _ = postures(GOALS[7])
    assert (np.abs(np.diff(q, axis=0)) / 0.05).max() < 6.0  # rad/s and m/s


def test_further_forward_means_more_lean_and_further_left_more_turning() -> None:
    still = BodyConfig(habit=0.0, sway=0.0)
    far, near = postures(GOALS[5], still)[0], postures(GOALS[1], still)[0]
    left, right = postures(GOALS[7], still)[0], postures(GOALS[4], still)[0]
    assert np.ptp(far[:, DOF["TorsoY"]]) > np.ptp(near[:, DOF["TorsoY"]]) + 0.05
    assert left[:, DOF["PelvisRotZ"]].max() > right[:, DOF["PelvisRotZ"]].max() + 0.3


def test_pelvis_sways_forwards_whichever_way_the_person_faces() -> None:
    body = ReachingBody(config=BodyConfig(habit=0.0, sway=0.0))
    moved = []
    for yaw in (0.0, 1.0, -2.5):
        rest = REST_Q.copy()
        rest[:3], rest[3] = 0.0, yaw
        start = body.palm_m(rest)
        forwards = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        path = draw_hand_path(start, start + 0.5 * forwards, start, HandPathConfig(), np.random.default_rng(0))
        pelvis = body.follow(path, np.array([path.arrival_s]), rest, np.random.default_rng(0))[0, :2]
        moved.append(pelvis @ forwards[:2])
    assert min(moved) > 0.01
    np.testing.assert_allclose(moved, moved[0], atol=0.03)


def test_the_body_lags_behind_the_hand() -> None:
    def leaves(lag_s: float) -> float:
        q, _ = postures(GOALS[7], BodyConfig(lag_s=lag_s, habit=0.0, sway=0.0))
        lean = np.abs(q[:, DOF["TorsoY"]] - REST_Q[DOF["TorsoY"]])
        return float(T[np.argmax(lean > 0.25 * lean.max())])

    assert leaves(0.3) > leaves(0.0) + 0.05


def test_rest_stays_rest_whatever_the_habit() -> None:
    q, hand = postures(GOALS[0], BodyConfig(habit=2.0, sway=0.0))
    resting = np.linalg.norm(hand - hand[0], axis=1) == 0
    assert resting.sum() > 3
    np.testing.assert_allclose(q[resting], np.tile(REST_Q, (resting.sum(), 1)), atol=1e-6)


def test_a_goal_out_of_reach_is_told() -> None:
    body = ReachingBody()
    assert max(body.miss_m(goal, REST_Q) for goal in GOALS) < 0.005
    assert body.miss_m(GOALS[0] + [0.0, 3.0, 0.0], REST_Q) > 0.5


def test_slow_noise_has_unit_variance_and_forgets() -> None:
    noise = slow_noise(np.arange(400) * 0.1, 0.5, 200, np.random.default_rng(0))
    assert noise.var() == pytest.approx(1.0, abs=0.05)
    assert (noise[1:] * noise[:-1]).mean() == pytest.approx(np.exp(-0.1 / 0.5), abs=0.03)
    assert (noise[50:] * noise[:-50]).mean() == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("bad", [{"lag_s": -0.1}, {"sway_s": 0.0}, {"iterations": 0}, {"habit": float("nan")}])
def test_impossible_settings_of_the_body_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(bad))):
        BodyConfig(**bad)
