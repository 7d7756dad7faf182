"""Rigid parts: every point of the surface once, and where the human model says it is."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.body_parts import BodyParts, rigid_parts

HUMAN = HumanModel.kinect12()


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
