"""Classifiers, predictors and cost terms are found by name, whichever installed package they come from.

A package offers them as entry points (`pyproject.toml`, `setup.cfg` or `setup.py`):

    [project.entry-points."humanpred_ros.classifiers"]
    nearest_end = "my_package.nearest_end:NearestEnd"

The built-in ones are entry points of this package, declared in its setup.py. The name is what users write in node
parameters, on the command line and in scenes; the first line of the class's docstring describes it in help texts.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from humanpred_ros.errors import UsageError

#: Groups of entry points.
CLASSIFIERS = "humanpred_ros.classifiers"
PREDICTORS = "humanpred_ros.predictors"
COST_TERMS = "humanpred_ros.cost_terms"

#: What is used unless another is chosen.
DEFAULT_CLASSIFIER = "forest"
DEFAULT_PREDICTOR = "forecast"

_WORDS = {CLASSIFIERS: "classifier", PREDICTORS: "predictor", COST_TERMS: "cost term"}
_PACKAGE = "humanpred_ros"

T = TypeVar("T")


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
