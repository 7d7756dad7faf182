"""The compiled steps of STOMP against what they are said to compute."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.stomp import iteration_kernels
from humanpred_ros.stomp.smoothness import accelerations_matrix, keep_within_limits, smoothness

SEEDS = st.integers(0, 2**32 - 1)


def rules(n: int, limit: np.ndarray) -> iteration_kernels.Rules:
    """P1's sharpness for trajectories of n waypoints, between -limit and limit (D,)."""
    smooth = smoothness(n)
    factor32 = smooth.factor.astype(np.float32)
    return iteration_kernels.Rules(
        iteration_kernels.QUANTILES, np.ones(len(limit), np.float32), 1.0, smooth.factor, factor32,
        smooth.column_scale, -limit, limit, sharpness=10.0, n_reused=0, tolerance=0.01, patience=0,
    )  # fmt: skip


def test_noise_is_standard_normal_and_repeatable() -> None:
    bits = iteration_kernels.random_bits(np.random.default_rng(0), 200_001)
    noise = iteration_kernels.QUANTILES[bits[: 2001 * 99]].reshape(2001, 99)
    assert noise.mean() == pytest.approx(0.0, abs=0.01)
    assert noise.var() == pytest.approx(1.0, abs=0.01)
    assert (noise**4).mean() == pytest.approx(3.0, abs=0.1)
    assert abs(np.corrcoef(noise.ravel()[:-1], noise.ravel()[1:])[0, 1]) < 0.01
    again = iteration_kernels.random_bits(np.random.default_rng(0), 200_001)
    assert np.array_equal(bits, again)


@settings(max_examples=40)
@given(seed=SEEDS, n_rollouts=st.integers(1, 12), n=st.integers(5, 60), n_joints=st.integers(1, 8))
def test_an_update_is_the_published_weighted_mean(seed: int, n_rollouts: int, n: int, n_joints: int) -> None:
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(n, n_joints))
    rollouts = (theta + rng.normal(0.0, 0.2, (n_rollouts, n, n_joints))).astype(np.float32)
    rollouts[:, [0, -1]] = theta[[0, -1]]
    state = rng.uniform(0.0, 5.0, (n_rollouts, n)).astype(np.float32)
    joint = rng.uniform(0.0, 5.0, (n_rollouts, n, n_joints)).astype(np.float32)

    S = state[:, :, None].astype(np.float64) + joint
    low, high = S.min(axis=0), S.max(axis=0)
    P = np.exp(-10.0 * (S - low) / np.maximum(high - low, 1e-12))
    P /= P.sum(axis=0)
    change = (P * (rollouts - theta)).sum(axis=0)[1:-1]
    A = accelerations_matrix(n)[:, 1:-1]
    inverse = np.linalg.inv(A.T @ A)
    expected = theta.copy()
    expected[1:-1] += inverse / np.abs(inverse).max(axis=0) / (n - 2) @ change

    iteration_kernels.improve(theta, rollouts, state, joint, rules(n, np.full(n_joints, 1e9)))
    np.testing.assert_allclose(theta, expected, atol=1e-4)


def test_equal_costs_pull_nowhere_in_particular() -> None:
    theta = np.zeros((9, 2))
    rollouts = np.stack([np.ones((9, 2)), -np.ones((9, 2))]).astype(np.float32)
    equal_state, equal_joint = np.full((2, 9), 3.0, np.float32), np.zeros((2, 9, 2), np.float32)
    iteration_kernels.improve(theta, rollouts, equal_state, equal_joint, rules(9, np.full(2, 9.0)))
    np.testing.assert_allclose(theta, 0.0, atol=1e-6)


@settings(max_examples=60)
@given(seed=SEEDS, n=st.integers(5, 100), reach=st.floats(0.05, 3.0))
def test_limits_are_kept_and_ends_left_alone(seed: int, n: int, reach: float) -> None:
    rng = np.random.default_rng(seed)
    x = rng.normal(0.0, 0.1, (n, 3)).cumsum(axis=0)
    before = x.copy()
    lower, upper = np.full(3, -reach), np.full(3, reach)
    keep_within_limits(x, lower, upper, smoothness(n).factor)
    assert (np.abs(x[1:-1]) <= reach).all()
    assert np.array_equal(x[[0, -1]], before[[0, -1]])
    untouched = (np.abs(before[1:-1]) <= reach).all(axis=0)
    assert np.array_equal(x[:, untouched], before[:, untouched])


def test_a_smooth_excursion_is_pushed_back_smoothly() -> None:
    t = np.linspace(0.0, 1.0, 100)
    x = np.sin(np.pi * t)[:, None]
    limit = np.array([0.8])
    clipped = keep_within_limits(x, -limit, limit, smoothness(100).factor)
    assert clipped == 0
    corner = np.abs(np.diff(np.minimum(np.sin(np.pi * t), 0.8), 2)).max()
    assert np.abs(np.diff(x[:, 0], 2)).max() < 0.3 * corner


@settings(max_examples=40)
@given(seed=SEEDS, n_rollouts=st.integers(1, 10), data=st.data())
def test_the_cheapest_rollouts_are_kept_with_their_costs(seed: int, n_rollouts: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    rollouts = rng.normal(size=(n_rollouts, 6, 2)).astype(np.float32)
    state = rng.integers(0, 3, (n_rollouts, 6)).astype(np.float32)  # ties happen
    joint = rng.integers(0, 2, (n_rollouts, 6, 2)).astype(np.float32)
    n_best = data.draw(st.integers(0, n_rollouts))
    total = state.sum(axis=1) + joint.sum(axis=(1, 2))
    chosen = np.sort(np.argsort(total, kind="stable")[:n_best])
    expected = rollouts[chosen], state[chosen], joint[chosen]
    iteration_kernels.keep_best(rollouts, state, joint, n_best, np.zeros(n_best, dtype=np.int64))
    for array, want in zip((rollouts, state, joint), expected, strict=True):
        assert np.array_equal(array[:n_best], want)
