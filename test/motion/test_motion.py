from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from small_library import small_library

from humanpred_ros.errors import MotionError
from humanpred_ros.motion.motion import SKELETON_POINTS, Motion, resample, resample_phase, unwrap_angles

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
