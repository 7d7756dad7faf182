"""Turns the observed postures of people into the space that they are going to occupy."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from builtin_interfaces.msg import Time
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from humanpred_ros import topics
from humanpred_ros.errors import UsageError
from humanpred_ros.geometry import compiled
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.human.model import human_named
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.nodes import conversions, qos
from humanpred_ros.nodes.base import GraphNode, entry_point
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.markers import future_markers, occupancy_markers
from humanpred_ros.nodes.occupancy_topics import OccupancyPublisher
from humanpred_ros.nodes.parameters import declare, declare_plugin, plugin_parameters
from humanpred_ros.nodes.watched_people import PeopleSettings, WatchedBody, WatchedPeople
from humanpred_ros.occupancy.people import PeoplePredictor
from humanpred_ros.occupancy.predictor import (
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
from humanpred_ros.settings import Settings, setting, setting_of

if TYPE_CHECKING:
    from humanpred_ros.reaching.reaching_predictor import ReachingPredictor, ReachingSettings

_MARKER_PERIOD_NS = 200_000_000
#: How often it is looked for bodies that have appeared, s.
_LOOK_S = 0.25
#: How often it is looked at whether the person can get to the goals; people walk, but not far in that time.
_REACH_PERIOD_NS = 1_000_000_000


class OccupancyPredictorSettings(PeopleSettings, NodeSettings):
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
    room_m: float = setting_of(PeopleSettings, "room_m", default=0.0)
    places: tuple[str, ...] = setting(
        ("",),
        "reaching only: where the hand may go, each 'label x y z' (world frame, m); [''] asks scene, then library",
        changeable=True,
    )
    detect_onsets: bool = setting(True, "find where motions begin and end; false: the first posture begins one")
    threshold: float = setting(0.001, "voxels with a higher probability are published", low=0.0, high=1.0)
    listener: str = setting("", "node that must be listening to the occupancy before this one is ready")
    copies: int = setting(
        1, "the compact form of each occupancy is sent so often: 2 or 3 over links that lose", low=1, high=5
    )
    lossless: bool = setting(False, "subscribe reliably and keep every posture (stepped runs)")


class OccupancyPredictorNode(GraphNode):
    """One occupancy per moment at which people were seen, and one class posterior per person.

    Each body has a predictor of its own; their occupancies are joined as those of people who move independently. Bodies
    that used to come with the same stamp are waited for, until the next posture of one that has come. A body whose
    posture does not come counts as predicted last until it is too old.

    A posture that cannot be used, or that no person can have, is refused with a counted reason on /diagnostics; what is
    published then says that nobody knows where people are, and why, so that the planner holds at once; so it does about
    a body that is lost, until a tracker says that it has left. Only a posture that was overtaken on its way is refused
    silently. A long silence, or postures that were refused for how they look, start a new motion.

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
        settings = self.settings
        self.predictors = PeoplePredictor(self.predictor)
        #: Postures to predict from and their times (s of the motion, stamp in ns), by body, until all have come.
        self.pending: dict[str, tuple[FloatArray, float, int]] = {}
        #: Why nobody knows where people are; empty while that is known.
        self.unknown = ""
        self.last_marker_ns = 0
        self.looked_ns: dict[str, int] = {}
        self.place_warnings: dict[str, dict[str, str]] = {}

        self.occupancies = OccupancyPublisher(self, 1 if settings.lossless else settings.copies)
        self.goal_publisher = self.create_publisher(PointCloud2, topics.HUMAN_GOALS, qos.SENSOR_PUBLISHER)
        self.posterior_publisher = self.create_publisher(JointState, topics.POSTERIOR, qos.SENSOR_PUBLISHER)
        self.marker_publisher = self.create_publisher(MarkerArray, topics.OCCUPANCY_MARKERS, qos.MARKERS)
        self.future_publisher = self.create_publisher(MarkerArray, topics.FUTURES, qos.MARKERS)
        self.grid_publisher = self.create_publisher(String, topics.VOXEL_GRID, qos.LATCHED)
        self.grid_publisher.publish(String(data=conversions.grid_description(self.scene.grid)))
        self.body_goals: dict[str, Any] = {}
        self.hardware_id = self.resolve_topic_name(topics.NOBODY).rpartition("/")[0]
        # One that plans may be slower than its sensor: old postures that queue up would make it ever later.
        profile = qos.sensor_subscription(settings.lossless, newest_only=settings.predictor == "reaching")
        self.people = WatchedPeople(
            self,
            self.human,
            self.scene,
            settings.part(PeopleSettings),
            self.on_people,
            frame=self.library_frame,
            profile=profile,
            max_age_s=math.inf if settings.lossless else settings.restart_gap_s,
            lossless=settings.lossless,
            left=self.on_left,
        )
        self.create_timer(_LOOK_S, self.people.look_for_bodies, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.people.look_for_bodies()

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
                for predictor in self.predictors.predictors:
                    cast("ReachingPredictor", predictor).set_places(told[-1] or self.scene_places)
                self.looked_ns.clear()
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def waiting_for(self) -> str:
        return self.unmatched(self.settings.listener, self.occupancies.compact, self.occupancies.cloud)

    def working(self) -> str:
        return "predicting" if self.predictors.predictions else super().working()

    def holding_because(self) -> str:
        return self.unknown

    def facts(self) -> dict[str, str]:
        return {"people": " ".join(body.name for body in self.people.present) or "nobody"}

    def on_people(self, body: WatchedBody, refusal: str) -> None:
        """Predict from a posture and publish, once all bodies have come that come together."""
        if body not in self.people.present or (refusal and refusal != body.trouble):  # one that was overtaken
            return
        if body.begins and not refusal:
            try:
                self.predictors.start(body.name)
            except UsageError as error:
                body.doubt(str(error))
                self.refuse(str(error))
        if self.pending and (body.trouble or body.name in self.pending):
            self._predict(publish=not body.trouble)
        if body.trouble:
            self._say(body.trouble_ns)
            return
        self.pending[body.name] = body.q, body.t_s, body.stamp_ns
        self._predict_if_complete()

    def _predict_if_complete(self) -> None:
        """Predict unless another body's posture is to be expected now."""
        before_ns = {self.people.bodies[name].before_ns for name in self.pending}
        for other in self.people.present:
            expected = other.stamp_ns in before_ns or other.came_s == -math.inf
            if expected and not other.trouble and other.name not in self.pending:
                return
        self._predict()

    def on_left(self, stamp_ns: int, nobody: bool) -> None:
        """Forget who has left, and publish what follows if that had been waited for, or nobody is there."""
        there = {body.name for body in self.people.present}
        for name in set(self.people.bodies) - there:
            self.predictors.forget(name)
            self.pending.pop(name, None)
        if self.pending:
            self._predict_if_complete()
        elif nobody and not there:
            self.unknown = ""
            self.occupancies.publish_nobody(self.scene.grid, stamp_ns)

    def _predict(self, publish: bool = True) -> None:
        """Predict from the postures that have come."""
        pending, self.pending = self.pending, {}
        troubles = self.predictors.update({name: (q, t_s) for name, (q, t_s, _) in pending.items()})
        for name, error in troubles.items():
            self.people.bodies[name].doubt(str(error))
            self.refuse(str(error))
        if publish:
            self._say(max(stamp_ns for _, _, stamp_ns in pending.values()))
        for name, (q, _, stamp_ns) in pending.items():
            if name not in troubles:
                self._publish_places(name, stamp_ns)
                self._look_for_warnings(name, q, stamp_ns)
        about = {what: text for warnings in self.place_warnings.values() for what, text in warnings.items()}
        self.warn(about | self.people.warnings())

    def _say(self, stamp_ns: int) -> None:
        """Publish the occupancy of everybody who is there, or that nobody knows it, and why."""
        present = self.people.present
        # How late all of them are, is for whoever plans to judge.
        now_s = self.people.steady_s() - min(body.late_s for body in present)
        of = "" if len(present) == 1 else "; {}"
        troubles = [
            body.trouble + of.format(body.name) if body.trouble else self.people.lost(body, now_s) for body in present
        ]
        occupancy, self.unknown = None, next((text for text in troubles if text), "")
        if not self.unknown:
            try:
                occupancy = self.predictors.occupancy([body.name for body in present], stamp_ns * 1e-9)
            except UsageError as error:
                self.unknown = str(error)
            if occupancy is not None and not occupancy.probability.any():
                self.unknown = "outside the lattice: wanted people who reach into it, nobody who is seen does"
        if occupancy is None or self.unknown:
            self.occupancies.publish_unknown(self.unknown, stamp_ns)
            return
        self.occupancies.publish(occupancy, self.settings.threshold, stamp_ns)
        if abs(stamp_ns - self.last_marker_ns) >= _MARKER_PERIOD_NS:
            self.last_marker_ns = stamp_ns
            self._draw(occupancy, conversions.time_message(stamp_ns))

    def _draw(self, occupancy: Occupancy, stamp: Time) -> None:
        """Publish markers that somebody looks at."""
        if self.marker_publisher.get_subscription_count():
            self.marker_publisher.publish(occupancy_markers(occupancy, stamp))
        if self.future_publisher.get_subscription_count():
            T, ways = self.T_world_human, []
            for body in self.people.present:
                futures = getattr(self.predictors.of(body.name), "futures", None)
                if futures is not None:
                    ways += [(p, way_m @ T[:3, :3].T + T[:3, 3]) for p, way_m in futures(body.q)]
            if ways:
                self.future_publisher.publish(future_markers(ways, stamp))

    def _publish_places(self, name: str, stamp_ns: int) -> None:
        """Publish where a body's hand may go, and how probable each place is."""
        prediction, T = self.predictors.predictions[name], self.T_world_human
        posterior = prediction.posterior
        if self.reaching is not None:
            self.goals_m = np.array(list(self.reaching.places.values()))
        if posterior is None or self.goals_m is None:
            return
        if prediction.T_library_tracker is not None:
            # The library's goals, as seen from where this person stands.
            T = T @ np.linalg.inv(prediction.T_library_tracker)
        goals_m = self.goals_m @ T[:3, :3].T + T[:3, 3]
        cloud = conversions.goals_cloud(goals_m, posterior.labels, posterior.probability, stamp_ns)
        if name not in self.body_goals:
            topic = topics.human_goals(name)
            self.body_goals[name] = self.create_publisher(PointCloud2, topic, qos.SENSOR_PUBLISHER)
        if self.body_goals[name].get_subscription_count():
            self.body_goals[name].publish(cloud)
        if name == self.people.present[0].name:
            self.goal_publisher.publish(cloud)
            names = list(map(str, posterior.labels))
            numbers = conversions.joint_state(names, np.asarray(posterior.probability), stamp_ns)
            self.posterior_publisher.publish(numbers)

    def _look_for_warnings(self, name: str, q: FloatArray, stamp_ns: int) -> None:
        """Warn of places told that this person does not get to."""
        looked_ns = self.looked_ns.get(name)
        if self.reaching is not None and (looked_ns is None or abs(stamp_ns - looked_ns) >= _REACH_PERIOD_NS):
            self.looked_ns[name] = stamp_ns
            own = cast("ReachingPredictor", self.predictors.of(name))
            self.place_warnings[name] = own.warnings(q)


main = entry_point(OccupancyPredictorNode)


if __name__ == "__main__":
    main()
