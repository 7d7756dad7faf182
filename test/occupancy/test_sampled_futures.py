"""Sampled futures of a body, counted per voxel."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import convolve
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.future_kernels import NEVER_CERTAIN
from humanpred_ros.occupancy.sampled_futures import SampledFutures, SweepSettings
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.2, -1.2, -0.2), 0.05, (48, 48, 44))
T = np.array([[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, -0.05], [0.0, 0.0, 1.0, 0.02], [0.0, 0.0, 0.0, 1.0]])
#: Every posture, every point, nothing given to neighbours.
DENSE = SweepSettings(step_voxels=1e-6, thinning=1, spread=0.0)


@cache
def reaches() -> FloatArray:
    """(6, 40, 12) one future each."""
    return np.stack([motion.q for motion in small_library(3, 2).motions])


def expected(futures: FloatArray, weights: FloatArray) -> FloatArray:
    voxeliser = BodyVoxeliser(HUMAN, GRID, T)
    swept = np.stack([voxeliser.mask(q) for q in futures])
    p = np.minimum(np.tensordot(weights, swept, axes=1), NEVER_CERTAIN)
    p[voxeliser.mask(REST)] = 1.0
    return p


def test_a_voxel_gets_the_probability_of_the_futures_that_touch_it() -> None:
    weights = np.array([0.1, 0.2, 0.3, 0.05, 0.25, 0.1])
    groups = [(weights[:4], reaches()[:4]), (weights[4:], reaches()[4:])]
    p = SampledFutures(HUMAN, GRID, T, DENSE).probability(REST, groups)
    truth = expected(reaches(), weights)
    # A point on a voxel's border may fall to either side in single precision.
    assert np.mean(np.abs(p - truth) > 1e-5) < 1e-4
    assert p.max() == 1.0


def test_thinned_points_and_long_steps_miss_little() -> None:
    weights = np.full(6, 1.0 / 6.0)
    thin = SampledFutures(HUMAN, GRID, T, SweepSettings(spread=0.0)).probability(REST, [(weights, reaches())])
    truth = expected(reaches(), weights)
    assert (thin <= truth + 1e-5).mean() > 0.9999
    assert thin.sum() > 0.93 * truth.sum()


def test_neighbours_share_a_little() -> None:
    weights = np.full(6, 1.0 / 6.0)
    kernel = np.zeros((3, 3, 3))
    kernel[1, 1, 1] = 0.6
    for axis in ((0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2)):
        kernel[axis] = 0.4 / 6.0
    config = SweepSettings(step_voxels=1e-6, thinning=1, spread=0.4)
    p = SampledFutures(HUMAN, GRID, T, config).probability(REST, [(weights, reaches())])
    now = BodyVoxeliser(HUMAN, GRID, T).mask(REST)
    swept = np.stack([BodyVoxeliser(HUMAN, GRID, T).mask(q) for q in reaches()])
    share = np.where(now, 1.0, np.tensordot(weights, swept, axes=1))
    wanted = np.where(now, 1.0, np.minimum(convolve(share, kernel, mode="constant"), NEVER_CERTAIN))
    assert np.mean(np.abs(p - wanted) > 1e-5) < 1e-3


def test_nothing_remains_of_the_update_before() -> None:
    futures = SampledFutures(HUMAN, GRID, T)
    weights = np.full(6, 1.0 / 6.0)
    first = futures.probability(REST, [(weights, reaches())])
    np.testing.assert_array_equal(futures.probability(REST, []), SampledFutures(HUMAN, GRID, T).probability(REST, []))
    np.testing.assert_array_equal(futures.probability(REST, [(weights, reaches())]), first)


def test_a_body_that_leaves_the_grid_is_counted_within_it() -> None:
    small = VoxelGrid((0.0, 0.0, 0.5), 0.05, (8, 8, 8))
    p = SampledFutures(HUMAN, small, T, DENSE).probability(REST, [(np.ones(1), reaches()[:1])])
    swept = BodyVoxeliser(HUMAN, small, T).mask(reaches()[0])
    assert ((p > 0.0) == (swept | BodyVoxeliser(HUMAN, small, T).mask(REST))).mean() > 0.999


def test_what_does_not_fit_is_refused() -> None:
    futures = SampledFutures(HUMAN, GRID, T)
    with pytest.raises(ArrayError, match="32"):
        futures.probability(REST, [(np.full(33, 0.01), np.zeros((33, 2, 12)))])
    with pytest.raises(ArrayError, match="futures"):
        futures.probability(REST, [(np.ones(1), np.full((1, 2, 12), np.nan))])
    with pytest.raises(ArrayError, match="probability"):
        futures.probability(REST, [(np.ones(2), np.zeros((1, 2, 12)))])
    with pytest.raises(SettingsError, match="spread"):
        SweepSettings(spread=1.5)
