"""How a setting is declared: once, as a field with unit, range and description.

A part of the package has one frozen class of settings. From its fields come the ROS parameters of the nodes, the flags
of the command line, the keys of the YAML files and the reference in docs/: nothing of them is written again.
"""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from humanpred_ros.errors import SettingsError

T = TypeVar("T", bound="Settings")


def setting(
    default: Any,
    description: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    changeable: bool = False,
) -> Any:
    """Return the field of a `Settings` class.

    Args:
        default: value where nothing is said.
        description: what it is, for parameter descriptors, `--help` and the reference; without its unit.
        unit: of the value, for people.
        low, high: smallest and largest value allowed (of numbers, or of each number of a tuple).
        changeable: whether the ROS parameter may be changed while the node runs.
    """
    text = f"{description} ({unit})" if unit else description
    return Field(
        default=default,
        description=text,
        json_schema_extra={"unit": unit, "low": low, "high": high, "changeable": changeable},
    )


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
            extra = field.json_schema_extra
            if not isinstance(extra, dict):
                continue
            low, high, value = extra.get("low"), extra.get("high"), getattr(self, name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, int | float) and not isinstance(number, bool) and not _within(number, low, high):
                    wanted = (
                        f"a number from {low} to {high}"
                        if None not in (low, high)
                        else (
                            f"a number of at least {low}"
                            if low is not None
                            else f"a number of at most {high}"
                            if high is not None
                            else "a finite number"
                        )
                    )
                    raise SettingsError(f"{type(self).__name__} {name}: wanted {wanted}, got {value!r}")
        self.check()

    def check(self) -> None:
        """Raise SettingsError for values that do not go together; overridden where there are such."""

    def replaced(self: T, **changes: Any) -> T:
        """Return these settings with some values changed, checked again."""
        return type(self)(**{**{name: getattr(self, name) for name in type(self).model_fields}, **changes})


def _within(number: float, low: Any, high: Any) -> bool:
    finite = number - number == 0.0
    return finite and (low is None or number >= low) and (high is None or number <= high)


def _first_error(owner: str, trouble: ValidationError) -> str:
    first = trouble.errors()[0]
    name = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"{owner}: has no setting {name}"
    return f"{owner} {name}: {first['msg'][:1].lower() + first['msg'][1:]}, got {first.get('input')!r:.80}"
