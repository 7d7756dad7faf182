"""Whatever a guard does with the speed factor, the planner knows where its controller has the arm by now."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.planning.following import ArmFollowing
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.robot.goals import Goal
from humanpred_ros.stomp.config import StompConfig

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from planning_worlds import free_space, nobody, planar_arm, somebody_at

from humanpred_ros.nodes import conversions
from humanpred_ros.nodes.trajectory_controller import TrajectoryController

ARM, START = planar_arm(), np.array([0.0, 0.3, 0.3])
CONFIG = ReplannerConfig(threads=1, human_margin_m=0.0, stomp=StompConfig(waypoints=30, iterations=3, noise_std=0.01))
GOALS = (Goal("left", np.array([1.2, 0.3, 0.3])), Goal("right", np.array([-1.2, 0.3, 0.3])))
NS, TICK_S = conversions.NS_PER_S, 0.01
#: What is told by a message is stamped in whole nanoseconds, and the controller's time advances by ticks of them.
NEAR_RAD = 1e-6


class Work:
    """A planner and its controller, who hear of a factor at the same tick, or the controller `late` ticks later."""

    def __init__(self, late: int = 0) -> None:
        self.planner, self.late = Replanner(ARM, GOALS, free_space(), CONFIG), late
        self.planner.start(START, 0.0)
        self.controller = TrajectoryController(self.planner.joint_names, START)
        self.following = ArmFollowing(self.planner.joint_names)
        self.tick, self.to_come = 0, []
        self.worst_rad, self.troubles, self.actions = 0.0, [], []
        self.controller.update(0)

    @property
    def t_s(self) -> float:
        return self.tick * TICK_S

    def command(self, decision: object) -> None:
        self.actions.append(decision.action)
        if decision.trajectory is not None:
            motion = self.planner.motion_from(self.t_s).lasting_until(self.t_s + 0.1)
            assert np.diff(motion.t_s).min() > 0.0
            message = conversions.trajectory_message(self.planner.joint_names, motion, 0)
            assert self.controller.command(message, self.tick * NS // 100) == ""

    def factor(self, factor: float) -> None:
        self.to_come.append((self.tick + self.late, factor))
        decision = self.planner.set_factor(factor, self.t_s, "" if factor else "separation guard: a test")
        if decision is not None:
            assert decision.reason == "separation guard: a test"
            self.command(decision)
        elif factor and self.planner.lost:
            self.planner.regain(self.controller.q, self.t_s)

    def go_on(self, ticks: int, world=nobody) -> None:
        for _ in range(ticks):
            while self.to_come and self.to_come[0][0] <= self.tick:
                self.controller.speed_factor = self.to_come.pop(0)[1]
            if self.tick % 3 == 0:
                self.command(self.planner.respond(world(self.t_s), lambda: self.t_s))
            self.tick += 1
            self.controller.update(self.tick * NS // 100)
            wanted = self.planner.state_at(self.t_s)[0]
            self.worst_rad = max(self.worst_rad, float(np.abs(self.controller.q - wanted).max()))
            if not self.planner.lost:
                self.troubles.append(self.planner.arm_trouble(self.following, self.controller.q, self.t_s))


HISTORIES = st.lists(st.tuples(st.integers(0, 100), st.integers(1, 25)), min_size=1, max_size=25)


@settings(max_examples=12, deadline=None)
@given(HISTORIES)
def test_planner_and_controller_agree_whatever_the_factor_does(history: list[tuple[int, int]]) -> None:
    work = Work()
    work.go_on(20)
    for k, (percent, ticks) in enumerate(history):
        work.factor(percent / 100.0)
        near = somebody_at(0.9, 0.9 * (-1.0) ** k, work.t_s, radius_m=0.1)  # so that plans change, too
        work.go_on(ticks, lambda t, near=near: type(near)(near.grid, near.probability, t))
    work.factor(1.0)
    work.go_on(300)
    assert work.worst_rad < NEAR_RAD
    assert set(work.troubles) == {""}
    assert work.actions[-1] in ("arrived", "keep")


@settings(max_examples=8, deadline=None)
@given(HISTORIES)
def test_a_controller_that_hears_of_the_factor_later_still_follows(history: list[tuple[int, int]]) -> None:
    work = Work(late=2)
    work.go_on(20)
    for percent, ticks in history:
        work.factor(percent / 100.0)
        work.go_on(ticks)
    limit = float((CONFIG.velocity_scale * ARM.chain.velocity_limit).max())
    # 20 ms at full speed, and as much again until the trajectory that begins where the planner has the arm.
    assert work.worst_rad <= 2 * 0.02 * limit + NEAR_RAD
    assert set(work.troubles) == {""}


def test_a_factor_of_zero_is_a_hold_with_the_guards_reason_until_the_arm_is_known_again() -> None:
    work = Work()
    work.go_on(50)
    assert work.planner.state_at(work.t_s)[1].any()
    work.factor(0.0)
    assert not work.planner.state_at(work.t_s)[1].any()
    work.go_on(30)
    answer = work.planner.respond(nobody(work.t_s), lambda: work.t_s)
    assert (answer.action, answer.reason, answer.trajectory) == ("hold", "separation guard: a test", None)
    work.planner.set_factor(0.5, work.t_s)
    assert work.planner.respond(nobody(work.t_s), lambda: work.t_s).action == "hold"  # nobody knows where it stands
    work.controller.q = work.controller.q + 0.2  # it was pushed
    work.planner.regain(work.controller.q, work.t_s)
    work.controller.speed_factor = 0.5
    work.go_on(300)
    assert work.actions[-1] in ("keep", "arrived")
    np.testing.assert_allclose(work.controller.q, work.planner.state_at(work.t_s)[0], atol=NEAR_RAD)


@pytest.mark.parametrize("factor", [1.0, 0.5, 0.1])
def test_plans_are_as_fast_as_the_factor_and_stops_as_short_as_the_arm_can(factor: float) -> None:
    work = Work()
    work.factor(factor)
    work.go_on(20 + int(30 / factor))
    fastest = float(np.abs(work.planner.state_at(work.t_s)[1]).max())
    limit = float((CONFIG.velocity_scale * ARM.chain.velocity_limit).max())
    assert 0.3 * factor * limit < fastest <= 1.02 * factor * limit
    q, v = (part.copy() for part in work.planner.state_at(work.t_s)[:2])
    v_most = float(np.abs(v).max())
    work.planner.hold(work.t_s, "a test")
    q_end, v_end, _ = work.planner.state_at(work.t_s + v_most / 4.0 + 0.35)
    assert not v_end.any()
    # Braking at the limit, and what building the deceleration up takes.
    assert np.abs(q_end - q).max() < 0.5 * v_most**2 / 4.0 + 0.2 * v_most


def test_without_a_guard_times_are_the_clocks_bit_for_bit() -> None:
    subject = Replanner(ARM, GOALS, free_space(), CONFIG)
    subject.start(START, 0.1)
    decision = subject.respond(nobody(0.2 + 1e-9))
    assert decision.t_switch_s == 0.2 + 1e-9 + CONFIG.period_s
    assert subject.reached_s(decision) == decision.t_switch_s
    assert subject.motion_from(0.7).start_s == 0.7
