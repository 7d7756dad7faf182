"""An arm that is not where it was commanded to be is found out; one that is merely late is not."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import PlanningError
from humanpred_ros.planning.following import ArmFollowing, FollowingSettings
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import Schedule

NAMES = ("shoulder", "elbow")


def commanded() -> Schedule:
    schedule = Schedule([0.0, 0.0], -1.0)
    schedule.add(0.0, time_parameterise(straight([0.0, 0.0], [1.5, -0.5], 40), 1.0, 4.0, [0.0, 0.0], start_s=0.0))
    return schedule


def troubles(schedule: Schedule, late_s: float, subject: ArmFollowing) -> list[str]:
    times = np.arange(0.0, 3.0, 0.01)
    return [subject.trouble(schedule.positions, schedule.state_at(t - late_s)[0], t) for t in times]


@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.15])
def test_an_arm_that_follows_a_little_late_follows(late_s: float) -> None:
    assert set(troubles(commanded(), late_s, ArmFollowing(NAMES))) == {""}


def test_an_arm_that_is_far_behind_does_not_follow() -> None:
    found = [text for text in troubles(commanded(), 0.5, ArmFollowing(NAMES)) if text]
    assert "shoulder" in found[0]


def test_an_arm_that_stands_is_found_out_as_soon_as_it_is_too_far() -> None:
    schedule, subject = commanded(), ArmFollowing(NAMES)
    times = np.arange(0.0, 3.0, 0.01)
    first = next(t for t in times if subject.trouble(schedule.positions, np.zeros(2), t))
    assert 0.05 <= schedule.state_at(first - 0.15)[0][0] < 0.07
    assert "is at 0.000 rad" in subject.trouble(schedule.positions, np.zeros(2), 2.0)


def test_tolerances_are_of_each_joint() -> None:
    subject = ArmFollowing(NAMES, FollowingSettings(follow_tolerance_rad=(1.0, 0.01)))
    assert "elbow" in subject.trouble(commanded().positions, np.array([0.5, 0.02]), -0.5)
    assert subject.trouble(commanded().positions, np.array([0.5, 0.0]), -0.5) == ""
    assert subject.error_rad == 0.5
    with pytest.raises(PlanningError, match=r"follow_tolerance_rad.* 2 of them, got 3"):
        ArmFollowing(NAMES, FollowingSettings(follow_tolerance_rad=(1.0, 1.0, 1.0)))


def test_rest_is_known_only_after_some_time_without_movement() -> None:
    subject, rng = ArmFollowing(NAMES), np.random.default_rng(0)
    assert not subject.at_rest
    for k in range(100):
        t_s = k * 0.01
        moving = 0.3 <= t_s < 0.5
        subject.see(np.array([0.5 * (t_s - 0.3) if moving else 0.0, 1.0]) + rng.normal(0.0, 2e-4, 2), t_s)
        if not any(abs(t_s - border) < 0.02 for border in (0.2, 0.3, 0.7)):
            assert subject.at_rest == (0.2 <= t_s < 0.3 or t_s > 0.7), t_s
    subject.see(np.zeros(2), 0.0)  # the clock was set back
    assert not subject.at_rest
