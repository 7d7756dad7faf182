"""ROS parameters from settings: declared, checked and read in one call."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.files import read_yaml
from humanpred_ros.plugins import CLASSIFIERS, COST_TERMS, PREDICTORS, names, put_given
from humanpred_ros.resources import share_file
from humanpred_ros.settings import Settings, facts_of, spelled

T = TypeVar("T", bound=Settings)

_KINDS = {
    str: "text",
    bool: "true or false",
    int: "a whole number",
    float: "a number with a decimal point",
    list: "a list of texts",
}
_LARGEST_INT = 2**63 - 1
#: Why a parameter is not changed at run time.
RESTART = "cannot change at run time: start the node anew with it"
RECONFIGURE = f"{RESTART}, or clean the node up, set it, and configure it again"
#: Declared by rclpy itself, some only once a publisher or subscription asks for them.
_RCLPY_PREFIXES = ("qos_overrides.",)
#: A node that uses plug-ins has the parameter that names them.
_PLUGIN_FIELDS = {CLASSIFIERS: "classifier", PREDICTORS: "predictor", COST_TERMS: "cost_terms"}


def declare(node: Node, settings_type: type[T], later: Iterable[str] = ()) -> T:
    """Declare one ROS parameter per field of a settings class, and return their values.

    A parameter that cannot change at run time says so as its additional constraint. `later` names what stands before
    the point of parameters that the node itself declares, and checks, later.

    Raises:
        UsageError: a parameter of the wrong type, with a value that cannot be used, or of a name that this node does
            not have (ROS itself would ignore it).
    """
    given = [name for name in node._parameter_overrides if name.partition(".")[0] not in set(later)]
    _refuse_unknown(node, settings_type, given)
    values = {name: declare_setting(node, name, field) for name, field in settings_type.model_fields.items()}
    try:
        return settings_type(**values)
    except SettingsError as error:
        raise UsageError(spelled(error, settings_type, lambda name: f"parameter {name}")) from error


def declare_setting(node: Node, name: str, field: FieldInfo) -> Any:
    """Declare a parameter that is not declared yet, as the field of a settings class says, and return its value.

    Raises:
        UsageError: a value of the wrong type, or out of range.
    """
    default = list(field.default) if isinstance(field.default, tuple) else field.default
    try:
        if node.has_parameter(name):
            value = node.get_parameter(name).value
        else:
            value = node.declare_parameter(name, default, _descriptor(field, default)).value
    except (InvalidParameterTypeException, InvalidParameterValueException) as trouble:
        # rclpy offers no public way to see what was given before it is declared.
        given = node._parameter_overrides[name].value
        low, high = facts_of(field)["low"], facts_of(field)["high"]
        kind = isinstance(trouble, InvalidParameterTypeException)
        wanted = _KINDS[type(default)] if kind else f"a value from {low} to {high}"
        remedy = _remedy(name, default, given) if kind else ""
        raise UsageError(f"parameter {name} ({field.description}): wanted {wanted}, got {given!r}{remedy}") from trouble
    # An empty list has no type in ROS, so that it arrives as if nothing had been given.
    return default if value is None else value


def plugin_parameters(node: Node, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return the values given to parameters NAME.SETTING, by the names of plug-ins and their settings."""
    given: dict[str, dict[str, Any]] = {name: {} for name in names}
    for path, parameter in node._parameter_overrides.items():
        name, *keys = path.split(".")
        if name in given and keys:
            put_given(given[name], keys, parameter.value)
    return given


def declare_plugin(node: Node, name: str, settings: Settings) -> None:
    """Declare the settings that a plug-in really has as parameters NAME.SETTING, which cannot change.

    Those that ROS has no type for are left out: none, and settings within settings.
    """
    for key, field in type(settings).model_fields.items():
        value = getattr(settings, key)
        if isinstance(value, str | bool | int | float) and not node.has_parameter(f"{name}.{key}"):
            descriptor = _descriptor(field, value)
            descriptor.additional_constraints = RESTART
            node.declare_parameter(f"{name}.{key}", value, descriptor, ignore_override=True)


def _descriptor(field: FieldInfo, value: Any) -> ParameterDescriptor:
    facts = facts_of(field)
    low, high = facts["low"], facts["high"]
    # Not read-only: ROS would refuse a change without saying why.
    constraint = "" if facts["changeable"] else "; ".join(part for part in (RECONFIGURE, facts["restart"]) if part)
    descriptor = ParameterDescriptor(description=field.description, additional_constraints=constraint)
    if low is None and high is None:
        return descriptor
    if isinstance(value, int):
        limits = (-_LARGEST_INT if low is None else int(low), _LARGEST_INT if high is None else int(high))
        descriptor.integer_range = [IntegerRange(from_value=limits[0], to_value=limits[1])]
    else:
        bounds = (-sys.float_info.max if low is None else low, sys.float_info.max if high is None else high)
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(bounds[0]), to_value=float(bounds[1]))]
    return descriptor


def _remedy(name: str, default: Any, value: Any) -> str:
    """Return how to write a value that YAML, which ROS arguments are, has read as another type."""
    if isinstance(default, float) and type(value) is int:
        return f"; write {name}:={value}.0"
    if isinstance(default, list) and isinstance(value, str):
        return f"; write {name}:=\"['{value}']\""
    if isinstance(default, str) and type(value) in (bool, int, float):
        return f"; quote it for YAML as well as for the shell: \"{name}:='{value}'\""
    return ""


def _refuse_unknown(node: Node, settings_type: type[Settings], given: list[str]) -> None:
    """Refuse misspelt parameters, and those that only other nodes have.

    Those of other nodes pass where a parameter file gives them to every node, in a section with a wildcard as /**.
    """
    own = list(settings_type.model_fields)
    plugins = {name: field for group, field in _PLUGIN_FIELDS.items() for name in names(group)}
    unknown = []
    for name in given:
        # Of plug-ins that the node uses they are checked by those.
        known = name in own or plugins.get(name.partition(".")[0]) in own
        if not (known or node.has_parameter(name) or name.startswith(_RCLPY_PREFIXES)):
            unknown.append(name)
    if not unknown:
        return
    owners = parameters_of_nodes()
    for_all = _given_to_all(sys.argv)
    for name in unknown:
        head = name.partition(".")[0]
        having = [other for other, all_of_it in owners.items() if name in all_of_it or plugins.get(head) in all_of_it]
        if having and name in for_all:
            continue
        close = get_close_matches(name, own, n=1)
        if having:
            advice = (
                f"{', '.join(having)} has: -p {having[0]}:{name}:=VALUE, or a file with a section for it or for /**"
            )
        else:
            advice = f"did you mean {close[0]}?" if close else f"it has {', '.join(own)}"
        raise UsageError(f"parameter {name}: {node.get_name()} has none of that name; {advice}")


def parameters_of_nodes() -> dict[str, set[str]]:
    """Return each node's parameters as in config/nodes.yaml; importing every node to ask it would take seconds."""
    nodes = yaml.safe_load(share_file("config", "nodes.yaml").read_text(encoding="utf-8"))
    return {node: set(content["ros__parameters"]) for node, content in nodes.items()}


def _given_to_all(arguments: list[str]) -> set[str]:
    """Return the parameters that the parameter files on a command line give to nodes by wildcards."""
    found: set[str] = set()

    def look(content: Any, path: str) -> None:
        for key, value in content.items() if isinstance(content, dict) else ():
            if key == "ros__parameters":
                found.update(_flat(value) if "*" in path else ())
            else:
                look(value, f"{path}/{key}")

    for flag, file in pairwise(arguments):
        if flag == "--params-file":
            look(read_yaml(Path(file), UsageError), "")
    return found


def _flat(content: Any, prefix: str = "") -> Iterator[str]:
    """Yield the names of parameters, which may be nested."""
    for key, value in content.items() if isinstance(content, dict) else ():
        yield from _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else (f"{prefix}{key}",)
