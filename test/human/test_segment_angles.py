"""Closed-form angles: the rotation comes back, the ranges are the recordings', and aligned axes stay calm."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.human.segment_angles import joint_angles, joint_rotation

SEQUENCES = ["xrz", "zxz", "rxz"]
each = pytest.mark.parametrize("sequence", SEQUENCES)


def middle_range(sequence: str) -> tuple[float, float]:
    return (-np.pi + 1e-3, -1e-3) if sequence == "zxz" else (-np.pi / 2 + 1e-3, np.pi / 2 - 1e-3)


def random_rotations(count: int, seed: int) -> np.ndarray:
    Q, R = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))
    Q = Q * np.sign(np.diagonal(R, axis1=1, axis2=2))[:, None]
    Q[np.linalg.det(Q) < 0, :, 0] *= -1
    return Q


@each
@settings(max_examples=100)
@given(a=st.floats(-3.1, 3.1), c=st.floats(-3.1, 3.1), share=st.floats(0, 1))
def test_angles_within_the_ranges_come_back(sequence: str, a: float, c: float, share: float) -> None:
    low, high = middle_range(sequence)
    angles = np.array([[a, low + share * (high - low), c]])
    np.testing.assert_allclose(joint_angles(joint_rotation(angles, sequence), sequence), angles, atol=1e-9)


@each
def test_every_rotation_comes_back(sequence: str) -> None:
    R = random_rotations(500, seed=1)
    angles = joint_angles(R, sequence)
    np.testing.assert_allclose(joint_rotation(angles, sequence), R, atol=1e-12)
    low, high = middle_range(sequence)
    assert ((angles[:, 1] > low - 2e-3) & (angles[:, 1] < high + 2e-3)).all()


@each
def test_angles_are_continuous_over_many_turns(sequence: str) -> None:
    s = np.linspace(0, 1, 300)
    b = np.mean(middle_range(sequence)) + 0.5 * np.sin(7 * s)
    angles = np.stack([-3 + 12 * s, b, 3 - 15 * s], axis=1)
    np.testing.assert_allclose(joint_angles(joint_rotation(angles, sequence), sequence), angles, atol=1e-9)


@each
def test_aligned_axes_keep_the_first_angle_and_the_rotation(sequence: str) -> None:
    aligned = 0.0 if sequence == "zxz" else np.pi / 2
    angles = np.array([[0.4, -1.0, 0.3], [0.9, aligned, 0.2], [0.9, aligned, 0.5], [0.5, -1.0, 0.2]])
    R = joint_rotation(angles, sequence)
    found = joint_angles(R, sequence)
    np.testing.assert_allclose(found[[1, 2], 0], 0.4)
    np.testing.assert_allclose(joint_rotation(found, sequence), R, atol=1e-9)
    alone = joint_angles(R[1:3], sequence)  # nothing shows the first angle
    np.testing.assert_allclose(alone[:, 0], 0.0)
    np.testing.assert_allclose(joint_rotation(alone, sequence), R[1:3], atol=1e-9)


@each
def test_unknown_rotations_stay_unknown_and_harm_no_neighbour(sequence: str) -> None:
    angles = np.array([[3.0, -0.5, 0.1], [3.1, -0.6, 0.1], [3.3, -0.7, 0.1]])
    R = joint_rotation(angles, sequence)
    R[1] = np.nan
    found = joint_angles(R, sequence)
    assert np.isnan(found[1]).all()
    np.testing.assert_allclose(found[[0, 2]], angles[[0, 2]], atol=1e-9)
