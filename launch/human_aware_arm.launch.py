"""The whole graph for those who have ros2 launch: tracker replay, predictor, planner, simulated arm, recorder.

`ros2 launch humanpred_ros human_aware_arm.launch.py scene:=face_to_face trajectory:=3/2 record:=run_bag`
"""

from __future__ import annotations

from typing import Any, List  # noqa: UP035 -- launch knows no list[str]

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "scene": ("face_to_face", "scene name in config/scenes, or a YAML file"),
    "library": ("synthetic_reaches", "motion library: a shipped name, a rosbag2 directory or a CSV folder"),
    "trajectory": ("0/0", "motion to replay: class/index, or the running number over sorted classes"),
    "model": ("", "model file made by `humanpred train`; empty trains on the library at start"),
    "predictor": (
        "forecast",
        "forecast, swept_volume (P1), reaching (P2), or a baseline: current, current_accumulated, constant_velocity",
    ),
    "human": ("kinect12", "whose postures come: kinect12 (P1, 12 DoFs) or mocap23 (P2, 23 DoFs)"),
    "places": ("['']", "predictor reaching: places the hand may go to, as in \"['3 -0.22 -0.67 0.80']\""),
    "record": ("", "folder of the bag, must not exist yet; empty records nothing"),
}
# The first start on a machine compiles the planner and trains a model before anybody is ready.
READY_TIMEOUT_S = 300.0


def text(name: str) -> ParameterValue:
    """Return a launch argument as text, also where it looks like a number (`trajectory:=3`)."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def node(executable: str, **parameters: Any) -> Node:
    """Return a node without which the graph is of no use: when it ends, everything ends."""
    return Node(
        package="humanpred_ros",
        executable=executable,
        parameters=[parameters],
        output="screen",
        on_exit=Shutdown(reason=f"{executable} has ended"),
    )


def graph(context: LaunchContext) -> list[Node]:
    """Return the nodes; the replay waits for all others, for a recorder only where there is one."""
    nodes = [
        node("simulated_arm", scene=text("scene")),
        node("stomp_planner", scene=text("scene"), controller="simulated_arm", listener="skeleton_tracker_replay"),
        node(
            "occupancy_predictor",
            scene=text("scene"),
            library=text("library"),
            model=text("model"),
            predictor=text("predictor"),
            human=text("human"),
            places=ParameterValue(LaunchConfiguration("places"), value_type=List[str]),  # noqa: UP006
            listener="stomp_planner",
        ),
    ]
    peers = ["simulated_arm", "stomp_planner", "occupancy_predictor"]
    if LaunchConfiguration("record").perform(context):
        nodes.append(node("run_recorder", output=text("record")))
        peers.append("run_recorder")
    tracker = node(
        "skeleton_tracker_replay",
        library=text("library"),
        trajectory=text("trajectory"),
        wait_for=",".join(peers),
        listener="occupancy_predictor",
        ready_timeout_s=READY_TIMEOUT_S,
    )
    return [*nodes, tracker]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments that people change, and the graph."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=graph)])
