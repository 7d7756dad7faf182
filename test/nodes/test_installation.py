"""What a ROS user gets: `colcon build`, executables that run from the install space, and errors of one line."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, List  # noqa: UP035 -- launch knows no list[str]

import pytest
from paths import REPOSITORY
from waiting import wait_until

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from reference import node_settings

from humanpred_ros import topics
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.nodes.parameters import declare

NODES: dict[str, type[Any]] = node_settings()
#: Executables that are no node of their own.
PROGRAMS = {"humanpred", "predict_and_plan"}
LAUNCH_FILE = REPOSITORY / "launch" / "human_aware_arm.launch.py"
_COLCON = "import sys; from colcon_core.command import main; sys.exit(main())"
_NOT_PACKAGED = (".*", "*.egg-info", "build", "install", "log", "runs", "test", "venv*")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a colcon workspace with a copy of the package, so that nothing is written into the checkout."""
    pytest.importorskip("colcon_core", reason="needs colcon: install the `test` extra")
    folder = tmp_path_factory.mktemp("workspace")
    shutil.copytree(REPOSITORY, folder / "src" / "humanpred_ros", ignore=shutil.ignore_patterns(*_NOT_PACKAGED))
    return folder


def build(workspace: Path, name: str, *options: str) -> Path:
    """Run `colcon build` and return the install space `name`."""
    spaces = ["--build-base", f"build_{name}", "--install-base", name]
    # The same interpreter, whatever `colcon` comes first on PATH: executables run with the one that built them.
    done = subprocess.run(
        [sys.executable, "-c", _COLCON, "--log-base", f"log_{name}", "build", *spaces, *options],
        cwd=workspace,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return workspace / name


def sourced(install: Path) -> dict[str, str]:
    """Return the environment of a shell that has sourced the install space's setup.bash."""
    done = subprocess.run(
        ["bash", "-c", '. "$0/setup.bash" && env -0', str(install)], capture_output=True, text=True, check=True
    )
    return dict(entry.split("=", 1) for entry in done.stdout.split("\0") if entry)


@pytest.fixture(scope="module")
def install(workspace: Path) -> Path:
    install = build(workspace, "install")
    lend_compiled_kernels(workspace / "src" / "humanpred_ros" / "humanpred_ros", install)
    return install


def lend_compiled_kernels(source: Path, install: Path) -> None:
    """Copy the kernels numba has compiled for the sources, if any: waiting for a compiler again tests nothing."""
    (installed,) = (install / "humanpred_ros" / "lib").glob("python*/site-packages/humanpred_ros")
    for module in source.rglob("*.py"):
        times = module.stat()  # numba takes what it compiled for valid at this very time, which building rounds
        os.utime(installed / module.relative_to(source), ns=(times.st_atime_ns, times.st_mtime_ns))
    for kernel in source.rglob("*.nb[ic]"):
        copy = installed / kernel.relative_to(source)
        copy.parent.mkdir(exist_ok=True)
        shutil.copyfile(kernel, copy)


@pytest.fixture(scope="module")
def environment(install: Path) -> dict[str, str]:
    return {
        **sourced(install),
        "ROS_DOMAIN_ID": str(free_domain_id()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(install.parent / "ros_log"),
        "PYTHONUNBUFFERED": "1",
    }


def executable(install: Path, name: str) -> str:
    return str(install / "humanpred_ros" / "lib" / "humanpred_ros" / name)


def packaged(folder: Path) -> set[str]:
    """Return the data files below a source or share folder, as colcon itself adds more beside them."""
    files = {
        file.relative_to(folder).as_posix()
        for name in ("config", "launch", "urdf", "bags")
        for file in (folder / name).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    return files | {name.name for name in [folder / "package.xml"] if name.is_file()}


def test_the_install_space_holds_everything(workspace: Path, install: Path, environment: dict[str, str]) -> None:
    prefix = install / "humanpred_ros"
    assert {file.name for file in (prefix / "lib" / "humanpred_ros").iterdir()} == {*NODES, *PROGRAMS}
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / "humanpred_ros").is_file()
    share = prefix / "share" / "humanpred_ros"
    assert packaged(share) == packaged(workspace / "src" / "humanpred_ros")
    assert str(prefix) in environment["AMENT_PREFIX_PATH"].split(os.pathsep)
    # The installed code finds the installed data, also where a checkout is installed beside it (pip -e).
    code = "from humanpred_ros.resources import share_directory; print(share_directory())"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=workspace, env=environment, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()) == share


def test_a_build_with_links_runs_the_sources(workspace: Path) -> None:
    install = build(workspace, "linked", "--symlink-install")
    assert {file.name for file in (install / "humanpred_ros" / "lib" / "humanpred_ros").iterdir()} >= set(NODES)
    source = workspace / "src" / "humanpred_ros" / "config" / "nodes.yaml"
    assert (install / "humanpred_ros" / "share" / "humanpred_ros" / "config" / "nodes.yaml").resolve() == source
    done = subprocess.run(
        [executable(install, "humanpred"), "--help"],
        cwd=workspace,
        env=sourced(install),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "demo" in done.stdout


class Diagnostics:
    """Listens to /diagnostics on one domain and keeps what each node said last."""

    def __init__(self, domain_id: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("diagnostics_listener", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.last: dict[str, str] = {}
        self.node.create_subscription(DiagnosticArray, topics.DIAGNOSTICS, self.on_message, 64)

    def on_message(self, message: DiagnosticArray) -> None:
        self.last |= {status.name: status.message for status in message.status}

    def heard(self, *names: str) -> bool:
        self.executor.spin_once(timeout_sec=0.02)
        return set(names) <= self.last.keys()

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def diagnostics(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Iterator[Diagnostics]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", environment["ROS_AUTOMATIC_DISCOVERY_RANGE"])
    listener = Diagnostics(int(environment["ROS_DOMAIN_ID"]))
    yield listener
    listener.close()


@contextmanager
def running(
    install: Path, environment: dict[str, str], parameters: dict[str, list[str]]
) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run installed nodes with `name:=value` parameters; none outlives the block."""
    processes: dict[str, subprocess.Popen[bytes]] = {}
    try:
        for name, given in parameters.items():
            arguments = [part for text in given for part in ("-p", text)]
            processes[name] = subprocess.Popen(
                [executable(install, name), "--ros-args", *arguments], cwd=install.parent, env=environment
            )
        yield processes
    finally:
        for process in processes.values():
            process.kill()
            process.wait()


def interrupted(process: subprocess.Popen[bytes]) -> int:
    """Return the status with which a process ends after Ctrl-C; one that has ended already keeps its own."""
    process.send_signal(signal.SIGINT)
    return process.wait(timeout=20)


def test_every_executable_joins_the_graph(install: Path, environment: dict[str, str], diagnostics: Diagnostics) -> None:
    scene = "scene:=side_by_side"
    graph = {
        "stomp_planner": [scene, "controller:=simulated_arm", "listener:=skeleton_tracker_replay"],
        "simulated_arm": [scene],
        # The baseline needs no training, which would take most of this test's time.
        "occupancy_predictor": [scene, "predictor:=current", "listener:=stomp_planner"],
        "run_recorder": ["output:=bag"],
        "skeleton_tracker_replay": [
            "wait_for:='stomp_planner,simulated_arm,occupancy_predictor,run_recorder'",
            "listener:=occupancy_predictor",
            "hold_last_s:=0.0",
        ],
    }
    with running(install, environment, graph) as processes:
        wait_until(lambda: diagnostics.heard(*graph), f"{', '.join(graph)} on /diagnostics", 120.0)
        tracker = processes["skeleton_tracker_replay"]
        wait_until(lambda: diagnostics.heard() and tracker.poll() is not None, "the end of the replay", 120.0)
        assert {name: interrupted(process) for name, process in processes.items()} == dict.fromkeys(graph, 0)
    with running(install, environment, {"occupancy_replay": ["bag:=bag"]}) as processes:
        wait_until(lambda: diagnostics.heard("occupancy_replay"), "occupancy_replay on /diagnostics")
        assert (
            diagnostics.last["occupancy_replay"]
            == f"waiting for stomp_planner to subscribe to /{topics.COMPACT_OCCUPANCY}"
        )
        assert interrupted(processes["occupancy_replay"]) == 0


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("simulated_arm", ["-p", "rate_hz:=50"], ["rate_hz", "wanted a number with a decimal point", "got 50", "50.0"]),
        ("stomp_planner", ["-p", "seed:=-1"], ["seed", "wanted a value from 0 to", "got -1"]),
        ("skeleton_tracker_replay", ["-p", "trajectry:='0/0'"], ["trajectry", "did you mean trajectory?"]),
        ("occupancy_predictor", ["-p", "scene:=nowhere"], ["nowhere", "face_to_face", "side_by_side"]),
        ("run_recorder", [], ["output", "wanted the folder"]),
        ("occupancy_replay", ["-p", "bag:=no_such_bag"], ["no_such_bag", "wanted a bag"]),
        ("simulated_arm", ["--scene", "side_by_side"], ["--scene", "-p"]),
    ],
)
def test_what_cannot_be_used_ends_with_one_line_and_status_2(
    name: str, arguments: list[str], words: list[str], install: Path, environment: dict[str, str], tmp_path: Path
) -> None:
    done = subprocess.run(
        [executable(install, name), "--ros-args", *arguments],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    for word in words:
        assert word in line
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=free_domain_id(), signal_handler_options=SignalHandlerOptions.NO)
    yield context
    rclpy.shutdown(context=context)


def declared(context: Any, name: str, **given: Any) -> Any:
    """Return the settings of a node that was given parameters."""
    overrides = [Parameter(key, value=value) for key, value in given.items()]
    node = Node(name, context=context, parameter_overrides=overrides)
    try:
        return declare(node, NODES[name])
    finally:
        node.destroy_node()


@pytest.mark.parametrize("name", NODES)
def test_without_parameters_the_defaults_are_in_force(context: Any, name: str) -> None:
    assert declared(context, name) == NODES[name]()


def test_parameters_are_read(context: Any) -> None:
    got = declared(context, "stomp_planner", seed=7, period_s=0.25, lossless=True, scene="side_by_side")
    assert got == NODES["stomp_planner"](seed=7, period_s=0.25, lossless=True, scene="side_by_side")


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("skeleton_tracker_replay", {"trajectory": 3}, r"wanted text, got 3; quote it .*trajectory:='3'"),
        ("skeleton_tracker_replay", {"publish_clock": "yes"}, r"wanted true or false, got 'yes'$"),
        ("stomp_planner", {"seed": 1.5}, r"wanted a whole number, got 1\.5$"),
        ("stomp_planner", {"scene": ["a", "b"]}, r"wanted text, got \['a', 'b'\]$"),
        ("stomp_planner", {"period_s": float("nan")}, r"wanted a value from 0\.02 to 10\.0, got nan"),
        ("stomp_planner", {"threads": 65}, r"wanted a value from 1 to 64, got 65"),
        ("simulated_arm", {"rate_hz": float("inf")}, r"got inf"),
        ("simulated_arm", {"nothing_like_it": 1}, r"has none of that name; it has .*scene, rate_hz"),
        (
            "occupancy_predictor",
            {"places": "3 0 0 1"},
            r"wanted a list of texts, .*places:=\"\['3 0 0 1'\]\"",
        ),
        # A field of the planner's own configuration is not a parameter.
        ("stomp_planner", {"n_waypoints": 50}, r"did you mean waypoints\?"),
    ],
)
def test_a_parameter_that_cannot_be_used_is_named(context: Any, name: str, given: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        declared(context, name, **given)


def test_a_list_may_be_empty(context: Any) -> None:
    told = declared(context, "occupancy_predictor", places=["3 0 0 1", "4 0 1 1"])
    assert told.places == ("3 0 0 1", "4 0 1 1")
    # ROS reads [] in a file or an argument as a parameter without a value.
    assert declared(context, "occupancy_predictor", places=None).places == ("",)


def test_parameters_meant_for_all_nodes_pass(context: Any) -> None:
    shared = {"scene": "side_by_side", "use_sim_time": True}
    quality = {"qos_overrides./diagnostics.publisher.depth": 3}
    assert declared(context, "simulated_arm", **shared, **quality).scene == "side_by_side"


class Recorded:
    """Stands in for the classes of launch, which no wheel provides: keeps what it was made with."""

    def __init__(self, *positional: Any, **named: Any) -> None:
        self.positional, self.named = positional, named

    def perform(self, context: dict[str, str]) -> str:
        """Return the value of a LaunchConfiguration."""
        return context[self.positional[0]]


def launch_file() -> ModuleType:
    spec = importlib.util.spec_from_file_location("human_aware_arm", LAUNCH_FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Return a function that gives what the launch file starts with some arguments, by name, without launch."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    used = {
        "launch": ["Action", "LaunchContext", "LaunchDescription"],
        "launch.actions": ["DeclareLaunchArgument", "OpaqueFunction", "SetEnvironmentVariable", "Shutdown"],
        "launch.substitutions": ["LaunchConfiguration"],
        "launch_ros": [],
        "launch_ros.actions": ["Node"],
        "launch_ros.parameter_descriptions": ["ParameterValue"],
    }
    for name, classes in used.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, each, type(each, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    *arguments, graph = launch_file().generate_launch_description().positional[0]
    defaults = {each.positional[0]: each.named["default_value"] for each in arguments}

    def started(**given: str) -> dict[str, Any]:
        assert given.keys() <= defaults.keys()
        actions = graph.named["function"]({**defaults, **given})
        return {each.named.get("executable", type(each).__name__): each for each in actions}

    return started


def given_to(node: Any) -> dict[str, Any]:
    """Return the parameters of a node of the launch file, a launch argument as its text; check names and types."""
    assert node.named["package"] == "humanpred_ros"
    fields = NODES[node.named["executable"]].model_fields
    values = {}
    for name, value in next((each for each in node.named["parameters"] if isinstance(each, dict)), {}).items():
        values[name] = value
        if name == "use_sim_time":
            continue
        kind = type(fields[name].default)
        if isinstance(value, Recorded):  # a launch argument with its type
            assert value.named["value_type"] == (List[str] if kind is tuple else kind)  # noqa: UP006
            (values[name],) = value.positional
        else:
            assert type(value) is kind
    return values


def test_launch_starts_a_demonstration_by_itself(launched: Callable[..., dict[str, Any]]) -> None:
    arguments = {
        "record": "run_bag", "trajectory": "3", "scene": "four_places", "library": "a", "model": "m.npz",
        "predictor": "reaching", "human": "mocap23", "body_id": "x", "places": "['3 0 0 1']", "use_sim_time": "true",
    }  # fmt: skip
    for given in ({}, arguments):
        nodes = launched(**given)
        told = {name: given_to(node) for name, node in nodes.items()}
        expected = {"simulated_arm", "stomp_planner", "occupancy_predictor", "skeleton_tracker_replay"}
        assert set(nodes) == expected | ({"run_recorder"} if given else set())
        replay = told["skeleton_tracker_replay"]
        assert set(replay["wait_for"].split(",")) == set(nodes) - {"skeleton_tracker_replay"}
        listeners = {name: each.get("listener", each.get("controller")) for name, each in told.items()}
        assert listeners["skeleton_tracker_replay"] == "occupancy_predictor"
        assert listeners["occupancy_predictor"] == "stomp_planner"
        assert (told["stomp_planner"]["controller"], listeners["stomp_planner"]) == (
            "simulated_arm",
            "skeleton_tracker_replay",
        )
        for name, value in given.items():
            assert value in [each[name] for each in told.values() if name in each] or name in ("record", "use_sim_time")
    assert told["run_recorder"]["output"] == "run_bag"
    assert replay["publish_clock"] is True
    assert {name for name, each in told.items() if each.get("use_sim_time")} == expected - {"skeleton_tracker_replay"}


@pytest.mark.parametrize("left_out", ["arm", "tracker", "predictor_node", "planner"])
def test_launch_leaves_out_what_others_do(left_out: str, launched: Callable[..., dict[str, Any]]) -> None:
    nodes = launched(**{left_out: "false"})
    assert len(nodes) == 3
    waited_for = " ".join(str(value) for node in nodes.values() for value in given_to(node).values())
    missing = next(
        iter({"simulated_arm", "stomp_planner", "occupancy_predictor", "skeleton_tracker_replay"} - set(nodes))
    )
    assert missing not in waited_for, "nobody waits for a node that is not started"


def test_launch_of_predictor_and_planner_in_one_process(launched: Callable[..., dict[str, Any]]) -> None:
    nodes = launched(one_process="true", guard="true", predictor="current", places="['3 0 0 1']")
    assert set(nodes) == {"simulated_arm", "separation_guard", "predict_and_plan", "skeleton_tracker_replay"}
    (told,) = nodes["predict_and_plan"].named["parameters"]
    either = {**NODES["stomp_planner"].model_fields, **NODES["occupancy_predictor"].model_fields}
    assert {"controller", "guard", "predictor", "places"} <= told.keys() <= either.keys()
    waited_for = given_to(nodes["skeleton_tracker_replay"])["wait_for"]
    assert set(waited_for.split(",")) >= {"stomp_planner", "occupancy_predictor"}


def test_launch_with_a_live_tracker(launched: Callable[..., dict[str, Any]]) -> None:
    nodes = launched(live_tracker="true", skeleton="coco17", points_topic="/camera/people", scene="four_places")
    assert set(nodes) == {"simulated_arm", "stomp_planner", "occupancy_predictor", "skeleton_tracker"}
    told = given_to(nodes["skeleton_tracker"])
    assert (told["skeleton"], told["topic"], told["scene"]) == ("coco17", "/camera/people", "four_places")
    assert told["listener"] == "occupancy_predictor"


def test_launch_with_rviz(launched: Callable[..., dict[str, Any]]) -> None:
    nodes = launched(rviz="true", scene="ur5_face_to_face")
    flag, file = nodes["rviz2"].named["arguments"]
    (described,) = nodes["robot_state_publisher"].named["parameters"][0].values()
    assert '<link name="world"' in described.positional[0]
    assert "robot_state_publisher" not in launched(rviz="true", arm="false")
    assert (flag, Path(file).is_file()) == ("-d", True)


def test_launch_in_operation(launched: Callable[..., dict[str, Any]]) -> None:
    nodes = launched(
        demo="false", guard="true", managed="true", record="bag", domain="7", namespace="robot1",
        params_file="mine.yaml", trajectory_topic="/real/joint_trajectory", joint_states_topic="/joint_states",
    )  # fmt: skip
    assert nodes.pop("SetEnvironmentVariable").positional == ("ROS_DOMAIN_ID", "7")
    demonstration = {"simulated_arm", "stomp_planner", "occupancy_predictor", "skeleton_tracker_replay"}
    assert set(nodes) == demonstration | {"separation_guard", "run_recorder"}
    for node in nodes.values():
        assert given_to(node)["managed"] is True
        assert node.named["namespace"] == "robot1"
        assert node.named["parameters"][0] == "mine.yaml", "what is given on the command line comes after it"
        assert (topics.TRAJECTORY, "/real/joint_trajectory") in node.named["remappings"]
    assert given_to(nodes["stomp_planner"])["guard"] is given_to(nodes["simulated_arm"])["guard"] is True
    # What ends: the recorder and the replay alone; planner, predictor and guard come back, unless they cannot.
    policies = {name: (node.named.get("respawn", False), node.named.get("on_exit")) for name, node in nodes.items()}
    assert policies["run_recorder"] == policies["skeleton_tracker_replay"] == (False, None)
    assert type(policies["simulated_arm"][1]).__name__ == "Shutdown"
    for name in ("stomp_planner", "occupancy_predictor", "separation_guard"):
        respawn, on_exit = policies[name]
        assert respawn
        assert on_exit(SimpleNamespace(returncode=-9, process_name=name), None) == []
        (end,) = on_exit(SimpleNamespace(returncode=2, process_name=name), None)
        assert name in end.named["reason"]
    assert type(launched()["skeleton_tracker_replay"].named["on_exit"]).__name__ == "Shutdown"
    with pytest.raises(RuntimeError, match="launch argument planner: wanted true or false, got maybe"):
        launched(planner="maybe")


def test_launch_accepts_the_launch_file() -> None:
    pytest.importorskip("launch_ros", reason="needs a ROS installation: launch is in no wheel")
    from launch import LaunchContext

    description = launch_file().generate_launch_description()
    names = [argument.name for argument in description.get_launch_arguments()]
    assert {"scene", "planner", "namespace", "record"} <= set(names)
    context = LaunchContext()
    for argument in description.get_launch_arguments():
        argument.execute(context)
    nodes = launch_file().graph(context)
    assert len(nodes) == 4
    for node in nodes:
        node._perform_substitutions(context)
