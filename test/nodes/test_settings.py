from __future__ import annotations

from dataclasses import fields

import pytest
import yaml
from paths import REPOSITORY

from humanpred_ros.nodes import settings

NODES = {
    "skeleton_tracker_replay": settings.SkeletonTrackerReplaySettings,
    "occupancy_predictor": settings.OccupancyPredictorSettings,
    "stomp_planner": settings.StompPlannerSettings,
    "simulated_arm": settings.SimulatedArmSettings,
    "run_recorder": settings.RunRecorderSettings,
    "occupancy_replay": settings.OccupancyReplaySettings,
}


@pytest.mark.parametrize("node", NODES)
def test_the_parameter_file_states_the_defaults_of_the_code(node: str) -> None:
    stated = yaml.safe_load((REPOSITORY / "config" / "nodes.yaml").read_text(encoding="utf-8"))
    parameters = stated[node]["ros__parameters"]
    defaults = {item.name: item.default for item in fields(NODES[node])}
    # YAML has lists only, which a frozen dataclass cannot have.
    assert {name: tuple(v) if isinstance(v, list) else v for name, v in parameters.items()} == defaults


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_is_described_and_within_its_range(node: str) -> None:
    for item in fields(NODES[node]):
        assert item.metadata["description"]
        if item.metadata["low"] is not None:
            assert item.metadata["low"] <= item.default <= item.metadata["high"]


def test_the_planner_parameters_become_its_configuration() -> None:
    config = settings.StompPlannerSettings(period_s=0.1, seed=9, threads=1, waypoints=50, rollouts=6).replanner_config()
    assert (config.period_s, config.seed, config.threads) == (0.1, 9, 1)
    assert (config.stomp.waypoints, config.stomp.rollouts) == (50, 6)
