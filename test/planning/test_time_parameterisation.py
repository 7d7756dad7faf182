"""Time parameterisation: limits hold and nothing jumps, whatever the robot was doing at the switch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.planning.path import path_parameter, straight
from humanpred_ros.planning.stopping import brake_along, stop_trajectory
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

V = np.array([2.088, 2.082, 3.27, 3.3, 3.6, 3.078, 3.6]) * 0.5
A = np.array([4.0, 4.0, 3.0, 5.0, 6.0, 2.0, 4.0])
SEEDS = st.integers(0, 2**32 - 1)


def some_path(rng: np.random.Generator, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """A line, a curve, a corner, a tiny move or no move at all, from q."""
    n = int(rng.integers(2, 120))
    kind = rng.integers(0, 6)
    goal = rng.uniform(-2.0, 2.0, len(q))
    path = straight(q, goal, n)
    if kind == 1:
        path += np.sin(np.pi * rng.integers(1, 4) * np.linspace(0, 1, n))[:, None] * rng.normal(0.0, 0.3, len(q))
    elif kind == 2:
        corner = rng.uniform(-1.0, 1.0, len(q))
        path = np.concatenate([straight(q, corner, 30), straight(corner, goal, 50)[1:]])
    elif kind == 3:
        path = q + (path - q) * 10.0 ** rng.uniform(-9.0, -1.0)
    elif kind == 4 and rng.random() < 0.3:
        path = np.repeat(q[None], n, axis=0)
    path[0] = q
    return path


def largest_use(trajectory: TimedTrajectory) -> tuple[float, float]:
    t = np.linspace(trajectory.start_s, trajectory.end_s, 1000)
    _, v, a = trajectory.sample(t)
    return float((np.abs(v) / V).max()), float((np.abs(a) / A).max())


@settings(max_examples=25)
@given(seed=SEEDS, period=st.sampled_from([0.005, 0.02, 0.05]))
def test_limits_hold_and_nothing_jumps_over_random_replanning(seed: int, period: float) -> None:
    rng = np.random.default_rng(seed)
    now, trajectory = 3.0, at_rest(rng.uniform(-1.0, 1.0, 7), 3.0)
    for _ in range(8):
        now += rng.choice([0.02, 0.1, 0.3, 0.8])
        state = trajectory.sample(now)
        path = some_path(rng, state[0])
        trajectory = time_parameterise(path, V, A, state[1], state[2], period, now)
        for was, begins in zip(state, trajectory.sample(now), strict=True):
            np.testing.assert_allclose(begins, was, atol=1e-9)
        assert np.array_equal(trajectory.q[-1], path[-1]) or len(trajectory) == 1
        assert np.diff(trajectory.t_s).max(initial=0.0) <= period + 1e-9
        use_v, use_a = largest_use(trajectory)
        assert use_v <= 1.0 + LIMIT_TOLERANCE
        assert use_a <= 1.0 + LIMIT_TOLERANCE


@settings(max_examples=25)
@given(seed=SEEDS)
def test_a_hold_can_come_at_any_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, 7)
    trajectory = time_parameterise(some_path(rng, q), V, A)
    for t in rng.uniform(0.0, trajectory.end_s + 0.1, 3):
        state = trajectory.sample(t)
        for stop in (brake_along(trajectory, t, A), stop_trajectory(*state, A, V, start_s=t)):
            for was, begins in zip(state, stop.sample(t), strict=True):
                np.testing.assert_allclose(begins, was, atol=1e-9)
            use_v, use_a = largest_use(stop)
            assert use_v <= 1.0 + LIMIT_TOLERANCE
            assert use_a <= 1.0 + 2.0 * LIMIT_TOLERANCE
            # Nothing needs longer than coming down from full speed at a third of the limit.
            assert stop.duration_s < 3.0 * (V / A).max() + 0.3


def test_braking_stays_on_the_trajectory() -> None:
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.0, 1.0, 7)
    curve = straight(q, q + 1.5, 80) + np.sin(np.linspace(0, np.pi, 80))[:, None] * rng.normal(0.0, 0.4, 7)
    curve[0] = q
    trajectory = time_parameterise(curve, V, A)
    stop = brake_along(trajectory, 0.4 * trajectory.end_s, A)
    way = trajectory.sample(np.linspace(0.0, trajectory.end_s, 4000))[0]
    for place in stop.sample(np.linspace(stop.start_s, stop.end_s, 60))[0]:
        assert np.abs(way - place).max(axis=1).min() < 2e-3
    moved = path_parameter(stop.q)[-1]
    assert 0.0 < moved < 0.5 * path_parameter(curve)[-1]


def test_the_trajectory_follows_the_path() -> None:
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.0, 1.0, 7)
    curve = straight(q, q + 1.0, 100) + np.sin(np.linspace(0, 2 * np.pi, 100))[:, None] * rng.normal(0.0, 0.3, 7)
    trajectory = time_parameterise(curve, V, A)
    driven = trajectory.sample(np.linspace(0.0, trajectory.end_s, 500))[0]
    off = np.linalg.norm(driven[:, None] - curve[None], axis=2).min(axis=1)
    assert off.max() < 0.03  # half the distance between waypoints, and what rounding off takes


def test_a_straight_line_is_driven_about_as_fast_as_physics_allows() -> None:
    q, goal = np.zeros(7), np.array([1.5, 0, 0, 0, 0, 0, 0])
    duration = time_parameterise(straight(q, goal, 50), V, A).duration_s
    fastest = 1.5 / V[0] + V[0] / A[0]
    assert fastest < duration < 1.15 * fastest


def test_a_robot_that_already_moves_the_right_way_keeps_its_speed() -> None:
    path = straight(np.zeros(7), np.full(7, 1.0), 50)
    along = 0.6 * np.ones(7)
    moving = time_parameterise(path, V, A, along)
    resting = time_parameterise(path, V, A)
    assert moving.duration_s < resting.duration_s - 0.1
    early = moving.sample(np.linspace(0.0, 0.3, 50))[1]
    assert early.min() > 0.5


def test_a_robot_that_moves_the_wrong_way_turns_round() -> None:
    path = straight(np.zeros(7), np.full(7, 1.0), 50)
    trajectory = time_parameterise(path, V, A, -0.6 * np.ones(7))
    assert trajectory.q.min() < -0.01
    assert trajectory.q.min() > -0.3
    np.testing.assert_array_equal(trajectory.q[-1], path[-1])


def test_it_stays_within_a_box_the_path_stays_in() -> None:
    rng = np.random.default_rng(8)
    path = np.clip(rng.normal(0.0, 0.3, (60, 7)).cumsum(axis=0) / 3.0, -0.5, 0.5)
    q = time_parameterise(path, V, A).sample(np.linspace(0.0, 60.0, 5000))[0]
    assert np.abs(q).max() <= 0.5 + 1e-4


@pytest.mark.parametrize("speed", [0.0, 1e-13, 1e-6, 0.5])
@pytest.mark.parametrize("length", [0.0, 1e-12, 1e-8, 1e-3])
def test_paths_that_lead_nowhere_are_followed_all_the_same(speed: float, length: float) -> None:
    path = straight(np.zeros(7), np.full(7, length), 10)
    trajectory = time_parameterise(path, V, A, np.full(7, speed), start_s=2.0)
    np.testing.assert_array_equal(trajectory.q[-1], path[-1])
    np.testing.assert_array_equal(trajectory.v[0], np.full(7, speed))
    # There is no way to stop at once: it goes on and comes back.
    assert trajectory.duration_s < 0.35 + 5.0 * speed
    assert max(largest_use(trajectory)) <= 1.0 + LIMIT_TOLERANCE


def test_the_start_time_only_shifts() -> None:
    path = straight(np.zeros(7), np.full(7, 1.0), 50)
    early, late = time_parameterise(path, V, A), time_parameterise(path, V, A, start_s=100.0)
    np.testing.assert_allclose(late.t_s - 100.0, early.t_s, atol=1e-9)
    assert np.array_equal(late.q, early.q)


def test_what_makes_no_sense_is_refused() -> None:
    path = straight(np.zeros(2), np.ones(2), 5)
    with pytest.raises(PlanningError, match="velocity limit"):
        time_parameterise(path, 0.0, 1.0)
    with pytest.raises(PlanningError, match="acceleration limit"):
        time_parameterise(path, 1.0, np.inf)
    with pytest.raises(PlanningError, match="sample period"):
        time_parameterise(path, 1.0, 1.0, sample_period_s=0.0)
    with pytest.raises(PlanningError, match="at least 2"):
        time_parameterise(path[:1], 1.0, 1.0)
    with pytest.raises(PlanningError, match="start velocity"):
        time_parameterise(path, 1.0, 1.0, start_velocity=[1.0])
    with pytest.raises(PlanningError, match="stop"):
        stop_trajectory([0.0], [1.0], [0.0], 0.0)
