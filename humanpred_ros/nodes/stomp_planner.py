"""Keeps the arm working on the task that disturbs the person least."""

from __future__ import annotations

import math
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, PointCloud2

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, PlanningError
from humanpred_ros.geometry import compiled
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.commander import OtherCommanders, commander
from humanpred_ros.nodes.inputs import Input, kind_of
from humanpred_ros.nodes.markers import PlanPictures
from humanpred_ros.nodes.measured_arm import MeasuredArm
from humanpred_ros.nodes.parameters import declare, plugin_parameters
from humanpred_ros.nodes.planner_settings import StompPlannerSettings
from humanpred_ros.planning.decision import ARRIVED, HOLD, KEEP, MISSED, Decision
from humanpred_ros.planning.following import FollowingSettings
from humanpred_ros.planning.replanner import NO_TIME, Replanner
from humanpred_ros.robot.scene import load_scene

_WATCH_PERIOD_S = 0.02
#: After an arm did not follow, so long passes before it is commanded again, s.
_RETRY_S = 1.0
#: So long the controller is given to take the last stop, s.
_LAST_WORD_S = 1.0
#: A trajectory that ends sooner could be over before the controller has it, s.
_LEAST_S = 0.1
_TWO = "two planners"
#: Threads of the process take turns so often, s.
_SWITCH_S = 5e-4
#: Share of a step after its occupancy's stamp that STOMP may take in real time: few goals answer sooner.
_SHARE_PER_GOAL, _LEAST_SHARE = 0.16, 0.25


class StompPlannerNode(GraphNode):
    """P1's Algorithm 1 on topics: an occupancy comes in, a decision goes out, and a trajectory when due.

    Every occupancy is answered by one decision with the same stamp, unless a newer one came before its turn. Human data
    that are stale, or that cannot be used, lead to a hold with a named reason, never to planning as if nobody were
    there. So does an arm that is silent, or not where it was commanded to be: planning goes on from where it was
    measured, once it rests. So does a machine too busy to finish a replanning step.

    What protects waits for nothing: one thread takes the messages, and holds at once when one calls for it; one plans
    with the newest occupancy; one watches, on a clock that nobody sets, for what does not come.

    In stepped runs, which wait for whoever is slow, ages mean nothing; they are not looked at, and neither is the arm.
    Everything then happens in one thread, one message after the other.
    """

    def __init__(self) -> None:
        super().__init__("stomp_planner")

    def configure(self) -> None:
        self.others = OtherCommanders(self)  # what takes long below is time for others to be heard of
        self.settings = settings = declare(self, StompPlannerSettings)
        self.scene = load_scene(settings.scene)
        with compiled.announced("STOMP planner", self.get_logger().info):
            config = settings.replanner_config(plugin_parameters(self, settings.cost_terms))
            self.replanner = Replanner.for_scene(self.scene, config)
            self.replanner.warm_up()

    def activate(self) -> None:
        settings = self.settings
        following = settings.part(FollowingSettings)
        self.arm = MeasuredArm(self.replanner.joint_names, following, self.replanner.arm.difference)
        self.begun = self.holding = self.told_hold = False
        self.lost_s = 0.0
        self.origin_ns = self.last_ns = self.last_now_ns = 0
        # When what is known of people was true, and when a replanning step was finished, on a clock that nobody sets.
        self.human_true_s = self.stepped_s = time.monotonic()
        self.somebody_seen = False
        self.n_holds, self.hold_reason = 0, ""
        self.last_refusal = ""

        self.commander = commander(self, settings.command_by, settings.controller, self.on_failed)
        self.decision_publisher = self.create_publisher(DiagnosticArray, topics.DECISION, qos.SENSOR_PUBLISHER)
        self.pictures = PlanPictures(self, self.replanner.tool_path)
        self.hardware_id = self.resolve_topic_name(topics.TRAJECTORY).rpartition("/")[0]
        arm_age_s, human_age_s = settings.max_arm_age_s, settings.max_human_age_s
        if settings.lossless:
            arm_age_s = human_age_s = math.inf
        self.listen(JointState, topics.JOINT_STATES, self.on_joint_state, qos.ARM, max_age_s=arm_age_s)
        profile = qos.sensor_subscription(settings.lossless, newest_only=True)
        self.listen(PointCloud2, topics.OCCUPANCY, self.on_occupancy, profile, max_age_s=human_age_s)
        self.answers = Input(topics.DECISION)
        self._closing, self._asked = threading.Event(), threading.Event()
        # With how many holds there were before it came: an older one ends none.
        self._newest: deque[tuple[Occupancy, int, float, int]] = deque(maxlen=1)
        # A plan that is ready, or a message that calls for a hold, must not wait 5 ms for the other thread's turn.
        sys.setswitchinterval(_SWITCH_S)
        work = () if settings.lossless else (self._plan, self._watch)
        self._threads = [threading.Thread(target=self._guarded, args=(target,), daemon=True) for target in work]
        for thread in self._threads:
            thread.start()

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take the noise of the rollouts at run time."""
        for parameter in parameters:
            if parameter.name == "noise_std":
                self.replanner.set_noise(parameter.value)
        return SetParametersResult(successful=True)

    def waiting_for(self) -> str:
        if self.arm.q is None:
            return f"the arm's joints on {self.resolve_topic_name(topics.JOINT_STATES)}"
        listening = self.unmatched(self.decision_publisher, self.settings.listener) if self.settings.listener else ""
        looking = "other planners to be heard of, if there are any" if self._looks_around() else ""
        return self.commander.waiting_for() or listening or looking

    def holding_because(self) -> str:
        return self.replanner.held

    def working(self) -> str:
        return "planning" if self.begun else super().working()

    def facts(self) -> dict[str, str]:
        if not self.begun:
            return {}
        answers = self.answers.facts(time.monotonic())
        error_rad = f"{self.arm.following.error_rad:.4f}"
        return {"following_error_rad": error_rad, **{f"answers/{name}": text for name, text in answers.items()}}

    def deactivate(self) -> None:
        """Stop the arm, which nobody is going to command any more."""
        stops = self.begun and not self.settings.lossless and self.context.ok()
        self._closing.set()
        if stops:
            with self.replanner.lock:
                moves = not self.replanner.at_rest(self.now_s())
                stop = self._hold("the planner is ended")  # nor is what is being planned sent any more
                if moves:
                    self.publish(stop, self.last_ns, time.perf_counter())
        self._asked.set()
        for thread in self._threads:
            thread.join()
        if stops:
            self.commander.wait_until_heard(_LAST_WORD_S)

    def _guarded(self, work: Callable[[], None]) -> None:
        """Do the work of a thread; if that fails, the arm is stopped and the process ends."""
        try:
            work()
        except Exception as error:
            self.get_logger().error(traceback.format_exc())
            if self.begun:
                self.publish(self._hold(f"the planner failed: {error}"), self.last_ns, time.perf_counter())
            self.stop_with(PlanningError(f"the planner failed: {error}; please report this with the log"))

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
            # After the clock was set back, what was commanded when means nothing: the next occupancy begins anew.
            if self.begun and not (self.settings.lossless or self._clock_is_back()):
                self._check_arm(self.arm, received_s)
        return True

    def _check_arm(self, arm: MeasuredArm, received_s: float) -> None:
        """Hold when the arm is not where it was commanded to be; go on from where it is once it rests."""
        now_s = self.now_s()
        assert arm.q is not None
        if not self.replanner.lost:
            trouble = self.replanner.arm_trouble(arm.following, arm.q, now_s, arm.late_s)
            if trouble:
                self._lose(trouble, received_s)
        elif arm.following.at_rest and arm.came_s - self.lost_s >= _RETRY_S and not self.commander.waiting_for():
            try:
                self.replanner.regain(self.replanner.nearest_start(arm.q, self.settings.start_slack_rad), now_s)
            except PlanningError as error:
                self.refuse(str(error))

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

    def on_occupancy(self, message: PointCloud2) -> None:
        """Answer one occupancy with one decision."""
        received_s = time.perf_counter()
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        now_ns = self.get_clock().now().nanoseconds
        age_s = (now_ns - stamp_ns) * 1e-9
        lossless = self.settings.lossless
        late = self.others.late() if self.begun and not lossless else ""
        if late:  # who of the two was first is not known: both leave the arm alone
            self.publish(self._hold(f"{_TWO}: {late} commands this arm, too"), stamp_ns, received_s)
            self.begun = False
        if -age_s > self.settings.max_ahead_s and not lossless:
            reason = f"stamp ahead: the human data's clock is {-age_s:.3g} s ahead, at most"
            self._answer_with_hold(f"{reason} {self.settings.max_ahead_s:g} s are allowed", stamp_ns, received_s)
            return
        back = self.begun and stamp_ns < self.last_ns
        stale = age_s > self.settings.max_human_age_s and not lossless
        if not self.begun or (back and (lossless or now_ns < self.last_now_ns)):
            if not self._begin(stamp_ns, received_s, anew=back and not lossless):
                return
        elif back and not stale:  # overtaken by a newer one: the clock has not jumped back, so neither has the arm
            self._refuse_occupancy("stamp not increasing: an occupancy came after a newer one")
            return
        self.last_ns, self.last_now_ns = max(self.last_ns, stamp_ns), now_ns
        if stale:
            reason = f"stale human data: {age_s:.2f} s old, at most {self.settings.max_human_age_s:g} s allowed"
            self._answer_with_hold(reason, stamp_ns, received_s)
            return
        t_s = (stamp_ns - self.origin_ns) * 1e-9
        try:
            occupancy = conversions.occupancy_from_cloud(message, self.scene.grid, t_s)
        except ArrayError as error:
            self._answer_with_hold(str(error), stamp_ns, received_s, "invalid human data: ")
            return
        if occupancy.probability.any():
            self.somebody_seen = True
        elif conversions.says_nobody(message):
            self.somebody_seen = False
        elif self.somebody_seen:
            reason = "empty occupancy: people were there, and nobody said that they have left"
            self._answer_with_hold(reason, stamp_ns, received_s)
            return
        self.human_true_s = time.monotonic() - max(age_s, 0.0)
        self.last_refusal = ""
        self.holding = False
        if lossless:
            self._answer(occupancy, stamp_ns, received_s, self.n_holds)
        else:
            self._newest.append((occupancy, stamp_ns, received_s, self.n_holds))
            self._asked.set()

    def _begin(self, stamp_ns: int, received_s: float, anew: bool) -> bool:
        """Let the time of `stamp_ns` be zero, and the arm begin where it was measured; return whether it can."""
        if self.arm.q is None:
            self._wait_with_hold(
                f"no arm: its joints have not come on {self.resolve_topic_name(topics.JOINT_STATES)}", stamp_ns
            )
            return False
        others = self.others.names()
        if others:
            self._wait_with_hold(f"{_TWO}: {others} commands this arm already; end one of them", stamp_ns)
            return False
        if self._looks_around():
            self._wait_with_hold(f"looking around: whether {_TWO} command this arm", stamp_ns)
            return False
        if not (self.settings.lossless or self.arm.following.known):
            self._wait_with_hold("arm not known: waiting to see whether it rests", stamp_ns)
            return False
        with self.replanner.lock:
            if anew:
                self.publish(self._hold("the clock was set back"), stamp_ns, received_s)
            try:
                self.replanner.start(self.replanner.nearest_start(self.arm.q, self.settings.start_slack_rad), 0.0)
            except PlanningError as error:
                self._wait_with_hold(str(error), stamp_ns)
                return False
            self.begun, self.origin_ns, self.last_ns = True, stamp_ns, stamp_ns
            self.stepped_s = time.monotonic()
            self.others.begin()
            if not (self.settings.lossless or self.arm.following.at_rest):
                self.lost_s = -_RETRY_S
                reason = "the arm moves, and not at this planner's command: it is stopped"
                self.publish(self.replanner.correct(self.arm.q, self.arm.v, 0.0, reason), stamp_ns, received_s)
        return True

    def _looks_around(self) -> bool:
        return not (self.begun or self.settings.lossless) and self.others.looking()

    def _wait_with_hold(self, reason: str, stamp_ns: int) -> None:
        """Refuse to begin, with a decision that says why: whoever listens must not take silence for work."""
        self.refuse(reason)
        waiting = Decision(0.0, 0, HOLD, reason, None, None)
        self.decision_publisher.publish(conversions.decision_message(waiting, stamp_ns, 0.0))

    def _refuse_occupancy(self, reason: str) -> None:
        self.last_refusal = reason
        self.refuse(reason)

    def _answer_with_hold(self, reason: str, stamp_ns: int, received_s: float, what: str = "") -> None:
        """Refuse an occupancy and hold, for data that say nothing of where people are; the hold also says `what`."""
        self._refuse_occupancy(reason)
        if self.begun:
            self.publish(self._hold(what + reason), stamp_ns, received_s)

    def _hold(self, reason: str) -> Decision:
        with self.replanner.lock:
            self.holding, self.hold_reason = True, reason
            self.n_holds += 1
            self._newest.clear()
            if self._clock_is_back() and self.arm.q is not None:
                return self.replanner.correct(self.arm.q, self.arm.v, self.now_s(), reason)
            return self.replanner.hold(self.now_s(), reason)

    def _clock_is_back(self) -> bool:
        """Return whether the node's clock has been set back since the newest occupancy."""
        return self.get_clock().now().nanoseconds < self.last_now_ns

    def _plan(self) -> None:
        """Answer the newest occupancy, again and again."""
        while True:
            self._asked.wait()
            self._asked.clear()
            if self._closing.is_set():
                return
            with self.replanner.lock:  # a hold forgets it
                newest = self._newest.pop() if self._newest else None
            if newest is not None:
                self._answer(*newest)

    def _answer(self, occupancy: Occupancy, stamp_ns: int, received_s: float, n_holds: int) -> None:
        """Publish the decision on an occupancy that came after so many holds; it ends none that came later."""
        try:
            decision = self.decide(occupancy)
        except PlanningError as error:  # the clock was set back meanwhile, and the arm began anew
            self.refuse(str(error))
            return
        if decision.goals and decision.action != MISSED and not decision.reason.startswith(NO_TIME):
            self.stepped_s = time.monotonic()
        with self.replanner.lock:
            if n_holds != self.n_holds and decision.action != HOLD:
                decision = self._hold(self.hold_reason)
            self.publish(decision, stamp_ns, received_s)
        self.answers.handled(time.monotonic(), time.perf_counter() - received_s)

    def decide(self, occupancy: Occupancy) -> Decision:
        """Replan when a step is due or called for; a plan that comes too late to be switched to is not sent.

        In real time STOMP stops iterating when time runs out, so that an overloaded machine gets a poorer plan
        rather than none. Stepped runs take the time they need, which makes them the same on every machine.
        """
        self.replanner.keep_rollouts = self.pictures.rollouts.get_subscription_count() > 0
        if self.settings.lossless:
            return self.replanner.respond(occupancy)
        share = max(_SHARE_PER_GOAL * len(self.replanner.goal_names), _LEAST_SHARE)
        enough_s = occupancy.t_s + min(share, self.settings.stomp_share) * self.settings.period_s
        decision = self.replanner.respond(occupancy, self.now_s, lambda: self.now_s() >= enough_s)
        with self.replanner.lock:
            if decision.action == ARRIVED and not self.arm.following.at_rest:
                reason = f"about to arrive: {decision.chosen}, but the arm still moves"
                return replace(decision, action=KEEP, reason=reason)
        return decision

    def now_s(self) -> float:
        """Return the node's time in seconds after the first occupancy."""
        return (self.get_clock().now().nanoseconds - self.origin_ns) * 1e-9

    def _watch(self) -> None:
        """Hold when joint states, human data or finished steps have not come for too long."""
        while not self._closing.wait(_WATCH_PERIOD_S):
            looked_s = time.perf_counter()
            with self.replanner.lock:
                reason = self._overdue(time.monotonic()) if self.begun else ""
                if reason:
                    self.publish(self._hold(reason), self.last_ns, looked_s)

    def _overdue(self, now_s: float) -> str:
        """Return what has not come for too long; empty if nothing is overdue, or nothing new."""
        settings, replanner = self.settings, self.replanner
        arm_s, human_s, step_s = (now_s - came_s for came_s in (self.arm.came_s, self.human_true_s, self.stepped_s))
        if arm_s > settings.max_arm_age_s:
            if replanner.lost:
                return ""
            self.lost_s = -_RETRY_S  # planned for again as soon as it is seen at rest
            replanner.lost = f"silent arm: its joint states have not come for {arm_s:.2f} s"
            return replanner.lost
        if self.holding:
            return ""
        if human_s > settings.max_human_age_s:
            why = f" ({self.last_refusal})" if self.last_refusal else ""
            return f"stale human data: what is known of people is {human_s:.2f} s old{why}"
        if step_s > settings.max_human_age_s + settings.period_s and not replanner.held:
            return f"overload: no replanning step was finished for {step_s:.2f} s; the machine is too busy"
        return ""

    def publish(self, decision: Decision, stamp_ns: int, received_s: float) -> None:
        """Send the trajectory first, then the decision: who waits for the decision finds the arm informed."""
        compute_ms = 1e3 * (time.perf_counter() - received_s)
        with self.replanner.lock:
            held = self.replanner.held
            if held and decision.action != HOLD and not self.settings.lossless:
                # The arm was stopped while this was decided.
                decision = replace(decision, action=HOLD, reason=held, trajectory=None)
            if decision.trajectory is not None:
                # A controller forgets the old trajectory at once: it is sent what is left of it, then the new one.
                now_s = decision.stamp_s if self.settings.lossless else self.now_s()
                motion = self.replanner.motion_from(min(now_s, decision.t_switch_s)).lasting_until(now_s + _LEAST_S)
                self.commander.send(conversions.trajectory_message(self.replanner.joint_names, motion, self.origin_ns))
        # People want to see what changes; that a goal is kept changes nothing, unless it ends a hold.
        if decision.action != KEEP or self.told_hold:
            self.told_hold = decision.action == HOLD
            kind = (decision.action, kind_of(decision.reason), decision.chosen)
            self.tell(kind, f"t {decision.stamp_s:5.2f} s  {decision.summary()}")
        self.decision_publisher.publish(conversions.decision_message(decision, stamp_ns, compute_ms))
        self.pictures.show(decision, self.replanner.rollouts, conversions.time_message(stamp_ns))


main = entry_point(StompPlannerNode)

if __name__ == "__main__":
    main()
