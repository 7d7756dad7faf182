"""Messages as no sensor sends them: the inputs of the fuzzing of nodes (`messages`).

Every message begins as a good one. One to three of its parts, found by what its type says, are then replaced by what a
broken, foreign or ill-meaning sender could put there, within what the type can carry.
"""

from __future__ import annotations

import array
import re
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

_NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e-12, 1e308, -1e308, 1e30, 1e6, 100.0, -7.0, 2.0 * np.pi)
_TEXTS = (
    *("", " ", "\0", "kinect", "world", "/world", "WORLD", "x", "PelvisTransX", "r_shoulder_pan_joint", "arrived"),
    *("hold", "ready", "\u00e4\u4e16\U0001f600", "[bold]", "<script>", "%s%n{0}", "../../etc", "unknown: "),
)
_LONG = 100_000
#: Where sizes and offsets go wrong.
_SIZES = (0, -1, 1, 2, 3, 4, 7, 8, 12, 15, 16, 17, 255, 4096, 2**16, 2**31 - 1, 2**31, 2**32 - 1)
_SHIFTS_S = (-3600.0, -3.0, -0.4, -0.05, 0.0, 0.03, 0.1, 3.0, 3600.0)
#: Array codes of the numbers in sequences, and the greatest of float32.
_CODES = {"double": "d", "float": "f"}
_FLOAT32 = float(np.finfo(np.float32).max)


class Mutator:
    """Spoils messages in place, with draws from one generator."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def one_of(self, choices: Sequence[Any]) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def message(self, message: Any) -> None:
        """Spoil one to three parts of a message."""
        for _ in range(int(self.rng.integers(1, 4))):
            self._part(message)

    def _part(self, message: Any) -> None:
        """Spoil one field of a message, or of one of the messages in it."""
        name, kind = self.one_of(list(message.get_fields_and_field_types().items()))
        value = getattr(message, name)
        if kind == "builtin_interfaces/Time":
            self.stamp(value)
        elif hasattr(value, "get_fields_and_field_types"):
            self._part(value)
        elif kind.startswith("sequence<"):
            within = kind.removeprefix("sequence<").rstrip(">")
            if "/" in within and len(value) and self.rng.random() < 0.7:
                self._part(self.one_of(value))
            else:
                setattr(message, name, self._sequence(value, within))
        else:
            setattr(message, name, self._single(value, kind))

    def _single(self, value: Any, kind: str) -> Any:
        """Return another value of a field that is neither message nor sequence."""
        if kind == "boolean":
            return not value
        if kind == "string":
            return self.text(value)
        if kind == "octet":
            return self.rng.bytes(1)
        if kind in _CODES:
            return _fitting(self.number(value), kind)
        bits = int(re.sub(r"\D", "", kind))
        low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return min(max(int(self.one_of((*_SIZES, low, high, value + 1))), low), high)

    def _sequence(self, values: Any, within: str) -> Any:
        """Return a sequence of which something is other, missing, there again, or in another order."""
        if within == "uint8":
            return array.array("B", self.raw(bytes(values)))
        numbers = within in _CODES
        if numbers and self.rng.random() < 0.3:  # other units
            factor = float(self.one_of((1000.0, 100.0, 180.0 / np.pi, -1.0, 0.0, np.nan)))
            return array.array(_CODES[within], [_fitting(x * factor, within) for x in values])
        found, way = list(values), int(self.rng.integers(7))
        if way == 0 or not found:
            new = _new_message(within) if "/" in within else self._single(0.0 if numbers else "", within)
            found = [*found, new] * int(self.one_of((1, 2, 50)))
        elif way == 1:
            found = found[: int(self.rng.integers(len(found)))]
        elif way == 2:
            found[int(self.rng.integers(len(found)))] = self.one_of(found)
        elif way == 3:
            del found[int(self.rng.integers(len(found)))]
        elif way == 4:
            found = found[::-1]
        elif "/" not in within:
            every = way == 5 and self.rng.random() < 0.3
            for k in range(len(found)) if every else [int(self.rng.integers(len(found)))]:
                found[k] = self._single(found[k], within)
        return array.array(_CODES[within], found) if numbers else found

    def number(self, x: float = 0.0) -> float:
        near = (x * 1000.0, x * 180.0 / np.pi, x + 2.0 * np.pi, -x, x + float(self.rng.normal()), x + 1e-9)
        with np.errstate(over="ignore"):
            return float(self.one_of((*_NUMBERS, *near)))

    def text(self, text: str = "") -> str:
        """Return another text; sometimes the same with a number in place of one of its words."""
        if self.rng.random() < 0.3:
            words = text.split(" ")
            words[int(self.rng.integers(len(words)))] = str(self.one_of((*_SIZES, self.number(), "nan", "")))
            return " ".join(words)
        return str(self.one_of((*_TEXTS, text + "_", text[:-1], text.upper(), "y" * _LONG)))

    def stamp(self, stamp: Any) -> None:
        """Shift a time a little, or replace it by anything that the type can carry."""
        if self.rng.random() < 0.5:
            ns = stamp.sec * 10**9 + stamp.nanosec + round(float(self.one_of(_SHIFTS_S)) * 1e9)
            stamp.sec, stamp.nanosec = int(np.clip(ns // 10**9, -(2**31), 2**31 - 1)), ns % 10**9
        else:
            stamp.sec = self._single(stamp.sec, "int32")
            stamp.nanosec = self._single(stamp.nanosec, "uint32")

    def raw(self, data: bytes) -> bytes:
        """Return bytes cut, extended, or with some of them, or a number among them, changed."""
        spoiled, way = bytearray(data), int(self.rng.integers(5))
        if way == 0:
            return bytes(spoiled[: int(self.rng.integers(len(spoiled) + 1))])
        if way == 1:
            return bytes(spoiled) + self.rng.bytes(int(self.one_of((1, 16, 100, 4096, 2**20))))
        if way == 2 and len(spoiled) >= 4:
            at = 4 * int(self.rng.integers(len(spoiled) // 4))
            with np.errstate(over="ignore"):
                spoiled[at : at + 4] = np.float32(self.number(0.5)).tobytes()
        for _ in range(min(len(spoiled), 8) if way == 3 else len(spoiled) // 4 if way == 4 else 0):
            spoiled[int(self.rng.integers(len(spoiled)))] = int(self.rng.integers(256))
        return bytes(spoiled)


def _fitting(x: float, kind: str) -> float:
    return float(np.clip(x, -_FLOAT32, _FLOAT32)) if kind == "float" and np.isfinite(x) else x


def _new_message(kind: str) -> Any:
    """Return an empty message of a type as in `sensor_msgs/PointField`."""
    package, name = kind.split("/")
    return getattr(import_module(f"{package}.msg"), name)()
