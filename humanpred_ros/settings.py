"""How a setting is declared: once, as a field with unit, range and description.

A part of the package has one frozen class of settings. From its fields come the ROS parameters of the nodes, the flags
of the command line, the keys of the YAML files and the reference in docs/: nothing of them is written again.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic.fields import FieldInfo

from humanpred_ros.errors import SettingsError

T = TypeVar("T", bound="Settings")

#: What every generator of random numbers takes, and every parameter holds.
LARGEST_SEED = 2**31 - 1


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    changeable: bool = False,
    restart: str = "",
    positional: bool = False,
    bare: Any = None,
) -> Any:
    """Return the field of a `Settings` class.

    Args:
        default: value where nothing is said; `...` where something must be said.
        description: what it is, for parameter descriptors, `--help` and the reference; without its unit.
        unit: of the value, for people.
        low, high: smallest and largest value allowed (of numbers, or of each number of a tuple).
        changeable: whether the ROS parameter may be changed while the node runs.
        restart: why another one may not, where that tells more than that it is read when the node is configured.
        positional: whether it is given on the command line by its place instead of `--name`.
        bare: value of a flag that is given without one; None where a flag needs its value.
    """
    facts = {
        "description": description,
        "unit": unit,
        "low": low,
        "high": high,
        "changeable": changeable,
        "restart": restart,
        "positional": positional,
        "bare": bare,
    }
    text = f"{description} ({unit})" if unit else description
    return Field(default=default, description=text, json_schema_extra=facts)


def setting_of(owner: type[Settings], name: str, **changes: Any) -> Any:
    """Return the field `name` of another settings class, for a class that offers it again.

    Args:
        owner: class that declares the setting.
        name: of its field.
        changes: arguments of `setting` that are to differ.
    """
    field = owner.model_fields[name]
    return setting(**{"default": ... if field.is_required() else field.default, **facts_of(field), **changes})


def facts_of(field: FieldInfo) -> dict[str, Any]:
    """Return what `setting` was told about a field, its default left out."""
    facts = field.json_schema_extra
    return dict(facts) if isinstance(facts, dict) else {}


def spelled(error: SettingsError, owner: type[Settings], spell: Callable[[str], str]) -> str:
    """Return the text of an error of a settings class, with the field named as the user knows it.

    Args:
        error: raised when `owner` was made.
        owner: settings class.
        spell: the field's name to that of a flag or parameter.
    """
    return re.sub(rf"^{owner.__name__} (\w+)", lambda found: spell(found[1]), str(error))


class Settings(BaseModel):
    """Base class of all settings: cannot be changed, refuses unknown names, wrong types and values out of range."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, arbitrary_types_allowed=True)

    def __init__(self, **values: Any) -> None:
        """Take values by name.

        Raises:
            SettingsError: with the name of the field, what was wanted and what came.
        """
        try:
            super().__init__(**values)
        except ValidationError as trouble:
            raise SettingsError(_first_error(type(self).__name__, trouble)) from None

    def model_post_init(self, context: Any) -> None:
        """Check ranges, and then what `check` says."""
        for name, field in type(self).model_fields.items():
            facts, value = facts_of(field), getattr(self, name)
            if not facts:
                continue
            low, high = facts["low"], facts["high"]
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, int | float) and not isinstance(number, bool) and not _within(number, low, high):
                    raise SettingsError(f"{type(self).__name__} {name}: wanted {_wanted(low, high)}, got {value!r}")
        self.check()

    def check(self) -> None:
        """Raise SettingsError for values that do not go together; overridden where there are such."""

    def part(self, owner: type[T], **changes: Any) -> T:
        """Return settings of class `owner` with the values of the fields that it shares with these."""
        shared = owner.model_fields.keys() & type(self).model_fields.keys()
        return owner(**{**{name: getattr(self, name) for name in shared}, **changes})

    def replaced(self: T, **changes: Any) -> T:
        """Return these settings with some values changed, checked again."""
        return type(self)(**{**{name: getattr(self, name) for name in type(self).model_fields}, **changes})


def _within(number: float, low: Any, high: Any) -> bool:
    finite = number - number == 0.0
    return finite and (low is None or number >= low) and (high is None or number <= high)


def _wanted(low: Any, high: Any) -> str:
    if low is None and high is None:
        return "a finite number"
    if high is None:
        return f"a number of at least {low}"
    return f"a number of at most {high}" if low is None else f"a number from {low} to {high}"


def _first_error(owner: str, trouble: ValidationError) -> str:
    first = trouble.errors()[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"{owner}: has no setting {name}"
    if first["type"] == "missing":
        return f"{owner} {name}: wanted a value, got none"
    return f"{owner} {name}: {first['msg'][:1].lower() + first['msg'][1:]}, got {first.get('input')!r:.80}"
