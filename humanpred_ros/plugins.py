"""Classifiers, predictors and cost terms are found by name, whichever installed package they come from.

A package offers them as entry points (`pyproject.toml`, `setup.cfg` or `setup.py`):

    [project.entry-points."humanpred_ros.classifiers"]
    nearest_end = "my_package.nearest_end:NearestEnd"

The built-in ones are entry points of this package, declared in its setup.py. The name is what users write in node
parameters, on the command line and in scenes; the first line of the class's docstring describes it in help texts.

A class has a `settings_type`, whose fields users set by the same name: `--set nearest_end.scale_m=0.1` on the command
line, the parameter `nearest_end.scale_m` of a node.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeAlias, TypeVar

from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.files import yaml_of
from humanpred_ros.settings import Settings, spelled

#: Groups of entry points.
CLASSIFIERS = "humanpred_ros.classifiers"
PREDICTORS = "humanpred_ros.predictors"
COST_TERMS = "humanpred_ros.cost_terms"

#: What is used unless another is chosen.
DEFAULT_CLASSIFIER = "forest"
DEFAULT_PREDICTOR = "forecast"

#: What the flag --set is, wherever it is.
SET = "settings of what is chosen by name, each as NAME.SETTING=VALUE, for instance gmm.evidence=mean"

_WORDS = {CLASSIFIERS: "classifier", PREDICTORS: "predictor", COST_TERMS: "cost term"}
_PACKAGE = "humanpred_ros"

T = TypeVar("T")
S = TypeVar("S", bound=Settings)
#: Values of settings by the name of a plug-in; in a settings class that another one holds, by name again.
Given: TypeAlias = Mapping[str, Mapping[str, Any]]


def names(group: str) -> tuple[str, ...]:
    """Return the names in a group: the built-in ones first, then those of other packages, each part sorted.

    Nothing is imported.

    Raises:
        UsageError: one name given by two packages, or none at all (this package is not installed properly).
    """
    return tuple(_found(group))


def check_name(group: str, name: str) -> None:
    """Raise UsageError, with the names there are, if a name is unknown; nothing is imported."""
    if name not in _found(group):
        raise UsageError(f"{_WORDS[group]}: wanted one of {', '.join(_found(group))}, got {name!r}")


def load(group: str, name: str, base: type[T]) -> type[T]:
    """Return the class with a name.

    Args:
        group: one of the groups above.
        name: as in `names(group)`.
        base: class that it must be derived from.

    Raises:
        UsageError: an unknown name, with those there are; a class that cannot be imported, or is not derived from
            `base`.
    """
    check_name(group, name)
    point = _found(group)[name]
    try:
        loaded = point.load()
    except Exception as trouble:  # whatever another package's module raises when it is imported
        raise UsageError(
            f"{_WORDS[group]} {name}: {point.value} of package {_owner(point)} could not be imported "
            f"({type(trouble).__name__}: {trouble}); repair or uninstall that package"
        ) from trouble
    if not isinstance(loaded, type) or not issubclass(loaded, base):
        raise UsageError(
            f"{_WORDS[group]} {name}: wanted a class derived from {base.__module__}.{base.__name__}, "
            f"{point.value} of package {_owner(point)} is {loaded!r:.80}"
        )
    return loaded


def describe(group: str, name: str) -> str:
    """Return one line on what a class does: the first line of its docstring. Imports it; raises as `load`."""
    text = (load(group, name, object).__doc__ or "").strip()
    return text.splitlines()[0].rstrip(".") if text else f"of package {_owner(_found(group)[name])}"


def given_settings(words: Sequence[str], used: Iterable[str] | None = None) -> dict[str, dict[str, Any]]:
    """Return settings of plug-ins that are given as texts.

    Args:
        words: each as NAME.SETTING=VALUE, the value as in YAML: `gmm.evidence=mean`, `gmm.window_frames=10`.
        used: names of the plug-ins that are going to be used; those of all if None.

    Raises:
        SettingsError: a text of another form, or a setting of something that is not used.
    """
    groups = (CLASSIFIERS, PREDICTORS, COST_TERMS)
    allowed = [name for group in groups for name in names(group)] if used is None else list(dict.fromkeys(used))
    given: dict[str, dict[str, Any]] = {}
    for word in words:
        path, equals, text = word.partition("=")
        name, *keys = path.strip().split(".")
        if not equals or not keys or not all(keys):
            raise SettingsError(f"--set: wanted NAME.SETTING=VALUE, as in gmm.evidence=mean, got {word!r}")
        if name not in allowed:
            raise SettingsError(
                f"--set {word}: wanted a setting of what is used ({', '.join(allowed)}), got one of {name}"
            )
        try:
            value = yaml_of(text)
        except ValueError:
            value = text
        put_given(given, (name, *keys), value)
    return given


def put_given(given: dict[str, Any], path: Sequence[str], value: Any) -> None:
    """Put a value into nested dictionaries, which are made as needed."""
    for key in path[:-1]:
        if not isinstance(given.get(key), dict):
            given[key] = {}
        given = given[key]
    given[path[-1]] = value


def parameters_of(given: Given, used: Iterable[str]) -> dict[str, Any]:
    """Return given settings as ROS parameters of a node, NAME.SETTING; none is no value in ROS, and means the default.

    Args:
        given: as `given_settings` returns them.
        used: names of the plug-ins that the node uses; the settings of others are left out.
    """
    return _flat({name: given[name] for name in used if name in given})


def _flat(given: Mapping[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, values in given.items():
        for key, value in values.items():
            flat.update(_flat({f"{name}.{key}": value}) if isinstance(value, dict) else {f"{name}.{key}": value})
    return {name: value for name, value in flat.items() if value is not None}


def settings_of(name: str, kind: type[S], given: Given, **defaults: Any) -> S:
    """Return the settings of a plug-in.

    Args:
        name: of the plug-in.
        kind: its `settings_type`.
        given: by the user.
        defaults: values of fields where the user gave none; those that `kind` does not have are passed over.

    Raises:
        SettingsError: a setting that it does not have, or a value that cannot be used, by NAME.SETTING.
    """
    own = dict(given.get(name, {}))
    for key in own:
        if key not in kind.model_fields:
            close = get_close_matches(key, kind.model_fields, n=1)
            advice = f"did you mean {close[0]}?" if close else f"it has {', '.join(kind.model_fields) or 'none'}"
            raise SettingsError(f"{name}.{key}: {name} has no setting of that name; {advice}")
    known = {key: value for key, value in defaults.items() if key in kind.model_fields}
    try:
        return kind(**{**known, **own})
    except SettingsError as error:
        raise SettingsError(spelled(error, kind, lambda key: f"{name}.{key}")) from None


@cache
def _found(group: str) -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group), key=lambda point: (_owner(point) != _PACKAGE, point.name)):
        other = found.setdefault(point.name, point)
        if (other.value, _owner(other)) != (point.value, _owner(point)):
            raise UsageError(
                f"{_WORDS[group]} {point.name}: wanted one package to give it, got {_owner(other)} and "
                f"{_owner(point)}; uninstall one of them"
            )
    if not any(_owner(point) == _PACKAGE for point in found.values()):
        raise UsageError(
            f"wanted the entry points {group} of {_PACKAGE}, got none; install the package again: "
            "`pip install -e .`, or `colcon build` and source the workspace"
        )
    return found


def _owner(point: EntryPoint) -> str:
    name = point.dist.name if point.dist is not None else "unknown"
    return name.replace("-", "_")
