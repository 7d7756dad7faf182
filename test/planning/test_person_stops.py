"""Between the steps: a motion is stopped when it must be, replaced when it should be, and left alone otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from planning_worlds import free_space, nobody, planar_arm, somebody_at

from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.planning.motion_check import MotionChecker
from humanpred_ros.planning.person import Person
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import Schedule

ARM = planar_arm()
CHECKER = MotionChecker(ARM.chain, ARM.spheres(), free_space())
CONFIG = ReplannerConfig()


def schedule(from_s: float = 0.0) -> Schedule:
    """An arm along +x that turns to the left from `from_s` on."""
    subject = Schedule(np.zeros(3), -1.0)
    path = np.linspace(np.zeros(3), [1.2, 0.0, 0.0], 20)
    subject.add(from_s, time_parameterise(path, 1.0, 4.0, start_s=from_s))
    return subject


def person(angle: float, probability: float = 1.0) -> Person:
    x, y = 0.7 * np.cos(angle), 0.7 * np.sin(angle)
    return Person(somebody_at(x, y, radius_m=0.08, probability=probability), CHECKER, CONFIG)


def test_it_stops_only_for_what_comes_before_a_new_plan_can() -> None:
    moving = schedule()
    assert person(0.7).stop_reason(moving, 0.5, 0.9).startswith("too close: ")
    assert person(1.3).stop_reason(moving, 0.2, 0.5) == ""
    assert person(0.7, probability=0.9).stop_reason(moving, 0.5, 0.9) == ""
    assert Person(nobody(), CHECKER, CONFIG).stop_reason(moving, 0.5, 0.9) == ""


def test_an_arm_at_rest_is_not_stopped() -> None:
    assert person(0.05).stop_reason(schedule(from_s=5.0), 0.5, 0.9) == ""


def test_an_arm_that_leaves_a_person_who_came_to_it_is_not_stopped() -> None:
    # The person is at the arm's right side, the arm turns to the left.
    assert person(-0.1).stop_reason(schedule(), 0.1, 0.5) == ""


def test_an_arm_that_is_within_a_person_however_it_moves_is_stopped() -> None:
    everywhere = Occupancy(nobody().grid, np.ones_like(nobody().probability))
    subject = Person(everywhere, CHECKER, CONFIG)
    assert subject.stop_reason(schedule(), 0.1, 0.5).startswith("too close: ")
    assert subject.stop_reason(schedule(from_s=5.0), 0.1, 0.5) == ""  # it rests


@pytest.mark.parametrize(
    ("angle", "probability", "bad"),
    [(1.2, 0.5, True), (0.8, 1.0, True), (0.8, 0.5, True), (0.8, 0.1, False), (2.2, 1.0, False)],
)
def test_it_is_replaced_if_the_person_is_or_comes_where_it_goes(angle: float, probability: float, bad: bool) -> None:
    assert person(angle, probability).calls_for_replanning(schedule(), 0.1, 0.2) == bad


def test_while_the_answer_has_not_taken_over_yet_nothing_is_asked_for() -> None:
    waiting = schedule(from_s=0.5)
    assert not person(0.0).calls_for_replanning(waiting, 0.4, 0.5)
    assert person(1.2).calls_for_replanning(waiting, 0.5, 0.6)


def test_an_arm_at_rest_must_leave_a_likely_place() -> None:
    resting = Schedule(np.zeros(3), 0.0)
    assert person(0.0, probability=0.4).calls_for_replanning(resting, 1.0, 1.1)
    assert not person(1.0).calls_for_replanning(resting, 1.0, 1.1)
    assert not Person(nobody(), CHECKER, CONFIG).calls_for_replanning(resting, 1.0, 1.1)
