"""The share of limits used, against sampling; and how states come to rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.planning.path_following import SMOOTHING_S, AveragedProfile, Begin
from humanpred_ros.planning.stopping import MOMENTS, ComingToRest, limit_use
from humanpred_ros.planning.trajectory import TimedTrajectory

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=30)
@given(seed=SEEDS, n=st.integers(1, 8))
def test_the_use_of_limits_is_that_of_samples(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    q, v, a = rng.normal(size=(3, n, 3))
    v[-1] = a[-1] = 0.0
    trajectory = TimedTrajectory(rng.uniform(0.05, 0.3, n).cumsum(), q, v, a)
    v_limit, a_limit = rng.uniform(0.1, 5.0, (2, 3))
    t = trajectory.t_s
    steps = np.append(np.diff(t), 0.0)
    _, v, a = trajectory.sample(t[:, None] + steps[:, None] * np.arange(MOMENTS) / MOMENTS)
    wanted = np.maximum((np.abs(v) / v_limit).max(axis=-1), (np.abs(a) / a_limit).max(axis=-1))
    np.testing.assert_allclose(limit_use(trajectory, v_limit, a_limit), wanted, rtol=1e-9, atol=1e-12)


@settings(max_examples=60)
@given(seed=SEEDS, shortest=st.sampled_from([0.0, 0.1]))
def test_what_comes_to_rest_does_so_smoothly_within_the_limits(seed: int, shortest: float) -> None:
    rng = np.random.default_rng(seed)
    v_limit, a_limit = rng.uniform(0.5, 2.0, 4), rng.uniform(1.0, 6.0, 4)
    v0, a0 = rng.uniform(-0.8, 0.8, 4) * v_limit, rng.uniform(-0.8, 0.8, 4) * a_limit
    v0[0] = a0[1] = 0.0
    fading = ComingToRest(v0, a0, v_limit, a_limit, shortest)
    t = np.linspace(0.0, 1.2 * fading.duration_s, 4000)
    q, v, a = fading.at(t)
    np.testing.assert_allclose(q[0], 0.0)
    np.testing.assert_allclose(v[0], v0)
    np.testing.assert_allclose(a[0], a0)
    for rate, whole in ((v, q), (a, v)):
        gained = ((rate[1:] + rate[:-1]) * 0.5 * np.diff(t)[:, None]).cumsum(axis=0)
        np.testing.assert_allclose(whole[0] + gained, whole[1:], atol=2e-3)
    np.testing.assert_allclose(q[-1], fading.way, atol=1e-12)
    assert not v[t > fading.duration_s].any()
    assert not a[t > fading.duration_s].any()
    assert (np.abs(a) <= a_limit + 1e-9).all()
    assert fading.duration_s <= (2.5 * np.abs(v0) / a_limit + np.abs(a0) / a_limit).max() + 0.2 + shortest


@pytest.mark.parametrize(
    "begin",
    [
        Begin.steady(0.0, 0.0),
        Begin.steady(0.5, 1.0),
        Begin.steady(0.8, -2.0),
        Begin.steady(0.5, 1.0).below(0.51),
        Begin.steady(0.5, 1.0).below(0.2),
    ],
)
def test_a_profile_begins_as_told_and_is_smooth(begin: Begin) -> None:
    nodes = np.linspace(0.0, 1.0, 101)
    # Braking from 2 towards the end: x = 4 (1 - s), starting no faster than the beginning allows.
    x = np.minimum(begin.raw_speed**2 + 3.0 * nodes, 4.0 * (1.0 - nodes))
    profile = AveragedProfile(x, begin, nodes[1])
    s, rate, change = profile.at(np.array([0.0]))
    assert s[0] == pytest.approx(0.0, abs=1e-12)
    assert rate[0] == pytest.approx(begin.speed, abs=1e-12)
    assert change[0] == pytest.approx(begin.change, abs=1e-9)
    t = np.linspace(0.0, profile.duration_s, 3000)
    s, rate, change = profile.at(t)
    np.testing.assert_allclose(np.gradient(s, t)[2:-2], rate[2:-2], atol=5e-3)
    np.testing.assert_allclose(np.gradient(rate, t)[2:-2], change[2:-2], atol=0.1)
    assert s[-1] == pytest.approx(1.0, abs=1e-9)
    assert rate[-1] == pytest.approx(0.0, abs=1e-6)
    # The acceleration changes no faster than averaging lets it.
    assert np.abs(np.diff(change)).max() < 4.0 * np.ptp(np.diff(np.sqrt(x))) / nodes[1] * (t[1] / SMOOTHING_S) + 0.2
