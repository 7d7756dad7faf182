"""Makes as much of control_msgs as FollowJointTrajectory needs, where it is not installed: no wheel has it.

The definitions have the fields that are documented of the real ones; rosidl's generators, which come with rclpy,
turn them into sources, and the C compiler makes the libraries that rclpy loads.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.errors import UsageError

#: Exit status where the compiler, a generator or a header file is missing.
_MISSING = 3

_DEFINITIONS = {
    "msg/JointTolerance.msg": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n",
    "action/FollowJointTrajectory.action": """
trajectory_msgs/JointTrajectory trajectory
JointTolerance[] path_tolerance
JointTolerance[] goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
""",
}
_NAME = "control_msgs"
_USED = (
    "action_msgs",
    "builtin_interfaces",
    "service_msgs",
    "std_msgs",
    "trajectory_msgs",
    "unique_identifier_msgs",
)
_FAST, _INTROSPECTION = "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"


@pytest.fixture(scope="session")
def control_msgs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let this process, and those it starts, find control_msgs: the installed one, else one that is made here."""
    from humanpred_ros.nodes.trajectory_action import action_type

    try:
        action_type()
        yield
        return
    except UsageError:
        folder = tmp_path_factory.mktemp("control_msgs")
    environment = {"AMENT_PREFIX_PATH": sys.prefix, **os.environ}
    made = subprocess.run([sys.executable, __file__, str(folder)], env=environment, capture_output=True, text=True)
    if made.returncode == _MISSING:
        pytest.skip(f"control_msgs is not installed and cannot be made: {made.stdout}")
    assert made.returncode == 0, made.stderr
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
        yield


def make(folder: Path) -> None:
    """Write the importable package into a folder.

    Raises:
        ImportError: a generator is missing.
        OSError: the C compiler or the header files of Python are missing.
        subprocess.CalledProcessError: the compiler reports an error.
    """
    from ament_index_python import get_package_prefix
    from rosidl_adapter.cli import TranslateActionToIDL, TranslateMsgToIDL
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    python_headers = Path(sysconfig.get_paths()["include"])
    if not (python_headers / "Python.h").exists():
        raise FileNotFoundError(f"Python.h is not in {python_headers}")
    prefixes = {name: Path(get_package_prefix(name)) for name in _USED}
    for name, text in _DEFINITIONS.items():
        (folder / "source" / name).parent.mkdir(parents=True)
        (folder / "source" / name).write_text(text, encoding="utf-8")
    share = folder / "share" / _NAME
    uses = [str(prefix / "share" / name) for name, prefix in prefixes.items()] + [str(share)]
    idl = [
        *TranslateMsgToIDL("").translate(_NAME, [f"{folder}/source:msg/JointTolerance.msg"], uses, share),
        *TranslateActionToIDL("").translate(
            _NAME, [f"{folder}/source:action/FollowJointTrajectory.action"], uses, share
        ),
    ]
    package, introspection = folder / _NAME, folder / "introspection" / _NAME
    (package / "msg").mkdir(parents=True)
    (package / "__init__.py").touch()
    for generator, out in (
        (GenerateC(""), package),
        (GeneratePython("", typesupport_implementations=["rosidl_typesupport_c"]), package),
        (GenerateCTypesupport("", typesupport_implementations=[_FAST, _INTROSPECTION]), package),
        (GenerateFastRTPSCTypesupport(""), package),
        (GenerateIntrospectionCTypesupport(""), introspection),  # some of its files have the names of others
    ):
        generator.generate(_NAME, idl, uses, output_path=out)

    roots = set(prefixes.values())
    headers = [folder, introspection.parent, python_headers, Path(np.get_include())]
    headers += [path for root in roots for path in (root / "include", *(root / "include").iterdir())]
    for_python = {*package.glob("*/_*_s.c"), *package.glob("_*.c")}
    others = {*package.rglob("*.c"), *package.rglob("*.cpp")} - for_python
    used = [f"{name}__{part}" for name in _USED for part in ("rosidl_generator_c", "rosidl_generator_py")]
    used += [f"{name}__{part}" for name in _USED for part in ("rosidl_typesupport_c", _FAST, _INTROSPECTION)]
    used += ["rosidl_runtime_c", "rosidl_typesupport_c", _FAST, "rosidl_typesupport_fastrtps_cpp", _INTROSPECTION]
    used += ["rmw", "rcutils", "fastcdr", "stdc++"]

    def library(name: str, sources: set[Path], *own: str) -> None:
        command = ["cc", "-w", "-O0", "-fPIC", "-shared", "-o", package / name, f"-Wl,-soname,{name}", *sources]
        command += [f"-I{path}" for path in headers if path.is_dir()]
        command += [f"-L{package}", "-Wl,-rpath,$ORIGIN", "-Wl,--no-as-needed", *(f"-l{_NAME}__{part}" for part in own)]
        command += ["-Wl,--as-needed", *(f"-L{root / 'lib'}" for root in roots), *(f"-l{part}" for part in used)]
        subprocess.run([str(word) for word in command], check=True)

    library(f"lib{_NAME}__{_FAST}.so", others)
    library(f"lib{_NAME}__{_INTROSPECTION}.so", set(introspection.rglob("*.c")), _FAST)
    # ROS looks for the two by name: they are found because this one has loaded them.
    library(f"{_NAME}_s__rosidl_typesupport_c.so", for_python, _FAST, _INTROSPECTION)


if __name__ == "__main__":
    logging.disable(logging.WARNING)
    try:
        make(Path(sys.argv[1]).absolute())
    except (ImportError, OSError) as missing:
        print(missing)
        sys.exit(_MISSING)
