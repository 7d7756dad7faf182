"""What the arm executed is what the planner's own schedule commanded, for as long as one likes to look back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from humanpred_ros.evaluation.run_figures import ExecutedMotion, goal_reached
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory, at_rest
from humanpred_ros.robot.scene import load_scene


def ramp(q_from: float, q_to: float, start_s: float, duration_s: float = 1.0) -> TimedTrajectory:
    """One joint that goes from rest to rest."""
    t = np.array([start_s, start_s + duration_s])
    q = np.array([[q_from], [q_to]])
    return TimedTrajectory(t, q, np.zeros((2, 1)), np.zeros((2, 1)))


def test_remembers_more_takeovers_than_a_schedule() -> None:
    executed = ExecutedMotion([0.0])
    for k in range(200):
        executed.take_over(0.1 * (k + 1), at_rest([float(k + 1)], 0.1 * (k + 1)))
    assert executed.at(np.array([0.05, 0.15, 10.05]))[:, 0].tolist() == [0.0, 1.0, 100.0]


def test_departure_and_rest() -> None:
    executed = ExecutedMotion([0.0])
    assert executed.departure_s == np.inf
    assert executed.rests_since() == 0.0
    executed.take_over(0.3, at_rest([0.0], 0.3))  # a stop of an arm that rests is no departure
    executed.take_over(0.5, ramp(0.0, 1.0, 0.5))
    assert executed.departure_s == 0.5
    assert executed.rests_since() == pytest.approx(1.5, abs=0.011)
    executed.take_over(2.0, at_rest([1.0], 2.0))  # nor is it a later arrival
    assert executed.end_s == 2.0
    assert executed.rests_since() == pytest.approx(1.5, abs=0.011)


def test_samples_hold_every_takeover() -> None:
    executed = ExecutedMotion([0.0], begin_s=1.0)
    executed.take_over(1.2345, ramp(0.0, 1.0, 1.2345, 0.5))
    t, q = executed.samples(0.1)
    assert t[0] == 1.0
    assert t[-1] == executed.end_s == 1.7345
    assert 1.2345 in t
    assert np.diff(t).max() <= 0.1 + 1e-9
    assert q[0, 0] == 0.0
    assert q[-1, 0] == 1.0


def test_late_decisions_are_not_executed() -> None:
    def decision(action: str, goal: float, t_s: float) -> Any:
        return SimpleNamespace(action=action, t_switch_s=t_s, trajectory=ramp(0.0, goal, t_s))

    nothing = SimpleNamespace(action="keep", t_switch_s=np.nan, trajectory=None)
    executed = ExecutedMotion.of([0.0], [decision("replan", 1.0, 0.1), nothing, decision("missed", 5.0, 0.2)])
    assert executed.q_end.tolist() == [1.0]


def test_goals_are_told_apart_and_full_turns_do_not_matter() -> None:
    scene = load_scene("face_to_face")
    red, blue = (goal.configuration for goal in scene.goals)
    assert goal_reached(scene, red) == "red"
    assert goal_reached(scene, blue + 0.01) == "blue"
    assert goal_reached(scene, blue + 0.05) is None
    turned = blue.copy()
    turned[6] += 2.0 * np.pi  # the wrist turns without end
    assert goal_reached(scene, turned) == "blue"
    path = straight(scene.start, red, 20)
    trajectory = time_parameterise(path, np.ones(7), 4.0 * np.ones(7), np.zeros(7), np.zeros(7), 0.02, 0.0)
    assert goal_reached(scene, trajectory.q[-1]) == "red"
