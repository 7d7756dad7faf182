"""The whole graph for those who have ros2 launch: tracker replay, predictor, planner, simulated arm, recorder.

`ros2 launch humanpred_ros human_aware_arm.launch.py scene:=face_to_face trajectory:=3/2 record:=run_bag`
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

PACKAGE = "humanpred_ros"
PEERS = "occupancy_predictor,stomp_planner,simulated_pr2"


def generate_launch_description() -> LaunchDescription:
    """Return the five nodes with the arguments that people change."""
    arguments = [
        DeclareLaunchArgument("scene", default_value="face_to_face", description="scene name or YAML file"),
        DeclareLaunchArgument("library", default_value="synthetic_reaches", description="motion library"),
        DeclareLaunchArgument("trajectory", default_value="0/0", description="motion to replay, class/index"),
        DeclareLaunchArgument("model", default_value="", description="trained model; empty trains at start"),
        DeclareLaunchArgument("predictor", default_value="swept_volume", description="swept_volume or current"),
        DeclareLaunchArgument("record", default_value="", description="folder of the bag; empty records nothing"),
    ]

    def text(name: str) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=str)

    tracker = Node(
        package=PACKAGE,
        executable="skeleton_tracker_replay",
        parameters=[{"library": text("library"), "trajectory": text("trajectory"), "wait_for": PEERS}],
    )
    return LaunchDescription(
        [
            *arguments,
            Node(package=PACKAGE, executable="simulated_pr2", parameters=[{"scene": text("scene")}]),
            Node(package=PACKAGE, executable="stomp_planner", parameters=[{"scene": text("scene")}]),
            Node(
                package=PACKAGE,
                executable="occupancy_predictor",
                parameters=[
                    {
                        "scene": text("scene"),
                        "library": text("library"),
                        "model": text("model"),
                        "predictor": text("predictor"),
                    }
                ],
            ),
            Node(
                package=PACKAGE,
                executable="run_recorder",
                parameters=[{"output": text("record")}],
                condition=IfCondition(PythonExpression(["'", LaunchConfiguration("record"), "' != ''"])),
            ),
            tracker,
            RegisterEventHandler(OnProcessExit(target_action=tracker, on_exit=[EmitEvent(event=Shutdown())])),
        ]
    )
