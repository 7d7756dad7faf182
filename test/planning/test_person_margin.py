from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.person import widened


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), margin_m=st.sampled_from([0.0, 0.04, 0.05, 0.0708, 0.1, 0.13]))
def test_each_voxel_is_as_likely_as_the_likeliest_within_the_margin(seed: int, margin_m: float) -> None:
    rng = np.random.default_rng(seed)
    grid = VoxelGrid((0.0, 0.0, 0.0), 0.05, (12, 9, 7))
    probability = np.where(rng.random(grid.shape) < 0.05, rng.random(grid.shape), 0.0).astype(np.float32)
    reach = np.arange(-3, 4)
    distance = 0.05 * np.sqrt(sum(axis**2 for axis in np.meshgrid(reach, reach, reach)))
    oracle = ndimage.maximum_filter(probability, footprint=distance <= margin_m + 1e-9, mode="constant")
    wide = widened(Occupancy(grid, probability, 2.5), margin_m)
    # What comes back is the box that holds it, in its place on the lattice.
    back = np.zeros(grid.size, dtype=np.float32)
    back[grid.flat_index(wide.grid.centres_m(np.arange(wide.grid.size)))] = wide.probability.ravel()
    assert np.array_equal(back.reshape(grid.shape), oracle)
    assert (wide.t_s, wide.grid.resolution_m) == (2.5, grid.resolution_m)


def test_with_nobody_there_the_box_is_small() -> None:
    grid = VoxelGrid((0.0, 0.0, 0.0), 0.05, (30, 30, 30))
    nobody = widened(Occupancy(grid, np.zeros(grid.shape, dtype=np.float32)), 0.1)
    assert nobody.grid.size < 100
    assert not nobody.probability.any()


@pytest.mark.parametrize("margin_m", [-0.1, np.nan, np.inf])
def test_an_impossible_margin_is_refused(margin_m: float) -> None:
    grid = VoxelGrid((0.0, 0.0, 0.0), 0.05, (2, 2, 2))
    with pytest.raises(PlanningError, match="margin"):
        widened(Occupancy(grid, np.zeros(grid.shape, dtype=np.float32)), margin_m)


@pytest.mark.parametrize("margin_m", [0.15, 0.3, 0.35])
def test_a_margin_of_whole_voxels_reaches_its_last_voxel_whatever_rounding_says(margin_m: float) -> None:
    steps = round(margin_m / 0.05)
    assert margin_m / 0.05 < steps  # as floating-point numbers
    probability = np.zeros((17, 17, 17), dtype=np.float32)
    probability[8, 8, 8] = 1.0
    wide = widened(Occupancy(VoxelGrid((0.0, 0.0, 0.0), 0.05, probability.shape), probability), margin_m)
    assert wide.grid.shape == (2 * steps + 1,) * 3
    along = wide.probability[:, steps, steps]
    assert along.all(), "every voxel on the axis is within the margin, the farthest exactly at it"
