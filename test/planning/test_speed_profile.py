"""How much longer trajectories take than the fastest motion that velocity and acceleration limits allow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from planning_paths import A, V, a_path

from humanpred_ros.planning.path import straight
from humanpred_ros.planning.path_following import SMOOTHING_S, PathLimits, SmoothPath, controllable, fastest
from humanpred_ros.planning.stopping import stop_trajectory
from humanpred_ros.planning.time_parameterisation import time_parameterise

SEEDS = st.integers(0, 2**32 - 1)


def fastest_s(path: NDArray[np.float64], n: int = 1001) -> float:
    """Duration of the fastest motion from rest to rest along the rounded path, accelerations free to jump."""
    s = np.linspace(0.0, 1.0, n)
    _, d1, d2 = SmoothPath.rounding(path).at(s)
    v, a = (np.ascontiguousarray(np.broadcast_to(limit, d1.shape)) for limit in (V, A))
    limits = PathLimits(-v, v, -a, a)
    best = controllable(d1, d2, limits, s[1])
    x = np.sqrt(fastest(d1, d2, limits, s[1], best, 1, 0.0, 0.0))
    return float((2.0 * s[1] / np.maximum(x[1:] + x[:-1], 1e-9)).sum())


def test_the_reference_is_the_trapezoid_on_a_straight_line() -> None:
    for way in (0.1, 1.5):
        path = straight(np.zeros(7), np.array([way, 0, 0, 0, 0, 0, 0]), 50)
        peak = min(V[0], np.sqrt(way * A[0]))
        assert fastest_s(path) == pytest.approx(way / peak + peak / A[0], rel=0.01)


@settings(max_examples=30)
@given(seed=SEEDS)
def test_from_rest_little_is_lost(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path = a_path(rng, rng.uniform(-1.0, 1.0, 7), np.zeros(7))
    fastest, duration = fastest_s(path), time_parameterise(path, V, A).duration_s
    assert fastest <= duration <= 1.15 * fastest + SMOOTHING_S + 0.02


@settings(max_examples=25)
@given(seed=SEEDS, share=st.floats(0.05, 0.95))
def test_in_motion_no_more_is_lost_than_by_stopping_first(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.0, 1.0, 7)
    old = time_parameterise(a_path(rng, q, np.zeros(7)), V, A)
    state = old.sample(share * old.end_s)
    path = a_path(rng, state[0], state[1])
    duration = time_parameterise(path, V, A, state[1], state[2]).duration_s
    stop = stop_trajectory(*state, A, V).duration_s
    # 0.5 s more where the stop itself leads away from the path.
    assert duration <= stop + 1.15 * fastest_s(path) + SMOOTHING_S + 0.5


def test_where_the_path_goes_on_as_the_robot_moves_nothing_is_lost() -> None:
    path = straight(np.zeros(7), np.full(7, 1.6), 80)
    old = time_parameterise(path, V, A)
    for share in (0.1, 0.25, 0.5, 0.6):
        now = share * old.end_s
        q, v, a = old.sample(now)
        new = time_parameterise(straight(q, path[-1], 80), V, A, v, a, start_s=now)
        assert new.end_s == pytest.approx(old.end_s, abs=0.03)
