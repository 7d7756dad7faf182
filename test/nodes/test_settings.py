"""Every parameter is described, within its range, and in the files made from the code."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import reference

from humanpred_ros.nodes.planner_settings import StompPlannerSettings
from humanpred_ros.settings import facts_of

NODES = reference.node_settings()


@pytest.mark.parametrize("path", reference.FILES, ids=lambda path: path.name)
def test_what_is_made_from_the_code_is_as_the_code(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == reference.FILES[path](), "run: python test/reference.py"


@pytest.mark.parametrize("node", NODES)
def test_every_parameter_is_described(node: str) -> None:
    assert all(facts_of(field)["description"] for field in NODES[node].model_fields.values())


def test_the_planner_parameters_become_its_configuration() -> None:
    given = StompPlannerSettings(period_s=0.1, seed=9, threads=1, waypoints=50, rollouts=6)
    config = given.replanner_config()
    assert (config.period_s, config.seed, config.threads) == (0.1, 9, 1)
    assert (config.stomp.waypoints, config.stomp.rollouts, config.stomp.reused) == (50, 6, 3)
