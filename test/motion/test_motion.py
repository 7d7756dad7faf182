from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from small_library import small_library

from humanpred_ros.errors import MotionError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import (
    PELVIS_DOFS,
    SKELETON_POINTS,
    Motion,
    MotionLibrary,
    placed,
    placed_postures,
    resample,
    resample_phase,
    start_pelvis_m,
    turn_and_shift,
    unwrap_angles,
)

pytestmark = pytest.mark.core

DOFS = ("PelvisTransX", "PelvisRotZ")


@st.composite
def motions(draw: st.DrawFn) -> Motion:
    ticks = np.cumsum([0, *draw(st.lists(st.integers(10**6, 10**9), min_size=1, max_size=12))])
    q = draw(hnp.arrays(np.float64, (len(ticks), 2), elements=st.floats(-6, 6)))
    return Motion(ticks * 1e-9, q, DOFS, 0)


@given(motions())
def test_unwrapping_changes_whole_turns_of_angles_only(motion: Motion) -> None:
    q = unwrap_angles(motion).q
    assert (q[:, 0] == motion.q[:, 0]).all()
    turns = (q[:, 1] - motion.q[:, 1]) / (2 * np.pi)
    assert turns == pytest.approx(np.round(turns), abs=1e-9)
    assert (np.abs(np.diff(q[:, 1])) <= np.pi + 1e-9).all()
    assert q[0, 1] == motion.q[0, 1]
    assert unwrap_angles(unwrap_angles(motion)).q == pytest.approx(q, abs=1e-9)


def test_a_motion_without_wraps_is_left_alone() -> None:
    motion = Motion(np.array([0.0, 1.0]), np.array([[0.0, 0.1], [75.0, 0.2]]), DOFS)
    assert unwrap_angles(motion) is motion


@given(motions(), st.integers(2, 200))
def test_end_points_are_exact_and_nothing_overshoots(motion: Motion, n: int) -> None:
    got, original = resample_phase(motion, n), unwrap_angles(motion).q
    assert len(got) == n
    assert (got.t_s[0], got.t_s[-1]) == (motion.t_s[0], motion.t_s[-1])
    assert (got.q[0] == original[0]).all()
    assert (got.q[-1] == original[-1]).all()
    assert (got.q.max(axis=0) <= original.max(axis=0) + 1e-12).all()
    assert (got.q.min(axis=0) >= original.min(axis=0) - 1e-12).all()


@given(motions())
def test_at_its_own_stamps_a_motion_is_itself(motion: Motion) -> None:
    got = resample(motion, t_s=motion.t_s)
    assert (got.q == unwrap_angles(motion).q).all()
    assert (got.t_s == motion.t_s).all()
    assert (got.label, got.index, got.dof_names) == (motion.label, motion.index, motion.dof_names)


def test_straight_motion_stays_straight() -> None:
    motion = Motion(np.array([0.0, 0.3, 1.0]), np.array([[0.0, 1.0], [0.3, 0.7], [1.0, 0.0]]), DOFS)
    got = resample(motion, t_s=np.linspace(0.1, 0.9, 17))
    assert got.q[:, 0] == pytest.approx(got.t_s)
    assert got.q[:, 1] == pytest.approx(1.0 - got.t_s)


def test_angles_take_the_short_way() -> None:
    motion = Motion(np.array([0.0, 1.0]), np.array([[0.0, 3.1], [0.0, -3.1]]), DOFS)
    assert resample(motion, t_s=[0.0, 0.5, 1.0]).q[1, 1] == pytest.approx(np.pi)


def test_points_are_lost_only_next_to_lost_ones() -> None:
    points = np.zeros((4, len(SKELETON_POINTS), 3))
    points[:, :, 0] = np.arange(4.0)[:, None]
    points[2, 5] = np.nan
    motion = Motion(np.arange(4.0), np.zeros((4, 2)), DOFS, points_m=points)
    got = resample(motion, t_s=[0.0, 0.5, 1.0, 1.5, 2.5, 3.0]).points_m
    assert got is not None
    assert np.isnan(got[:, 5, 0]).tolist() == [False, False, False, True, True, False]
    assert got[:, 0, 0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.5, 3.0]


@pytest.mark.parametrize("t_s", [[0.0], [], [-0.1, 0.5], [0.5, 1.1], [0.5, np.nan], [0.5, 0.5]])
def test_impossible_stamps_are_refused(t_s: list[float]) -> None:
    motion = Motion(np.array([0.0, 1.0]), np.zeros((2, 2)), DOFS)
    with pytest.raises(MotionError):
        resample(motion, t_s=t_s)
    with pytest.raises(MotionError, match="phases"):
        resample_phase(motion, 1)


def test_a_library_can_be_pickled_and_is_not_copied_since_it_cannot_change() -> None:
    library = small_library(2, 1, 5)
    again = pickle.loads(pickle.dumps(library))
    assert (again.name, dict(again.provenance)) == (library.name, dict(library.provenance))
    assert [motion.name for motion in again] == [motion.name for motion in library]
    assert copy.deepcopy(library) is library


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


def test_a_pelvis_that_tilts_turns_about_the_vertical_all_the_same() -> None:
    human = HumanModel.mocap23()
    q = np.random.default_rng(2).uniform(-0.9, 0.9, (20, len(human.dof_names))).clip(human.lower, human.upper)
    T = turn_and_shift(2.1, (0.3, -0.1, 0.2))
    moved = placed_postures(q, human.dof_names, T)
    expected = human.surface_points(q, 0.2) @ T[:3, :3].T + T[:3, 3]
    np.testing.assert_allclose(human.surface_points(moved, 0.2), expected, atol=1e-9)
    np.testing.assert_allclose(moved[3], placed_postures(q[3], human.dof_names, T), atol=1e-12)


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
