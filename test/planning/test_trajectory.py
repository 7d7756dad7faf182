"""Timed trajectories: exact at knots, smooth between them, at rest beyond them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import PlanningError
from humanpred_ros.planning.trajectory import TimedTrajectory, at_rest


def knots(seed: int, n: int = 6, d: int = 3) -> TimedTrajectory:
    rng = np.random.default_rng(seed)
    q, v, a = rng.normal(size=(3, n, d))
    v[-1] = a[-1] = 0.0
    return TimedTrajectory(5.0 + rng.uniform(0.05, 0.3, n).cumsum(), q, v, a)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 9))
def test_knots_are_met_exactly_and_everything_is_continuous(seed: int, n: int) -> None:
    trajectory = knots(seed, n)
    q, v, a = trajectory.sample(trajectory.t_s)
    assert np.array_equal(q, trajectory.q)
    np.testing.assert_allclose(v, trajectory.v, atol=1e-12)
    np.testing.assert_allclose(a, trajectory.a, atol=1e-10)
    just_before = trajectory.sample(trajectory.t_s[1:] - 1e-11)
    for before, at in zip(just_before, (q, v, a), strict=True):
        np.testing.assert_allclose(before, at[1:], atol=1e-3)


def test_velocity_and_acceleration_are_the_derivatives() -> None:
    trajectory = knots(2)
    t = np.linspace(trajectory.start_s + 0.01, trajectory.end_s - 0.01, 200)
    h = 1e-5
    _, v, a = trajectory.sample(t)
    after, before = trajectory.sample(t + h), trajectory.sample(t - h)
    inside = np.abs(t[:, None] - trajectory.t_s).min(axis=1) > 2 * h
    np.testing.assert_allclose(((after[0] - before[0]) / (2 * h))[inside], v[inside], rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(((after[1] - before[1]) / (2 * h))[inside], a[inside], rtol=1e-4, atol=1e-2)


def test_a_quintic_movement_is_reproduced() -> None:
    movement = np.polynomial.Polynomial([0.3, -0.2, 0.5, 1.0, -2.0, 0.7])
    end = movement(1.0)
    t = np.array([0.0, 0.4, 0.7])
    rows = [movement.deriv(k)(t)[:, None] if k else movement(t)[:, None] for k in range(3)]
    rows = [np.vstack([row, [[end if k == 0 else 0.0]]]) for k, row in enumerate(rows)]
    trajectory = TimedTrajectory(np.append(t, 1.0), *rows)
    fine = np.linspace(0.0, 0.7, 50)
    np.testing.assert_allclose(trajectory.sample(fine)[0][:, 0], movement(fine), atol=1e-12)


def test_beyond_its_ends_the_robot_rests() -> None:
    trajectory = knots(3)
    q, v, a = trajectory.sample([0.0, trajectory.end_s, 100.0])
    assert np.array_equal(q, trajectory.q[[0, -1, -1]])
    assert not v.any()
    assert not a.any()
    q, v, _ = at_rest([1.0, 2.0], 3.0).sample(np.array([[0.0, 3.0], [4.0, 5.0]]))
    assert q.shape == (2, 2, 2)
    assert (q == [1.0, 2.0]).all()
    assert not v.any()


def test_one_time_gives_one_state() -> None:
    q, v, a = knots(4).sample(5.4)
    assert q.shape == v.shape == a.shape == (3,)


def test_equality_is_of_every_bit() -> None:
    one, other = knots(5), knots(5)
    assert one == other
    assert one != TimedTrajectory(one.t_s + 1.0, one.q, one.v, one.a)
    nudged = TimedTrajectory(one.t_s, np.nextafter(one.q, 9.0), one.v, one.a)
    assert one != nudged
    assert one != "a trajectory"


@pytest.mark.parametrize(
    ("change", "trouble"),
    [
        ({"t_s": [0.0, 0.0]}, "strictly increasing"),
        ({"v": [[0.0], [1.0]]}, "at rest"),
        ({"a": [[0.0], [1.0]]}, "at rest"),
        ({"q": [[0.0]]}, "shape"),
        ({"q": [[0.0], [np.nan]]}, "finite"),
    ],
)
def test_what_a_controller_would_refuse_is_refused(change: dict[str, list[list[float]]], trouble: str) -> None:
    parts = {"t_s": [0.0, 1.0], "q": [[0.0], [1.0]], "v": [[0.0], [0.0]], "a": [[0.0], [0.0]]} | change
    with pytest.raises(PlanningError, match=trouble):
        TimedTrajectory(**parts)
