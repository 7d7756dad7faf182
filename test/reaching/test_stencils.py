"""The finite differences differentiate, and noise of their covariance is as large and as smooth as P2's."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import MotionError
from humanpred_ros.reaching.stencils import (
    JERK_RULE,
    REACH,
    RULES,
    difference_matrix,
    jerk_covariance,
    standard_deviation,
)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_each_rule_is_the_derivative_of_its_order(order: int) -> None:
    offsets = np.arange(-REACH, REACH + 1)
    rule = RULES[order - 1]
    factorial = (1.0, 1.0, 2.0, 6.0)[order]
    for power in range(order):
        assert rule @ offsets.astype(float) ** power == pytest.approx(0.0, abs=1e-12)
    assert rule @ offsets.astype(float) ** order == pytest.approx(factorial)


def test_noise_has_the_covariance_of_the_jerk_rule() -> None:
    n = 20
    D = difference_matrix(np.array(JERK_RULE), n)
    R = D.T @ D
    draws = jerk_covariance(n).draw(np.random.default_rng(0), (3000, 2))
    flat = draws.transpose(0, 2, 1).reshape(-1, n)
    expected = np.linalg.inv(R)
    np.testing.assert_allclose(standard_deviation(n), np.sqrt(np.diagonal(expected)), rtol=1e-8)
    empirical = flat.T @ flat / len(flat)
    spread = np.sqrt(np.diagonal(expected))
    assert np.abs((empirical - expected) / np.outer(spread, spread)).max() < 0.06  # 1 / sqrt(6000), times 4.6


def test_noise_of_a_hundred_waypoints_is_as_large_as_in_p2() -> None:
    # facts section 5: 746 in the middle, 1e-4 / 1.5e-4 at the ends.
    deviation = standard_deviation(100)
    assert deviation[50] == pytest.approx(746.0, abs=1.0)
    assert 0.5 < deviation[0] < 1.0
    assert deviation[-1] == pytest.approx(deviation[0], rel=1e-6)


def test_the_same_seed_gives_the_same_noise() -> None:
    draws = [jerk_covariance(30).draw(np.random.default_rng(5), (4, 3)) for _ in range(2)]
    assert draws[0].shape == (4, 30, 3)
    np.testing.assert_array_equal(*draws)


def test_reaches_shorter_than_the_stencil_are_refused() -> None:
    with pytest.raises(MotionError, match="at least 7 waypoints, got 6"):
        jerk_covariance(6)
