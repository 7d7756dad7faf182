"""The person as the planner sees them: what is certain is kept away from, what is likely is not rested in."""

from __future__ import annotations

import numpy as np
import pytest
from planning_worlds import PLANE, free_space, planar_arm, somebody_at

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.planning.motion_check import MotionChecker
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory

ARM = planar_arm()
CHECKER = MotionChecker(ARM.chain, ARM.spheres(), free_space())
STRAIGHT = np.zeros(3)  # along +x
TURNED = np.array([1.2, 0.0, 0.0])


def person(occupancy: Occupancy, **change: float) -> Person:
    return Person(occupancy, CHECKER, ReplannerConfig(**change))


def sweep(start: FloatArray = STRAIGHT, goal: FloatArray = TURNED) -> TimedTrajectory:
    return time_parameterise(np.linspace(start, goal, 20), 1.0, 4.0)


def at(angle: float, radius_m: float = 0.7, **kind: float) -> Occupancy:
    return somebody_at(radius_m * np.cos(angle), radius_m * np.sin(angle), radius_m=0.08, **kind)


@pytest.mark.parametrize(
    ("probability", "conflicts", "crosses"), [(1.0, True, True), (0.5, False, True), (0.2, False, False)]
)
def test_what_is_certain_blocks_and_what_is_likely_warns(probability: float, conflicts: bool, crosses: bool) -> None:
    subject = person(at(0.6, probability=probability))
    assert (subject.conflict(sweep(), 0.0) is not None) == conflicts
    assert bool(subject.crossing(sweep(), 0.0)) == crosses
    # Beyond the end of the movement nothing is crossed.
    aside = person(at(2.0, probability=probability))
    assert aside.conflict(sweep(), 0.0) is None
    assert not aside.crossing(sweep(), 0.0)


def test_only_what_is_still_to_come_counts() -> None:
    subject, trajectory = person(at(0.3, probability=1.0)), sweep()
    assert subject.conflict(trajectory, 0.0) is not None
    late_s = trajectory.start_s + 0.8 * trajectory.duration_s
    assert subject.conflict(trajectory, late_s) is None
    assert not subject.crossing(trajectory, late_s)


def test_distances_are_those_to_the_voxels() -> None:
    flat = PLANE.flat_index(np.array([[0.5, 0.425, 0.025]]))
    probability = np.zeros(PLANE.size, dtype=np.float32)
    probability[flat] = 1.0
    subject = person(Occupancy(PLANE, probability.reshape(PLANE.shape)), min_separation_m=0.2)
    # A straight arm of 3 cm radius at y = 0; the voxel's near face is at y = 0.4.
    gap = float(subject.certain_gap_m(STRAIGHT[None])[0])
    assert gap == pytest.approx(0.4 - 0.03, abs=0.03)
    assert float(subject.likely_gap_m(STRAIGHT[None])[0]) == gap
    assert subject.least_gap_m(sweep(), 0.0) < 0.02


def test_an_arm_does_not_rest_where_the_person_is_likely_to_come() -> None:
    subject = person(at(0.0, probability=0.4))
    assert "the person is likely (p >= 0.3) to come within 0.0" in subject.rest_conflict(STRAIGHT)
    assert subject.rest_conflict(TURNED) == ""
    assert person(at(0.0, probability=0.4), likely_probability=0.5).rest_conflict(STRAIGHT) == ""


def test_an_arm_in_a_likely_place_may_leave_it_but_not_go_deeper() -> None:
    subject = person(somebody_at(0.6, 0.1, radius_m=0.12, probability=0.5))
    assert subject.rest_conflict(STRAIGHT)
    assert subject.crossing(sweep(STRAIGHT, -TURNED), 0.0) == ""
    assert subject.crossing(sweep(STRAIGHT, TURNED), 0.0)


def test_without_a_separation_nothing_is_forbidden() -> None:
    subject = person(at(0.3, probability=1.0), min_separation_m=0.0)
    assert subject.conflict(sweep(), 0.0) is None
    assert subject.crossing(sweep(), 0.0) == ""
    assert subject.rest_conflict(STRAIGHT) == ""
    assert np.isinf(subject.likely_gap_m(STRAIGHT[None])).all()
    assert np.isinf(subject.least_gap_m(sweep(), 0.0))
