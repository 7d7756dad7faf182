"""The body that follows a hand keeps the hand where it should be and shares the reach out as people do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from humanpred_ros.errors import UsageError
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.motion.hand_path import HandPathConfig, draw_hand_path
from humanpred_ros.motion.reaching_body import BodyConfig, ReachingBody, slow_noise
from humanpred_ros.motion.synthetic import ReachGeneratorConfig

REST = np.array(ReachGeneratorConfig().rest_q)
GOALS = np.array(ReachGeneratorConfig().goals_m)
T = np.arange(0.0, 3.0, 0.05)
DOF = {name: k for k, name in enumerate(KINECT12_DOFS)}


def postures(goal: np.ndarray, config: BodyConfig | None = None, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the postures of a reach and where the palm should be."""
    body = ReachingBody(config=config or BodyConfig())
    rng = np.random.default_rng(seed)
    start = body.palm_m(REST)
    path = draw_hand_path(start, goal, start, replace(HandPathConfig(), wait_s=(0.5, 0.0)), rng)
    return body.follow(path, T, REST, rng), path.at(T)


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
        rest = REST.copy()
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
        lean = np.abs(q[:, DOF["TorsoY"]] - REST[DOF["TorsoY"]])
        return float(T[np.argmax(lean > 0.25 * lean.max())])

    assert leaves(0.3) > leaves(0.0) + 0.05


def test_rest_stays_rest_whatever_the_habit() -> None:
    q, hand = postures(GOALS[0], BodyConfig(habit=2.0, sway=0.0))
    resting = np.linalg.norm(hand - hand[0], axis=1) == 0
    assert resting.sum() > 3
    np.testing.assert_allclose(q[resting], np.tile(REST, (resting.sum(), 1)), atol=1e-6)


def test_a_goal_out_of_reach_is_told() -> None:
    body = ReachingBody()
    assert max(body.miss_m(goal, REST) for goal in GOALS) < 0.005
    assert body.miss_m(GOALS[0] + [0.0, 3.0, 0.0], REST) > 0.5


def test_slow_noise_has_unit_variance_and_forgets() -> None:
    noise = slow_noise(np.arange(400) * 0.1, 0.5, 200, np.random.default_rng(0))
    assert noise.var() == pytest.approx(1.0, abs=0.05)
    assert (noise[1:] * noise[:-1]).mean() == pytest.approx(np.exp(-0.1 / 0.5), abs=0.03)
    assert (noise[50:] * noise[:-50]).mean() == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("bad", [{"lag_s": -0.1}, {"sway_s": 0.0}, {"iterations": 0}, {"habit": float("nan")}])
def test_impossible_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=next(iter(bad))):
        BodyConfig(**bad)
