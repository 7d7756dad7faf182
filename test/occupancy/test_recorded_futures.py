"""Rigid parts hold every point of the surface; recorded futures are the library's own poses, at even steps."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.recorded_futures import MOMENTS, BodyParts, RecordedFutures, rigid_parts
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
