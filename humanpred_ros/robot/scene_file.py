"""Typed reading of a scene's YAML, so that every slip in a file is named with its place and the way out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from humanpred_ros.errors import SceneError
from humanpred_ros.geometry.checks import FloatArray, checked


class Section:
    """One mapping of a scene file with a fixed set of keys.

    Angles may be given in radians (`<name>_rad`) or degrees (`<name>_deg`), never both.

    Args:
        content: what YAML gave.
        where: place in the file, for messages.
        keys: the valid keys; an `<name>_angle` stands for both spellings of an angle.

    Raises:
        SceneError: if `content` is not a mapping or has a key that is not valid.
    """

    def __init__(self, content: Any, where: str, keys: tuple[str, ...]) -> None:
        self._where = where
        valid = [spelling for key in keys for spelling in _spellings(key)]
        if not isinstance(content, dict):
            raise SceneError(f"{where}: wanted a mapping with the keys {', '.join(valid)}, got {content!r:.60}")
        unknown = [str(key) for key in content if key not in valid]
        if unknown:
            raise SceneError(f"{where}: unknown key {', '.join(unknown)}; valid keys are {', '.join(valid)}")
        self._content: dict[str, Any] = content

    @property
    def where(self) -> str:
        """The section's place in the file, for messages."""
        return self._where

    def __contains__(self, key: str) -> bool:
        return any(spelling in self._content for spelling in _spellings(key))

    def value(self, key: str) -> Any:
        """Return what stands under a key that must be there."""
        if key not in self._content:
            raise SceneError(f"{self._where}: the key {key} is missing; add it")
        return self._content[key]

    def text(self, key: str) -> str:
        """Return a string that is not empty."""
        text = self.value(key)
        if not isinstance(text, str) or not text.strip():
            raise SceneError(f"{self._where}: wanted a name under {key}, got {text!r:.60}")
        return text

    def number(self, key: str) -> float:
        """Return one finite number."""
        return float(checked(f"{self._where}: {key}", self.value(key), (), error=SceneError))

    def numbers(self, key: str, count: int) -> FloatArray:
        """Return `count` finite numbers."""
        return checked(f"{self._where}: {key}", self.value(key), (count,), error=SceneError)

    def each(self, key: str, count: int) -> FloatArray:
        """Return `count` finite numbers, all the same where the file has only one."""
        one = np.ndim(self.value(key)) == 0
        return np.full(count, self.number(key)) if one else self.numbers(key, count)

    def each_angle(self, name: str, count: int) -> FloatArray:
        """Return `count` angles in rad from `<name>_rad` or `<name>_deg`, all the same where it has only one."""
        one = np.ndim(self._content[self._angle_key(name)]) == 0
        return np.full(count, self.angle(name)) if one else self.angles(name, count)

    def angles(self, name: str, count: int) -> FloatArray:
        """Return `count` angles in rad from `<name>_rad` or `<name>_deg`."""
        return self._angle(name, (count,))

    def angle(self, name: str) -> float:
        """Return one angle in rad from `<name>_rad` or `<name>_deg`."""
        return float(self._angle(name, ()))

    def section(self, key: str, keys: tuple[str, ...]) -> Section:
        """Return the mapping under a key."""
        return Section(self.value(key), f"{self._where}: {key}", keys)

    def sections(self, key: str, keys: tuple[str, ...]) -> list[Section]:
        """Return the list of mappings under a key."""
        entries = self.value(key)
        if not isinstance(entries, list):
            raise SceneError(f"{self._where}: wanted a list under {key}, got {entries!r:.60}")
        return [Section(entry, f"{self._where}: {key}[{i}]", keys) for i, entry in enumerate(entries)]

    def _angle(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        key = self._angle_key(name)
        angles = checked(f"{self._where}: {key}", self._content[key], shape, error=SceneError)
        return np.deg2rad(angles) if key.endswith("_deg") else angles

    def _angle_key(self, name: str) -> str:
        given = [spelling for spelling in _spellings(f"{name}_angle") if spelling in self._content]
        if len(given) != 1:
            raise SceneError(
                f"{self._where}: wanted either {name}_rad or {name}_deg, got {' and '.join(given) or 'neither'}"
            )
        return given[0]


def read_yaml(path: Path) -> Any:
    """Return the content of a YAML file.

    Raises:
        SceneError: if it cannot be read or is not YAML.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as trouble:
        raise SceneError(f"scene: wanted a readable file, got {path}: {trouble.strerror}") from trouble
    except (yaml.YAMLError, UnicodeDecodeError) as trouble:
        raise SceneError(f"scene: wanted YAML in {path}, got something else: {trouble}") from trouble


def _spellings(key: str) -> tuple[str, ...]:
    if key.endswith("_angle"):
        stem = key.removesuffix("_angle")
        return f"{stem}_rad", f"{stem}_deg"
    return (key,)
