"""Smooth noise and smooth updates: what the sweeps compute is what the matrices say."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import PlanningError
from humanpred_ros.stomp.smoothness import accelerations_matrix, colour, smoothness, solve


def dense(n_waypoints: int) -> np.ndarray:
    A = accelerations_matrix(n_waypoints)[:, 1:-1]
    return A.T @ A


@pytest.mark.parametrize("n", [5, 6, 9, 30, 100, 101])
def test_updates_are_the_columns_of_the_inverse_scaled_to_one_over_n(n: int) -> None:
    inverse = np.linalg.inv(dense(n))
    M = inverse / np.abs(inverse).max(axis=0) / (n - 2)
    smooth = smoothness(n)
    scaled = np.diag(smooth.column_scale)
    solve(smooth.factor, scaled)
    np.testing.assert_allclose(scaled, M, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(np.abs(M).max(axis=0), 1.0 / (n - 2))


@pytest.mark.parametrize("n", [5, 8, 60, 100])
def test_noise_has_the_inverse_as_its_covariance(n: int) -> None:
    white = np.eye(n - 2, dtype=np.float32)
    colour(smoothness(n).factor.astype(np.float32), white)
    map_of_noise = white.astype(np.float64)
    covariance = map_of_noise @ map_of_noise.T
    exact = np.linalg.inv(dense(n))
    assert np.abs(covariance - exact).max() < 1e-4 * exact.max()


def test_noise_is_as_large_as_published() -> None:
    # docs/papers.md, P1 STOMP: std 0.002 gives 0.148 rad at the middle and 0.10 at a quarter, of 100 free waypoints.
    deviation = 0.002 * np.sqrt(np.diag(np.linalg.inv(dense(102))))
    assert deviation[49] == pytest.approx(0.148, abs=0.002)
    assert deviation[24] == pytest.approx(0.10, abs=0.005)


def test_accelerations_are_those_of_a_robot_at_rest_at_both_ends() -> None:
    A = accelerations_matrix(20)
    assert A.shape == (22, 20)
    np.testing.assert_allclose(A @ np.ones(20), 0.0, atol=1e-12)
    parabola = np.arange(20.0) ** 2
    np.testing.assert_allclose((A @ parabola)[3:-3], 2.0)
    constant_speed = A @ np.arange(20.0)
    assert abs(constant_speed[1]) > 0.5
    np.testing.assert_allclose(constant_speed[3:-3], 0.0, atol=1e-12)


def test_too_short_a_trajectory_is_refused() -> None:
    with pytest.raises(PlanningError, match="at least 5 waypoints"):
        smoothness(4)
