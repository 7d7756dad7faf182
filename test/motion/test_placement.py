"""Placing a motion elsewhere moves every point of the body rigidly, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_library import small_library

from humanpred_ros.errors import MotionError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import PELVIS_DOFS, Motion, MotionLibrary, placed, start_pelvis_m, turn_and_shift

HUMAN = HumanModel.kinect12()
MOTION = small_library(1, 1, 8).motions[0]
metres = st.floats(-3.0, 3.0)


@settings(max_examples=50)
@given(yaw=st.floats(-7.0, 7.0), shift=st.tuples(metres, metres, metres), about=st.tuples(metres, metres, metres))
def test_every_point_of_the_body_moves_with_it(yaw: float, shift: tuple, about: tuple) -> None:
    T = turn_and_shift(yaw, shift, about)
    moved = placed(MOTION, T)
    expected = HUMAN.surface_points(MOTION.q, 0.2) @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(HUMAN.surface_points(moved.q, 0.2), expected, atol=1e-9)
    np.testing.assert_allclose(np.asarray(about) + shift, T[:3, :3] @ about + T[:3, 3], atol=1e-9)


def test_nothing_else_changes_and_the_way_back_leads_back() -> None:
    points = np.random.default_rng(0).normal(size=(len(MOTION), 15, 3))
    points[2, 3] = np.nan
    motion = replace(MOTION, points_m=points)
    T = turn_and_shift(0.4, (0.3, -0.1, 0.0), (1.0, 2.0, 0.5))
    moved = placed(motion, T)
    others = [d for d, name in enumerate(MOTION.dof_names) if name not in PELVIS_DOFS]
    np.testing.assert_array_equal(moved.q[:, others], MOTION.q[:, others])
    np.testing.assert_array_equal(moved.t_s, MOTION.t_s)
    assert (moved.label, moved.index, moved.frame_id) == (motion.label, motion.index, motion.frame_id)
    assert np.isnan(moved.points_m[2, 3]).all()
    back = placed(moved, np.linalg.inv(T))
    np.testing.assert_allclose(back.q, motion.q, atol=1e-12)
    np.testing.assert_allclose(back.points_m, motion.points_m, atol=1e-12)


def test_the_order_of_the_dofs_does_not_matter() -> None:
    order = np.random.default_rng(1).permutation(12)
    shuffled = Motion(MOTION.t_s, MOTION.q[:, order], tuple(MOTION.dof_names[d] for d in order))
    T = turn_and_shift(-0.8, (0.3, 0.2, 0.1))
    np.testing.assert_array_equal(placed(shuffled, T).q, placed(MOTION, T).q[:, order])


def test_a_wild_recording_does_not_move_the_start() -> None:
    library = small_library(2, 5, 8)
    wild = library.motions[0].with_postures(library.motions[0].q + 50.0)
    with_wild = MotionLibrary("wild", (wild, *library.motions[1:]))
    np.testing.assert_allclose(start_pelvis_m(with_wild), start_pelvis_m(library), atol=0.02)


def test_what_cannot_be_placed_is_named() -> None:
    legless = Motion(MOTION.t_s, MOTION.q[:, 4:], MOTION.dof_names[4:])
    with pytest.raises(MotionError, match=r"PelvisTransX.*missing among TorsoX"):
        placed(legless, np.eye(4))
    tilted = np.eye(4)[[0, 2, 1, 3]] * np.array([1, -1, 1, 1.0])
    for T in (
        tilted,
        np.diag([2.0, 2.0, 2.0, 1.0]),
        np.diag([1.0, 1.0, -1.0, 1.0]),
        np.eye(3),
        np.full((4, 4), np.nan),
    ):
        with pytest.raises(MotionError):
            placed(MOTION, T)
    with pytest.raises(MotionError):
        turn_and_shift(np.nan)
