"""The schedule of trajectories: who is in charge when."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import PlanningError
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import Schedule, at_rest


def place(schedule: Schedule, t_s: float) -> float:
    return float(schedule.state_at(t_s)[0][0])


def test_each_trajectory_rules_from_its_time_on() -> None:
    schedule = Schedule([0.0], 5.0)
    schedule.add(6.0, at_rest([1.0], 6.0))
    schedule.add(7.0, at_rest([2.0], 7.0))
    assert [place(schedule, t) for t in (0.0, 5.5, 6.0, 6.99, 7.0, 99.0)] == [0.0, 0.0, 1.0, 1.0, 2.0, 2.0]


def test_what_was_to_come_later_is_dropped() -> None:
    schedule = Schedule([0.0], 0.0)
    schedule.add(2.0, at_rest([2.0], 2.0))
    schedule.add(1.0, at_rest([1.0], 1.0))
    assert [place(schedule, t) for t in (0.5, 1.5, 2.5)] == [0.0, 1.0, 1.0]


def test_what_it_has_forgotten_it_does_not_make_up() -> None:
    schedule = Schedule([0.0], 0.0)
    for k in range(1, 200):
        schedule.add(float(k), at_rest([float(k)], float(k)))
    assert place(schedule, 180.5) == 180.0
    with pytest.raises(PlanningError, match="or later"):
        schedule.state_at(3.0)


def test_bad_times_and_places_are_refused() -> None:
    with pytest.raises(PlanningError, match="finite"):
        Schedule([0.0], 0.0).state_at(np.nan)
    with pytest.raises(PlanningError, match="start configuration"):
        Schedule([[0.0]], 0.0)


@pytest.mark.parametrize("from_s", [-0.5, 0.0, 0.35, 0.8, 1.3, 4.0])
def test_what_is_left_of_the_motion_is_one_trajectory_that_begins_now(from_s: float) -> None:
    schedule = Schedule([0.0, 0.0], -1.0)
    path = straight([0.0, 0.0], [1.0, -0.5], 20)
    first = time_parameterise(path, 1.0, 4.0, [0.0, 0.0], start_s=0.0)
    schedule.add(0.0, first)
    q, v, a = first.sample(0.8)
    second = time_parameterise(straight(q, [0.5, 1.0], 20), 1.0, 4.0, v, a, start_s=0.8)
    schedule.add(0.8, second)
    whole = schedule.motion_from(from_s)
    assert whole.start_s == from_s
    for t_s in np.linspace(from_s, second.end_s + 1.0, 200):
        for executed, sent in zip(schedule.state_at(t_s), whole.sample(t_s), strict=True):
            np.testing.assert_allclose(sent, executed, atol=1e-6)
