"""Signed distances of boxes and cylinders, against closest points found another way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.shapes import Box, Cylinder, planar_pose

SEED = st.integers(0, 10_000)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    T = np.eye(4)
    T[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    T[:3, 3] = rng.normal(size=3)
    return T


@given(SEED)
def test_box_distance_outside_is_the_way_to_the_clamped_point_and_inside_to_the_nearest_face(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, size = random_pose(rng), rng.uniform(0.1, 1.0, 3)
    local = rng.uniform(-1.0, 1.0, (50, 3))
    distance = Box(T, size).distance(local @ T[:3, :3].T + T[:3, 3])
    clamped = np.clip(local, -size / 2, size / 2)
    outside = np.linalg.norm(local - clamped, axis=1)
    to_face = np.concatenate([size / 2 - local, size / 2 + local], axis=1).min(axis=1)
    np.testing.assert_allclose(distance, np.where(outside > 0, outside, -to_face), atol=1e-9)


@given(SEED)
def test_cylinder_distance_is_that_to_a_densely_sampled_surface(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, radius, height = random_pose(rng), rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.5)
    # By symmetry the closest surface point lies in the half-plane through the axis and the point.
    rim = np.linspace(0.0, radius, 800)
    side = np.linspace(-height / 2, height / 2, 800)
    profile = np.concatenate(
        [
            np.stack([rim, np.full(800, height / 2)], axis=1),
            np.stack([rim, np.full(800, -height / 2)], axis=1),
            np.stack([np.full(800, radius), side], axis=1),
        ]
    )
    local = rng.uniform(-0.6, 0.6, (20, 3))
    flat = np.stack([np.hypot(local[:, 0], local[:, 1]), local[:, 2]], axis=1)
    expected = np.linalg.norm(flat[:, None] - profile, axis=2).min(axis=1)
    inside = (flat[:, 0] < radius) & (np.abs(flat[:, 1]) < height / 2)
    distance = Cylinder(T, radius, height).distance(local @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(distance, np.where(inside, -expected, expected), atol=1e-3)


def test_shapes_take_any_number_of_points_of_either_precision() -> None:
    cylinder = Cylinder(planar_pose(1.0, 2.0, 3.0), 0.1, 0.2)
    assert cylinder.distance(np.array([1.0, 2.0, 3.0])) == pytest.approx(-0.1)
    assert cylinder.distance(np.ones((2, 3, 3))).shape == (2, 3)
    assert Box(np.eye(4), [1, 1, 1]).distance(np.zeros((4, 3), dtype=np.float32)) == pytest.approx([-0.5] * 4)


def test_planar_pose_turns_about_the_vertical() -> None:
    T = planar_pose(1.0, 2.0, 3.0, np.pi / 2)
    np.testing.assert_allclose(T @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12)


@pytest.mark.parametrize(("radius", "height"), [(0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (1.0, np.inf)])
def test_impossible_cylinders_are_refused(radius: float, height: float) -> None:
    with pytest.raises(ArrayError, match="cylinder"):
        Cylinder(np.eye(4), radius, height)


def test_impossible_boxes_are_refused() -> None:
    with pytest.raises(ArrayError, match="positive"):
        Box(np.eye(4), [1.0, 0.0, 1.0])
    with pytest.raises(ArrayError, match="rigid"):
        Box(2.0 * np.eye(4), [1.0, 1.0, 1.0])
    with pytest.raises(ArrayError, match="shape"):
        Box(np.eye(3), [1.0, 1.0, 1.0])
