"""What the YAML files of scenes and robots are made of: mappings whose unknown keys are refused, with their place.

An angle is given in radians under `<name>_rad` or in degrees under `<name>_deg`, never both.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, model_validator

from humanpred_ros.errors import HumanPredError
from humanpred_ros.files import read_yaml
from humanpred_ros.geometry.checks import FloatArray

S = TypeVar("S", bound="Section")


def _name(text: str) -> str:
    if not text.strip():
        raise ValueError("wanted a name")
    return text


Name = Annotated[str, AfterValidator(_name)]


class Section(BaseModel):
    """One mapping of a scene file; keys that it does not know are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    optional_angles: ClassVar[tuple[str, ...]] = ()

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, content: Any) -> Any:
        valid = ", ".join(cls.model_fields)
        if not isinstance(content, dict):
            raise ValueError(f"wanted a mapping with the keys {valid}")
        unknown = [str(key) for key in content if key not in cls.model_fields]
        if unknown:
            raise ValueError(f"unknown key {', '.join(unknown)}; valid keys are {valid}")
        return content

    @model_validator(mode="after")
    def _one_spelling(self) -> Section:
        for key in type(self).model_fields:
            name = key.removesuffix("_rad")
            if name == key:
                continue
            given = [spelling for spelling in (key, f"{name}_deg") if getattr(self, spelling) is not None]
            if len(given) > 1 or not (given or name in self.optional_angles):
                raise ValueError(f"wanted either {name}_rad or {name}_deg, got {' and '.join(given) or 'neither'}")
        return self

    def has_angle(self, name: str) -> bool:
        """Return whether the file states an angle, in either unit."""
        return getattr(self, f"{name}_rad") is not None or getattr(self, f"{name}_deg") is not None

    def angle(self, name: str) -> FloatArray:
        """Return an angle or several in rad, an array () or (N,), whatever the file's unit; 0 if it states none."""
        degrees, radians = getattr(self, f"{name}_deg"), getattr(self, f"{name}_rad")
        return np.asarray((radians or 0.0) if degrees is None else np.deg2rad(degrees), dtype=np.float64)


def read_section(path: Path, kind: type[S], what: str, error: type[HumanPredError]) -> S:
    """Return the content of a YAML file.

    Args:
        path: of the file.
        kind: of the mapping that the file is.
        what: what messages call the file.
        error: raised if it cannot be read, or for unknown, missing or impossible values, with their place in the file.
    """
    return section_of(read_yaml(path, error), kind, what, error)


def section_of(content: Any, kind: type[S], what: str, error: type[HumanPredError]) -> S:
    """Return the content of a mapping that was read from YAML; the rest as in `read_section`."""
    try:
        return kind.model_validate(content)
    except ValidationError as trouble:
        raise error(f"{what}{_reason(trouble)}") from None


def _reason(trouble: ValidationError) -> str:
    """Return the place and kind of the first thing that is wrong with a file."""
    first = trouble.errors()[0]
    place, missing = list(first["loc"]), first["type"] == "missing"
    last = place.pop() if missing else ""
    where = "".join(f"[{part}]" if isinstance(part, int) else f": {part}" for part in place)
    if isinstance(last, int):
        return f"{where}: wanted at least {last + 1} numbers, got {first['input']!r:.80}; correct it"
    if missing:
        return f"{where}: the key {last} is missing; add it"
    said = str(first.get("ctx", {}).get("error", "")) or first["msg"][:1].lower() + first["msg"][1:]
    return f"{where}: {said}, got {first['input']!r:.80}; correct it"
