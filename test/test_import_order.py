"""The folders are the order of the data: a package imports only from packages above it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from paths import REPOSITORY

ORDER = (
    "geometry", "bags", "human", "motion", "recognition", "occupancy", "stomp", "reaching", "robot", "planning",
    "viewing", "api", "__init__", "evaluation", "nodes", "commands", "cli",
)  # fmt: skip
SHARED = {"errors", "files", "plugins", "resources", "settings", "topics", "__version__"}
ROS_MODULES = {
    "rclpy", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "rcl_interfaces", "rosgraph_msgs",
    "sensor_msgs", "std_msgs", "trajectory_msgs", "visualization_msgs",
}  # fmt: skip
SOURCES = sorted((REPOSITORY / "humanpred_ros").rglob("*.py"))


def imported_modules(source: Path) -> list[str]:
    modules = []
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: relative import"
            module = node.module or ""
            modules += [f"{module}.{alias.name}" for alias in node.names] if module == "humanpred_ros" else [module]
    return modules


@pytest.mark.parametrize("source", SOURCES, ids=lambda source: str(source.relative_to(REPOSITORY)))
def test_imports_point_upwards(source: Path) -> None:
    part = source.relative_to(REPOSITORY / "humanpred_ros").parts[0].removesuffix(".py")
    for module in imported_modules(source):
        names = module.split(".")
        if names[0] in ROS_MODULES:
            assert part == "nodes", f"{module}: only nodes/ may import ROS"
        if names[0] == "humanpred_ros" and len(names) > 1 and names[1] not in SHARED:
            assert part in ORDER, f"{part} is shared by all and must not import {module}"
            assert ORDER.index(names[1]) <= ORDER.index(part), f"{part} must not import {module}"


def test_every_package_has_its_place() -> None:
    packages = {path.name for path in (REPOSITORY / "humanpred_ros").iterdir() if (path / "__init__.py").exists()}
    assert packages <= set(ORDER)
