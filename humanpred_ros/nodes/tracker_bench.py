"""How long a body tracker's points take to become a posture: in a program, and through `skeleton_tracker` over DDS."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Point
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from rich.console import Console
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.framework import Begin, Column, OutputSettings, Report, Table, present
from humanpred_ros.evaluation.processes import NodeGroup, free_domain_id
from humanpred_ros.evaluation.timing import MachineLoad, Spread
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.skeleton_tracker import SkeletonTracker
from humanpred_ros.human.skeletons import load_skeleton, person_points
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.resources import locate, share_file
from humanpred_ros.settings import setting

_RATE_HZ = 30.0
#: Frames that do not count: what is compiled at its first use.
_SETTLING = 30
_READY_S, _LAST_S = 180.0, 2.0


class TrackerBenchSettings(OutputSettings):
    """Settings of `humanpred bench tracker`."""

    library: str = setting("synthetic_reaches", "library whose people are shown")
    seconds: float = setting(20.0, "length of the run of the node, 30 frames a second", unit="s", low=5.0, high=600.0)


def run(settings: TrackerBenchSettings, console: Console) -> int:
    """Measure how long points take to become a posture."""
    present(settings, console, measure)
    return 0


def measure(settings: TrackerBenchSettings, begin: Begin) -> Report:
    """Measure every shipped skeleton in this process, and an Azure Kinect's through the node."""
    load = MachineLoad()
    library, human = load_library(locate(settings.library, "bags")), HumanModel.kinect12()
    q = np.concatenate([motion.q for motion in library.of_class(library.labels[0])[:3]])
    points = person_points(human, q)
    names = sorted(path.stem for path in share_file("config", "skeletons").glob("*.yaml"))
    advance = begin("skeletons", len(names) + 1)
    rows: list[tuple[str, Spread]] = []
    for k, name in enumerate(names, start=1):
        rows.append((f"SkeletonTracker, {name}", Spread.of(_update_ms(name, points)[_SETTLING:])))
        advance(k)
    with tempfile.TemporaryDirectory() as folder:
        node = Spread.of(_node_ms(points, round(settings.seconds * _RATE_HZ), Path(folder))[_SETTLING:])
    advance(len(names) + 1)
    rows.append(("skeleton_tracker over DDS, azure_kinect", node))
    table = Table(
        "Milliseconds from points to posture",
        rows,
        (
            Column("", lambda row: row[0]),
            Column("median", lambda row: row[1].median, ".2f", "ms"),
            Column("99 %", lambda row: row[1].p99, ".2f", "ms"),
            Column("frames", lambda row: row[1].n),
        ),
        "Over DDS: from the publication of the markers to that of the posture.",
    )
    return Report("body tracker", (table,), {"points_to_posture_ms": dict(rows)}, load.notes())


def _update_ms(name: str, points: FloatArray) -> list[float]:
    tracker = SkeletonTracker(name, np.eye(4))
    durations = []
    for k, frame in enumerate(tracker.skeleton.shown(points)):
        before = time.perf_counter()
        tracker.update(frame, k / _RATE_HZ)
        durations.append(1e3 * (time.perf_counter() - before))
    return durations


def _node_ms(points: FloatArray, n: int, folder: Path) -> list[float]:
    """Return the delays of the postures of `n` frames.

    Raises:
        UsageError: a node that ends, or does not answer.
    """
    skeleton = load_skeleton("azure_kinect")
    shown = skeleton.shown(points)
    there_and_back = np.concatenate([shown, shown[::-1]])
    sent_ns: dict[int, int] = {}
    delays_ms: list[float] = []

    def on_posture(message: JointState, info: dict[str, Any]) -> None:
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        if stamp_ns in sent_ns:
            delays_ms.append((info["source_timestamp"] - sent_ns[stamp_ns]) * 1e-6)

    with NodeGroup(folder, free_domain_id()) as group:
        node = group.start("skeleton_tracker", {"topic": "points"})
        before = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE")
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=group.domain_id)
        try:
            client = rclpy.create_node("tracker_bench", context=context)
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(client)
            camera = client.create_publisher(MarkerArray, "points", qos.SENSOR_PUBLISHER)
            # rclpy's annotation leaves out that a callback may take the times of a message, too.
            answered: Any = on_posture
            client.create_subscription(JointState, topics.human_joint_states("body_0"), answered, qos.LOSSLESS)
            until_s = time.monotonic() + _READY_S
            while not camera.get_subscription_count():
                group.check()
                if not node.running or time.monotonic() > until_s:
                    raise UsageError(f"skeleton_tracker did not become ready: {node.tail()}")
                executor.spin_once(timeout_sec=0.05)
            start_s = time.monotonic()
            for k in range(n):
                due_s = start_s + k / _RATE_HZ
                while (left_s := due_s - time.monotonic()) > 0.0:
                    executor.spin_once(timeout_sec=left_s)
                message, stamp_ns = _markers(there_and_back[k % len(there_and_back)], skeleton.frame, client)
                data = serialize_message(message)  # a driver's work, not the node's
                sent_ns[stamp_ns] = time.time_ns()
                camera.publish(data)
            until_s = time.monotonic() + _LAST_S
            while len(delays_ms) < n and time.monotonic() < until_s:
                executor.spin_once(timeout_sec=0.05)
        finally:
            rclpy.try_shutdown(context=context)
            if before is None:
                del os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"]
            else:
                os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = before
    if not delays_ms:
        raise UsageError(f"skeleton_tracker answered none of {n} frames: {node.tail()}")
    return delays_ms


def _markers(points: FloatArray, frame_id: str, client: Any) -> tuple[MarkerArray, int]:
    """Return the markers of a body as an Azure Kinect's driver sends them, and their stamp."""
    stamp_ns = int(client.get_clock().now().nanoseconds)
    stamp, array = conversions.time_message(stamp_ns), MarkerArray()
    for k, (x, y, z) in enumerate(points.tolist()):
        if x == x:
            marker = Marker(type=Marker.SPHERE, action=Marker.ADD, id=100 + k)
            marker.header.frame_id, marker.header.stamp = frame_id, stamp
            marker.pose.position = Point(x=x, y=y, z=z)
            array.markers.append(marker)
    return array, stamp_ns
