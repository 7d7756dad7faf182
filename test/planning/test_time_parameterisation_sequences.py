"""Whatever is replanned, held and resumed, and whenever: nothing jumps and no limit is exceeded."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning_paths import BOX, A, V, a_path, rest_of

from humanpred_ros.planning.stopping import brake_along, stop_trajectory
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

SEEDS = st.integers(0, 2**32 - 1)
#: What a joint may leave the box of its paths by: it cannot stop at once. 1.5 v² / a is a stop of every joint for
#: itself at the acceleration limit; fading beside a path takes a little longer.
SLACK = 1.2 * (V**2 / A)


@dataclass
class Robot:
    """Executes one trajectory after the other, and remembers which from when on."""

    executing: TimedTrajectory
    past: list[tuple[float, float, TimedTrajectory]] = field(default_factory=list)

    def switch(self, t_s: float, to: TimedTrajectory) -> None:
        before, after = self.executing.sample(t_s), to.sample(t_s)
        for was, begins in zip(before, after, strict=True):
            np.testing.assert_allclose(begins, was, atol=1e-9, rtol=0.0)
        assert to.start_s == t_s
        self.past.append((self.executing.start_s, t_s, self.executing))
        self.executing = to

    def stretches(self) -> list[tuple[float, float, TimedTrajectory]]:
        return [*self.past, (self.executing.start_s, self.executing.end_s, self.executing)]


def sequence(seed: int, v_limit: NDArray[np.float64], a_limit: NDArray[np.float64], period: float) -> Robot:
    rng = np.random.default_rng(seed)
    now = float(rng.choice([0.0, 3.0, 1000.0]))
    robot = Robot(at_rest(rng.uniform(-1.0, 1.0, 7), now))
    for _ in range(7):
        now += float(rng.choice([0.0, 0.013, 0.1, 0.3, 0.8]) * rng.uniform(0.7, 1.3))
        q, v, a = robot.executing.sample(now)
        what = rng.random()
        if what < 0.15:
            new = brake_along(robot.executing, now, a_limit, period)
        elif what < 0.2:
            new = stop_trajectory(q, v, a, a_limit, v_limit, period, now)
        elif what < 0.3:  # the old plan, once more
            old = rest_of(robot.executing, now, 60)
            new = time_parameterise(old, v_limit, a_limit, v, a, period, now)
        else:
            new = time_parameterise(a_path(rng, q, v), v_limit, a_limit, v, a, period, now)
        robot.switch(now, new)
    return robot


@settings(max_examples=25)
@given(
    seed=SEEDS, period=st.sampled_from([0.01, 0.02, 0.05]), scale=st.tuples(st.floats(0.4, 2.0), st.floats(0.5, 2.5))
)
def test_nothing_jumps_and_limits_hold(seed: int, period: float, scale: tuple[float, float]) -> None:
    v_limit, a_limit = V * scale[0], A * scale[1]
    robot = sequence(seed, v_limit, a_limit, period)
    for begin, end, trajectory in robot.stretches():
        assert (np.diff(trajectory.t_s) > 0.0).all()
        assert not trajectory.v[-1].any()
        assert not trajectory.a[-1].any()
        _, v, a = trajectory.sample(np.linspace(begin, end, 1200))
        assert (np.abs(v) <= v_limit * (1.0 + LIMIT_TOLERANCE)).all()
        assert (np.abs(a) <= a_limit * (1.0 + LIMIT_TOLERANCE)).all()


@settings(max_examples=20)
@given(seed=SEEDS)
def test_joints_stay_where_their_paths_are_but_for_what_stopping_takes(seed: int) -> None:
    for begin, end, trajectory in sequence(seed, V, A, 0.02).stretches():
        q = trajectory.sample(np.linspace(begin, end, 600))[0]
        assert (np.abs(q) <= BOX + SLACK).all()


@settings(max_examples=20)
@given(seed=SEEDS)
def test_motion_in_between_is_what_velocity_and_acceleration_say(seed: int) -> None:
    """Position is the integral of velocity over the whole run, so no switch hides a step."""
    robot = sequence(seed, V, A, 0.02)
    q, t, v = [], [], []
    for begin, end, trajectory in robot.stretches():
        if end > begin:
            times = np.linspace(begin, end, 400)
            place, speed, _ = trajectory.sample(times)
            q.append(place), t.append(times), v.append(speed)
    moved = sum(
        ((speed[1:] + speed[:-1]) * 0.5 * np.diff(times)[:, None]).sum(axis=0)
        for speed, times in zip(v, t, strict=True)
    )
    np.testing.assert_allclose(moved, q[-1][-1] - q[0][0], atol=2e-4)


@settings(max_examples=15)
@given(seed=SEEDS)
def test_planning_the_old_path_anew_loses_little_time(seed: int) -> None:
    """The path then begins along the present velocity; in the median nothing is lost."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, 7)
    old = time_parameterise(a_path(rng, q, np.zeros(7)), V, A)
    lost = []
    for share in (0.1, 0.2, 0.35, 0.5, 0.8):
        now = share * old.end_s
        state = old.sample(now)
        new = time_parameterise(rest_of(old, now, 100), V, A, state[1], state[2], start_s=now)
        lost.append(new.end_s - old.end_s)
    # At the limits already there is nothing left to give, and some paths are left for a moment.
    assert max(lost) <= 0.7
    assert np.median(lost) <= 0.2
