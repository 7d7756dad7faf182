"""Whether this machine has what the package needs, and what to do about what it lacks: `humanpred doctor`.

Everything is tried: libraries are imported, two participants find each other over DDS, robots and scenes are read.
"""

from __future__ import annotations

import importlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.table import Table

from humanpred_ros import __version__
from humanpred_ros.errors import HumanPredError, RobotError, one_line
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.resources import cache_root, share_file
from humanpred_ros.robot.robot import load_robot
from humanpred_ros.robot.robot_file import robot_names
from humanpred_ros.robot.scene_file import read_scene_file, scene_names
from humanpred_ros.settings import Settings

#: Libraries that results depend on, by what they are imported as.
_LIBRARIES = {
    "numpy": "numpy", "scipy": "scipy", "numba": "numba", "sklearn": "scikit-learn", "pinocchio": "pin",
    "mcap": "mcap", "rosbags": "rosbags", "pydantic": "pydantic", "yourdfpy": "yourdfpy", "matplotlib": "matplotlib",
}  # fmt: skip
#: Without these something is left out, and the rest works.
_EXTRAS = {"viser": ("view", "views in a browser"), "ezc3d": ("markers", "C3D files"), "mkdocs": ("docs", "the site")}
_INSTALL = "pip install -c constraints.txt -e '.[ros,view]'"
_TOPIC, _WAIT_S, _LEAST_FREE_GB = "humanpred_doctor", 20.0, 1.0

Check = Iterator[tuple[str, str]]  # what was found, and what to do: empty where all is well


class DoctorSettings(Settings):
    """Settings of `humanpred doctor`."""


def run(settings: DoctorSettings, console: Console) -> int:
    """Say of each thing that is needed whether it is there, and what to do; the exit status is 1 if something lacks."""
    del settings
    lacking = 0
    table = Table("", "", "found, and what to do", box=None)
    for name, check in _CHECKS.items():
        with console.status(f"looking at {name}"):
            try:
                found = list(check())
            except (HumanPredError, ImportError, OSError) as trouble:
                found = [(one_line(str(trouble)), f"repair it, or {_INSTALL}")]
        for what, to_do in found:
            lacking += bool(to_do)
            table.add_row(name, "!" if to_do else "ok", f"{what}: {to_do}" if to_do else what)
    console.print(table)
    console.print(f"{lacking} to mend" if lacking else "this machine has what it needs: humanpred demo")
    return 1 if lacking else 0


def versions() -> str:
    """Return the versions that results depend on, the package's in the first line."""
    found = [f"{name} {_version(name) or 'not installed'}" for name in _LIBRARIES.values()]
    python = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    return "\n".join([f"humanpred_ros {__version__}", python, ", ".join(found[:5]), ", ".join(found[5:]), _ros()])


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return ""


def _ros() -> str:
    """Return which ROS there is, in words; empty if there is none."""
    spec = find_spec("rclpy")
    if spec is None:
        return ""
    wheel = _version("ros-jazzy-rclpy")
    if wheel:
        return f"ROS 2 Jazzy from wheels, rclpy {_version('ros-rclpy') or wheel}"
    return (
        f"ROS 2 {os.environ.get('ROS_DISTRO', 'of an unknown name')} installed at {Path(str(spec.origin)).parents[4]}"
    )


def _python() -> Check:
    fits = (3, 10) <= sys.version_info < (3, 14)
    yield platform.python_version(), "" if fits else "take Python 3.10 to 3.13"


def _libraries() -> Check:
    found = []
    for module, distribution in _LIBRARIES.items():
        try:
            loaded = importlib.import_module(module)
            found.append(f"{distribution} {_version(distribution) or getattr(loaded, '__version__', '')}".strip())
        except ImportError as trouble:
            yield f"{distribution} cannot be imported ({one_line(str(trouble))})", _INSTALL
    yield ", ".join(found), ""


def _extras() -> Check:
    missing = {extra: what for module, (extra, what) in _EXTRAS.items() if find_spec(module) is None}
    yield "all" if not missing else "without " + ", ".join(f"{extra} ({what})" for extra, what in missing.items()), ""


def _ros_found() -> Check:
    yield _ros() or "none", "" if _ros() else f"{_INSTALL}, or source /opt/ros/jazzy/setup.bash first"


def _discovery() -> Check:
    """Let two processes find each other and exchange a message on a free domain of this host."""
    if not _ros():
        yield "not tried", "ROS comes first"
        return
    domain = free_domain_id()
    for transports, to_do in (("", ""), ("UDPv4", "set FASTDDS_BUILTIN_TRANSPORTS=UDPv4 for all nodes")):
        began = time.monotonic()
        trouble = _exchanged(domain, transports)
        if not trouble:
            took = f"two participants met on domain {domain} in {time.monotonic() - began:.1f} s"
            yield took + (", but only without shared memory" if to_do else ""), to_do
            return
    yield trouble, "look at firewall, loopback multicast and /dev/shm"


def _exchanged(domain: int, transports: str) -> str:
    """Return why no message went from one process to another; empty if one did."""
    environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    if transports:
        environment["FASTDDS_BUILTIN_TRANSPORTS"] = transports
    command = [sys.executable, "-m", "humanpred_ros.nodes.doctor"]
    talker = subprocess.Popen([*command, "talk"], env=environment, stderr=subprocess.DEVNULL)
    try:
        heard = subprocess.run([*command, "listen"], env=environment, capture_output=True, text=True, check=False)
    finally:
        talker.terminate()
        talker.wait()
    return "" if heard.returncode == 0 else (heard.stderr.strip().splitlines() or ["nothing was heard"])[-1]


def _domain() -> Check:
    names = (
        "ROS_DOMAIN_ID ROS_AUTOMATIC_DISCOVERY_RANGE ROS_STATIC_PEERS RMW_IMPLEMENTATION FASTRTPS_DEFAULT_PROFILES_FILE"
    )
    told = {name: os.environ.get(name) for name in names.split()}
    yield ", ".join(f"{name}={value}" for name, value in told.items() if value) or "nothing set", ""


def _cache() -> Check:
    root = cache_root()
    try:
        if root is None:
            raise OSError("no home")
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            size = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
        yield f"{root}, {size / 1e6:.0f} MB", ""
    except OSError as trouble:
        yield f"{root} cannot be written ({trouble})", "set XDG_CACHE_HOME: else every start compiles for a minute"


def _disk() -> Check:
    free_gb = shutil.disk_usage(".").free / 1e9
    yield f"{free_gb:.1f} GB free here", "" if free_gb >= _LEAST_FREE_GB else "make room: a run takes some 10 MB"


def _robots() -> Check:
    lacking = []
    for name in robot_names():
        try:
            load_robot(name)
        except RobotError:
            lacking.append(name)
    found = ", ".join(name for name in robot_names() if name not in lacking)
    yield found + (f"; without {', '.join(lacking)} (extra robots)" if lacking else ""), "" if found else _INSTALL


def _scenes() -> Check:
    for name in scene_names():
        read_scene_file(name)
    yield ", ".join(scene_names()), ""


def _data() -> Check:
    yield str(share_file("bags")), ""


_CHECKS: dict[str, Callable[[], Check]] = {
    "Python": _python, "libraries": _libraries, "extras": _extras, "ROS": _ros_found, "environment": _domain,
    "DDS": _discovery, "cache": _cache, "disk": _disk, "data": _data, "robots": _robots, "scenes": _scenes,
}  # fmt: skip


def _participate(listens: bool) -> int:
    """Talk, or listen until something is heard; return the exit status."""
    import rclpy
    from std_msgs.msg import String

    rclpy.init(args=[])
    heard: list[String] = []
    try:
        node = rclpy.create_node(f"humanpred_doctor_{'listens' if listens else 'talks'}")
        publisher = None if listens else node.create_publisher(String, _TOPIC, 10)
        if listens:
            node.create_subscription(String, _TOPIC, heard.append, 10)
        end_s = time.monotonic() + (1.0 if listens else 2.0) * _WAIT_S
        while not heard and time.monotonic() < end_s:
            if publisher is not None:
                publisher.publish(String(data="here"))
            rclpy.spin_once(node, timeout_sec=0.05)
    finally:
        rclpy.try_shutdown()
    if listens and not heard:
        print(f"two participants did not meet within {_WAIT_S:g} s", file=sys.stderr)
    return 0 if heard or not listens else 1


if __name__ == "__main__":
    sys.exit(_participate(sys.argv[1:] == ["listen"]))
