"""Parameters of `stomp_planner`: the replanner's and STOMP's, and when the node holds."""

from __future__ import annotations

from typing import Literal

from humanpred_ros.errors import SettingsError
from humanpred_ros.nodes.lifecycle import NodeSettings
from humanpred_ros.nodes.priority import PrioritySettings
from humanpred_ros.planning.following import FollowingSettings
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.plugins import Given
from humanpred_ros.settings import setting, setting_of
from humanpred_ros.stomp.config import StompConfig


class StompPlannerSettings(PrioritySettings, NodeSettings):
    """Parameters of `stomp_planner`."""

    scene: str = setting(
        "face_to_face",
        "scene name in config/scenes, or a YAML file",
        restart="robot, obstacles and clearances are computed from it",
    )
    tasks: str = setting(
        "", "all tasks there are to be, in YAML as under goals in a scene file; none: the scene's", changeable=True
    )
    period_s: float = setting_of(ReplannerConfig, "period_s")
    seed: int = setting_of(ReplannerConfig, "seed")
    threads: int = setting_of(ReplannerConfig, "threads")
    waypoints: int = setting_of(StompConfig, "waypoints", restart="the noise is computed for paths of this length")
    iterations: int = setting_of(StompConfig, "iterations", low=1)
    rollouts: int = setting_of(
        StompConfig, "rollouts", description="noisy rollouts per iteration, half of them reused", low=2
    )
    noise_std: float = setting_of(StompConfig, "noise_std")
    cost_terms: tuple[str, ...] = setting_of(ReplannerConfig, "cost_terms", restart="they are compiled together")
    noise_decay: float = setting_of(StompConfig, "noise_decay")
    velocity_scale: float = setting_of(ReplannerConfig, "velocity_scale", changeable=True)
    acceleration_limit: float = setting_of(ReplannerConfig, "acceleration_limit")
    min_improvement: float = setting_of(ReplannerConfig, "min_improvement")
    padding_m: float = setting_of(ReplannerConfig, "padding_m", changeable=True)
    human_margin_m: float = setting_of(ReplannerConfig, "human_margin_m", changeable=True)
    min_separation_m: float = setting_of(ReplannerConfig, "min_separation_m", changeable=True)
    likely_probability: float = setting_of(ReplannerConfig, "likely_probability", changeable=True)
    command_by: Literal["topic", "action"] = setting(
        "topic", "the arm is commanded on its controller's topic, or by its action FollowJointTrajectory"
    )
    controller: str = setting("", "node that must be listening to the trajectories before this one is ready")
    listener: str = setting("", "node that must be listening to the decisions before this one is ready")
    max_human_age_s: float = setting(
        0.5, "older human occupancy leads to a hold", unit="s", low=0.02, high=60.0, changeable=True
    )
    max_ahead_s: float = setting(
        0.05,
        "human data with a stamp farther ahead of the clock are invalid",
        unit="s",
        low=0.0,
        high=10.0,
        changeable=True,
    )
    max_arm_age_s: float = setting(
        0.5,
        "an arm whose joint states have not come for so long is silent: a hold",
        unit="s",
        low=0.02,
        high=60.0,
        changeable=True,
    )
    follow_tolerance_rad: float = setting_of(FollowingSettings, "follow_tolerance_rad")
    follow_lag_s: float = setting_of(FollowingSettings, "follow_lag_s")
    start_slack_rad: float = setting(
        0.01, "an arm so little outside its joint limits is planned for from within them", unit="rad", low=0.0, high=0.2
    )
    stomp_share: float = setting(
        0.6,
        "share of a step after which STOMP must stop in real time, with many goals; sooner with few",
        low=0.05,
        high=0.95,
    )
    guard: bool = setting(
        False, "there must be a separation guard: the arm stands until it is heard; one that was heard once must stay"
    )
    lossless: bool = setting(False, "subscribe reliably and keep every occupancy (stepped runs)")

    def check(self) -> None:
        if self.lossless and self.command_by == "action":
            raise SettingsError(
                f"{type(self).__name__} command_by: wanted topic in a stepped run (lossless), got action; "
                "an action is answered in its own time"
            )

    def replanner_config(self, cost_terms: Given | None = None) -> ReplannerConfig:
        """Return the replanner's settings these parameters, and those of cost terms, stand for."""
        stomp = self.part(StompConfig, reused=self.rollouts // 2)
        return self.part(ReplannerConfig, stomp=stomp, cost_term_settings=dict(cost_terms or {}))
