"""Rigid parts hold every surface point; recorded futures are the library's own poses; futures counted per voxel."""

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
from humanpred_ros.occupancy.future_kernels import MOMENTS, NEVER_CERTAIN
from humanpred_ros.occupancy.futures import BodyParts, RecordedFutures, SampledFutures, SweepSettings, rigid_parts
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.forest import Exemplars

HUMAN = HumanModel.kinect12()
PARTS = BodyParts.of(HUMAN, 0.05, 2)


@cache
def exemplars() -> Exemplars:
    library = small_library(2, 3, 30, there_and_back=True)
    return Exemplars.of_motions(library.motions, library.labels, HUMAN, 12)


def test_present_poses_are_those_of_the_exemplars() -> None:
    futures = RecordedFutures.of(exemplars(), HUMAN, PARTS, 0.05)
    expected = HUMAN.link_poses(exemplars().q)[:, PARTS.link, :3]
    np.testing.assert_allclose(futures.ways.present, expected, atol=1e-6)
    np.testing.assert_array_equal(futures.label, np.repeat([0, 1], 3 * 12))
    assert futures.n_classes == 2


@pytest.mark.parametrize("step_m", [0.01, 0.05, 10.0])
def test_ways_begin_and_end_with_the_motion_and_go_in_steps(step_m: float) -> None:
    ways = RecordedFutures.of(exemplars(), HUMAN, PARTS, step_m).ways
    for k in range(len(exemplars().names)):
        begin, end = ways.begin[k], ways.begin[k + 1]
        for p in range(len(PARTS.link)):
            some = slice(ways.first[k, p], ways.first[k, p + 1])
            moment, pose = ways.moment[some], ways.pose[some]
            assert moment[0] == 0
            assert moment[-1] == MOMENTS * (end - begin - 1)
            assert (np.diff(moment) > 0).all()
            np.testing.assert_allclose(pose[[0, -1]], ways.present[[begin, end - 1], p], atol=1e-6)
            corners = PARTS.corners_m[p] @ np.swapaxes(pose[:, :, :3], 1, 2) + pose[:, None, :, 3]
            moved = np.linalg.norm(np.diff(corners, axis=0), axis=-1).max(axis=1)
            assert (moved[:-1] >= step_m - 1e-6).all()
            if step_m > 1.0:
                assert len(moment) == 2


def test_no_moment_in_between_is_farther_than_a_step_from_the_last_pose_kept() -> None:
    q = exemplars().q[:12]
    fine = q[:-1, None] + np.arange(MOMENTS)[:, None] / MOMENTS * np.diff(q, axis=0)[:, None]
    poses = HUMAN.link_poses(np.vstack([fine.reshape(-1, q.shape[1]), q[-1:]]))[:, PARTS.link, :3]
    ways = RecordedFutures.of(exemplars(), HUMAN, PARTS, 0.03).ways
    for p in range(len(PARTS.link)):
        kept = ways.moment[ways.first[0, p] : ways.first[0, p + 1]]
        corners = PARTS.corners_m[p] @ np.swapaxes(poses[:, p, :, :3], 1, 2) + poses[:, p, None, :, 3]
        last = kept[np.searchsorted(kept, np.arange(len(poses)), side="right") - 1]
        assert np.linalg.norm(corners - corners[last], axis=-1).max() < 0.03


@pytest.mark.parametrize("n_rounds", [1, 3])
def test_every_surface_point_belongs_to_one_round_of_one_part(n_rounds: int) -> None:
    parts = BodyParts.of(HUMAN, 0.04, n_rounds)
    assert parts.first.shape == (len(parts.link), n_rounds + 1)
    q = np.random.default_rng(0).uniform(-0.5, 0.5, len(HUMAN.dof_names))
    poses = HUMAN.link_poses(q)[parts.link]
    local = np.stack(parts.points, axis=-1).astype(np.float64)
    found = [local[first[0] : first[-1]] @ T[:3, :3].T + T[:3, 3] for first, T in zip(parts.first, poses, strict=True)]
    expected = HUMAN.surface_points(q, 0.04)
    # In some order of the points; single precision.
    np.testing.assert_allclose(_sorted(np.concatenate(found)), _sorted(expected), atol=1e-6)


def _sorted(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(np.round(points, 5).T)]


def test_rounds_are_of_one_size_and_boxes_hold_their_parts() -> None:
    parts = BodyParts.of(HUMAN, 0.03, 4)
    sizes = np.diff(parts.first, axis=1)
    assert (sizes.max(axis=1) - sizes.min(axis=1) <= 1).all()
    for first, corners in zip(parts.first, parts.corners_m, strict=True):
        points = np.stack(parts.points, axis=-1)[first[0] : first[-1]]
        np.testing.assert_allclose(points.min(axis=0), corners[0], atol=1e-6)
        np.testing.assert_allclose(points.max(axis=0), corners[-1], atol=1e-6)
        assert len(np.unique(corners, axis=0)) == 8


def test_the_kinect_human_has_five_parts() -> None:
    part_of, _ = rigid_parts(HUMAN)
    bodies = sorted({HUMAN.link_names[part_of[HUMAN.link_names.index(body.link)]] for body in HUMAN.bodies})
    assert bodies == ["pelvis", "right_elbow", "right_forearm", "right_upper_arm", "torso"]


def test_links_of_a_part_keep_their_place_in_it() -> None:
    part_of, T_part_link = rigid_parts(HUMAN)
    poses = HUMAN.link_poses(np.random.default_rng(1).uniform(-1.0, 1.0, len(HUMAN.dof_names)))
    np.testing.assert_allclose(poses[part_of] @ T_part_link, poses, atol=1e-12)


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
