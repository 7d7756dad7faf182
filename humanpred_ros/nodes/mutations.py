"""Messages as no sensor sends them: the inputs of the fuzzing of nodes (`fuzzing`).

Every message begins as a good one. One to three of its parts are then replaced by what a broken, foreign or ill-meaning
sender could put there, within what the message type can carry.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from trajectory_msgs.msg import JointTrajectoryPoint

_SEC, _NANOSEC = (-(2**31), 2**31 - 1), 2**32 - 1
_NUMBERS = (np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e-12, 1e308, -1e308, 1e30, 1e6, 100.0, -7.0, 2.0 * np.pi)
_TEXTS = (
    *("", " ", "\0", "kinect", "world", "/world", "WORLD", "x", "PelvisTransX", "r_shoulder_pan_joint", "arrived"),
    *("hold", "ready", "\u00e4\u4e16\U0001f600", "[bold]", "<script>", "%s%n{0}", "../../etc", "unknown: "),
)
_LONG = 100_000
#: Where sizes and offsets go wrong.
_SIZES = (0, 1, 2, 3, 4, 7, 8, 12, 15, 16, 17, 255, 4096, 2**16, 2**31 - 1, 2**31, 2**32 - 1)


class Mutator:
    """Spoils messages in place, with draws from one generator."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def one_of(self, choices: Sequence[Any]) -> Any:
        return choices[int(self.rng.integers(len(choices)))]

    def some(self, ways: Sequence[Callable[[Any], None]], message: Any) -> None:
        """Spoil a message in one to three of these ways."""
        for _ in range(int(self.rng.integers(1, 4))):
            self.one_of(ways)(message)

    def number(self, x: float = 0.0) -> float:
        near = (x * 1000.0, x * 180.0 / np.pi, x + 2.0 * np.pi, -x, x + float(self.rng.normal()), x + 1e-9)
        with np.errstate(over="ignore"):
            return float(self.one_of((*_NUMBERS, *near)))

    def text(self, text: str = "") -> str:
        return str(self.one_of((*_TEXTS, text + "_", text[:-1], text.upper(), "y" * _LONG)))

    def stamp(self, header: Any) -> None:
        """Shift a stamp a little, or replace it by anything that the type can carry."""
        stamp = header.stamp
        if self.rng.random() < 0.5:
            shift_s = float(self.one_of((-3600.0, -3.0, -0.4, -0.05, 0.0, 0.03, 0.1, 3.0, 3600.0)))
            ns = stamp.sec * 10**9 + stamp.nanosec + round(shift_s * 1e9)
            stamp.sec, stamp.nanosec = int(np.clip(ns // 10**9, *_SEC)), ns % 10**9
        else:
            stamp.sec = int(self.one_of((0, -1, *_SEC, stamp.sec, int(self.rng.integers(*_SEC)))))
            stamp.nanosec = int(self.one_of((0, 10**9, _NANOSEC, stamp.nanosec)))

    def frame(self, header: Any) -> None:
        header.frame_id = self.text(header.frame_id)

    def numbers(self, values: Any) -> Any:
        """Return an array with some numbers replaced, or of another length."""
        values = array.array("d", values)
        way = int(self.rng.integers(6))
        if way == 0:
            return values[: int(self.rng.integers(len(values) + 1))]
        if way == 1:
            return values + array.array("d", [self.number()] * int(self.one_of((1, 12, 1000))))
        if way == 2:
            return array.array("d", [self.number(x) for x in values])
        if way == 3:
            factor = float(self.one_of((1000.0, 100.0, 180.0 / np.pi, -1.0, 0.0, np.nan)))
            return array.array("d", [x * factor for x in values])
        if len(values):
            k = int(self.rng.integers(len(values)))
            values[k] = self.number(values[k])
        return values

    def names(self, names: list[str]) -> list[str]:
        """Return names of which some are others, missing, given twice, or in another order."""
        names = list(names)
        way = int(self.rng.integers(5))
        if way == 0 or not names:
            return [] if self.rng.random() < 0.5 else [*names, self.text()] * 2
        k = int(self.rng.integers(len(names)))
        if way == 1:
            names[k] = self.text(names[k])
        elif way == 2:
            names[k] = names[int(self.rng.integers(len(names)))]
        elif way == 3:
            del names[k]
        else:
            self.rng.shuffle(names)
        return names

    def joint_state(self, message: Any) -> None:
        def position(m: Any) -> None:
            m.position = self.numbers(m.position)

        def velocity(m: Any) -> None:
            m.velocity = self.numbers(m.velocity)

        def names(m: Any) -> None:
            m.name = self.names(m.name)

        self.some(
            (position, position, velocity, names, lambda m: self.stamp(m.header), lambda m: self.frame(m.header)),
            message,
        )

    def cloud(self, message: Any) -> None:
        def sizes(m: Any) -> None:
            setattr(m, self.one_of(("height", "width", "point_step", "row_step")), int(self.one_of(_SIZES)))

        def swapped(m: Any) -> None:
            m.is_bigendian = not m.is_bigendian

        def field(m: Any) -> None:
            if not m.fields:
                return
            k = int(self.rng.integers(len(m.fields)))
            way = int(self.rng.integers(6))
            if way == 0:
                m.fields[k].offset = int(self.one_of(_SIZES))
            elif way == 1:
                m.fields[k].datatype = int(self.rng.integers(256))
            elif way == 2:
                m.fields[k].count = int(self.one_of(_SIZES))
            elif way == 3:
                m.fields[k].name = self.text(m.fields[k].name)
            elif way == 4:
                del m.fields[k]
            else:
                m.fields.append(m.fields[k])

        def data(m: Any) -> None:
            raw = bytearray(m.data)
            way = int(self.rng.integers(4))
            if way == 0:
                raw = raw[: int(self.rng.integers(len(raw) + 1))]
            elif way == 1:
                raw += bytes(int(self.one_of((1, 16, 4096, 2**20))))
            elif way == 2:
                raw = bytearray(self.rng.bytes(len(raw)))
            elif len(raw) >= 4:
                at = 4 * int(self.rng.integers(len(raw) // 4))
                with np.errstate(over="ignore"):
                    raw[at : at + 4] = np.float32(self.number(0.5)).tobytes()
            m.data = array.array("B", raw)

        self.some(
            (sizes, swapped, field, field, data, data, lambda m: self.stamp(m.header), lambda m: self.frame(m.header)),
            message,
        )

    def occupancy(self, message: Any) -> None:
        """Spoil an occupancy of either form."""
        if hasattr(message, "fields"):
            self.cloud(message)
            return

        def number(m: Any) -> None:
            words = m.format.split(" ")
            words[int(self.rng.integers(len(words)))] = str(self.one_of((*_SIZES, self.number(), "", "nan", "-1")))
            m.format = " ".join(words)

        def text(m: Any) -> None:
            m.format = self.text(m.format)

        def data(m: Any) -> None:
            m.data = array.array("B", self.raw(bytes(m.data)))

        header = (lambda m: self.stamp(m.header), lambda m: self.frame(m.header))
        self.some((number, number, text, data, data, *header), message)

    def trajectory(self, message: Any) -> None:
        def points(m: Any) -> None:
            way = int(self.rng.integers(4))
            if way == 0:
                m.points = []
            elif way == 1:
                m.points = [*m.points, JointTrajectoryPoint()] * int(self.one_of((1, 2, 50)))
            elif way == 2:
                m.points = m.points[::-1]
            else:
                m.points = m.points[:1]

        def point(m: Any) -> None:
            if not m.points:
                return
            spoiled = self.one_of(m.points)
            part = self.one_of(("positions", "velocities", "accelerations", "effort", "time"))
            if part == "time":
                spoiled.time_from_start.sec = int(self.one_of((0, 1, *_SEC)))
                spoiled.time_from_start.nanosec = int(self.one_of((0, 1, _NANOSEC)))
            else:
                setattr(spoiled, part, self.numbers(getattr(spoiled, part)))

        def names(m: Any) -> None:
            m.joint_names = self.names(m.joint_names)

        self.some((points, point, point, names, lambda m: self.stamp(m.header)), message)

    def diagnostics(self, message: Any) -> None:
        def statuses(m: Any) -> None:
            m.status = self.one_of(([], m.status * 100, [DiagnosticStatus()], m.status[::-1]))

        def status(m: Any) -> None:
            if not m.status:
                return
            spoiled = self.one_of(m.status)
            part = self.one_of(("name", "message", "hardware_id", "level", "values"))
            if part == "level":
                spoiled.level = bytes([int(self.rng.integers(256))])
            elif part == "values":
                spoiled.values = self.one_of(([], [KeyValue(key=self.text(), value=self.text())] * 100))
            else:
                setattr(spoiled, part, self.text(getattr(spoiled, part)))

        self.some((statuses, status, status, lambda m: self.stamp(m.header)), message)

    def clock(self, message: Any) -> None:
        class Header:
            stamp = message.clock

        self.stamp(Header)

    def raw(self, data: bytes) -> bytes:
        """Return serialized bytes cut, extended, or with some of them changed."""
        spoiled = bytearray(data)
        way = int(self.rng.integers(4))
        if way == 0:
            return bytes(spoiled[: int(self.rng.integers(len(spoiled) + 1))])
        if way == 1:
            return bytes(spoiled) + self.rng.bytes(int(self.one_of((1, 100, 10_000))))
        for _ in range(8 if way == 2 else len(spoiled) // 4):
            if spoiled:
                spoiled[int(self.rng.integers(len(spoiled)))] = int(self.rng.integers(256))
        return bytes(spoiled)
