"""Turns the observed postures of a person into the space the person is going to occupy."""

from __future__ import annotations

import sys

import numpy as np
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from humanpred_ros.errors import HumanPredError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.nodes import conversions, qos, topics
from humanpred_ros.nodes.base import GraphNode, run_node
from humanpred_ros.nodes.markers import occupancy_markers
from humanpred_ros.nodes.parameters import declare
from humanpred_ros.nodes.settings import OccupancyPredictorSettings
from humanpred_ros.occupancy.factory import check_predictor, make_predictor, needs_model
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.recognition.model_file import load_model
from humanpred_ros.recognition.registry import make_classifier
from humanpred_ros.recognition.training import TrainedModel, train_model
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import load_scene

_MARKER_PERIOD_NS = 200_000_000


class OccupancyPredictorNode(GraphNode):
    """One occupancy, and one class posterior, per posture received.

    A posture that cannot be used is refused with a counted reason on /diagnostics; the planner sees no
    new occupancy then and holds when the last one gets old. A jump back in time or a long silence starts
    a new motion.
    """

    def __init__(self) -> None:
        super().__init__("occupancy_predictor")
        self.settings = settings = declare(self, OccupancyPredictorSettings)
        scene = load_scene(settings.scene)
        self.human = HumanModel.kinect12()
        learned = needs_model(settings.predictor)
        online = {}
        if settings.classifier == "gmm":
            online = {"evidence": settings.evidence, "window_frames": settings.window_frames or None}
        # Named wrongly, these should not cost a training first.
        make_classifier(settings.classifier, GmmConfig(**online) if online else None)
        check_predictor(settings.predictor, settings.classifier)
        model = self._model() if learned else None
        self.predictor = make_predictor(
            settings.predictor,
            model,
            self.human,
            scene.grid,
            scene.T_world_human,
            classifier=settings.classifier,
            onsets=settings.detect_onsets,
            **online,
        )
        self.T_world_human = scene.T_world_human
        self.goals_m = None if model is None else model.goals_m
        self.origin_ns = 0
        self.last_ns: int | None = None
        self.last_marker_ns = 0

        self.publisher = self.create_publisher(PointCloud2, topics.OCCUPANCY, qos.SENSOR_PUBLISHER)
        self.goal_publisher = self.create_publisher(PointCloud2, topics.HUMAN_GOALS, qos.SENSOR_PUBLISHER)
        self.marker_publisher = self.create_publisher(MarkerArray, topics.OCCUPANCY_MARKERS, qos.MARKERS)
        self.grid_publisher = self.create_publisher(String, topics.VOXEL_GRID, qos.LATCHED)
        self.grid_publisher.publish(String(data=conversions.grid_description(scene.grid)))
        self.create_subscription(
            JointState,
            topics.human_joint_states(settings.body_id),
            self.on_posture,
            qos.sensor_subscription(settings.lossless),
        )

    def _model(self) -> TrainedModel:
        if self.settings.model:
            return load_model(self.settings.model, self.human)
        self.get_logger().info(f"no model given: training on {self.settings.library}")
        return train_model(load_library(locate(self.settings.library, "bags")), self.human, GmmConfig())

    def waiting_for(self) -> str:
        return self.unmatched(self.publisher, self.settings.listener)

    def on_posture(self, message: JointState) -> None:
        """Predict from one posture and publish; refuse it with a named reason if it cannot be used."""
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        gap_ns = self.settings.restart_gap_s * 1e9
        if self.last_ns is not None and -gap_ns < stamp_ns - self.last_ns <= 0:
            self.refuse(f"stamp not increasing: posture at {stamp_ns} ns after one at {self.last_ns} ns")
            return
        try:
            q = conversions.ordered_positions(message, self.human.dof_names)
            if self.last_ns is None or abs(stamp_ns - self.last_ns) > gap_ns:
                self.predictor.start()
                self.origin_ns = stamp_ns
            self.last_ns = stamp_ns
            prediction = self.predictor.update(q, (stamp_ns - self.origin_ns) * 1e-9)
        except HumanPredError as error:
            self.refuse(str(error))
            return
        self.publisher.publish(conversions.occupancy_cloud(prediction.occupancy, self.settings.threshold, stamp_ns))
        if prediction.posterior is not None and self.goals_m is not None:
            # The library's goals, as seen from where this person stands.
            T = self.T_world_human
            if prediction.T_library_tracker is not None:
                T = T @ np.linalg.inv(prediction.T_library_tracker)
            goals_m = self.goals_m @ T[:3, :3].T + T[:3, 3]
            posterior = prediction.posterior
            self.goal_publisher.publish(
                conversions.goals_cloud(goals_m, posterior.labels, posterior.probability, stamp_ns)
            )
        if self.marker_publisher.get_subscription_count() and abs(stamp_ns - self.last_marker_ns) >= _MARKER_PERIOD_NS:
            self.last_marker_ns = stamp_ns
            self.marker_publisher.publish(occupancy_markers(prediction.occupancy, conversions.time_message(stamp_ns)))


def main() -> None:
    """Console entry point."""
    sys.exit(run_node(OccupancyPredictorNode))


if __name__ == "__main__":
    main()
