"""Voxel grids and occupancies: indices and centres agree, and what is no probability is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid

pytestmark = pytest.mark.core

GRID = VoxelGrid((-2.0, -3.0, -0.4), 0.05, (8, 5, 6))


def test_every_centre_lies_in_its_voxel() -> None:
    flat = np.arange(GRID.size)
    np.testing.assert_array_equal(GRID.flat_index(GRID.centres_m(flat)), flat)


@given(st.tuples(*[st.floats(-5, 5)] * 3))
def test_a_point_is_within_half_an_edge_of_its_voxels_centre(point: tuple[float, float, float]) -> None:
    flat = int(GRID.flat_index(np.array(point)))
    inside = all(lower <= x < lower + n * 0.05 for x, lower, n in zip(point, GRID.origin_m, GRID.shape, strict=True))
    if flat >= 0:
        assert np.abs(GRID.centres_m(np.array(flat)) - point).max() <= 0.025 + 1e-9
    elif inside:  # rounding may put a point on the border outside, never one within
        distance = min(
            abs(x - edge)
            for x, lower, n in zip(point, GRID.origin_m, GRID.shape, strict=True)
            for edge in (lower, lower + n * 0.05)
        )
        assert distance < 1e-9


def test_points_outside_or_lost_have_no_voxel() -> None:
    points = np.array([[-2.001, -2.9, -0.3], [-1.59, -2.9, -0.3], [np.nan, -2.9, -0.3], [1e300, 0, 0]])
    np.testing.assert_array_equal(GRID.flat_index(points), -1)
    assert not GRID.mask_of(points).any()


def test_mask_marks_voxels_with_points_once() -> None:
    points = GRID.centres_m(np.array([0, 0, 17, GRID.size - 1]))
    np.testing.assert_array_equal(np.flatnonzero(GRID.mask_of(points)), [0, 17, GRID.size - 1])


def test_sparse_keeps_what_exceeds_the_threshold() -> None:
    probability = np.zeros(GRID.shape, dtype=np.float32)
    probability.ravel()[[3, 50, 51]] = [0.2, 0.6, 0.8]
    occupancy = Occupancy(GRID, probability, 1.25)
    np.testing.assert_array_equal(occupancy.voxels_above(0.7), [51])
    kept = occupancy.sparse(0.2)
    assert (kept.t_s, kept.probability.sum()) == (1.25, pytest.approx(1.4))


@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan])
def test_what_is_no_probability_is_refused(value: float) -> None:
    probability = np.zeros(GRID.shape, dtype=np.float32)
    probability[1, 2, 3] = value
    with pytest.raises(ArrayError):
        Occupancy(GRID, probability)


def test_impossible_grids_are_refused() -> None:
    for origin, resolution, shape in (
        ((0, 0), 0.1, (1, 1, 1)),
        ((0, 0, 0), 0.0, (1, 1, 1)),
        ((0, 0, 0), float("nan"), (1, 1, 1)),
        ((0, 0, 0), 0.1, (1, 0, 1)),
        ((0, 0, 0), 0.1, (1, 1)),
    ):
        with pytest.raises(ArrayError):
            VoxelGrid(origin, resolution, shape)
    with pytest.raises(ArrayError):
        Occupancy(GRID, np.zeros((2, 2, 2), dtype=np.float32))
