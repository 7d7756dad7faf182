"""Every node's parameters, declared once: name, default, range and description.

The nodes declare their ROS parameters from these dataclasses (`parameters.declare`), and a test checks
config/nodes.yaml against them, so a default lives in exactly one place.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from humanpred_ros import topics
from humanpred_ros.occupancy.predictor import DEFAULT_PREDICTOR
from humanpred_ros.planning.replanner import ReplannerConfig
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.reaching_predictor import DEFAULT_WEIGHTS
from humanpred_ros.recognition.classifier import DEFAULT_CLASSIFIER
from humanpred_ros.stomp.config import StompConfig

_REPLANNER = ReplannerConfig()
_STOMP = StompConfig()


def setting(
    default: Any, description: str, low: float | None = None, high: float | None = None, changeable: bool = False
) -> Any:
    """Return a dataclass field that carries a parameter's description and, for numbers, its range.

    A parameter can be changed while the node runs only where that is said.
    """
    metadata = {"description": description, "low": low, "high": high, "changeable": changeable}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class SkeletonTrackerReplaySettings:
    """Parameters of `skeleton_tracker_replay`."""

    library: str = setting("synthetic_reaches", "motion library: a rosbag2 directory, a CSV folder, or a shipped name")
    trajectory: str = setting("0/0", "motion to replay: class/index, or the running number over sorted classes")
    body_id: str = setting("body_0", "REP-155 body id, part of the topic names")
    mode: str = setting("real_time", "real_time, or stepped: wait for the planner's decision after every posture")
    rate: float = setting(1.0, "playback speed in real_time mode", 0.05, 20.0)
    hold_last_s: float = setting(4.0, "seconds the last posture is repeated after the motion's end", 0.0, 600.0)
    wait_for: str = setting("", "comma-separated nodes whose /diagnostics must say ready before the replay starts")
    listener: str = setting("", "node that must be listening to the postures before the replay starts")
    ready_timeout_s: float = setting(180.0, "longest wait for those nodes", 0.1, 600.0)
    decision_timeout_s: float = setting(30.0, "longest wait for one decision in stepped mode", 0.1, 600.0)
    publish_clock: bool = setting(False, "publish /clock; always on in stepped mode")


@dataclass(frozen=True)
class OccupancyPredictorSettings:
    """Parameters of `occupancy_predictor`."""

    scene: str = setting("face_to_face", "scene name in config/scenes, or a YAML file")
    model: str = setting("", "model file made by `humanpred train`; empty: train on `library` at start")
    library: str = setting("synthetic_reaches", "library trained on when no model is given")
    classifier: str = setting(DEFAULT_CLASSIFIER, "how a partial motion is recognised: forest, or gmm (P1)")
    evidence: str = setting("sum", "gmm only: sum or mean of the postures' log densities")
    window_frames: int = setting(0, "gmm only: count only so many last postures; 0 counts all", 0, 100000)
    predictor: str = setting(
        DEFAULT_PREDICTOR,
        "forecast, swept_volume (P1), reaching (P2), or a baseline: current, current_accumulated, constant_velocity",
    )
    human: str = setting("kinect12", "whose postures come: kinect12 (P1, 12 DoFs) or mocap23 (P2, 23 DoFs)")
    reach_goals: tuple[str, ...] = setting(
        ("",),
        "reaching only: where the hand may go, each 'label x y z' (world frame, m); [''] asks scene, then library; "
        "may be changed at run time",
        changeable=True,
    )
    reach_weights: str = setting(
        DEFAULT_WEIGHTS, f"reaching only: weights of P2's cost, {', '.join(NAMED_WEIGHTS)}, or a .json file"
    )
    detect_onsets: bool = setting(True, "find where motions begin and end; false: the first posture begins one")
    body_id: str = setting("body_0", "REP-155 body id listened to")
    threshold: float = setting(0.001, "voxels with a higher probability are published", 0.0, 1.0)
    listener: str = setting("", "node that must be listening to the occupancy before this one is ready")
    restart_gap_s: float = setting(1.0, "a longer silence starts a new motion", 0.05, 60.0)
    lossless: bool = setting(False, "subscribe reliably and keep every posture (stepped runs)")


@dataclass(frozen=True)
class StompPlannerSettings:
    """Parameters of `stomp_planner`."""

    scene: str = setting("face_to_face", "scene name in config/scenes, or a YAML file")
    period_s: float = setting(_REPLANNER.period_s, "length of a replanning step", 0.02, 10.0)
    seed: int = setting(_REPLANNER.seed, "seed of every random draw", 0, 2**31 - 1)
    threads: int = setting(_REPLANNER.threads, "goals planned at the same time", 1, 64)
    waypoints: int = setting(_STOMP.waypoints, "waypoints of a path", 10, 1000)
    iterations: int = setting(_STOMP.iterations, "STOMP iterations per goal and step", 1, 10000)
    rollouts: int = setting(_STOMP.rollouts, "noisy rollouts per iteration, half of them reused", 2, 1000)
    noise_std: float = setting(
        _STOMP.noise_std,
        "noise of the rollouts, units of R^-1; may be changed at run time",
        1e-6,
        1.0,
        changeable=True,
    )
    noise_decay: float = setting(_STOMP.noise_decay, "factor on the noise per iteration", 0.01, 1.0)
    velocity_scale: float = setting(_REPLANNER.velocity_scale, "share of the URDF's velocity limits used", 0.01, 1.0)
    acceleration_limit: float = setting(
        _REPLANNER.acceleration_limit, "acceleration limit of every joint, rad/s^2", 0.01, 100.0
    )
    min_improvement: float = setting(
        _REPLANNER.min_improvement, "share by which a path must be cheaper to replace the one being executed", 0.0, 0.99
    )
    padding_m: float = setting(_REPLANNER.padding_m, "clearance every motion keeps from obstacles", 0.0, 0.09)
    human_margin_m: float = setting(
        _REPLANNER.human_margin_m, "coming this close to predicted occupancy costs as much as entering it", 0.0, 0.5
    )
    min_separation_m: float = setting(
        _REPLANNER.min_separation_m, "the arm never moves closer to the person than this; 0 forbids nothing", 0.0, 1.0
    )
    likely_probability: float = setting(
        _REPLANNER.likely_probability, "from here on the person counts as likely to come to a voxel", 0.001, 1.0
    )
    controller: str = setting("", "node that must be listening to the trajectories before this one is ready")
    listener: str = setting("", "node that must be listening to the decisions before this one is ready")
    max_human_age_s: float = setting(0.5, "older human occupancy leads to a hold", 0.02, 60.0)
    stomp_share: float = setting(
        0.6, "share of a step after which STOMP must stop in real time, with many goals; sooner with few", 0.05, 0.95
    )
    lossless: bool = setting(False, "subscribe reliably and keep every occupancy (stepped runs)")

    def replanner_config(self) -> ReplannerConfig:
        """Return the replanner's configuration these parameters stand for."""
        stomp = _STOMP.replaced(
            waypoints=self.waypoints,
            iterations=self.iterations,
            rollouts=self.rollouts,
            reused=self.rollouts // 2,
            noise_std=self.noise_std,
            noise_decay=self.noise_decay,
        )
        return _REPLANNER.replaced(
            period_s=self.period_s,
            seed=self.seed,
            threads=self.threads,
            velocity_scale=self.velocity_scale,
            acceleration_limit=self.acceleration_limit,
            min_improvement=self.min_improvement,
            padding_m=self.padding_m,
            human_margin_m=self.human_margin_m,
            min_separation_m=self.min_separation_m,
            likely_probability=self.likely_probability,
            stomp=stomp,
        )


@dataclass(frozen=True)
class SimulatedArmSettings:
    """Parameters of `simulated_arm`."""

    scene: str = setting("face_to_face", "scene whose start configuration the arm is in")
    rate_hz: float = setting(50.0, "joint states per second", 1.0, 1000.0)


@dataclass(frozen=True)
class RunRecorderSettings:
    """Parameters of `run_recorder`."""

    output: str = setting("", "folder of the bag; must not exist yet")
    body_id: str = setting("body_0", "REP-155 body id recorded")
    wait_for: str = setting(
        ",".join((topics.human_joint_states("<id>"), topics.OCCUPANCY, topics.DECISION, topics.JOINT_STATES)),
        "comma-separated topics that must have a publisher before the recorder calls itself ready",
    )
    run_info: str = setting("{}", "JSON object of facts about the run, stored in the bag as metadata")
    markers: bool = setting(False, "record the markers too; their publishers are silent otherwise, which saves time")


@dataclass(frozen=True)
class OccupancyReplaySettings:
    """Parameters of `occupancy_replay`."""

    bag: str = setting("", "bag of a recorded run")
    wait_for: str = setting("", "comma-separated nodes whose /diagnostics must say ready before the replay starts")
