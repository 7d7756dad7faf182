"""The nodes that are fuzzed: how each is made, what it is shown, and what it must not answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Int16
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fuzz.mutations import Mutator
from humanpred_ros import topics
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.nodes import (
    commanding_node,
    conversions,
    guard_listener,
    measured_arm,
    occupancy_topics,
    seen_people,
    stomp_planner,
)
from humanpred_ros.nodes.base import GraphNode
from humanpred_ros.nodes.occupancy_predictor import OccupancyPredictorNode
from humanpred_ros.nodes.occupancy_replay import OccupancyReplay
from humanpred_ros.nodes.run_recorder import RunRecorder
from humanpred_ros.nodes.simulated_arm import SimulatedArm
from humanpred_ros.nodes.skeleton_tracker_replay import SkeletonTrackerReplay
from humanpred_ros.nodes.stomp_planner import StompPlannerNode
from humanpred_ros.occupancy.baselines import CurrentOccupancyPredictor
from humanpred_ros.recognition.training import classifier_settings, save_model, train_model
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import load_scene

STEP_NS = conversions.NS_PER_S // 30
SCENE_NAME = "face_to_face"
START_NS = 1_700_000_000 * conversions.NS_PER_S
#: Whoever plans in a thread of its own has answered after so long, if at all.
_ANSWER_S = 0.2


class Case(NamedTuple):
    """One message for one handler."""

    handler: Callable[..., Any]
    arguments: tuple[Any, ...]
    #: whether it is told people's data that nothing may be concluded from
    unusable: bool = False
    #: whether it is a good message, of the kind that is answered
    good: bool = False


class Bench:
    """What the targets share: the scene, people who move, a trained model, a recorded run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scene = load_scene(SCENE_NAME, check=False)
        self.human = HumanModel.kinect12()
        library = load_library(locate("synthetic_reaches", "bags"))
        # There and back, so that it may go on for ever.
        self.motions = [np.concatenate([m.q[::2], m.q[::-2]]) for m in library.motions[::7]]
        self.frame_id = library.frame_id
        self.library = library
        self.clouds = self._clouds()

    def model(self) -> Path:
        path = self.folder / "model.npz"
        if not path.exists():
            some = self.library.select(lambda motion: motion.index < 6)
            chosen = {name: classifier_settings(name, 0, {name: {}}) for name in ("forest", "gmm")}
            save_model(train_model(some, self.human, chosen), path)
        return path

    def _clouds(self) -> list[Any]:
        predictor = CurrentOccupancyPredictor(self.human, self.scene.grid, self.scene.T_world_human)
        return [
            conversions.occupancy_cloud(predictor.update(q, 0.0).occupancy, 0.001, 0) for q in self.motions[0][::12]
        ]

    def run(self) -> Path:
        """Return a recorded run: what `occupancy_replay` plays."""
        path = self.folder / "run"
        with BagWriter(path) as bag:
            for topic, kind in (
                (topics.OCCUPANCY, "sensor_msgs/msg/PointCloud2"),
                (topics.DECISION, "diagnostic_msgs/msg/DiagnosticArray"),
                (topics.JOINT_STATES, "sensor_msgs/msg/JointState"),
            ):
                bag.add_topic(f"/{topic}", kind)
            for k, cloud in enumerate(self.clouds):
                t_ns = START_NS + k * STEP_NS
                for topic, message in (
                    (
                        topics.JOINT_STATES,
                        conversions.joint_state(self.scene.arm.chain.joint_names, self.scene.start, t_ns),
                    ),
                    (topics.OCCUPANCY, stamped(cloud, t_ns)),
                    (topics.DECISION, decision(t_ns)),
                ):
                    bag.write(f"/{topic}", t_ns, serialize_message(message))
        return path


def stamped(message: Any, t_ns: int) -> Any:
    """Return a copy with that stamp."""
    message = deepcopy(message)
    message.header.stamp = conversions.time_message(t_ns)
    return message


def decision(t_ns: int, action: str = "keep") -> Any:
    message = DiagnosticArray(status=[DiagnosticStatus(name="decision", message=action)])
    message.header.stamp = conversions.time_message(t_ns)
    return message


class Target:
    """One node to be fuzzed: how it is made, what it is shown, and what it must not answer."""

    def __init__(self, name: str, make: Callable[[], GraphNode], **parameters: str) -> None:
        self.name, self.make, self.parameters = name, make, parameters

    def prepare(self, bench: Bench) -> dict[str, str]:
        """Return the node's parameters."""
        return self.parameters

    def open(self, node: Any, bench: Bench) -> None:
        """Listen to what the node publishes."""

    def cases(self, node: Any, bench: Bench, spoil: Mutator, spoiled: bool, now_ns: int) -> Iterator[Case]:
        """Yield the messages of one moment."""
        raise NotImplementedError

    def answered(self, node: Any) -> tuple[bool, bool]:
        """Return whether the node answered as usual, and whether it held, since the last call."""
        return False, False


class PredictorTarget(Target):
    """`occupancy_predictor` with one of the predictors."""

    def __init__(self, predictor: str) -> None:
        super().__init__(f"occupancy_predictor/{predictor}", OccupancyPredictorNode)
        self.predictor = predictor

    def prepare(self, bench: Bench) -> dict[str, str]:
        return {"scene": SCENE_NAME, "predictor": self.predictor, "model": str(bench.model())}

    def open(self, node: Any, bench: Bench) -> None:
        self.clouds: list[Any] = []
        node.occupancies.compact.publish = self.clouds.append
        node.marker_publisher.get_subscription_count = lambda: 1
        self.frame = 0

    def cases(self, node: Any, bench: Bench, spoil: Mutator, spoiled: bool, now_ns: int) -> Iterator[Case]:
        motion = bench.motions[(self.frame // 500) % len(bench.motions)]
        q = motion[self.frame % len(motion)] + 1e-4 * spoil.rng.standard_normal(motion.shape[1])
        self.frame += 1
        message = conversions.joint_state(bench.human.dof_names, q, now_ns - 10_000_000, bench.frame_id)
        body = node.people.bodies["body_0"]
        if not spoiled:
            yield Case(node.people.take, (body, message), good=True)
            return
        if spoil.rng.random() < 0.02:
            yield Case(setattr, (body, "held", bool(spoil.rng.integers(2))))
        if spoil.rng.random() < 0.02:
            texts = ["3 -0.2 -0.67 0.8", spoil.text("1 0 0 1"), f"1 {spoil.number()} {spoil.number(-0.7)} 0.8"]
            yield Case(node.set_parameters, ([Parameter("places", value=texts)],))
            yield Case(node.set_parameters, ([Parameter("places", value=[""])],))
        spoil.message(message)
        yield Case(node.people.take, (body, message), unusable=self._unusable(message, bench, now_ns))
        if spoil.rng.random() < 0.1:
            yield Case(node.publish_status, ())

    def _unusable(self, message: Any, bench: Bench, now_ns: int) -> bool:
        """Return whether nothing can follow from this posture, by rules simpler than the node's."""
        names, q = list(message.name), np.asarray(message.position)
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        known = {name: q[k] for k, name in enumerate(names) if k < len(q)}
        values = np.array([known.get(name, np.nan) for name in bench.human.dof_names])
        return bool(
            any(names.count(name) != 1 for name in bench.human.dof_names)
            or not (np.abs(values) < 20.0).all()
            or stamp_ns - now_ns > 60_000_000
            or stamp_ns <= 0
            or message.header.frame_id.lstrip("/") not in (bench.frame_id, "world")
        )

    def answered(self, node: Any) -> tuple[bool, bool]:
        unknown = [occupancy.format.startswith("unknown: ") for occupancy in self.clouds]
        usual = any(not said for said in unknown)
        self.clouds.clear()
        return usual, any(unknown)


class PlannerTarget(Target):
    """`stomp_planner`, with few iterations: what it does with messages is tested, not how well it plans."""

    def __init__(self, lossless: bool) -> None:
        super().__init__(
            f"stomp_planner/{'lossless' if lossless else 'real_time'}",
            StompPlannerNode,
            scene=SCENE_NAME,
            lossless=str(lossless).lower(),
            iterations="1",
            rollouts="2",
            waypoints="12",
            threads="1",
        )

    def open(self, node: Any, bench: Bench) -> None:
        # Its times of arrival are those of the messages, not of this process.
        now: Any = SimpleNamespace(
            monotonic=lambda: node.get_clock().now().nanoseconds * 1e-9,
            time_ns=lambda: node.get_clock().now().nanoseconds,
            perf_counter=time.perf_counter,
        )
        for module in (stomp_planner, commanding_node, guard_listener, measured_arm, seen_people):
            vars(module)["time"] = now
        self.decisions: list[Any] = []
        node.decision_publisher.publish = self.decisions.append
        node.commander.send = lambda message: None
        node.others.looking = lambda: False  # nobody else commands this arm, and seconds are many messages

    def cases(self, node: Any, bench: Bench, spoil: Mutator, spoiled: bool, now_ns: int) -> Iterator[Case]:
        at = bench.scene.start if not node.begun else node.replanner.state_at((now_ns - node.origin_ns) * 1e-9)[0]
        arm = conversions.joint_state(node.replanner.joint_names, at, now_ns)
        if spoiled and spoil.rng.random() < 0.3:
            spoil.message(arm)
        yield Case(node.on_joint_state, (arm,))
        if node.guard.heard or spoil.rng.random() < 0.01:
            percent = int(spoil.rng.integers(-200, 300)) if spoiled else 100
            yield Case(node.guard.on_factor, (Int16(data=percent),))
        t_ns = now_ns - 20_000_000
        cloud = stamped(bench.clouds[(now_ns // STEP_NS) % len(bench.clouds)], t_ns)

        def show(message: Any) -> None:
            node.on_occupancy(message)
            until_s = time.monotonic() + _ANSWER_S
            while not self.decisions and time.monotonic() < until_s:
                time.sleep(1e-4)  # a thread of the planner's answers

        if spoil.rng.random() < 0.5:
            cloud = occupancy_topics.compact_message(
                conversions.occupancy_from_cloud(cloud, bench.scene.grid, 0.0), 0.0, t_ns
            )
        if spoiled:
            spoil.message(cloud)
            yield Case(show, (cloud,), unusable=self._unusable(cloud, node, now_ns))
        else:
            yield Case(show, (cloud,), good=node.settings.lossless)
        if spoil.rng.random() < 0.02:
            yield Case(node.publish_status, ())

    def _unusable(self, cloud: Any, node: Any, now_ns: int) -> bool:
        if hasattr(cloud, "format"):
            torn = bool(cloud.data) and bytes(cloud.data[-8:-4]) != b"IEND"
        else:
            names = [field.name for field in cloud.fields]
            torn = any(names.count(name) != 1 for name in ("x", "y", "z", "probability"))
            torn = torn or len(cloud.data) != cloud.height * cloud.row_step
        return bool(
            cloud.header.frame_id.lstrip("/") != "world"
            or torn
            or (not node.settings.lossless and conversions.stamp_ns(cloud.header.stamp) - now_ns > 60_000_000)
        )

    def answered(self, node: Any) -> tuple[bool, bool]:
        told = [(message.status[0].message, len(message.status) > 1) for message in self.decisions]
        self.decisions.clear()
        # Planned is what says something of goals; it may be that none can be got to from where the arm was said to be.
        return any(action != "hold" or planned for action, planned in told), any(action == "hold" for action, _ in told)


class ArmTarget(Target):
    """`simulated_arm`: trajectories and the clock."""

    def __init__(self) -> None:
        super().__init__("simulated_arm", SimulatedArm, scene=SCENE_NAME)

    def open(self, node: Any, bench: Bench) -> None:
        self.states: list[Any] = []
        node.publisher.publish = self.states.append

    def cases(self, node: Any, bench: Bench, spoil: Mutator, spoiled: bool, now_ns: int) -> Iterator[Case]:
        tick = Clock(clock=conversions.time_message(now_ns))
        if spoiled and spoil.rng.random() < 0.2:
            spoil.message(tick)
        yield Case(node.on_clock, (tick,))
        message = _trajectory(bench, spoil.rng, now_ns)
        if spoiled:
            spoil.message(message)
        yield Case(node.on_trajectory, (message,))
        if spoil.rng.random() < 0.02:
            yield Case(node.set_parameters, ([Parameter("speed_factor", value=float(spoil.rng.random()))],))

    def answered(self, node: Any) -> tuple[bool, bool]:
        wild = [state for state in self.states if not np.isfinite([*state.position, *state.velocity]).all()]
        self.states.clear()
        if wild:
            raise ArithmeticError(f"joint states: {wild[0].position}, {wild[0].velocity}")
        return False, False


def _trajectory(bench: Bench, rng: np.random.Generator, now_ns: int) -> Any:
    """Return a quick trajectory of three points about the scene's start."""
    message = JointTrajectory(joint_names=list(bench.scene.arm.chain.joint_names))
    message.header.stamp = conversions.time_message(now_ns)
    for k in range(3):
        q = bench.scene.start + 0.1 * rng.standard_normal(len(bench.scene.start))
        zeros = [0.0] * len(q)
        message.points.append(
            JointTrajectoryPoint(
                positions=q.tolist(), velocities=zeros, accelerations=zeros,
                time_from_start=Duration(sec=0, nanosec=(k + 1) * 10**8),
            )
        )  # fmt: skip
    return message


class RecorderTarget(Target):
    """`run_recorder`: serialized bytes, whole and spoilt, on every topic."""

    def __init__(self) -> None:
        super().__init__("run_recorder", RunRecorder)

    def prepare(self, bench: Bench) -> dict[str, str]:
        return {"output": str(bench.folder / "recorded")}

    def cases(self, node: Any, bench: Bench, spoil: Mutator, spoiled: bool, now_ns: int) -> Iterator[Case]:
        # The node's own, not that of its clock.
        heard = [one for one in node.subscriptions if one.callback.__name__ == "on_message"]
        data = serialize_message(stamped(spoil.one_of(bench.clouds), now_ns))[:4096]
        times = {"received_timestamp": now_ns, "source_timestamp": now_ns}
        if spoiled:
            data = spoil.raw(data)
            times["source_timestamp"] = int(spoil.one_of((0, -1, 2**63 - 1, -(2**63), now_ns)))
        yield Case(spoil.one_of(heard).callback, (data, times))
        if spoil.rng.random() < 0.02:
            yield Case(node.writer.flush, ())


class SourceTarget(Target):
    """`skeleton_tracker_replay` or `occupancy_replay`: decisions and other nodes' diagnostics."""

    def prepare(self, bench: Bench) -> dict[str, str]:
        return {"bag": str(bench.run())} if self.make is OccupancyReplay else self.parameters

    def open(self, node: Any, bench: Bench) -> None:
        def start_again(reason: str) -> None:
            node.next_frame = node.next = 0

        node.finish = start_again  # which would end this process
        node.begun = True

    def cases(self, node: Any, bench: Bench, spoil: Mutator, spoiled: bool, now_ns: int) -> Iterator[Case]:
        if node._awaited_ns is None:
            node.publish_next()
        told = decision(node._awaited_ns or now_ns)
        if spoiled:
            spoil.message(told)
        yield Case(spoil.one_of((node._on_decision, node._on_decision, node._on_diagnostics)), (told,))
        yield Case(node._poll, ())


def targets() -> dict[str, Target]:
    """Return all targets by name."""
    predictors = ("forecast", "swept_volume", "reaching", "current", "current_accumulated", "constant_velocity")
    every = (
        *(PredictorTarget(name) for name in predictors),
        PlannerTarget(lossless=False),
        PlannerTarget(lossless=True),
        ArmTarget(),
        RecorderTarget(),
        SourceTarget("skeleton_tracker_replay", SkeletonTrackerReplay, mode="stepped"),
        SourceTarget("occupancy_replay", OccupancyReplay),
    )
    return {target.name: target for target in every}
