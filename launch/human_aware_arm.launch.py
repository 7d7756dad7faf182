"""The graph for those who have ros2 launch: body tracker, predictor, planner, guard, arm and recorder, each in or out.

A demonstration, whose end is that of the replayed motion:

    ros2 launch humanpred_ros human_aware_arm.launch.py trajectory:=3/2 record:=run_bag

An arm and a tracker of one's own, in operation:

    ros2 launch humanpred_ros human_aware_arm.launch.py arm:=false tracker:=false guard:=true scene:=my_table.yaml \
        trajectory_topic:=/scaled_joint_trajectory_controller/joint_trajectory joint_states_topic:=/joint_states
"""

from __future__ import annotations

from typing import Any, List  # noqa: UP035 -- launch knows no list[str]

from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from humanpred_ros import topics
from humanpred_ros.resources import share_directory

#: What is started, and whether it is unless somebody says otherwise.
PARTS = {
    "arm": ("true", "start simulated_arm; false: there is a driver or a simulator with a trajectory controller"),
    "tracker": ("true", "start skeleton_tracker_replay; false: there is a body tracker"),
    "live_tracker": ("false", "start skeleton_tracker for a body tracker's points, instead of the replay"),
    "predictor_node": ("true", "start occupancy_predictor; false: somebody else publishes the occupancy"),
    "planner": ("true", "start stomp_planner"),
    "guard": ("false", "start separation_guard; planner and simulated arm then move only while they hear it"),
}
#: What the nodes are told; one left empty is as the parameter file says, else the node's default.
TOLD = {
    "scene": "scene name in config/scenes, or a YAML file",
    "library": "motion library: a shipped name, a rosbag2 directory or a CSV folder",
    "trajectory": "motion to replay: class/index, or the running number over sorted classes",
    "model": "model file made by `humanpred train`; without one the predictor trains on the library at start",
    "predictor": "forecast, swept_volume (P1), reaching (P2), a baseline, or an installed package's",
    "human": "whose postures come: kinect12 (P1, 12 DoFs) or mocap23 (P2, 23 DoFs)",
    "body_id": "REP-155 body id, part of the names of the body's topics",
    "skeleton": "of the live tracker: which point is which, a name in config/skeletons or a YAML file",
    "points_topic": "of the live tracker: the topic on which its points come",
}
OTHERS = {
    "places": ("", "predictor reaching: places the hand may go to, as in \"['3 -0.22 -0.67 0.80']\""),
    "record": ("", "folder of the bag, must not exist yet; empty records nothing"),
    "params_file": ("", "file of parameters, as config/nodes.yaml; arguments given here come first"),
    "namespace": ("", "of all nodes and topics, as robot1, for several robots on one network"),
    "trajectory_topic": ("", f"the arm's controller listens to it; empty: {topics.TRAJECTORY}"),
    "joint_states_topic": ("", f"the arm's joint states come on it; empty: {topics.JOINT_STATES}"),
    "use_sim_time": ("false", "time comes from /clock; the replay, if started, publishes it"),
    "domain": ("", "ROS_DOMAIN_ID of the nodes; empty: that of the terminal"),
    "managed": ("false", "nodes wait for a lifecycle manager to configure and activate them"),
    "one_process": ("false", "predictor and planner run in one process, for small computers"),
    "rviz": ("false", "look at it in RViz, with rviz/humanpred.rviz"),
    "demo": ("true", "the end of the replay ends everything"),
}
# The first start on a machine compiles the planner and trains a model before anybody is ready.
READY_TIMEOUT_S = 300.0
RESPAWN_DELAY_S = 2.0
#: Status with which a node ends that cannot use what it was given: started again it would say the same.
BAD_INPUT = 2


class Graph:
    """The nodes to start, from the values of the launch arguments."""

    def __init__(self, context: LaunchContext) -> None:
        self.value = {name: LaunchConfiguration(name).perform(context) for name in (*PARTS, *TOLD, *OTHERS)}

    def on(self, name: str) -> bool:
        """Return whether an argument says yes.

        Raises:
            RuntimeError: neither true nor false.
        """
        value = self.value[name].lower()
        if value not in ("true", "false"):
            raise RuntimeError(f"launch argument {name}: wanted true or false, got {self.value[name]}")
        return value == "true"

    def node(self, executable: str, told: str, ends: str, **own: Any) -> Node:
        """Return a node.

        Args:
            executable: its name.
            told: the launch arguments that are its parameters, with spaces between them; their values are texts, also
                where they look like numbers (`trajectory:=3`).
            ends: what its end does: "all" ends everything; after "again" it is started again, as the arm rests
                meanwhile: its peers notice its silence; "alone" ends nothing else.
            own: its other parameters.
        """
        given = {name: ParameterValue(self.value[name], value_type=str) for name in told.split() if self.value[name]}
        if "points_topic" in given:
            given["topic"] = given.pop("points_topic")
        managed = {"managed": True} if self.on("managed") else {}
        parameters = [self.value["params_file"], {**given, **managed, **own}]
        renamed = {topics.TRAJECTORY: "trajectory_topic", topics.JOINT_STATES: "joint_states_topic"}
        policy: dict[str, Any] = {}
        if ends == "all":
            policy = {"on_exit": Shutdown(reason=f"{executable} has ended")}
        elif ends == "again":
            policy = {"respawn": True, "respawn_delay": RESPAWN_DELAY_S, "on_exit": cannot_start}
        return Node(
            package="humanpred_ros",
            executable=executable,
            namespace=self.value["namespace"] or None,
            parameters=[some for some in parameters if some],
            remappings=[(topic, self.value[name]) for topic, name in renamed.items() if self.value[name]],
            output="screen",
            **policy,
        )

    def nodes(self) -> dict[str, Node]:
        """Return what is to be started, by name; the replay waits for all others that are."""
        clock = {"use_sim_time": True} if self.on("use_sim_time") else {}
        arm, guard, live = self.on("arm"), self.on("guard"), self.on("live_tracker")
        tracker = self.on("tracker") and not live
        predictor, planner = self.on("predictor_node"), self.on("planner")
        watched = {"guard": True} if guard else {}
        nodes = {}
        if arm:
            nodes["simulated_arm"] = self.node("simulated_arm", "scene", "all", **watched, **clock)
        if guard:
            nodes["separation_guard"] = self.node("separation_guard", "scene human", "again", **clock)
        both = "scene library model predictor human"
        together = planner and predictor and self.on("one_process")
        if planner and not together:
            own: dict[str, Any] = {"controller": "simulated_arm"} if arm else {}
            own |= {"listener": "skeleton_tracker_replay"} if tracker else {}
            nodes["stomp_planner"] = self.node("stomp_planner", "scene", "again", **own, **watched, **clock)
        if predictor:
            own = {"listener": "stomp_planner"} if planner and not together else {}
            own |= {**({"controller": "simulated_arm"} if arm else {}), **watched} if together else {}
            if self.value["places"]:
                own["places"] = ParameterValue(self.value["places"], value_type=List[str])  # noqa: UP006
            name = "predict_and_plan" if together else "occupancy_predictor"
            nodes[name] = self.node(name, both, "again", **own, **clock)
        if self.value["record"]:  # its end ends nothing: a full disk must not stop the work
            output = ParameterValue(self.value["record"], value_type=str)
            nodes["run_recorder"] = self.node("run_recorder", "body_id", "alone", output=output)
        if live:
            own = {"listener": "occupancy_predictor"} if predictor else {}
            nodes["skeleton_tracker"] = self.node(
                "skeleton_tracker", "scene skeleton points_topic", "again", **own, **clock
            )
        if tracker:
            own = {"listener": "occupancy_predictor"} if predictor else {}
            own |= {"publish_clock": True} if clock else {}
            nodes["skeleton_tracker_replay"] = self.node(
                "skeleton_tracker_replay",
                "library trajectory body_id",
                "all" if self.on("demo") else "alone",
                wait_for=",".join(nodes).replace("predict_and_plan", "occupancy_predictor,stomp_planner"),
                ready_timeout_s=READY_TIMEOUT_S,
                **own,
            )
        if self.on("rviz"):
            if arm:  # a driver of one's own brings this
                nodes["robot_state_publisher"] = self._state_publisher(clock)
            file = str(share_directory() / "rviz" / "humanpred.rviz")
            nodes["rviz2"] = Node(package="rviz2", executable="rviz2", arguments=["-d", file], parameters=[clock])
        return nodes

    def _state_publisher(self, clock: dict[str, Any]) -> Node:
        """Return the node that publishes the description and the transforms of the scene's whole robot."""
        from humanpred_ros.robot.scene import load_scene  # nobody else needs the compiler here

        text = load_scene(self.value["scene"] or "face_to_face").arm.urdf()
        described = {"robot_description": ParameterValue(text, value_type=str)}
        return Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=self.value["namespace"] or None,
            parameters=[described, clock],
        )


def cannot_start(event: Any, context: LaunchContext) -> list[Action]:
    """End everything if a node has ended because of what it was given, and would end again."""
    if event.returncode != BAD_INPUT:
        return []
    return [Shutdown(reason=f"{event.process_name} cannot use what it was given: its last line says why")]


def graph(context: LaunchContext) -> list[Action]:
    """Return the actions that start the nodes."""
    chosen = Graph(context)
    domain = chosen.value["domain"]
    before = [SetEnvironmentVariable("ROS_DOMAIN_ID", domain)] if domain else []
    return [*before, *chosen.nodes().values()]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments that people change, and the graph."""
    defaults = {**PARTS, **{name: ("", f"{text}; empty: the node's default") for name, text in TOLD.items()}, **OTHERS}
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in defaults.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=graph)])
