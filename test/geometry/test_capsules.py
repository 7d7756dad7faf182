"""Shapes: distances against geometry worked out another way, and samples that leave no hole."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.capsules import Box, Capsule, EllipticCylinder, Shape, Sphere

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
    with pytest.raises(HumanModelError, match="positive radius_m"):
        Sphere(length)
