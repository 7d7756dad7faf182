"""Cutting keeps the surface, covers cover, samples are spread: properties that hold for any closed surface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError
from humanpred_ros.robot.surface import bounds, covering_boxes, covering_spheres, sample, split

CORNERS = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def box(lower: list[float], upper: list[float]) -> np.ndarray:
    """Surface of an axis-aligned box, outward normals."""
    corners = np.array(lower) + CORNERS * (np.array(upper) - np.array(lower))
    return corners[[t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))]]


# An L of two boxes that overlap: its bounding box is mostly air.
L_SHAPE = np.concatenate([box([0, 0, 0], [1, 0.1, 0.1]), box([0, 0, 0], [0.1, 0.1, 0.8])])


def area(triangles: np.ndarray) -> float:
    edges = triangles[:, 1:] - triangles[:, :1]
    return float(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2.0)


def volume(triangles: np.ndarray) -> float:
    return float(np.einsum("fi,fi->f", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6.0)


@given(st.integers(0, 2), st.floats(-0.2, 1.2), st.integers(0, 10_000))
def test_split_keeps_area_and_orientation_and_separates(axis: int, at: float, seed: int) -> None:
    soup = np.random.default_rng(seed).uniform(0.0, 1.0, (8, 3, 3))
    below, above = split(soup, axis, at)
    assert area(below) + area(above) == pytest.approx(area(soup), rel=1e-9)
    assert volume(below) + volume(above) == pytest.approx(volume(soup), abs=1e-9)
    assert (below[:, :, axis] <= at + 1e-9).all()
    assert (above[:, :, axis] >= at - 1e-9).all()


@settings(max_examples=30)
@given(st.floats(0.1, 0.6), st.integers(0, 10_000))
def test_spheres_cover_every_point_of_the_surface(largest: float, seed: int) -> None:
    centres, radii = covering_spheres(L_SHAPE, largest)
    assert (radii <= largest).all()
    weights = np.random.default_rng(seed).dirichlet([1, 1, 1], 60)
    points = np.einsum("pc,fcx->fpx", weights, L_SHAPE).reshape(-1, 3)
    depth = radii - np.linalg.norm(points[:, None] - centres, axis=2)
    assert depth.max(axis=1).min() >= -1e-9


def test_one_sphere_around_a_cube_is_nearly_the_smallest() -> None:
    centres, radii = covering_spheres(box([0, 0, 0], [1, 1, 1]), 1.0)
    assert len(centres) == 1
    assert radii[0] == pytest.approx(np.sqrt(3.0) / 2.0, rel=0.02)


@given(st.floats(1e-4, 0.1), st.integers(0, 10_000))
def test_boxes_cover_the_inside_of_a_solid(saving: float, seed: int) -> None:
    boxes = covering_boxes(L_SHAPE, saving)
    rng = np.random.default_rng(seed)
    solid = np.concatenate(
        [rng.uniform([0, 0, 0], [1, 0.1, 0.1], (200, 3)), rng.uniform([0, 0, 0], [0.1, 0.1, 0.8], (200, 3))]
    )
    inside = [((solid >= low - 1e-9) & (solid <= high + 1e-9)).all(axis=1) for low, high in boxes]
    assert np.any(inside, axis=0).all()


def test_boxes_leave_no_hollow_where_the_surface_is_far(rng: np.random.Generator) -> None:
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    octahedron = corners[[[x, y, z] for x in (0, 3) for y in (1, 4) for z in (2, 5)]]
    boxes = covering_boxes(octahedron, 1e-3)
    solid = rng.uniform(-1.0, 1.0, (4000, 3))
    solid = solid[np.abs(solid).sum(axis=1) < 1.0]
    inside = [((solid >= low - 1e-9) & (solid <= high + 1e-9)).all(axis=1) for low, high in boxes]
    assert len(boxes) > 10
    assert np.any(inside, axis=0).all()


def test_boxes_follow_a_shape_that_is_mostly_air() -> None:
    air = np.prod(np.subtract(*bounds(L_SHAPE)[::-1]))
    covered = sum(np.prod(high - low) for low, high in covering_boxes(L_SHAPE, 1e-3))
    assert covered < 0.4 * air


@settings(max_examples=30)
@given(st.floats(0.05, 0.5))
def test_samples_are_neither_crowded_nor_missing(spacing: float) -> None:
    points = sample(L_SHAPE, spacing)
    apart = np.linalg.norm(points[:, None] - points, axis=2)[~np.eye(len(points), dtype=bool)]
    assert len(points) > 1
    assert apart.min() >= spacing - 1e-6
    corners = L_SHAPE.reshape(-1, 3)
    assert np.linalg.norm(corners[:, None] - points, axis=2).min(axis=1).max() < spacing + 1e-6
    lower, upper = bounds(L_SHAPE)
    assert ((points >= lower - 1e-9) & (points <= upper + 1e-9)).all()
    np.testing.assert_array_equal(points, sample(L_SHAPE, spacing))


def test_meaningless_requests_are_refused() -> None:
    with pytest.raises(ArrayError, match="spacing"):
        sample(L_SHAPE, 0.0)
    with pytest.raises(ArrayError, match="radius"):
        covering_spheres(L_SHAPE, -1.0)
    with pytest.raises(ArrayError, match="volume"):
        covering_boxes(L_SHAPE, 0.0)
    with pytest.raises(ArrayError, match="triangle"):
        bounds(np.zeros((0, 3, 3)))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)
