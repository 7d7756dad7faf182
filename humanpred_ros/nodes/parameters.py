"""ROS parameters from the settings dataclasses: declared, checked and read in one call."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from humanpred_ros.errors import UsageError
from humanpred_ros.nodes import settings as all_settings

Settings = TypeVar("Settings")

_KINDS = {
    str: "text",
    bool: "true or false",
    int: "a whole number",
    float: "a number with a decimal point",
    tuple: "a list of texts",
}
#: Declared by rclpy itself, some only once a publisher or subscription asks for them.
_RCLPY_PREFIXES = ("qos_overrides.",)


def declare(node: Node, settings: type[Settings]) -> Settings:
    """Declare one ROS parameter per field of `settings`, read-only unless it may change, and return their values.

    Raises:
        UsageError: a parameter of the wrong type or outside its range, or of a name that no node of this
            package has (ROS itself would ignore it).
    """
    # rclpy offers no public way to see what was given before it is declared.
    given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
    _refuse_unknown(node, settings, list(given))
    values: dict[str, Any] = {}
    for item in fields(settings):  # type: ignore[arg-type]
        name, default, description = item.name, item.default, item.metadata["description"]
        low, high = item.metadata["low"], item.metadata["high"]
        descriptor = ParameterDescriptor(description=description, read_only=not item.metadata["changeable"])
        if low is not None and isinstance(default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
        elif low is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
        try:
            values[name] = node.declare_parameter(name, _plain(default), descriptor).value
        except InvalidParameterTypeException as trouble:
            raise UsageError(
                f"parameter {name} ({description}): wanted {_KINDS[type(default)]}, "
                f"got {given[name]!r}{_remedy(name, default, given[name])}"
            ) from trouble
        except InvalidParameterValueException as trouble:
            raise UsageError(
                f"parameter {name} ({description}): wanted a value from {low} to {high}, got {given[name]!r}"
            ) from trouble
        if isinstance(default, tuple):
            # An empty list has no type in ROS, so that it arrives as if nothing had been given.
            values[name] = default if values[name] is None else tuple(values[name])
    return settings(**values)


def _plain(default: Any) -> Any:
    return list(default) if isinstance(default, tuple) else default


def _remedy(name: str, default: Any, value: Any) -> str:
    """Return how to write a value that YAML, which ROS arguments are, has read as another type."""
    if isinstance(default, float) and type(value) is int:
        return f"; write {name}:={value}.0"
    if isinstance(default, tuple) and isinstance(value, str):
        return f"; write {name}:=\"['{value}']\""
    if isinstance(default, str) and type(value) in (bool, int, float):
        return f"; quote it for YAML as well as for the shell: \"{name}:='{value}'\""
    return ""


def _refuse_unknown(node: Node, settings: type[Any], given: list[str]) -> None:
    """Refuse misspelt parameters.

    Names of this package's other nodes pass: a parameter file for /** or a launch file's SetParameter
    gives every node the same ones.
    """
    own = [item.name for item in fields(settings)]
    kinds = [kind for kind in vars(all_settings).values() if is_dataclass(kind)]
    others = {item.name for kind in kinds if kind.__module__ == all_settings.__name__ for item in fields(kind)}
    for name in given:
        known = name in own or name in others or node.has_parameter(name) or name.startswith(_RCLPY_PREFIXES)
        if not known:
            close = get_close_matches(name, own, n=1)
            advice = f"did you mean {close[0]}?" if close else f"it has {', '.join(own)}"
            raise UsageError(f"parameter {name}: {node.get_name()} has none of that name; {advice}")
