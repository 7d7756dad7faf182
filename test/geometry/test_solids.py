"""Solids: distances against geometry worked out another way, and samples that leave no hole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.solids import Box, Capsule, EllipticCylinder, Obstacle, Shape, Sphere, cylinder, planar_pose

SHAPES = [
    Sphere(0.13),
    Box(0.2, 0.4, 0.15),
    Capsule(0.06, 0.2),
    EllipticCylinder(0.1415, 0.203, 0.2574),
    EllipticCylinder(0.203, 0.1415, 0.2574),
    EllipticCylinder(0.07, 0.07, 0.12),
]
names = pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)


def on_surface(shape: Shape, seed: int, count: int = 3000) -> np.ndarray:
    """Return random surface points, found by bisection on rays from the centre (all shapes are star-shaped)."""
    rays = np.random.default_rng(seed).normal(size=(count, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    low, high = np.zeros(count), np.ones(count)
    for _ in range(50):
        middle = (low + high) / 2
        inside = shape.distance_m(rays * middle[:, None]) < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return rays * low[:, None]


@names
def test_samples_leave_no_hole_and_lie_on_the_surface(shape: Shape) -> None:
    for spacing in (0.01, 0.02, 0.05, 1.0):
        samples = shape.sample(spacing)
        assert np.abs(shape.distance_m(samples)).max() < 1e-9
        farthest = cKDTree(samples).query(on_surface(shape, seed=1))[0].max()
        assert farthest <= spacing


@names
def test_sampling_is_no_denser_than_asked_for(shape: Shape) -> None:
    area = len(shape.sample(0.005)) * 0.005**2  # about the shape's area, so about 1 point per spacing squared
    assert len(shape.sample(0.02)) < 1.6 * area / 0.02**2


@names
def test_sampling_is_deterministic(shape: Shape) -> None:
    np.testing.assert_array_equal(shape.sample(0.02), shape.sample(0.02))


@names
def test_distance_is_the_way_to_the_nearest_surface_point(shape: Shape) -> None:
    points = np.random.default_rng(2).uniform(-0.6, 0.6, (400, 3))
    distance = shape.distance_m(points)
    to_samples = cKDTree(shape.sample(0.004)).query(points)[0]
    # The nearest sample is never nearer than the surface, and at most the spacing farther.
    assert (to_samples >= np.abs(distance) - 1e-9).all()
    assert (to_samples <= np.abs(distance) + 0.004).all()
    assert np.median(to_samples - np.abs(distance)) < 1e-4  # and mostly hardly farther


@names
@settings(max_examples=50)
@given(step=st.floats(-0.2, 0.2), seed=st.integers(0, 1000))
def test_distance_never_changes_faster_than_the_point_moves(shape: Shape, step: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.uniform(-0.4, 0.4, (20, 3))
    b = a + step * rng.uniform(-1, 1, (20, 3))
    change = np.abs(shape.distance_m(a) - shape.distance_m(b))
    assert (change <= np.linalg.norm(a - b, axis=1) + 1e-8).all()


@pytest.mark.parametrize(("x", "y"), [(0.1415, 0.203), (0.203, 0.1415), (0.02, 0.4)])
def test_ellipse_distance_agrees_with_a_dense_outline(x: float, y: float) -> None:
    rng = np.random.default_rng(3)
    grid = np.linspace(-0.5, 0.5, 41)
    flat = np.concatenate(
        [rng.uniform(-0.5, 0.5, (400, 2)), np.c_[grid, 0 * grid], np.c_[0 * grid, grid], [[0.0, 0.0]]]
    )
    angle = np.linspace(0, 2 * np.pi, 200_001)
    outline = cKDTree(np.c_[x * np.cos(angle), y * np.sin(angle)])
    got = EllipticCylinder(x, y, 10.0).distance_m(np.c_[flat, np.zeros(len(flat))])
    np.testing.assert_allclose(np.abs(got), outline.query(flat)[0], atol=1e-6)
    np.testing.assert_array_equal(got < 0, ((flat / (x, y)) ** 2).sum(axis=1) < 1)


def test_known_distances() -> None:
    assert Sphere(0.5).distance_m(np.array([[2.0, 0, 0]]))[0] == pytest.approx(1.5)
    assert Box(2, 2, 2).distance_m(np.array([[4.0, 5.0, 0.5], [0.9, 0, 0]])) == pytest.approx([5.0, -0.1])
    assert Capsule(0.1, 2).distance_m(np.array([[0.3, 0, 1.4], [0, 0, 1.1]])) == pytest.approx([0.4, 0.0])
    assert EllipticCylinder(1, 1, 2).distance_m(np.array([[4.0, 0, 5.0], [0, 0, 0.8]])) == pytest.approx([5.0, -0.2])


@pytest.mark.parametrize("length", [0.0, -0.1, float("nan"), float("inf")])
def test_lengths_that_are_no_lengths_are_refused(length: float) -> None:
    with pytest.raises(ArrayError, match="positive radius_m"):
        Sphere(length)


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
    distance = Obstacle("box", Box(*size), T).distance_m(local @ T[:3, :3].T + T[:3, 3])
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
    distance = Obstacle("cup", cylinder(radius, height), T).distance_m(local @ T[:3, :3].T + T[:3, 3])
    np.testing.assert_allclose(distance, np.where(inside, -expected, expected), atol=1e-3)


def test_shapes_take_any_number_of_points_of_either_precision() -> None:
    cup = Obstacle("cup", cylinder(0.1, 0.2), planar_pose(1.0, 2.0, 3.0))
    assert cup.distance_m(np.array([1.0, 2.0, 3.0])) == pytest.approx(-0.1)
    assert cup.distance_m(np.ones((2, 3, 3))).shape == (2, 3)
    zeros = np.zeros(4, dtype=np.float32)
    for shape, middle in ((Box(1, 1, 1), -0.5), (Sphere(0.3), -0.3), (Capsule(0.1, 2), -0.1), (cylinder(0.1, 2), -0.1)):
        assert shape.local_distance(zeros, zeros, zeros).dtype == np.float32
        assert shape.local_distance(zeros, zeros, zeros) == pytest.approx([middle] * 4)


def test_planar_pose_turns_about_the_vertical() -> None:
    T = planar_pose(1.0, 2.0, 3.0, np.pi / 2)
    np.testing.assert_allclose(T @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12)


def test_obstacles_that_do_not_stand_anywhere_are_refused() -> None:
    with pytest.raises(ArrayError, match=r"post.*rigid"):
        Obstacle("post", Box(1.0, 1.0, 1.0), 2.0 * np.eye(4))
    with pytest.raises(ArrayError, match=r"post.*shape"):
        Obstacle("post", Box(1.0, 1.0, 1.0), np.eye(3))


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: type(s).__name__)
def test_a_solid_touches_every_side_of_the_box_around_it(shape: Shape) -> None:
    farthest = shape.sample(0.002).max(axis=0)
    np.testing.assert_allclose(farthest, shape.half_m, atol=1e-3)
    assert (farthest <= np.array(shape.half_m) + 1e-12).all()
