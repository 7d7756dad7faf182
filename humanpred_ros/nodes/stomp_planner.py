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

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import CompressedImage, PointCloud2

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, PlanningError
from humanpred_ros.geometry import compiled
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import entry_point
from humanpred_ros.nodes.commander import OtherCommanders
from humanpred_ros.nodes.commanding_node import CommandingNode
from humanpred_ros.nodes.inputs import Input
from humanpred_ros.nodes.obstacles import ObstacleInput
from humanpred_ros.nodes.occupancy_topics import OccupancyInput, occupancy_of, says_nobody
from humanpred_ros.nodes.operator_services import TASK_COSTS, OperatorServices, declare_task_costs, take_parameters
from humanpred_ros.nodes.parameters import declare, plugin_parameters
from humanpred_ros.nodes.planner_settings import StompPlannerSettings
from humanpred_ros.nodes.priority import DDS, come_first, threads_named
from humanpred_ros.nodes.seen_people import SeenPeople
from humanpred_ros.planning.decision import ARRIVED, HOLD, KEEP, MISSED, Decision
from humanpred_ros.planning.replanner import NO_TIME, Replanner
from humanpred_ros.robot.scene import load_scene

_WATCH_PERIOD_S = 0.02
#: So long the controller is given to take the last stop, s.
_LAST_WORD_S = 1.0
_TWO = "two planners"
#: Threads of the process take turns so often, s.
_SWITCH_S = 5e-4
#: Share of a step after its occupancy's stamp that STOMP may take in real time: few goals answer sooner.
_SHARE_PER_GOAL, _LEAST_SHARE = 0.16, 0.25


class StompPlannerNode(CommandingNode):
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
        self.settings = settings = declare(self, StompPlannerSettings, (TASK_COSTS,))
        self.scene = load_scene(settings.scene)
        with compiled.announced("STOMP planner", self.get_logger().info):
            config = settings.replanner_config(plugin_parameters(self, settings.cost_terms))
            self.replanner = Replanner.for_scene(self.scene, config)
            self.replanner.warm_up()
        self.tasks = {}
        self.tasks = self.tasks_of(settings.tasks)
        if settings.tasks:
            self.replanner.change(goals=tuple(self.tasks.values()))
        self.replanner.change(task_costs=declare_task_costs(self))

    def activate(self) -> None:
        super().activate()
        settings = self.settings
        self.people = SeenPeople(settings)
        self.stepped_s = time.monotonic()  # when a replanning step was finished, on a clock that nobody sets
        age_s = math.inf if settings.lossless else settings.max_human_age_s
        profile = qos.sensor_subscription(settings.lossless, newest_only=True)
        self.occupancies = OccupancyInput(self, self.on_occupancy, profile, max_age_s=age_s)
        self.people.clock, self.people.silence = self.occupancies.clock, self.occupancies.silence
        self.obstacles = ObstacleInput(self, self.scene)
        self.operator = OperatorServices(self)
        self.answers = Input(topics.DECISION)
        self._busy = False  # with a step, which a stop must not wait for
        self._closing, self._asked = threading.Event(), threading.Event()
        # With how many holds there were before it came: an older one ends none.
        self._newest: deque[tuple[Occupancy, int, float, int]] = deque(maxlen=1)
        # A plan that is ready, or a message that calls for a hold, must not wait 5 ms for the other thread's turn.
        sys.setswitchinterval(_SWITCH_S)
        work = () if settings.lossless else (self._plan, self._watch)
        self._threads = [threading.Thread(target=self._guarded, args=(target,), daemon=True) for target in work]
        for thread in self._threads:
            thread.start()
        # In a stepped run everybody waits for this node, and it plans in the thread that brings the messages.
        watching = [] if settings.lossless else [threading.get_native_id(), *threads_named(DDS)]
        self.real_time = self.come_first(watching)

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        return take_parameters(self, parameters)

    def live_solids(self) -> tuple[Obstacle, ...]:
        return self.obstacles.live.solids if self.connected else ()

    def use(self, settings: StompPlannerSettings) -> None:
        super().use(settings)
        if self.connected:
            self.operator.follow_tasks()
            self.obstacles.show()
            self.people.settings = settings
            if not settings.lossless:
                self.inputs[self.resolve_topic_name(topics.JOINT_STATES)].max_age_s = settings.max_arm_age_s
                for heard in self.occupancies.inputs:
                    heard.max_age_s = settings.max_human_age_s

    def waiting_for(self) -> str:
        if self.arm.q is None:
            return f"the arm's joints on {self.resolve_topic_name(topics.JOINT_STATES)}"
        listening = self.unmatched(self.settings.listener, self.decision_publisher) if self.settings.listener else ""
        looking = "other planners to be heard of, if there are any" if self._looks_around() else ""
        return self.commander.waiting_for() or listening or looking

    def holding_because(self) -> str:
        return self.replanner.held or self.replanner.paused

    def working(self) -> str:
        return "planning" if self.begun else super().working()

    def facts(self) -> dict[str, str]:
        facts = {**self.operator.facts(), **self.obstacles.facts()}
        if not self.begun:
            return facts
        answers = self.answers.facts(time.monotonic())
        facts["following_error_rad"] = f"{self.arm.following.error_rad:.4f}"
        facts["real_time"] = self.real_time
        return {**facts, **{f"answers/{name}": text for name, text in answers.items()}}

    def deactivate(self) -> None:
        """Stop the arm, which nobody is going to command any more."""
        stops = self.begun and not self.settings.lossless and self.context.ok()
        self._closing.set()
        come_first(0, [threading.get_native_id()])
        if stops:
            with self.replanner.lock:
                moves = not self.replanner.at_rest(self.now_s())
                stop = self._hold("the planner is ended")  # nor is what is being planned sent any more
                if moves or stop.trajectory is not None:  # one that is yet to begin has been sent, too
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

    def on_occupancy(self, message: PointCloud2 | CompressedImage) -> None:
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
        ahead, stale = self.people.ahead(age_s), self.people.stale(age_s)
        if ahead:
            self._answer_with_hold(ahead, stamp_ns, received_s)
            return
        back = self.begun and stamp_ns < self.last_ns
        if not self.begun or (back and (lossless or now_ns < self.last_now_ns)):
            if not self._begin(stamp_ns, received_s, anew=back and not lossless):
                return
        elif back and not stale:  # overtaken by a newer one: the clock has not jumped back, so neither has the arm
            self._refuse_occupancy("stamp not increasing: an occupancy came after a newer one")
            return
        self.last_ns, self.last_now_ns = max(self.last_ns, stamp_ns), now_ns
        if stale:
            self._answer_with_hold(stale, stamp_ns, received_s)
            return
        t_s = (stamp_ns - self.origin_ns) * 1e-9
        try:
            occupancy = occupancy_of(message, self.scene.grid, t_s)
        except ArrayError as error:
            self._answer_with_hold(str(error), stamp_ns, received_s, "invalid human data: ")
            return
        vanished = self.people.vanished(occupancy, says_nobody(message))
        if vanished:
            self._answer_with_hold(vanished, stamp_ns, received_s)
            return
        self.people.believe(age_s)
        self.holding = False
        if lossless:
            self._answer(occupancy, stamp_ns, received_s, self.n_holds)
            return
        with self.replanner.lock:
            reason = self.replanner.too_close(occupancy, self.now_s()) if self._busy else ""
            if reason:
                self._note_hold(reason)
                self.publish(self.replanner.hold(self.now_s(), reason), stamp_ns, received_s)
            self._newest.append((occupancy, stamp_ns, received_s, self.n_holds))
        self._asked.set()

    def _begin(self, stamp_ns: int, received_s: float, anew: bool) -> bool:
        """Let the time of `stamp_ns` be zero, and the arm begin where it was measured; return whether it can."""
        if self.arm.q is None:
            self._wait_with_hold(
                f"no arm: its joints have not come on {self.resolve_topic_name(topics.JOINT_STATES)}", stamp_ns
            )
            return False
        if not self.awake():
            self._wait_with_hold("stood still: waiting to hear where the arm is by now", stamp_ns)
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
            self.stepped_s = self.people.true_s = time.monotonic()
            self.others.begin()
            stopped = self.replanner.stopped
            if not (self.settings.lossless or (self.arm.following.at_rest and not stopped)):
                self.lost_s = -math.inf
                # Where a guard stops the arm, it would go on with what it was sent before as soon as it may move.
                reason = stopped or "the arm moves, and not at this planner's command: it is stopped"
                self.publish(self.replanner.correct(self.arm.q, self.arm.v, 0.0, reason), stamp_ns, received_s)
        return True

    def _looks_around(self) -> bool:
        return not (self.begun or self.settings.lossless) and self.others.looking()

    def _wait_with_hold(self, reason: str, stamp_ns: int) -> None:
        """Refuse to begin, with a decision that says why: whoever listens must not take silence for work."""
        self.refuse(reason)
        waiting = Decision(0.0, 0, HOLD, reason, None, None)
        self.decision_publisher.publish(conversions.decision_message(waiting, stamp_ns, 0.0, waits=True))

    def _refuse_occupancy(self, reason: str) -> None:
        self.people.refusal = reason
        self.refuse(reason)

    def _answer_with_hold(self, reason: str, stamp_ns: int, received_s: float, what: str = "") -> None:
        """Refuse an occupancy and hold, for data that say nothing of where people are; the hold also says `what`."""
        self._refuse_occupancy(reason)
        if self.begun:
            self.publish(self._hold(what + reason), stamp_ns, received_s)

    def _note_hold(self, reason: str) -> None:
        super()._note_hold(reason)
        self._newest.clear()

    def _plan(self) -> None:
        """Answer the newest occupancy, again and again."""
        come_first(0, [threading.get_native_id()])
        while True:
            self._asked.wait()
            self._asked.clear()
            if self._closing.is_set():
                return
            with self.replanner.lock:  # a hold forgets it
                newest = self._newest.pop() if self._newest else None
                self._busy = newest is not None
            if newest is not None:
                self._answer(*newest)
                self._busy = False

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
        self.obstacles.refresh()
        self.replanner.keep_rollouts = self.pictures.rollouts.get_subscription_count() > 0
        if self.settings.lossless:
            return self.replanner.respond(occupancy)
        usual_s = max(_SHARE_PER_GOAL * len(self.replanner.goal_names), _LEAST_SHARE) * self.settings.period_s
        # What has been on its way for long is given time, too, as long as there is any.
        usual_s = max(occupancy.t_s + usual_s, self.now_s() + 0.5 * usual_s)
        enough_s = min(usual_s, occupancy.t_s + self.settings.stomp_share * self.settings.period_s)
        decision = self.replanner.respond(occupancy, self.now_s, lambda: self.now_s() >= enough_s)
        with self.replanner.lock:
            if decision.action == ARRIVED and not self.arm.following.at_rest:
                reason = f"about to arrive: {decision.chosen}, but the arm still moves"
                return replace(decision, action=KEEP, reason=reason)
        return decision

    def _watch(self) -> None:
        """Hold when joint states, human data or finished steps have not come for too long."""
        self.come_first([threading.get_native_id()])
        while not self._closing.wait(_WATCH_PERIOD_S):
            self.awake()
            self.guard.look()
            looked_s = time.perf_counter()
            with self.replanner.lock:
                reason = self._overdue(time.monotonic()) if self.begun else ""
                if reason:
                    self.publish(self._hold(reason), self.last_ns, looked_s)

    def _overdue(self, now_s: float) -> str:
        """Return what has not come for too long; empty if nothing is overdue, or nothing new."""
        silent = self._silent(now_s)
        if silent:
            return silent
        if self.holding:
            return ""
        old = self.people.overdue(now_s)
        if old:
            return old
        step_s, settings = now_s - self.stepped_s, self.settings
        if step_s > settings.max_human_age_s + settings.period_s and not self.replanner.held:
            return f"overload: no replanning step was finished for {step_s:.2f} s; the machine is too busy"
        return ""


main = entry_point(StompPlannerNode)

if __name__ == "__main__":
    main()
