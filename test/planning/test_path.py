"""Polylines: lengths, places on them, and even spacing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.planning.path import path_integral, path_parameter, point_at, resampled, straight

SEEDS = st.integers(0, 2**32 - 1)


def wander(seed: int, n: int = 30, d: int = 4) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.2, (n, d)).cumsum(axis=0)


@settings(max_examples=40)
@given(seed=SEEDS, n=st.integers(2, 80))
def test_resampling_spaces_evenly_and_keeps_the_ends(seed: int, n: int) -> None:
    path, weights = wander(seed), np.array([0.5, 0.2, 0.4, 0.1])
    even = resampled(path, n, weights)
    assert even.shape == (n, 4)
    assert np.array_equal(even[[0, -1]], path[[0, -1]])
    length = path_parameter(path, weights)[-1]
    # A chord is never longer than the stretch it spans.
    assert np.diff(path_parameter(even, weights)).max() <= length / (n - 1) * (1 + 1e-9)


def test_resampling_a_straight_line_gives_equal_steps() -> None:
    line = np.array([[0.0, 0.0], [0.1, 0.0], [0.11, 0.0], [3.0, 0.0]])
    np.testing.assert_allclose(resampled(line, 7)[:, 0], np.linspace(0.0, 3.0, 7), atol=1e-12)


def test_a_robot_that_stays_is_a_path_too() -> None:
    still = np.ones((5, 3))
    assert np.array_equal(resampled(still, 4), np.ones((4, 3)))
    assert path_parameter(still)[-1] == 0.0


def test_places_beyond_the_ends_are_the_ends() -> None:
    path = wander(1)
    along = path_parameter(path)
    np.testing.assert_array_equal(point_at(path, along, np.array([-1.0, along[-1] + 1.0])), path[[0, -1]])
    np.testing.assert_allclose(point_at(path, along, along), path, atol=1e-12)


def test_the_parameter_is_weighted_distance() -> None:
    assert path_parameter(np.array([[0.0, 0.0], [1.0, 1.0]]), [3.0, 4.0])[-1] == pytest.approx(5.0)


def test_the_integral_is_the_trapezoid_rule_over_length() -> None:
    path = np.array([[0.0], [1.0], [3.0]])
    assert path_integral(np.array([2.0, 4.0, 0.0]), path) == pytest.approx(3.0 + 4.0)
    both = path_integral(np.array([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]), np.stack([path, path]), 0.5)
    np.testing.assert_allclose(both, [1.5, 0.0])


def test_a_straight_line_has_exact_ends() -> None:
    a, b = np.array([0.1, 0.7]), np.array([0.3, -1e-17])
    line = straight(a, b, 11)
    assert np.array_equal(line[0], a)
    assert np.array_equal(line[-1], b)
