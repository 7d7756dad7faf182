"""Skeletons as data: `config/skeletons/<name>.yaml` says which points of a tracker are which points of a person.

A file has these keys (`Skeleton`); one with `like: NAME` takes those that it leaves out from another.

    names: [nose, left_eye, ...]       # all points of the tracker, in its order
    points: {head: nose, ...}          # a person's points (POINTS): the tracker's, or the first seen of several
    unit: m                            # or mm, cm
    axes: [right, down, forward]       # where x, y, z point
    least_confidence: 0.3              # points told with less are lost
    lost_at_origin: true               # points at (0, 0, 0) are lost, as those with NaN always are
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import ArrayError, SettingsError, UsageError
from humanpred_ros.files import read_yaml
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.kinect import LINK_OF_POINT
from humanpred_ros.human.model import HumanModel
from humanpred_ros.resources import locate
from humanpred_ros.settings import Settings, setting

#: A person's points that a tracker may show, and the model's links at them: the 15 of an OpenNI skeleton, and what
#: stands in for some of them.
LINKS = {**LINK_OF_POINT, "pelvis": "pelvis", "left_wrist": "left_wrist", "right_wrist": "right_wrist"}
POINTS = tuple(LINKS)
#: Points of which a posture cannot do without one of each group.
_NEEDED = (
    ("left_shoulder",), ("right_shoulder",), ("right_elbow",), ("right_hand", "right_wrist"),
    ("left_hip", "right_hip", "pelvis", "torso"),
)  # fmt: skip
#: Directions of a person's room, x forward, y left, z up (REP-103).
_DIRECTIONS = {
    "forward": (1, 0, 0), "back": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0), "up": (0, 0, 1),
    "down": (0, 0, -1),
}  # fmt: skip
#: How many of a unit make a metre.
PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}

Direction = Literal["forward", "back", "left", "right", "up", "down"]


class Skeleton(Settings):
    """Which points of a tracker are which, and how they are told."""

    names: tuple[str, ...] = setting(..., "names of all points of the tracker, in its order")
    points: dict[str, str | tuple[str, ...]] = setting(..., "the tracker's point, or several, for a person's points")
    first_index: int = setting(0, "index of the first point, where messages give indices", low=0, high=1)
    per_body: int = setting(100, "ids of markers are body * this + index", low=1)
    unit: Literal["m", "cm", "mm"] = setting("m", "of lengths")
    axes: tuple[Direction, Direction, Direction] = setting(("forward", "left", "up"), "where x, y and z point")
    frame: str = setting("", "usual name of the frame, which the scene places where TF does not")
    least_confidence: float = setting(0.0, "points told with less confidence are lost")
    lost_at_origin: bool = setting(False, "points at (0, 0, 0) are lost")
    centred: bool = setting(False, "points are about the body's own middle: somebody must say where the person stands")

    def check(self) -> None:
        """Refuse points that do not exist, on either side."""
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise SettingsError(f"Skeleton names: wanted different ones, got {', '.join(twice)} twice")
        for name, chosen in self.points.items():
            if name not in POINTS:
                raise SettingsError(f"Skeleton points: wanted points of a person ({', '.join(POINTS)}), got {name}")
            strange = [point for point in _several(chosen) if point not in self.names]
            if strange or not chosen:
                raise SettingsError(
                    f"Skeleton points {name}: wanted points among the names, got {', '.join(strange) or 'none'}"
                )
        for group in _NEEDED:
            if not set(group) & set(self.points):
                raise SettingsError(f"Skeleton points: wanted {' or '.join(group)}, without which there is no posture")
        if len({np.argmax(np.abs(_DIRECTIONS[axis])) for axis in self.axes}) < 3:
            raise SettingsError(f"Skeleton axes: wanted three different directions, got {', '.join(self.axes)}")

    @cached_property
    def columns(self) -> Mapping[str, tuple[int, ...]]:
        """Places in `names` of each of a person's points that the tracker shows, the preferred one first."""
        return {name: tuple(self.names.index(point) for point in _several(chosen))
                for name, chosen in self.points.items()}  # fmt: skip

    @cached_property
    def to_room(self) -> FloatArray:
        """(3, 3) matrix from the tracker's numbers to metres with x forward, y left, z up; it may mirror."""
        to_room: FloatArray = np.array([_DIRECTIONS[axis] for axis in self.axes], dtype=np.float64).T
        return to_room / PER_METRE[self.unit]

    def read(
        self, points: ArrayLike | Mapping[str, ArrayLike], confidence: ArrayLike | Mapping[str, float] | None = None
    ) -> FloatArray:
        """Return a person's points (18, 3), in the order of `POINTS` and the tracker's unit and axes; NaN where lost.

        Args:
            points: (N, 3) in the order of `names`, or those seen by name.
            confidence: (N,), or by name.

        Raises:
            ArrayError: another number of points, names that the tracker does not have, or no numbers.
        """
        table = self._table("points", points, (3,))
        table = np.where(np.isfinite(table).all(axis=1, keepdims=True), table, np.nan)
        if self.lost_at_origin:
            table = np.where((table == 0.0).all(axis=1, keepdims=True), np.nan, table)
        if confidence is not None and self.least_confidence > 0.0:
            known = self._table("confidence", confidence, ())
            table = np.where((known >= self.least_confidence)[:, None], table, np.nan)
        seen = np.full((len(POINTS), 3), np.nan)
        for name, columns in self.columns.items():
            for column in columns:
                if not np.isnan(table[column, 0]):
                    seen[POINTS.index(name)] = table[column]
                    break
        return seen

    def shown(self, points: FloatArray) -> FloatArray:
        """Return what the tracker would give (..., N, 3) of a person's points (..., 18, 3), x forward, y left, z up.

        NaN where it has a point that is none of a person's.
        """
        table = np.full((*points.shape[:-2], len(self.names), 3), np.nan)
        for name, columns in self.columns.items():
            for column in reversed(columns):
                table[..., column, :] = points[..., POINTS.index(name), :] @ np.linalg.inv(self.to_room).T
        return table

    def _table(self, what: str, given: ArrayLike | Mapping[str, ArrayLike], shape: tuple[int, ...]) -> FloatArray:
        n = len(self.names)
        if not isinstance(given, Mapping):
            return checked(f"skeleton {what}", given, (n, *shape), finite=False)
        strange = sorted(set(given) - set(self.names))
        if strange:
            raise ArrayError(f"skeleton {what}: wanted {', '.join(self.names)}, got {', '.join(strange)}")
        table = np.full((n, *shape), np.nan)
        for name, value in given.items():
            table[self.names.index(name)] = checked(f"skeleton {what}: {name}", value, shape, finite=False)
        return table


def load_skeleton(name: str | Path, **changes: object) -> Skeleton:
    """Return the skeleton of that name in config/skeletons, or of a YAML file.

    Args:
        name: of a shipped one, as `azure_kinect`, or the path of a file.
        changes: keys that are to be otherwise than there.

    Raises:
        UsageError: there is none of that name, or the file says what no skeleton can be.
    """
    path = locate(str(name), "config", "skeletons", suffix=".yaml")
    content = read_yaml(path, UsageError)
    if not isinstance(content, dict):
        raise UsageError(f"{path}: wanted the keys {', '.join(Skeleton.model_fields)}, got {content!r:.80}")
    like = content.pop("like", None)
    if like is not None:
        base = locate(str(like), "config", "skeletons", suffix=".yaml")
        other = read_yaml(base, UsageError)
        if not isinstance(other, dict) or "like" in other:
            raise UsageError(f"{path}: like: wanted a skeleton that is not itself like another, got {like}")
        content = {**other, **content}
    try:
        return Skeleton(**{**content, **changes})
    except (SettingsError, TypeError) as error:
        raise UsageError(f"{path}: {error}") from error


def person_points(model: HumanModel, q: ArrayLike) -> FloatArray:
    """Return the points (..., 18, 3) of a person in postures (..., 12), in the order of `POINTS`."""
    places = model.forward(q)
    return np.stack([places[link] for link in LINKS.values()], axis=-2)


def pose_of(text: str) -> FloatArray:
    """Return the (4, 4) pose of 'x y z roll pitch yaw' in metres and radians; that of an empty text is none.

    Raises:
        UsageError: other than six numbers.
    """
    T = np.eye(4)
    if not text.strip():
        return T
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 6 or not np.isfinite(numbers).all():
        raise UsageError(f"tracker_pose: wanted six numbers, 'x y z roll pitch yaw' in m and rad, got {text!r}")
    T[:3, :3] = Rotation.from_euler("xyz", numbers[3:]).as_matrix()
    T[:3, 3] = numbers[:3]
    return T


def _several(chosen: str | Sequence[str]) -> tuple[str, ...]:
    return (chosen,) if isinstance(chosen, str) else tuple(chosen)
