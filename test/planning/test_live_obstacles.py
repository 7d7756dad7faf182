"""Obstacles that come and go are in the distance field, and plans that no longer fit them are dropped."""

from __future__ import annotations

import numpy as np
import pytest
from planning_worlds import free_space, nobody, planar_arm

from humanpred_ros.errors import ArrayError, GoalUnreachableError, PlanningError
from humanpred_ros.geometry.distance_field import build_distance_field
from humanpred_ros.geometry.solids import Box, Obstacle, Shape, Sphere, cylinder, planar_pose
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.live_obstacles import CAP_M, LiveObstacles
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.robot.goals import Goal
from humanpred_ros.stomp.config import StompConfig

pytestmark = pytest.mark.core

CORNER = np.array([0.6, 0.5, 0.4])
TABLE = Obstacle("table", Box(1.0, 0.8, 0.04), planar_pose(0.0, 0.0, -0.1))


def solid(name: str, shape: Shape, *place: float) -> Obstacle:
    return Obstacle(name, shape, planar_pose(*place))


CUPS = [solid("box", Box(0.1, 0.2, 0.05), 0.2, 0.1, 0.0, 0.4), solid("can", cylinder(0.03, 0.1), -0.3, 0.1, 0.0)]
BALL = solid("ball", Sphere(0.05), 0.0, -0.9, 0.1)  # it stands outside the lattice, and reaches into it by its distance


def field_of(*obstacles: Obstacle) -> np.ndarray:
    return build_distance_field(obstacles, -CORNER, CORNER, cap_m=CAP_M).values


def test_solids_come_are_replaced_and_go() -> None:
    live = LiveObstacles(build_distance_field([TABLE], -CORNER, CORNER, cap_m=CAP_M))
    for key, obstacle in enumerate([*CUPS, BALL]):
        live.put(key, obstacle, until_s=5.0 if obstacle is BALL else np.inf)
    np.testing.assert_array_equal(live.field().values, field_of(TABLE, *CUPS, BALL))
    assert not live.changed
    live.put(0, solid("box", Box(0.1, 0.1, 0.1), -0.4, -0.3, 0.1))
    live.expire(5.0)
    assert live.changed
    np.testing.assert_array_equal(live.field().values, field_of(TABLE, live.solids[0], CUPS[1]))
    live.clear()
    np.testing.assert_array_equal(live.field().values, field_of(TABLE))


def test_no_distance_to_a_cloud_is_too_large_by_more_than_a_cubes_corner() -> None:
    live = LiveObstacles(build_distance_field([TABLE], -CORNER, CORNER, cap_m=CAP_M))
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.5, -0.8, -0.05), (0.3, 0.4, 0.2), (300, 3))  # some lie outside the lattice
    live.set_points(points)
    asked = rng.uniform(-CORNER, CORNER, (2000, 3))
    near = np.linalg.norm(asked[:, None] - points, axis=-1).min(axis=1)
    true = np.minimum(np.minimum(near, TABLE.distance_m(asked)), CAP_M)
    error = live.field().distance(asked) - true
    h = live.grid.resolution_m
    assert error.max() < h
    assert error.min() > -1.5 * np.sqrt(3.0) * h
    live.set_points(points[:0])
    np.testing.assert_array_equal(live.field().values, field_of(TABLE))


def test_what_is_in_doubt_stays_until_something_believable_takes_its_place() -> None:
    live = LiveObstacles(build_distance_field([TABLE], -CORNER, CORNER, cap_m=CAP_M))
    live.put("box", CUPS[0])
    live.doubts |= {"box": "torn", None: "torn cloud"}
    assert live.doubt == "torn"
    live.put("can", CUPS[1])
    assert live.doubt == "torn"
    live.clear()
    assert live.doubt == "torn cloud"
    for wrong in (np.array([[np.nan, 0.0, 0.0]]), np.array([[0.0, 0.0, 700.0]])):
        with pytest.raises(ArrayError):
            live.set_points(wrong)
    assert live.doubt == "torn cloud"
    live.set_points(np.zeros((1, 3)))
    assert not live.doubt


ARM = planar_arm()
START, LEFT, RIGHT = np.array([0.0, 0.3, 0.3]), np.array([1.2, 0.3, 0.3]), np.array([-1.2, 0.3, 0.3])
CONFIG = ReplannerConfig(threads=1, human_margin_m=0.0, stomp=StompConfig(waypoints=40, iterations=15, noise_std=0.01))


class Run:
    """A replanner in a world whose obstacles come and go, asked ten times a second."""

    def __init__(self) -> None:
        self.replanner = Replanner(ARM, (Goal("left", LEFT), Goal("right", RIGHT, 0.5)), free_space(), CONFIG)
        self.replanner.start(START, 0.0)
        self.live, self.t_s = LiveObstacles(free_space()), 0.0

    def step(self) -> Decision:
        self.t_s += 0.1
        return self.replanner.respond(nobody(self.t_s))

    def put(self, q: np.ndarray, radius_m: float = 0.08) -> None:
        """Let a ball be where the arm's last joint is at a configuration."""
        x, y, z = ARM.chain.link_poses(q)[-1, :3, 3]
        self.live.put("ball", solid("ball", Sphere(radius_m), float(x), float(y), float(z)))
        self.replanner.change(field=self.live.field())

    def remove(self) -> None:
        self.live.clear()
        self.replanner.change(field=self.live.field())


def test_a_goal_that_an_obstacle_blocks_is_left_and_comes_back() -> None:
    run = Run()
    assert run.step().chosen == "left"
    run.put(LEFT)
    left = run.step()
    assert (left.action, left.chosen) == ("replan", "right")
    assert "m from obstacle" in left.report("left").set_aside
    run.remove()
    assert run.step().report("left").set_aside == ""


def test_a_motion_that_an_obstacle_comes_into_is_stopped_or_replaced() -> None:
    run = Run()
    while run.step().chosen != "left" or run.t_s < 0.3:
        pass
    executing = run.replanner.motion_from(run.t_s)
    run.put(executing.q[-1] * 0.5 + executing.q[0] * 0.5, radius_m=0.05)
    answer = run.step()
    assert answer.action in ("replan", "hold")
    rest = run.replanner.motion_from(run.t_s + CONFIG.period_s)
    assert not run.replanner.problem.not_free(rest, rest.start_s)

    run = Run()
    while run.step().chosen != "left" or run.t_s < 0.4:
        pass
    soon = run.replanner.motion_from(run.t_s + 0.18).q[0]
    run.put(soon, radius_m=0.05)
    held = run.step()
    assert held.action == "hold"
    assert held.reason.startswith("an obstacle has come into its way")


def test_the_arm_is_held_while_obstacles_are_in_doubt() -> None:
    run = Run()
    run.step()
    run.replanner.doubt = "invalid obstacles: torn"
    held = run.step()
    assert (held.action, held.reason) == ("hold", "invalid obstacles: torn")
    run.replanner.doubt = ""
    assert run.step().action == "replan"


def test_tasks_come_change_and_go() -> None:
    run = Run()
    run.put(LEFT)
    run.step()
    goals = run.replanner.goals
    with pytest.raises(GoalUnreachableError, match="goal new"):
        run.replanner.change(goals=(*goals, Goal("new", LEFT)))  # where the ball is
    with pytest.raises(PlanningError, match="different names"):
        run.replanner.change(goals=(*goals, Goal("left", RIGHT)))
    assert run.replanner.goals == goals
    run.replanner.change(goals=(*goals, Goal("new", RIGHT / 2.0)))
    assert run.step().chosen == "new"
    run.replanner.change(goals=goals, task_costs={"right": 1.0})
    gone = run.step()
    assert (gone.action, gone.reason) == ("hold", "task new was removed")
    assert run.step().chosen == "right"
    assert run.replanner.goals[1].task_cost == 1.0
