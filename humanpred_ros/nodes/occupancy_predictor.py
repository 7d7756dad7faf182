"""Turns the observed postures of a person into the space the person is going to occupy."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Bool, String
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import ArrayError, HumanPredError, UsageError
from humanpred_ros.geometry import compiled
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import TRACKER_FRAMES, human_named
from humanpred_ros.human.plausible import PlausibilityCheck, PlausibilitySettings
from humanpred_ros.human.stamps import StampCheck, StampSettings
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import placed_postures
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.frames import TrackerFrames, tf_lookup
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.markers import future_markers, occupancy_markers
from humanpred_ros.nodes.occupancy_topics import OccupancyPublisher
from humanpred_ros.nodes.parameters import declare, declare_plugin, plugin_parameters
from humanpred_ros.occupancy.predictor import (
    Prediction,
    Predictor,
    PredictorRequest,
    check_predictor,
    make_predictor,
    needed_classifiers,
    predictor_type,
    warm_up,
)
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR, settings_of
from humanpred_ros.reaching.places import places_from_text, places_in_world
from humanpred_ros.recognition.training import TrainedModel, classifier_settings, load_model, train_model
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.settings import Settings, setting

if TYPE_CHECKING:
    from humanpred_ros.reaching.reaching_predictor import ReachingPredictor, ReachingSettings

_MARKER_PERIOD_NS = 200_000_000
#: How often it is looked at whether the person can get to the goals; people walk, but not far in that time.
_REACH_PERIOD_NS = 1_000_000_000


class OccupancyPredictorSettings(PlausibilitySettings, StampSettings, NodeSettings):
    """Parameters of `occupancy_predictor`."""

    scene: str = setting(
        "face_to_face",
        "scene name in config/scenes, or a YAML file",
        restart="the lattice of voxels is the scene's",
    )
    model: str = setting(
        "", "model file made by `humanpred train`; empty: train on `library` at start", restart="a model is loaded once"
    )
    library: str = setting(
        "synthetic_reaches", "library trained on when no model is given", restart="the model was trained on it"
    )
    classifier: str = setting(
        DEFAULT_CLASSIFIER,
        "how a partial motion is recognised: forest, gmm (P1), or an installed package's",
        restart="the model was trained for it",
    )
    predictor: str = setting(
        DEFAULT_PREDICTOR,
        "forecast, swept_volume (P1), reaching (P2), a baseline (current, current_accumulated, constant_velocity), or "
        "an installed package's",
        restart="the model was trained, and code compiled, for it",
    )
    human: str = setting(
        "kinect12",
        "whose postures come: kinect12 (P1, 12 DoFs) or mocap23 (P2, 23 DoFs)",
        restart="the model was trained for it",
    )
    human_frame: str = setting(
        "", "frame the postures must be in; empty: the scene's, else the library's; with TF, others are moved there"
    )
    places: tuple[str, ...] = setting(
        ("",),
        "reaching only: where the hand may go, each 'label x y z' (world frame, m); [''] asks scene, then library",
        changeable=True,
    )
    detect_onsets: bool = setting(True, "find where motions begin and end; false: the first posture begins one")
    body_id: str = setting("body_0", "REP-155 body id listened to")
    threshold: float = setting(0.001, "voxels with a higher probability are published", low=0.0, high=1.0)
    listener: str = setting("", "node that must be listening to the occupancy before this one is ready")
    copies: int = setting(
        1, "the compact form of each occupancy is sent so often: 2 or 3 over links that lose", low=1, high=5
    )
    lossless: bool = setting(False, "subscribe reliably and keep every posture (stepped runs)")


class OccupancyPredictorNode(GraphNode):
    """One occupancy, and one class posterior, per posture received.

    A posture that cannot be used, or that no person can have, is refused with a counted reason on /diagnostics; what is
    published then says that nobody knows where people are, and why, so that the planner holds at once. Only a posture
    that was overtaken on its way is refused silently. A long silence, or postures that were refused for how they look,
    start a new motion.

    With the predictor `reaching`, the places where the hand may go can be changed while the node runs
    (parameter `places`); those that the person cannot get to are warned about on /diagnostics.
    """

    def __init__(self) -> None:
        super().__init__("occupancy_predictor")

    def configure(self) -> None:
        self.settings = settings = declare(self, OccupancyPredictorSettings)
        self.scene = scene = load_scene(settings.scene)
        self.human = human_named(settings.human)
        self.T_world_human = scene.T_world_human
        # Named wrongly, these should not cost a training first.
        check_predictor(settings.predictor, settings.classifier)
        given = plugin_parameters(self, (settings.predictor, settings.classifier))
        classifier_settings(settings.classifier, 0, given)
        own = settings_of(settings.predictor, predictor_type(settings.predictor).settings_type, given)
        told = self._told(list(settings.places))
        self.goals_m: FloatArray | None = None
        scene_places = places_in_world({place.label: place.place_m for place in scene.places}, scene.T_world_human)
        self.scene_places = None if scene_places is None else scene_places.by_label
        self.reaching: ReachingPredictor | None = None
        #: Frame of what was learned from, empty where nothing was.
        self.library_frame = ""
        with compiled.announced("occupancy predictor", self.get_logger().info):
            if settings.predictor == "reaching":
                self.reaching = self._reaching(scene, told, cast("ReachingSettings", own))
            self.predictor = self.reaching or self._trained(scene, own, given[settings.classifier])
        declare_plugin(self, settings.predictor, own)

    def activate(self) -> None:
        scene, settings = self.scene, self.settings
        self.plausibility = PlausibilityCheck(
            self.human, scene.grid, scene.T_world_human, settings.part(PlausibilitySettings)
        )
        frame = settings.human_frame or scene.human_frame or self.library_frame or TRACKER_FRAMES[settings.human]
        self.frames = TrackerFrames(frame.lstrip("/"), scene.T_world_human, tf_lookup(self))
        self.stamps = StampCheck(settings.part(StampSettings), settings.lossless)
        # When postures come, on a clock that nobody sets.
        self.steady_s: Callable[[], float] = time.monotonic
        self.held = self.doubted = False
        #: Why nobody knows where people are; empty while that is known.
        self.unknown = ""
        self.first_ns = self.origin_ns = 0
        self.looked_ns: int | None = None
        self.last_marker_ns = 0
        self.place_warnings: dict[str, str] = {}

        self.occupancies = OccupancyPublisher(self, 1 if settings.lossless else settings.copies)
        self.goal_publisher = self.create_publisher(PointCloud2, topics.HUMAN_GOALS, qos.SENSOR_PUBLISHER)
        self.posterior_publisher = self.create_publisher(JointState, topics.POSTERIOR, qos.SENSOR_PUBLISHER)
        self.marker_publisher = self.create_publisher(MarkerArray, topics.OCCUPANCY_MARKERS, qos.MARKERS)
        self.future_publisher = self.create_publisher(MarkerArray, topics.FUTURES, qos.MARKERS)
        self.grid_publisher = self.create_publisher(String, topics.VOXEL_GRID, qos.LATCHED)
        self.grid_publisher.publish(String(data=conversions.grid_description(scene.grid)))
        postures = topics.human_joint_states(settings.body_id)
        self.hardware_id = self.resolve_topic_name(postures).rpartition("/")[0]
        self.listen(Bool, topics.human_held(settings.body_id), self.on_held, qos.LATCHED)
        # One that plans may be slower than its sensor: old postures that queue up would make it ever later.
        profile = qos.sensor_subscription(settings.lossless, newest_only=settings.predictor == "reaching")
        max_age_s = math.inf if settings.lossless else settings.restart_gap_s
        self.listen(JointState, postures, self.on_posture, profile, max_age_s=max_age_s)

    def on_held(self, message: Bool) -> None:
        """Remember whether the tracker repeats its last posture on purpose."""
        self.held = message.data

    def _trained(self, scene: Scene, own: Settings, classifier: dict[str, Any]) -> Predictor:
        """Return one of the predictors that know classes, or nothing, with its settings and the classifier's."""
        settings = self.settings
        model = self._model(classifier) if predictor_type(settings.predictor).needs_model else None
        self.goals_m = None if model is None else np.array(list(model.places.values()))
        self.library_frame = "" if model is None else model.library.frame_id
        request = PredictorRequest(
            self.human,
            scene.grid,
            scene.T_world_human,
            model,
            settings.classifier,
            classifier,
            settings.detect_onsets,
            own,
        )
        if model is not None and settings.classifier in model.classifiers:
            used = model.classifier(settings.classifier, **classifier)
            declare_plugin(self, settings.classifier, used.settings)
        # Not the one that is used: what it takes a standing person to look like outlives a motion.
        spare = make_predictor(settings.predictor, request)
        warm_up(spare, self.human, None if model is None else model.library.motions[0])
        return make_predictor(settings.predictor, request)

    def _model(self, classifier: dict[str, Any]) -> TrainedModel:
        if self.settings.model:
            return load_model(self.settings.model, self.human)
        self.get_logger().info(f"no model given: training on {self.settings.library}")
        needed = needed_classifiers(self.settings.predictor, self.settings.classifier)
        given = {self.settings.classifier: classifier}
        chosen = {name: classifier_settings(name, 0, given) for name in needed}
        return train_model(load_library(locate(self.settings.library, "bags")), self.human, chosen)

    def _reaching(
        self, scene: Scene, told: Mapping[str, FloatArray] | None, own: ReachingSettings
    ) -> ReachingPredictor:
        """Return the predictor that knows places; a library without classes is enough for it, given places."""
        # These take half a second to import.
        from humanpred_ros.reaching.reaching_predictor import ReachingPredictor, ReachKnowledge
        from humanpred_ros.reaching.weights import reach_weights

        settings = self.settings
        reach_weights(own.weights)  # named wrongly, they should not cost the learning first
        if settings.model:
            model = load_model(settings.model, self.human)
            self.library_frame = model.library.frame_id
            knowledge = ReachKnowledge.of_model(model, self.human)
        else:
            self.get_logger().info(f"no model given: learning how people reach from {settings.library}")
            library = load_library(locate(settings.library, "bags"))
            if "recordings" in library.provenance:
                self.get_logger().info(f"motions: {library.provenance['recordings']}")
            self.library_frame = library.frame_id
            knowledge = ReachKnowledge.of_library(library, self.human)
        predictor = ReachingPredictor(
            knowledge,
            scene.grid,
            scene.T_world_human,
            told or self.scene_places,
            onsets=settings.detect_onsets,
            obstacles=scene.obstacles,
            settings=own,
        )
        for note in predictor.notes:
            self.get_logger().warning(note)
        return predictor

    def _told(self, entries: list[str]) -> Mapping[str, FloatArray] | None:
        """Return the places in the parameter `places` (UsageError if it cannot be used)."""
        told = places_from_text(entries, self.T_world_human)
        if told is not None and self.settings.predictor != "reaching":
            raise UsageError(
                f"parameter places: wanted the predictor reaching, got {self.settings.predictor}, which knows "
                "only what its library shows; set predictor to reaching"
            )
        return None if told is None else told.by_label

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take other places at run time."""
        try:
            told = [self._told(parameter.value or []) for parameter in parameters if parameter.name == "places"]
            if told and self.reaching is not None:
                self.reaching.set_places(told[-1] or self.scene_places)
                self.looked_ns = None
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def waiting_for(self) -> str:
        return self.unmatched(self.settings.listener, self.occupancies.compact, self.occupancies.cloud)

    def working(self) -> str:
        return "predicting" if self.first_ns else super().working()

    def holding_because(self) -> str:
        return self.unknown

    def on_posture(self, message: JointState) -> None:
        """Predict from one posture and publish; refuse it with a named reason if it cannot be used."""
        stamp_ns = conversions.stamp_ns(message.header.stamp)
        now_ns = self.get_clock().now().nanoseconds
        verdict = self.stamps.judge(stamp_ns, now_ns, self.steady_s())
        if verdict.refusal:
            self.refuse(verdict.refusal)
            if verdict.tell:
                self._say_unknown(verdict.refusal, now_ns)
            return
        if verdict.begins:
            self.plausibility.start()
            self.first_ns, self.doubted = stamp_ns, True
        try:
            q = self._believed(message, (stamp_ns - self.first_ns) * 1e-9)
            if self.doubted:
                self.predictor.start()
                self.origin_ns, self.doubted = stamp_ns, False
            prediction = self.predictor.update(q, (stamp_ns - self.origin_ns) * 1e-9)
        except HumanPredError as error:
            self.doubted = True
            self.refuse(str(error))
            self._say_unknown(str(error), stamp_ns)
            return
        self.unknown = ""
        self.occupancies.publish(prediction.occupancy, self.settings.threshold, stamp_ns)
        self._publish_places(prediction, stamp_ns)
        self._look_for_warnings(q, stamp_ns)
        if abs(stamp_ns - self.last_marker_ns) >= _MARKER_PERIOD_NS:
            self.last_marker_ns = stamp_ns
            self._draw(prediction, q, conversions.time_message(stamp_ns))

    def _draw(self, prediction: Prediction, q: FloatArray, stamp: Time) -> None:
        """Publish markers that somebody looks at."""
        if self.marker_publisher.get_subscription_count():
            self.marker_publisher.publish(occupancy_markers(prediction.occupancy, stamp))
        futures = getattr(self.predictor, "futures", None)
        if futures is not None and self.future_publisher.get_subscription_count():
            T = self.T_world_human
            ways = [(p, way_m @ T[:3, :3].T + T[:3, 3]) for p, way_m in futures(q)]
            self.future_publisher.publish(future_markers(ways, stamp))

    def _say_unknown(self, reason: str, stamp_ns: int) -> None:
        """Tell whoever plans that nobody knows where people are, and why."""
        self.unknown = reason
        self.occupancies.publish_unknown(reason, stamp_ns)

    def _believed(self, message: JointState, t_s: float) -> FloatArray:
        """Return the posture (D,) of a message in the tracker's frame of the scene.

        Raises:
            HumanPredError: one that cannot be read, is in a frame that is not known, or is not to be believed.
        """
        try:
            q = conversions.ordered_positions(message, self.human.dof_names)
            T = self.frames.placement(message.header.frame_id)
        except ArrayError as error:
            self.plausibility.unread(t_s, str(error).split(":", 1)[0])
            raise
        if T is not None:
            q = placed_postures(q, self.human.dof_names, T)
        doubt = self.plausibility.refusal(q, t_s, self.held)
        if doubt is not None:
            raise ArrayError(str(doubt))
        return q

    def _publish_places(self, prediction: Prediction, stamp_ns: int) -> None:
        """Publish where the hand may go, and how probable each place is."""
        posterior, T = prediction.posterior, self.T_world_human
        if self.reaching is not None:
            self.goals_m = np.array(list(self.reaching.places.values()))
        if posterior is None or self.goals_m is None:
            return
        if prediction.T_library_tracker is not None:
            # The library's goals, as seen from where this person stands.
            T = T @ np.linalg.inv(prediction.T_library_tracker)
        goals_m = self.goals_m @ T[:3, :3].T + T[:3, 3]
        self.goal_publisher.publish(conversions.goals_cloud(goals_m, posterior.labels, posterior.probability, stamp_ns))
        names = [f"class {label}" for label in posterior.labels]
        self.posterior_publisher.publish(conversions.joint_state(names, np.asarray(posterior.probability), stamp_ns))

    def _look_for_warnings(self, q: FloatArray, stamp_ns: int) -> None:
        """Warn of places told that this person does not get to, of a clock that is behind, and of a moved tracker."""
        if self.reaching is not None and (self.looked_ns is None or abs(stamp_ns - self.looked_ns) >= _REACH_PERIOD_NS):
            self.looked_ns = stamp_ns
            self.place_warnings = self.reaching.warnings(q)
        others = {"tracker clock": self.stamps.behind(), "tracker frame": self.frames.warning}
        self.warn({**self.place_warnings, **{about: text for about, text in others.items() if text}})


main = entry_point(OccupancyPredictorNode)


if __name__ == "__main__":
    main()
