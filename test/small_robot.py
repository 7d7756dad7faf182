"""A small robot written as a user would write one: a URDF of boxes, cylinders and spheres, and its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

_LIMIT = '<limit lower="-2.5" upper="2.5" velocity="2" effort="1"/>'


def _link(name: str, shape: str, xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    collision = f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></collision>' if shape else ""
    return f'<link name="{name}">{collision}</link>'


def _joint(name: str, kind: str, parent: str, child: str, xyz: str, axis: str = "0 1 0", more: str = _LIMIT) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{xyz}"/>'
        f'<axis xyz="{axis}"/>{more if kind != "fixed" else ""}</joint>'
    )


FINGER = '<limit lower="0" upper="0.04" velocity="0.1" effort="1"/>'
URDF = "".join(
    [
        '<robot name="small">',
        _link("floor", ""),
        _link("base", '<box size="0.2 0.2 0.2"/>', "0 0 0.1"),
        _link("turret", '<cylinder radius="0.08" length="0.2"/>', "0 0 0.1"),
        _link("upper", '<cylinder radius="0.05" length="0.4"/>', "0 0 0.2"),
        _link("fore", '<box size="0.08 0.08 0.4"/>', "0 0 0.2"),
        _link("hand", '<sphere radius="0.06"/>', "0 0 0.05"),
        _link("left", '<box size="0.02 0.02 0.08"/>', "0 0.02 0.04"),
        _link("right", '<box size="0.02 0.02 0.08"/>', "0 -0.02 0.04"),
        _link("tool", ""),
        _joint("stand", "fixed", "floor", "base", "0 0 0"),
        _joint("turn", "continuous", "base", "turret", "0 0 0.2", "0 0 1", '<limit velocity="2" effort="1"/>'),
        _joint("lift", "revolute", "turret", "upper", "0 0 0.2"),
        _joint("bend", "revolute", "upper", "fore", "0 0 0.4"),
        _joint("roll", "revolute", "fore", "hand", "0 0 0.4", "0 0 1"),
        _joint("grip", "prismatic", "hand", "left", "0 0 0.08", "0 1 0", FINGER),
        _joint("grip2", "prismatic", "hand", "right", "0 0 0.08", "0 -1 0", FINGER + '<mimic joint="grip"/>'),
        _joint("reach", "fixed", "hand", "tool", "0 0 0.18"),
        "</robot>",
    ]
)
FILE: dict[str, Any] = {
    "name": "small",
    "description": "small.urdf",
    "joints": ["turn", "lift", "bend", "roll"],
    "tool_frame": "tool",
    "standing": {"grip": 0.02},
}


def write_robot(folder: Path, *, urdf: str = URDF, **changes: Any) -> Path:
    """Write the robot into a folder and return its file; changes replace the file's keys, None removes one."""
    (folder / "small.urdf").write_text(urdf)
    path = folder / "small.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in {**FILE, **changes}.items() if value is not None}))
    return path
