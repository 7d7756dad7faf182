"""Messages that are not as they should be, for `humanpred bench faults`.

A message is spoilt by a function that takes it and gives what is sent instead of it. Some spoil every message alike
(`always`), some only a few (`briefly`), some remember what came before. They are made anew for each occurrence of a
fault, from the lattice of the scene.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np

from humanpred_ros.geometry.lattice import VoxelGrid

#: What a message becomes.
Spoil: TypeAlias = Callable[[Any], Iterable[Any]]
#: Makes one, given the lattice of the scene.
MakeSpoil: TypeAlias = Callable[[VoxelGrid], Spoil]

#: Parts of the names of a person's joints: lengths in m, angles in rad.
LENGTHS, ANGLES = ("Trans",), ("Rot", "Torso", "Shoulder", "Elbow")
_NS_PER_S = 1_000_000_000
#: How many messages are a few.
_FEW = 6


def stamped(message: Any, by_s: float = 0.0, at_ns: int | None = None) -> Any:
    """Return a message with its stamp moved, or set."""
    stamp = message.header.stamp
    ns = stamp.sec * _NS_PER_S + stamp.nanosec + round(by_s * _NS_PER_S) if at_ns is None else at_ns
    stamp.sec, stamp.nanosec = divmod(ns, _NS_PER_S)
    return message


def with_value(message: Any, names: Sequence[str], change: Callable[[float], float]) -> Any:
    """Return joint states with other positions of the joints whose names have one of these parts."""
    for k, name in enumerate(message.name):
        if any(part in name for part in names):
            message.position[k] = change(message.position[k])
    return message


def without_last(message: Any) -> Any:
    """Return joint states without the last joint."""
    message.name = list(message.name)[:-1]
    message.position = message.position[:-1]
    message.velocity = message.velocity[:-1]
    return message


def with_joint_twice(message: Any) -> Any:
    """Return joint states with the first joint named again in place of the last."""
    message.name = [*message.name[:-1], message.name[0]]
    return message


def in_frame(message: Any, frame: str) -> Any:
    """Return a message in another frame."""
    message.header.frame_id = frame
    return message


def always(change: Callable[..., Any], *args: Any, **kwargs: Any) -> MakeSpoil:
    """Spoil every message in the same way."""
    return lambda grid: lambda message: [change(message, *args, **kwargs)]


def briefly(change: Callable[..., Any], *args: Any, **kwargs: Any) -> MakeSpoil:
    """Spoil a few messages: a single one may be overtaken by the next before it is looked at."""

    def make(grid: VoxelGrid) -> Spoil:
        left = [True] * _FEW

        def spoil(message: Any) -> Iterable[Any]:
            return [change(message, *args, **kwargs) if left and left.pop() else message]

        return spoil

    return make


def lost(grid: VoxelGrid) -> Spoil:
    """Let no message through."""
    return lambda message: []


def frozen(grid: VoxelGrid) -> Spoil:
    """Repeat the first posture under new stamps."""
    first: list[Any] = []

    def spoil(message: Any) -> Iterable[Any]:
        if not first:
            first.append(message)
        message.position = first[0].position
        return [message]

    return spoil


def backwards(grid: VoxelGrid) -> Spoil:
    """Let stamps run backwards from where they are."""
    first: list[int] = []

    def spoil(message: Any) -> Iterable[Any]:
        ns = message.header.stamp.sec * _NS_PER_S + message.header.stamp.nanosec
        first.append(ns)
        return [stamped(message, at_ns=2 * first[0] - ns)]

    return spoil


def same_stamp(grid: VoxelGrid) -> Spoil:
    """Give every message the stamp of the first."""
    first: list[int] = []

    def spoil(message: Any) -> Iterable[Any]:
        first.append(message.header.stamp.sec * _NS_PER_S + message.header.stamp.nanosec)
        return [stamped(message, at_ns=first[0])]

    return spoil


def two_people(grid: VoxelGrid) -> Spoil:
    """Add a second person, 0.6 m beside the first."""

    def spoil(message: Any) -> Iterable[Any]:
        yield message
        yield stamped(with_value(message, ("PelvisTransX",), lambda x: x + 0.6), by_s=0.005)

    return spoil


def with_points(cloud: Any, points: bytes, count: int) -> Any:
    """Return a cloud with other points."""
    cloud.height, cloud.width, cloud.row_step = 1, count, len(points)
    cloud.data = array.array("B", points)
    return cloud


def full(grid: VoxelGrid) -> Spoil:
    """Let every voxel of the lattice be occupied."""
    table = np.ones((grid.size, 4), dtype=np.float32)
    table[:, :3] = grid.centres_m(np.arange(grid.size))
    points = table.tobytes()
    return _seldom(lambda cloud: with_points(cloud, points, grid.size), 6)


def _seldom(change: Callable[[Any], Any], one_in: int) -> Spoil:
    """Send one message in so many, spoilt: large ones take long to be sent."""
    count = [0]

    def spoil(message: Any) -> Iterable[Any]:
        count[0] += 1
        return [change(message)] if count[0] % one_in == 1 else []

    return spoil


def huge(grid: VoxelGrid) -> Spoil:
    """Give every voxel of a body again and again, until the message has 16 MB."""

    def grown(cloud: Any) -> Any:
        times = max(1, 16_000_000 // max(len(cloud.data), 1))
        return with_points(cloud, cloud.data.tobytes() * times, cloud.width * times)

    return _seldom(grown, 15)


def claims_more(cloud: Any) -> Any:
    """Return a cloud that claims more points than any memory holds."""
    cloud.height, cloud.width = 65536, 65536
    return cloud


def torn(cloud: Any) -> Any:
    """Return a cloud that lacks half of its data."""
    cloud.data = cloud.data[: len(cloud.data) // 2]
    return cloud


def foreign(cloud: Any) -> Any:
    """Name the fields as a depth camera does."""
    for field, name in zip(cloud.fields, ("x", "y", "z", "rgb"), strict=False):
        field.name = name
    return cloud


def with_column(cloud: Any, column: int, change: Callable[[Any], Any]) -> Any:
    """Return a cloud of float32 x, y, z, probability with one of them changed."""
    table = np.frombuffer(cloud.data, dtype=np.float32).reshape(-1, 4).copy()
    table[:, column] = change(table[:, column])
    return with_points(cloud, table.tobytes(), len(table))
