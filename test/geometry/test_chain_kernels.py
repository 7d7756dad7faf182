"""Forward kinematics against a plain product of transforms, for trees of joints of every kind."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humanpred_ros.geometry.chain_kernels import link_poses, point_jacobians, point_positions, point_positions_32
from humanpred_ros.geometry.joints import FIRST, LAST, Joints

STRAIGHT, ANY = "straight", "any"


def some_joints(seed: int, axes: str, serial: bool) -> tuple[Joints, np.ndarray, np.ndarray, np.ndarray]:
    """Return random joints with their placements, axes and whether they slide."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 9))
    T = np.tile(np.eye(4), (n, 1, 1))
    turned = rng.random(n) < 0.5
    T[turned, :3, :3] = Rotation.random(n, random_state=seed).as_matrix()[turned]
    T[:, :3, 3] = rng.normal(0.0, 0.3, (n, 3)) * (rng.random((n, 1)) < 0.8)
    axis = np.eye(3)[rng.integers(0, 3, n)] * rng.choice([-1.0, 1.0], (n, 1))
    if axes == ANY:
        axis = rng.normal(size=(n, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    slides = rng.random(n) < 0.3
    parent = np.arange(n) if serial else np.array([int(rng.integers(0, j + 1)) for j in range(n)])
    return Joints.of(parent, T, axis, slides), T, axis, slides


def frames(q: np.ndarray, joints: Joints, T: np.ndarray, axis: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Return the (J + 1, 4, 4) frames after the root and each joint: the oracle."""
    found = [np.eye(4)]
    for j, angle in enumerate(q):
        motion = np.eye(4)
        if slides[j]:
            motion[:3, 3] = angle * axis[j]
        else:
            motion[:3, :3] = Rotation.from_rotvec(angle * axis[j]).as_matrix()
        found.append(found[joints.parent[j]] @ T[j] @ motion)
    return np.array(found)


@pytest.mark.parametrize("axes", [STRAIGHT, ANY])
@given(seed=st.integers(0, 2**32 - 1))
def test_link_poses_are_products_of_transforms(axes: str, seed: int) -> None:
    joints, *parts = some_joints(seed, axes, serial=False)
    rng = np.random.default_rng(seed)
    q = rng.uniform(-4.0, 4.0, (3, len(joints.parent)))
    joint = rng.integers(0, len(joints.parent) + 1, 4)
    T_joint_link = np.tile(np.eye(4), (4, 1, 1))
    T_joint_link[:, :3, :3] = Rotation.random(4, random_state=seed).as_matrix()
    T_joint_link[:, :3, 3] = rng.normal(size=(4, 3))
    poses = link_poses(q, joints, joint, T_joint_link)
    wanted = [frames(posture, joints, *parts)[joint] @ T_joint_link for posture in q]
    np.testing.assert_allclose(poses, wanted, atol=1e-12)
    points = point_positions(q, joints, joint, T_joint_link[:, :3, 3].copy())
    np.testing.assert_allclose(points, np.array(wanted)[..., :3, 3], atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1))
def test_jacobians_are_finite_differences(seed: int) -> None:
    joints, *_ = some_joints(seed, ANY, serial=False)
    rng = np.random.default_rng(seed)
    q = rng.uniform(-3.0, 3.0, (2, len(joints.parent)))
    joint, local = rng.integers(0, len(joints.parent) + 1, 3), rng.normal(size=(3, 3))
    found = point_jacobians(q, joints, joint, local)
    step = 1e-6
    for j, unit in enumerate(np.eye(len(joints.parent))):
        ahead, back = (point_positions(q + sign * step * unit, joints, joint, local) for sign in (1.0, -1.0))
        np.testing.assert_allclose(found[..., j], (ahead - back) / (2.0 * step), atol=1e-8)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 130))
def test_single_precision_in_blocks_is_double_precision_rounded(seed: int, count: int) -> None:
    joints, *_ = some_joints(seed, STRAIGHT, serial=True)
    rng = np.random.default_rng(seed)
    q = rng.uniform(-7.0, 7.0, (count, len(joints.parent))).astype(np.float32)
    joint, local = np.sort(rng.integers(0, len(joints.parent) + 1, 5)), rng.normal(size=(5, 3))
    table = joints.table.astype(np.float32)
    first = np.searchsorted(joint, np.arange(1, len(joints.parent) + 2))
    table[:, FIRST], table[:, LAST] = first[:-1], first[1:]
    points = np.column_stack([local, np.zeros(5)]).astype(np.float32)
    found = point_positions_32(q, table, points)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, point_positions(q.astype(np.float64), joints, joint, local), atol=3e-5)
