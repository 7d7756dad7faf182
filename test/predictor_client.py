"""An occupancy_predictor in a process of its own, and a node of the test's that plays its planner over DDS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_client import NodeClient
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from humanpred_ros import topics
from humanpred_ros.bags.messages import point_cloud2_fields
from humanpred_ros.evaluation.processes import NodeProcess, ParameterValue
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.reaching.places import Places
from humanpred_ros.robot.scene import load_scene

SCENE = load_scene("four_places")
_DECISION_PERIOD_S = 0.02


class PredictorClient(NodeClient):
    """Use as a context manager: the processes and everything of ROS end with it.

    A replay is stepped: the next posture comes after this node's decision on the last one's occupancy, so that nothing
    depends on how fast the machine is.

    Attributes:
        posteriors: by stamp, the probability of each label and the places (G, 3) in the world, in the same order.
        occupancies: by stamp, as they came.
        stop_after: the replay stands still once so many occupancies came, until `go_on`.
    """

    def __init__(self, folder: Path, parameters: Mapping[str, ParameterValue], stop_after: int = 10**9) -> None:
        tested = "occupancy_predictor"
        usual: dict[str, ParameterValue] = {
            "scene": SCENE.name,
            "predictor": "reaching",
            "lossless": True,
            "listener": f"{tested}_client",
        }
        super().__init__(folder, tested, {**usual, **parameters})
        self.posteriors: dict[int, tuple[dict[int, float], NDArray[np.float64]]] = {}
        self.occupancies: dict[int, PointCloud2] = {}
        self.stop_after = stop_after
        self._decided_ns: int | None = None

    def connect(self, node: Node) -> tuple[Publisher, ...]:
        node.create_subscription(PointCloud2, topics.HUMAN_GOALS, self._on_goals, qos.LOSSLESS)
        node.create_subscription(PointCloud2, topics.OCCUPANCY, self._on_occupancy, qos.LOSSLESS)
        self._decisions = node.create_publisher(DiagnosticArray, topics.DECISION, qos.COMMAND)
        node.create_timer(_DECISION_PERIOD_S, self._send_decision)
        return ()

    def connected(self, node: Node) -> bool:
        return self.diagnostics[0] == "ready"

    def replay(self, library: Path, trajectory: str) -> NodeProcess:
        """Let a skeleton_tracker_replay play one motion."""
        return self.group.start(
            "skeleton_tracker_replay",
            {
                "library": str(library),
                "trajectory": trajectory,
                "mode": "stepped",
                "hold_last_s": 0.1,
                "wait_for": "occupancy_predictor",
                "listener": "occupancy_predictor",
            },
        )

    def wait_for_end(self, tracker: NodeProcess) -> None:
        """Return when the tracker has shown everything and every occupancy has its posterior."""
        self.wait(lambda: not tracker.running, "the replay to end", timeout_s=120.0)
        self.group.check()
        self.wait(lambda: self.posteriors.keys() == self.occupancies.keys(), "the last posterior")

    def go_on(self, stop_after: int = 10**9) -> None:
        """Let the replay that stands still go on, to its end or until so many occupancies came."""
        self.stop_after = stop_after
        self._decide(max(self.occupancies))

    def set_places(self, places: Places) -> None:
        """Set the parameter to these places of the tracker's frame."""
        done, reason = self.set_parameter("places", goal_texts(places))
        assert done, reason

    def probability(self, label: str) -> NDArray[np.float64]:
        """Return the probability of a place after each posture; NaN where it was not among the places."""
        return np.array([self.posteriors[stamp][0].get(label, np.nan) for stamp in sorted(self.posteriors)])

    def _on_goals(self, message: PointCloud2) -> None:
        fields = point_cloud2_fields(message)
        labels = [label.decode() for label in fields["label"].tolist()]
        places = np.stack([fields[axis].astype(np.float64) for axis in "xyz"], axis=1)
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        self.posteriors[stamp_ns] = (dict(zip(labels, fields["probability"].tolist(), strict=True)), places)

    def _on_occupancy(self, message: PointCloud2) -> None:
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        self.occupancies[stamp_ns] = message
        if len(self.occupancies) < self.stop_after:
            self._decide(stamp_ns)

    def _decide(self, stamp_ns: int) -> None:
        self._decided_ns = stamp_ns
        self._send_decision()

    def _send_decision(self) -> None:
        """Send the decision there is, once somebody hears it: the first occupancy may come before the replay does."""
        stamp_ns = self._decided_ns
        if stamp_ns is None or not self._decisions.get_subscription_count():
            return
        self._decided_ns = None
        decision = DiagnosticArray(status=[DiagnosticStatus(name="decision", message="keep")])
        decision.header.stamp = conversions.time_message(stamp_ns)
        self._decisions.publish(decision)


def goal_texts(goals: Places) -> list[str]:
    """Return places of the tracker's frame as the parameter wants them."""
    places = goals.moved(SCENE.T_world_human).places_m.tolist()
    return [f"{label} {x!r} {y!r} {z!r}" for label, (x, y, z) in zip(goals.labels, places, strict=True)]
