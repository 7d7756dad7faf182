"""ROS parameters from the settings dataclasses: declared, checked and read in one call."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from humanpred_ros.errors import UsageError

Settings = TypeVar("Settings")


def declare(node: Node, settings: type[Settings]) -> Settings:
    """Declare one read-only ROS parameter per field of `settings` and return the values in force.

    Raises:
        UsageError: a parameter of the wrong type or outside its range.
    """
    values: dict[str, Any] = {}
    for item in fields(settings):  # type: ignore[arg-type]
        default = item.default
        descriptor = ParameterDescriptor(description=item.metadata["description"], read_only=True)
        low, high = item.metadata["low"], item.metadata["high"]
        if low is not None and isinstance(default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
        elif low is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
        try:
            values[item.name] = node.declare_parameter(item.name, default, descriptor).value
        except InvalidParameterTypeException as trouble:
            raise UsageError(f"parameter {item.name}: wanted {type(default).__name__}; {trouble}") from trouble
        except InvalidParameterValueException as trouble:
            raise UsageError(f"parameter {item.name}: wanted a value from {low} to {high}; {trouble}") from trouble
    return settings(**values)
