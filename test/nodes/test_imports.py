"""Nodes that only pass messages on load no compiler, solver or plotting: every process of the graph costs memory."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")

from humanpred_ros.human.model import HumanModel

HEAVY = {"numba", "llvmlite", "scipy", "sklearn", "pinocchio", "matplotlib", "yourdfpy", "trimesh"}
_CODE = """
import sys, rclpy
from humanpred_ros.nodes.lifecycle import started
from humanpred_ros.nodes.{module} import {node} as Node
rclpy.init(args=["node", "--ros-args", *{parameters}])
node = started(Node)
{act}
node.close()
print("modules", *sys.modules)
"""


@pytest.mark.parametrize(
    ("module", "node", "parameters", "act"),
    [
        ("run_recorder", "RunRecorder", ["output:=bag"], ""),
        ("skeleton_tracker_replay", "SkeletonTrackerReplay", ["mode:=stepped"], "node.publish_next()"),
        ("simulated_arm", "SimulatedArm", [], "node.publish_now()"),
    ],
)
def test_a_node_that_passes_messages_on_is_light(
    module: str, node: str, parameters: list[str], act: str, tmp_path: Path
) -> None:
    HumanModel.kinect12()  # descriptions are parsed once on a machine
    given = [part for parameter in parameters for part in ("-p", parameter)]
    code = _CODE.format(module=module, node=node, parameters=given, act=act)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    loaded = {name.split(".")[0] for name in done.stdout.split("modules ", 1)[1].split()}
    assert not loaded & HEAVY


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("stomp_planner", {"scipy.interpolate", "scipy.optimize", "scipy.spatial", "sklearn", "pinocchio"}),
        ("separation_guard", {"humanpred_ros.stomp", "humanpred_ros.planning.replanner", "sklearn", "pinocchio"}),
        ("occupancy_predictor", {"humanpred_ros.reaching.reaching_predictor", "scipy.linalg", "sklearn", "pinocchio"}),
    ],
)
def test_a_node_that_computes_loads_what_its_defaults_need(module: str, unwanted: set[str]) -> None:
    code = f"import sys, humanpred_ros.nodes.{module}\nprint('modules', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not unwanted & set(done.stdout.split("modules ", 1)[1].split())
