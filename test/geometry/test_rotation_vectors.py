"""Rotation vectors and matrices say the same, up to half turns and down to none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humanpred_ros.geometry.rotation_vectors import rotation_matrix, rotation_vector

SEED = st.integers(0, 100_000)


def axes(seed: int, n: int = 20) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@given(SEED, st.floats(0.0, np.pi - 1e-5))
def test_vectors_and_matrices_agree_with_scipy(seed: int, angle: float) -> None:
    vectors = angle * axes(seed)
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotation_matrix(vectors), expected, atol=1e-12)
    np.testing.assert_allclose(rotation_vector(expected), vectors, atol=1e-9)


@pytest.mark.parametrize("short_of", [0.0, 1e-12, 1e-9, 1e-7, 1e-6])
def test_half_turns_keep_their_axis(short_of: float) -> None:
    rotation = Rotation.from_rotvec((np.pi - short_of) * np.concatenate([axes(0), np.eye(3), -np.eye(3)])).as_matrix()
    found = rotation_vector(rotation)
    np.testing.assert_allclose(rotation_matrix(found), rotation, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), np.pi - short_of, atol=1e-9)


def test_any_number_of_leading_axes() -> None:
    vectors = 0.3 * axes(1, 24).reshape(2, 3, 4, 3)
    assert rotation_matrix(vectors).shape == (2, 3, 4, 3, 3)
    np.testing.assert_allclose(rotation_vector(rotation_matrix(vectors)), vectors, atol=1e-12)
    np.testing.assert_array_equal(rotation_matrix(np.zeros(3)), np.eye(3))
    np.testing.assert_array_equal(rotation_vector(np.eye(3)), np.zeros(3))
