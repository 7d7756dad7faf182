"""Costs are those of a path whose cost is known, and contacts are seen where they were made to happen."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from human_distance import least_distance_m
from small_library import DOF_NAMES, REST

from humanpred_ros.evaluation.interference_runs import find_avoidance
from humanpred_ros.evaluation.run_figures import LENGTH_WEIGHT, ExecutedMotion, RunEvaluator, executed_cost
from humanpred_ros.geometry.chain import BodyPoints, KinematicChain
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.planning.path import straight
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.planning.trajectory import TimedTrajectory
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.stomp.costs import POINTS_OF_P1, HumanOccupancyCost

HUMAN = HumanModel.kinect12()
FAR = np.array([-3.0, -3.0])


@cache
def scene() -> Scene:
    return load_scene("side_by_side")


def pelvis_at(world_xy: FloatArray) -> FloatArray:
    """A posture with the pelvis at a place in the world; the scene's human frame is not turned."""
    q = REST.copy()
    q[:2] = world_xy - scene().T_world_human[:2, 3]
    return q


def person(places: FloatArray, period_s: float = 0.05) -> Motion:
    """Somebody who is carried from place to place (T, 2)."""
    return Motion(period_s * np.arange(len(places)), np.stack([pelvis_at(p) for p in places]), DOF_NAMES, 1, 0)


def evaluator(motion: Motion, n_held: int = 0) -> RunEvaluator:
    nothing = Occupancy(scene().grid, np.zeros(scene().grid.shape, dtype=np.float32))
    return RunEvaluator(scene(), HUMAN, motion, nothing, nothing, n_held)


def tool_xy(q: FloatArray) -> FloatArray:
    xy: FloatArray = scene().arm.chain.tool_pose(q)[:2, 3]
    return xy


def turntable() -> tuple[KinematicChain, BodyPoints]:
    """One joint about z that carries one point 1 m from the axis."""
    chain = KinematicChain(
        joint_names=("turn",),
        joint_origin_m=np.zeros((1, 3)),
        joint_rotation=np.eye(3)[None],
        joint_axis=np.array([[0.0, 0.0, 1.0]]),
        T_world_root=np.eye(4),
        T_last_tool=np.eye(4),
        lower=np.array([-3.0]),
        upper=np.array([3.0]),
        continuous=np.array([False]),
        velocity_limit=np.ones(1),
    )
    return chain, BodyPoints(np.zeros(1, dtype=np.int64), np.array([[1.0, 0.0, 0.0]]))


def test_cost_of_a_straight_path_through_a_box_is_the_known_one() -> None:
    chain, points = turntable()
    grid = VoxelGrid((-1.5, -1.5, -0.05), 0.1, (30, 30, 1))
    probability = np.zeros(grid.shape, dtype=np.float32)
    probability[:, 15:] = 0.6  # the half of the room with y > 0
    term = HumanOccupancyCost(chain, points, Occupancy(grid, probability))
    path = straight([-0.5], [0.8], 4001)
    weight = 0.7
    inside_rad = 0.8
    wanted = POINTS_OF_P1 * 0.6 * weight * inside_rad + LENGTH_WEIGHT * weight * 1.3
    assert executed_cost(term, path, np.array([weight])) == pytest.approx(wanted, rel=2e-3)


def test_cost_does_not_depend_on_speed_or_pauses() -> None:
    chain, points = turntable()
    grid = VoxelGrid((-1.5, -1.5, -0.05), 0.1, (30, 30, 1))
    term = HumanOccupancyCost(chain, points, Occupancy(grid, np.ones(grid.shape, dtype=np.float32)))
    path = straight([0.0], [1.0], 100)
    paused = np.concatenate([path[:50], np.repeat(path[49:50], 500, axis=0), path[50:]])
    assert executed_cost(term, paused, np.ones(1)) == pytest.approx(executed_cost(term, path, np.ones(1)))


def test_no_margin_is_added_to_the_occupancy() -> None:
    chain, points = turntable()
    grid = VoxelGrid((-1.5, -1.5, -0.05), 0.1, (30, 30, 1))
    probability = np.zeros(grid.shape, dtype=np.float32)
    probability[:, 17:] = 1.0  # from y = 0.2 on
    term = HumanOccupancyCost(chain, points, Occupancy(grid, probability))
    path = straight([0.0], [0.19], 50)  # ends just below
    assert executed_cost(term, path, np.ones(1)) == pytest.approx(LENGTH_WEIGHT * 0.19)


def test_who_walks_into_a_resting_arm_is_seen_and_named() -> None:
    aim = tool_xy(scene().start)
    places = np.linspace(FAR, aim, 60)
    figures = evaluator(person(places)).figures("basic", 0, ExecutedMotion(scene().start), [])
    assert figures.contact is not None
    assert figures.contact.moved == "human"
    assert figures.contact.closed_by_arm_m == pytest.approx(0.0, abs=1e-9)
    assert figures.contact.closed_by_human_m > 0.05
    assert figures.least_distance_m == figures.contact.deepest_m < 0.0
    assert 0.0 < figures.contact.t_s <= figures.least_distance_s
    assert figures.goal is None
    assert figures.time_to_goal_s == np.inf
    assert figures.length == 0.0


def test_an_arm_that_moves_into_a_resting_person_is_named() -> None:
    goal = scene().goals[0].configuration
    motion = person(np.repeat(tool_xy(goal)[None], 60, axis=0))
    executed = ExecutedMotion(scene().start)
    t = np.array([0.2, 1.2])
    executed.take_over(0.2, TimedTrajectory(t, np.stack([scene().start, goal]), np.zeros((2, 7)), np.zeros((2, 7))))
    figures = evaluator(motion).figures("basic", 0, executed, [])
    assert figures.contact is not None
    assert figures.contact.t_s > 0.2  # not before the arm moves
    assert figures.contact.moved == "arm"
    assert figures.contact.closed_by_human_m == pytest.approx(0.0, abs=1e-9)
    assert figures.contact.closed_by_arm_m > 0.0


def test_contact_on_the_way_is_not_missed_after_the_end_of_the_motion() -> None:
    """The last posture is held: an arm that moves later than the recording still meets the person."""
    goal = scene().goals[0].configuration
    motion = person(np.repeat(tool_xy(goal)[None], 10, axis=0))
    executed = ExecutedMotion(scene().start)
    t = np.array([1.0, 2.0])
    executed.take_over(1.0, TimedTrajectory(t, np.stack([scene().start, goal]), np.zeros((2, 7)), np.zeros((2, 7))))
    figures = evaluator(motion, n_held=60).figures("wait", 0, executed, [])
    assert figures.contact is not None
    assert figures.contact.t_s > motion.duration_s
    assert figures.goal == "red"
    assert figures.time_to_goal_s == pytest.approx(2.0, abs=0.02)
    assert figures.execution_s == pytest.approx(1.0, abs=0.02)


def test_who_is_still_on_the_way_at_the_end_has_not_arrived() -> None:
    goal = scene().goals[0].configuration
    executed = ExecutedMotion(scene().start)
    t = np.array([0.1, 1.5])
    executed.take_over(0.1, TimedTrajectory(t, np.stack([scene().start, goal]), np.zeros((2, 7)), np.zeros((2, 7))))
    motion = person(np.repeat(FAR[None], 20, axis=0))
    assert evaluator(motion).figures("basic", 0, executed, []).goal is None
    assert evaluator(motion, n_held=20).figures("basic", 0, executed, []).goal == "red"


def test_far_away_there_is_no_contact_and_the_distance_is_the_models() -> None:
    motion = person(np.linspace(FAR, FAR + 0.5, 20))
    seen = evaluator(motion)
    figures = seen.figures("ours", 3, ExecutedMotion(scene().start), [])
    spheres = scene().arm.spheres()
    centres = spheres.world_m(scene().arm.chain, scene().start)
    T = scene().T_world_human
    local = (centres - T[:3, 3]) @ T[:3, :3]
    wanted = [least_distance_m(HUMAN, q, local, spheres.radius_m) for q in motion.q]
    assert figures.contact is None
    assert figures.least_distance_m == pytest.approx(min(wanted))
    assert (figures.method, figures.seed, figures.motion) == ("ours", 3, "1/0")


def test_clearance_is_to_the_nearest_object() -> None:
    figures = evaluator(person(np.repeat(FAR[None], 5, axis=0))).figures("basic", 0, ExecutedMotion(scene().start), [])
    spheres = scene().arm.spheres()
    centres = spheres.world_m(scene().arm.chain, scene().start)
    least = {o.name: (o.distance_m(centres) - spheres.radius_m).min() for o in scene().obstacles}
    assert figures.clearance_to == min(least, key=lambda name: least[name])
    assert figures.clearance_m == pytest.approx(min(least.values()))


def test_staying_avoids_a_person_who_stays_away() -> None:
    found = find_avoidance(evaluator(person(np.repeat(FAR[None], 10, axis=0))), ReplannerConfig())
    assert found.policy == "stay at the start"
    assert found.latest_departure_s == np.inf


def test_somebody_who_slowly_walks_into_the_arm_could_be_avoided_by_leaving() -> None:
    aim = tool_xy(scene().start)
    found = find_avoidance(evaluator(person(np.linspace(aim + np.array([0.9, -0.9]), aim, 40), 0.1)), ReplannerConfig())
    assert found.policy not in ("", "stay at the start")
    assert 0.0 <= found.latest_departure_s < np.inf
    assert found.best_m > 0.0


def test_somebody_who_is_inside_the_arm_at_once_cannot_be_avoided() -> None:
    aim = tool_xy(scene().start)
    found = find_avoidance(evaluator(person(np.repeat(aim[None], 4, axis=0))), ReplannerConfig())
    assert found.policy == ""
    assert found.best_m < 0.0
    assert found.tried > 100
