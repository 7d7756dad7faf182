"""What a planner node commands its arm with: trajectories and holds, and whether the arm does as it is told."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, PlanningError
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.commander import commander
from humanpred_ros.nodes.guard_listener import GuardListener
from humanpred_ros.nodes.inputs import kind_of
from humanpred_ros.nodes.markers import PlanPictures
from humanpred_ros.nodes.measured_arm import MeasuredArm
from humanpred_ros.nodes.planner_settings import StompPlannerSettings
from humanpred_ros.planning.decision import ARRIVED, HOLD, KEEP, REPLAN, Decision
from humanpred_ros.planning.following import FollowingSettings
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.robot.goals import Goal
from humanpred_ros.robot.scene import Scene, tasks_of
from humanpred_ros.robot.scene_file import GoalSection, read_scene_file

#: After an arm did not follow, so long passes before it is commanded again, s.
_RETRY_S = 1.0
#: A trajectory that ends sooner could be over before the controller has it, s.
_LEAST_S = 0.1
#: A process none of whose threads has looked for so long stood still: what it knows is from before, s.
_STOOD_S = 0.2


class CommandingNode(GraphNode):
    """A node with a replanner and an arm, which is held when it does not follow, is silent, or a guard stops it.

    Attributes:
        settings, replanner, scene: made when it is configured.
        tasks: all there are, by what YAML says of each.
        arm: as it was measured.
        begun: whether the arm is commanded, since `origin_ns`.
        holding: the hold is for data that are bad, or do not come.
        n_holds, hold_reason: how many holds there were, and why the last one is.
        last_ns, last_now_ns: stamp of the newest occupancy, and the node's time when it came.
        woke_s: when the process went on after it stood still, on the steady clock, as long as what the arm and the
            guard have done meanwhile is not known; None once it is.
    """

    settings: StompPlannerSettings
    replanner: Replanner
    scene: Scene
    tasks: dict[GoalSection, Goal]

    def activate(self) -> None:
        settings, replanner = self.settings, self.replanner
        replanner.forget()
        self.arm = MeasuredArm(replanner.joint_names, settings.part(FollowingSettings), replanner.arm.difference)
        self.begun = self.holding = self.told_hold = False
        self.lost_s = 0.0
        self.origin_ns = self.last_ns = self.last_now_ns = 0
        self.n_holds, self.hold_reason = 0, ""
        self.woke_s: float | None = None
        self._stood = ""
        self._looked_s = time.monotonic()
        self.commander = commander(self, settings.command_by, settings.controller, self.on_failed)
        self.decision_publisher = self.create_publisher(DiagnosticArray, topics.DECISION, qos.SENSOR_PUBLISHER)
        self.cost_publisher = self.create_publisher(JointState, topics.COSTS, qos.SENSOR_PUBLISHER)
        self.pictures = PlanPictures(self, replanner.tool_path)
        self.hardware_id = self.resolve_topic_name(topics.TRAJECTORY).rpartition("/")[0]
        age_s = math.inf if settings.lossless else settings.max_arm_age_s
        self.listen(JointState, topics.JOINT_STATES, self.on_joint_state, qos.ARM, max_age_s=age_s)
        self.guard = GuardListener(self, settings.guard, self._obey)
        replanner.set_factor(self.guard.factor, 0.0, self.guard.reason)

    def on_joint_state(self, message: JointState) -> bool:
        """Compare where the arm is with where it was commanded to be; return False for other joints' messages."""
        if not set(message.name) & set(self.replanner.joint_names):
            return False
        received_s = time.perf_counter()
        with self.replanner.lock:
            try:
                if not self.arm.take(message, self.get_clock().now().nanoseconds):
                    self.refuse("late joint states: they were under way for too long to tell where the arm is")
                    return True
            except ArrayError as error:
                self.refuse(str(error))
                return True
            if not self.awake():
                self._come_to(received_s)
            # After the clock was set back, what was commanded when means nothing: the next occupancy begins anew.
            elif self.begun and not (self.settings.lossless or self._clock_is_back()):
                self._check_arm(self.arm, received_s)
        return True

    def awake(self) -> bool:
        """Return whether what is known of arm and guard is from after the process last stood still.

        To be called every few hundredths of a second, too: a process that was stopped, suspended or starved does not
        know it, and believes what it heard last. Meanwhile the arm has moved on, or a guard has stopped it.
        """
        now_s = time.monotonic()
        stood_s, self._looked_s = now_s - self._looked_s, now_s
        if stood_s > _STOOD_S and not self.settings.lossless:
            with self.replanner.lock:
                self.woke_s = now_s
                self.arm.following.forget()
                self._stood = f"the planner stood still for {stood_s:.2f} s, and asks anew where the arm is"
                if self.begun:
                    self.replanner.lost = self._stood
                    self._note_hold(self._stood)
        return self.woke_s is None

    def _come_to(self, received_s: float) -> None:
        """Stop the arm where it is, once it and the guard have spoken since the process stood still."""
        assert self.woke_s is not None
        if self.arm.sent_since(self.woke_s) and self.arm.speed_known and self.guard.known_since(self.woke_s):
            self.woke_s = None
            if self.begun:
                self._lose(self._stood, received_s)
                self.lost_s = -math.inf  # planned for again as soon as it is seen at rest

    def _check_arm(self, arm: MeasuredArm, received_s: float) -> None:
        """Hold when the arm is not where it was commanded to be; go on from where it is once it rests."""
        now_s = self.now_s()
        assert arm.q is not None
        if not self.replanner.lost:
            trouble = self.replanner.arm_trouble(arm.following, arm.q, now_s, arm.late_s)
            if trouble:
                self._lose(trouble, received_s)
        elif (
            arm.following.at_rest
            and arm.came_s - self.lost_s >= _RETRY_S
            and not (self.commander.waiting_for() or self.replanner.stopped)
        ):
            try:
                self.replanner.regain(self.replanner.nearest_start(arm.q, self.settings.start_slack_rad), now_s)
            except PlanningError as error:
                self.refuse(str(error))

    def _obey(self, factor: float, reason: str) -> None:
        """Do as the separation guard says: the arm's controller does so already."""
        received_s = time.perf_counter()
        with self.replanner.lock:
            stop = self.replanner.set_factor(factor, self.now_s(), reason)
            if stop is not None and self.begun:
                self.lost_s = -math.inf  # planned for again as soon as it may move and is seen at rest
                self._note_hold(reason)
                self.publish(stop, self.last_ns, received_s)

    def _lose(self, reason: str, received_s: float) -> None:
        """Tell the arm to stay where it is by now, so that it does not go on by itself when it is free again."""
        self.lost_s = time.monotonic()
        decision = self.replanner.correct(self.arm.position_now(), self.arm.v, self.now_s(), reason)
        self.publish(decision, self.last_ns, received_s)

    def on_failed(self, reason: str) -> None:
        """Take the arm for one that does not follow: its controller does not carry out what it was sent last."""
        received_s = time.perf_counter()
        with self.replanner.lock:
            if self.replanner.lost:  # then it was the stop: sent again and again it would fare no better
                self.lost_s = time.monotonic()
                self.tell(("failed", kind_of(reason)), f"the arm was told to stay where it is, but {reason}")
            elif self.begun:
                self._lose(reason, received_s)

    def hold(self, reason: str) -> None:
        """Bring the arm to rest, if it is commanded, and say so; in stepped runs at the newest occupancy's stamp."""
        received_s = time.perf_counter()
        with self.replanner.lock:
            if self.begun and self.settings.lossless:
                self._note_hold(reason)
                stop = self.replanner.hold((self.last_ns - self.origin_ns) * 1e-9, reason)
                self.publish(stop, self.last_ns, received_s)
            elif self.begun:
                self.publish(self._hold(reason), self.last_ns, received_s)

    def tasks_of(self, text: str) -> dict[GoalSection, Goal]:
        """Return the tasks of a YAML text, or the scene's for none, by what is said of each; raises as `tasks_of`."""
        entries = read_scene_file(self.settings.scene).goals
        own = dict(zip(entries, self.scene.goals, strict=True))
        return tasks_of(text, self.scene, self.live_solids(), {**own, **self.tasks}) if text.strip() else own

    def live_solids(self) -> tuple[Obstacle, ...]:
        """Return what stands there beside the scene's obstacles."""
        return ()

    def use(self, settings: StompPlannerSettings) -> None:
        """Go by other settings, where they may change at run time."""
        self.settings = settings

    def _hold(self, reason: str) -> Decision:
        with self.replanner.lock:
            self.holding = True
            self._note_hold(reason)
            if self._clock_is_back() and self.arm.q is not None:
                return self.replanner.correct(self.arm.q, self.arm.v, self.now_s(), reason)
            return self.replanner.hold(self.now_s(), reason)

    def _note_hold(self, reason: str) -> None:
        """Let no answer that is under way end this hold."""
        self.hold_reason = reason
        self.n_holds += 1

    def _clock_is_back(self) -> bool:
        """Return whether the node's clock has been set back since the newest occupancy."""
        return self.get_clock().now().nanoseconds < self.last_now_ns

    def now_s(self) -> float:
        """Return the node's time in seconds after the first occupancy."""
        return (self.get_clock().now().nanoseconds - self.origin_ns) * 1e-9

    def publish(self, decision: Decision, stamp_ns: int, received_s: float) -> None:
        """Send the trajectory first, then the decision: who waits for the decision finds the arm informed."""
        compute_ms = 1e3 * (time.perf_counter() - received_s)
        with self.replanner.lock:
            awake = self.awake()
            held = self.replanner.held if awake else self.replanner.lost
            if held and decision.action != HOLD and not self.settings.lossless:
                # The arm was stopped while this was decided.
                decision = replace(decision, action=HOLD, reason=held, trajectory=None)
            if decision.trajectory is not None and awake:
                # A controller forgets the old trajectory at once: it is sent what is left of it, then the new one.
                now_s = decision.stamp_s if self.settings.lossless else self.now_s()
                begin_s = min(now_s, self.replanner.reached_s(decision))
                motion = self.replanner.motion_from(begin_s).lasting_until(now_s + _LEAST_S)
                self.commander.send(conversions.trajectory_message(self.replanner.joint_names, motion, self.origin_ns))
            decision = replace(decision, t_switch_s=self.replanner.reached_s(decision))
        # People want to see what changes; that a goal is kept changes nothing, unless it ends a hold.
        if decision.action != KEEP or self.told_hold:
            self.told_hold = decision.action == HOLD
            why = "" if decision.action in (REPLAN, ARRIVED) else kind_of(decision.reason)
            self.tell((decision.action, why, decision.chosen), f"{decision.stamp_s:5.2f} s  {decision.summary()}")
        self.decision_publisher.publish(conversions.decision_message(decision, stamp_ns, compute_ms))
        if decision.goals:
            costs = np.array([goal.selection_cost for goal in decision.goals])
            self.cost_publisher.publish(conversions.joint_state([g.name for g in decision.goals], costs, stamp_ns))
        self.pictures.show(decision, self.replanner.rollouts, conversions.time_message(stamp_ns))

    def _silent(self, now_s: float) -> str:
        """Return that the arm has been silent for too long on the steady clock; empty if it is not, or nothing new."""
        silent_s = now_s - self.arm.came_s
        if silent_s <= self.settings.max_arm_age_s or self.replanner.lost:
            return ""
        self.lost_s = -math.inf  # planned for again as soon as it is seen at rest
        self.replanner.lost = f"silent arm: its joint states have not come for {silent_s:.2f} s"
        return self.replanner.lost
