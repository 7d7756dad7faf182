"""Time warping is the least of all warpings, and the distances are P2's: as coded to compare, as meant to judge."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from paths import shared_data
from reaching_people import MODEL, recording
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import HumanModelError, MotionError
from humanpred_ros.evaluation.reach_distances import angles, quaternions, reach_distance, warped_sum
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.reach_recordings import load_reach_recordings

distance_of = partial(reach_distance, MODEL)
TABLES = hnp.arrays(
    np.float64, st.tuples(st.integers(1, 6), st.integers(1, 6)), elements=st.floats(0.0, 100.0, width=32)
)


def least_sum(costs: FloatArray) -> float:
    """Look at all warpings."""

    @lru_cache
    def best(i: int, j: int) -> float:
        before = [(i - 1, j), (i, j - 1), (i - 1, j - 1)]
        reachable = [best(a, b) for a, b in before if a >= 0 and b >= 0]
        return float(costs[i, j]) + (min(reachable) if reachable else 0.0)

    return best(costs.shape[0] - 1, costs.shape[1] - 1)


@given(TABLES)
def test_warping_finds_the_least_sum(costs: FloatArray) -> None:
    assert warped_sum(costs) == pytest.approx(least_sum(costs), rel=1e-12)


@given(TABLES)
def test_warping_is_symmetric_and_no_worse_than_the_diagonal(costs: FloatArray) -> None:
    assert warped_sum(costs) == pytest.approx(warped_sum(costs.T.copy()), rel=1e-12)
    n = min(costs.shape)
    square = costs[:n, :n]
    assert warped_sum(square) <= np.trace(square) * (1.0 + 1e-12)


def test_being_late_costs_nothing_but_the_wait() -> None:
    a = np.array([0.0, 1.0, 2.0, 3.0])
    late = np.array([0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    assert warped_sum(np.abs(a[:, None] - late)) == 0.0


@pytest.mark.parametrize("costs", [np.zeros((0, 3)), np.zeros(3), np.array([[np.nan]])])
def test_tables_without_frames_or_numbers_are_refused(costs: FloatArray) -> None:
    with pytest.raises(MotionError):
        warped_sum(costs)


def test_a_reach_is_at_no_distance_from_itself_but_as_coded() -> None:
    q = recording(1).active.q
    distance = distance_of(q, q)
    assert distance.joint_m == 0.0
    assert distance.task_m == pytest.approx(0.0, abs=1e-9)
    assert distance.task_as_coded_m > 1.0


def test_distances_are_symmetric_and_grow_with_the_difference() -> None:
    q = recording(1).active.q
    near, far = q.copy(), q.copy()
    near[:, 12] += 0.05
    far[:, 12] += 0.3
    a, b = distance_of(near, q), distance_of(far, q)
    assert 0.0 < a.joint_m < b.joint_m
    assert 0.0 < a.task_m < b.task_m
    assert distance_of(q, far).joint_m == pytest.approx(b.joint_m, rel=1e-9)
    assert distance_of(q, far).task_m == pytest.approx(b.task_m, rel=1e-9)


def test_a_person_beside_the_place_is_off_by_five_points_and_one_palm() -> None:
    q = np.repeat(recording(1).active.q[:1], 20, axis=0)  # nothing to warp
    beside = q.copy()
    beside[:, 0] += 0.1
    distance = distance_of(beside, q)
    assert distance.joint_m == pytest.approx(20 * 5 * 0.1)
    assert distance.task_m == pytest.approx(20 * 0.1)


def test_a_radian_of_the_palm_counts_a_fifth_of_a_metre() -> None:
    q = np.repeat(recording(1).active.q[:1], 10, axis=0)
    turned = q.copy()
    turned[:, MODEL.dof_names.index("rWristY")] += 0.5  # about the axis the palm lies on
    distance = distance_of(turned, q)
    assert distance.joint_m == pytest.approx(0.0, abs=1e-9)
    assert distance.task_m == pytest.approx(10 * 0.2 * 0.5)


@given(st.integers(0, 10_000))
def test_quaternions_and_angles_are_those_of_rotations(seed: int) -> None:
    rotations = Rotation.random(6, random_state=seed)
    q = quaternions(rotations.as_matrix())
    theirs = rotations.as_quat()[:, [3, 0, 1, 2]]
    np.testing.assert_allclose(q * np.sign((q * theirs).sum(axis=1, keepdims=True)), theirs, atol=1e-9)
    wanted = [[(a.inv() * b).magnitude() for b in rotations] for a in rotations]
    np.testing.assert_allclose(angles(q, q), wanted, atol=1e-7)


def test_quaternions_have_the_signs_of_the_authors_library() -> None:
    for axis in np.eye(3):
        (upright,) = quaternions(Rotation.from_rotvec(2.0 * axis).as_matrix()[None])
        assert upright[0] > 0.0  # trace above zero
        (turned,) = quaternions(Rotation.from_rotvec(-3.0 * axis).as_matrix()[None])
        assert turned[1 + int(np.argmax(axis))] > 0.0


def test_the_papers_recordings_are_as_far_from_themselves_as_coded() -> None:
    # docs/papers.md, P2 distances
    wanted = {"0446-0578": 31.76, "0525-0657": 32.67, "0444-0585": 29.04, "0489-0589": 23.51, "0780-0871": 11.83,
              "1537-1608": 10.81, "2711-2823": 29.36}  # fmt: skip
    for entry in load_reach_recordings(shared_data("icra2015/demos")):
        distance = distance_of(entry.active.q, entry.active.q)
        assert distance.task_as_coded_m == pytest.approx(wanted[entry.name], abs=0.05)
        assert (distance.joint_m, distance.task_m) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_postures_of_another_human_are_refused() -> None:
    with pytest.raises(HumanModelError):
        distance_of(np.zeros((5, 12)), recording(1).active.q)
