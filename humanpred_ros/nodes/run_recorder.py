"""Records a whole run to an MCAP bag, byte for byte as it went over the wire."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Header, String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.bags.metadata import DEFAULT_QOS, LATCHED_QOS
from humanpred_ros.bags.reader import TOPICS_RECORD
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError, UsageError
from humanpred_ros.nodes import qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.occupancy_topics import FORMS, OccupancyInput
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.settings import setting

_FLUSH_PERIOD_S = 0.5
#: How often it is looked for bodies that have appeared, s.
_LOOK_S = 0.25


class RunRecorderSettings(NodeSettings):
    """Parameters of `run_recorder`."""

    output: str = setting(
        "",
        "folder of the bag; must not exist yet; a recorder that is activated again adds _2, _3 to it",
        restart="a bag is one folder from beginning to end",
    )
    body_id: str = setting(
        "body_0", "REP-155 body id listened to from the start; bodies that appear later are recorded, too"
    )
    wait_for: str = setting(
        ",".join((topics.human_joint_states("<id>"), topics.OCCUPANCY, topics.DECISION, topics.JOINT_STATES)),
        "comma-separated topics that must have a publisher before the recorder calls itself ready",
    )
    run_info: str = setting("{}", "JSON object of facts about the run, stored in the bag as metadata")
    markers: bool = setting(False, "record the markers too; their publishers are silent otherwise, which saves time")
    stay: bool = setting(
        True, "when nothing can be written any more: stay, and say so on /diagnostics; false: end with status 2"
    )


class RunRecorder(GraphNode):
    """Subscribes to the graph's topics as serialized bytes and writes them as they come.

    log_time is the wall time of receipt, publish_time the sender's, so latencies between nodes can be
    read off the bag. What has come is with the operating system half a second later: a recorder that is killed loses
    no more than that. When the disk refuses (full, removed), the bag ends with what it took, and the node says at once
    that nothing is recorded any more, on the terminal and, with level ERROR, on /diagnostics.
    """

    def __init__(self) -> None:
        super().__init__("run_recorder")

    def configure(self) -> None:
        self.settings = settings = declare(self, RunRecorderSettings)
        if not settings.output:
            raise UsageError("parameter output: wanted the folder of the new bag, got nothing")
        try:
            info = json.loads(settings.run_info)
        except json.JSONDecodeError as error:
            raise UsageError(f"parameter run_info: wanted a JSON object; {error}") from error
        if not isinstance(info, dict):
            raise UsageError(f"parameter run_info: wanted a JSON object, got {settings.run_info}")
        self.run_info = {key: str(value) for key, value in info.items()}
        body = settings.body_id
        self.recorded: list[tuple[str, Any, Any]] = [
            *self._of_body(body),
            (topics.VOXEL_GRID, String, qos.LATCHED),
            (topics.HUMAN_GOALS, PointCloud2, qos.LOSSLESS),
            (topics.POSTERIOR, JointState, qos.LOSSLESS),
            (topics.DECISION, DiagnosticArray, qos.LOSSLESS),
            (topics.COSTS, JointState, qos.LOSSLESS),
            (topics.TRAJECTORY, JointTrajectory, qos.LOSSLESS),
            (topics.JOINT_STATES, JointState, qos.LOSSLESS),
            (topics.OBSTACLES, MarkerArray, qos.LOSSLESS),
            (topics.SCENE_MARKERS, MarkerArray, qos.LATCHED),
            (topics.DIAGNOSTICS, DiagnosticArray, qos.LOSSLESS),
            (topics.CLOCK, Clock, qos.LOSSLESS),
        ]
        if settings.markers:
            self.recorded += [
                (topics.OCCUPANCY_MARKERS, MarkerArray, qos.LOSSLESS),
                (topics.FUTURES, MarkerArray, qos.LOSSLESS),
                (topics.CANDIDATES, MarkerArray, qos.LOSSLESS),
                (topics.ROLLOUTS, MarkerArray, qos.LOSSLESS),
            ]
        full = {topic: self.resolve_topic_name(topic) for topic in (*FORMS, *(topic for topic, _, _ in self.recorded))}
        words = [word.strip() for word in settings.wait_for.replace("<id>", body).split(",") if word.strip()]
        self.wanted = [full.get(word, word) for word in words]
        unknown = [word for word, topic in zip(words, self.wanted, strict=True) if topic not in full.values()]
        if unknown:
            raise UsageError(
                f"parameter wait_for: wanted recorded topics ({', '.join(full.values())}), got {', '.join(unknown)}"
            )
        self.full_names = full

    def _of_body(self, body: str) -> list[tuple[str, Any, Any]]:
        """Return what is recorded of a body."""
        recorded = [
            (topics.human_joint_states(body), JointState, qos.LOSSLESS),
            (topics.human_urdf(body), String, qos.LATCHED),
            (topics.human_goals(body), PointCloud2, qos.LOSSLESS),
            (topics.human_left(body), Header, qos.LOSSLESS),
        ]
        if self.settings.markers:
            recorded.append((topics.human_markers(body), MarkerArray, qos.LOSSLESS))
        return recorded

    def look_for_bodies(self) -> None:
        """Record the bodies that have appeared, too."""
        own = self.resolve_topic_name(topics.human_joint_states("ANY")).split("ANY")
        for topic, kinds in self.get_topic_names_and_types():
            if not (topic.startswith(own[0]) and topic.endswith(own[1]) and "sensor_msgs/msg/JointState" in kinds):
                continue
            body = topic.removeprefix(own[0]).removesuffix(own[1])
            if topic not in self.inputs and "/" not in body and self.failure is None:
                self._record(self._of_body(body))
                self.writer.add_metadata(TOPICS_RECORD, self.full_names)

    def _record(self, recorded: list[tuple[str, Any, Any]]) -> None:
        for topic, kind, profile in recorded:
            self.full_names[topic] = self.resolve_topic_name(topic)
            self._add(topic, kind, profile)
            self.listen(kind, topic, partial(self._write, topic), profile, raw=True)

    def activate(self) -> None:
        # One that is activated again begins another bag, beside the first one.
        self.output = output = self.settings.output + (f"_{self.activations + 1}" if self.activations else "")
        self.hardware_id = str(Path(output).resolve())
        self.writer = BagWriter(output)
        self.writer.add_metadata("run", self.run_info)
        self.writer.add_metadata(TOPICS_RECORD, self.full_names)
        self._record(self.recorded)
        for topic, kind in FORMS.items():
            self._add(topic, kind, qos.LOSSLESS)
        self.occupancies = OccupancyInput(self, self._write, qos.LOSSLESS, raw=True)
        flush = partial(self._unless_refused, self.writer.flush)
        self.create_timer(_FLUSH_PERIOD_S, flush, clock=self._status_timer.clock)
        self.create_timer(_LOOK_S, self.look_for_bodies, clock=self._status_timer.clock)
        self.look_for_bodies()

    def _add(self, topic: str, kind: Any, profile: Any) -> None:
        name = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"
        self.writer.add_topic(self.full_names[topic], name, qos=LATCHED_QOS if profile is qos.LATCHED else DEFAULT_QOS)

    def _write(self, topic: str, data: bytes, info: Any) -> None:
        # The sender's time is whatever it says.
        times = info["received_timestamp"], max(info["source_timestamp"], 0)
        self._unless_refused(self.writer.write, self.full_names[topic], times[0], bytes(data), times[1])

    def _unless_refused(self, write: Callable[..., None], *arguments: Any) -> None:
        """Write something; after a refusal by the disk nothing is written any more."""
        if self.failure is not None:
            return
        try:
            write(*arguments)
        except BagError as error:
            if not self.settings.stay:
                self.stop_with(error)
                return
            self.failure = error  # which makes the status 2 when the node is ended
            self.get_logger().error(self.fault())

    def fault(self) -> str:
        return "" if self.failure is None else f"not recording: {self.failure}"

    def working(self) -> str:
        return "recording" if any(heard.came_s for heard in self.inputs.values()) else super().working()

    def waiting_for(self) -> str:
        forms = {self.full_names[topic] for topic in FORMS}
        missing = [
            topic
            for topic in self.wanted
            if not (self.occupancies if topic in forms else self.inputs[topic]).publishers()
        ]
        return f"a publisher of {', '.join(missing)}" if missing else ""

    def deactivate(self) -> None:
        """Finish the bag: without this it would have to be salvaged."""
        if self.failure is None:
            self.writer.close()
            self.get_logger().info(f"bag written: {self.output}")


main = entry_point(RunRecorder)

if __name__ == "__main__":
    main()
