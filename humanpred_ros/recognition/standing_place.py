"""Where a person stands, compared with the people of the library, and the rigid motion that brings them together.

A library recorded at one place must serve a person who stands at another. People at one place never stand twice in
quite the same way, and the places they reach for do not move with them. So a person who starts within the spread of the
library's own starts is taken to stand where the library was recorded. Only a person who clearly starts elsewhere is
moved there, rigidly on the floor. The estimate gets better with several motions from one place, because single starts
differ by some centimetres and degrees.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen

#: Start postures whose median says where a motion began.
_N_START = 5
#: Motions remembered from one place.
_N_MEMORY = 30
#: A spread below this says more about the library's size than about people: metres, metres, radians.
_LEAST_SPREAD = (0.02, 0.02, 0.04)


@dataclass(frozen=True, eq=False)
class StandingPlace:
    """Where a library's motions start."""

    pose: FloatArray  #: (3,) typical x, y (m) and yaw (rad) of the pelvis at the start, library frame
    spread: FloatArray  #: (3,) their standard deviations, from quantiles, so that mistracked motions do not count
    #: a start within so many spreads is one of this place. With four, at most one of 1000 motions from the library's
    #: place would be moved.
    limit: float = 4.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", frozen(checked("standing place", self.pose, (3,))))
        object.__setattr__(self, "spread", frozen(checked("spread of starts", self.spread, (3,))))
        if (self.spread <= 0).any() or not self.limit > 0:
            raise ArrayError(f"standing place: wanted positive spreads and limit, got {self.spread} and {self.limit}")

    @classmethod
    def of_starts(cls, poses: FloatArray) -> StandingPlace:
        """Return the place of motions that start with the pelvis at (M, 3) x, y, yaw."""
        poses = checked("start poses", poses, ("M", 3))
        typical = _typical(poses)
        deviation = np.column_stack([poses[:, :2] - typical[:2], _wrapped(poses[:, 2] - typical[2])])
        # Of a normal distribution, nine tenths lie within 1.645 standard deviations; the rest may be mistracked.
        return cls(typical, np.maximum(np.quantile(np.abs(deviation), 0.9, axis=0) / 1.645, _LEAST_SPREAD))

    def holds(self, pose: FloatArray, other: FloatArray | None = None) -> bool:
        """Return whether a person at `pose` (3,) stands at `other` (3,); by default at this place itself."""
        away = pose - (self.pose if other is None else other)
        away[2] = _wrapped(away[2])
        return bool((np.abs(away) <= self.limit * self.spread).all())

    def alignment(self, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return rotation (3, 3) and translation (3,) that bring a person standing at `pose` to this place."""
        turn = self.pose[2] - pose[2]
        c, s = np.cos(turn), np.sin(turn)
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return R, np.append(self.pose[:2], 0.0) - R @ np.append(pose[:2], 0.0)


class PlaceTracker:
    """Follows where one person stands, from the first postures of each motion."""

    def __init__(self, place: StandingPlace) -> None:
        self.place = place
        self._starts: deque[FloatArray] = deque(maxlen=_N_MEMORY)
        self._seen: list[FloatArray] = []
        self.R, self.p = np.eye(3), np.zeros(3)

    @property
    def elsewhere(self) -> bool:
        """Whether the person does not stand where the library was recorded."""
        return bool(self.p.any())

    def start(self) -> None:
        """Begin a new motion; the starts of the last ones are remembered.

        A motion of fewer postures than a start needs does not count: on a stream, that is every posture at rest.
        """
        if len(self._seen) == _N_START:
            now = _typical(self._seen)
            if self._starts and not self.place.holds(now, _typical(self._starts)):
                self._starts.clear()
            self._starts.append(now)
        self._seen = []

    def update(self, T_pelvis: FloatArray) -> None:
        """Take the pelvis' pose (4, 4) in one posture, tracker's frame; only the first postures of a motion count."""
        if len(self._seen) == _N_START:
            return
        self._seen.append(np.array([T_pelvis[0, 3], T_pelvis[1, 3], np.arctan2(T_pelvis[1, 0], T_pelvis[0, 0])]))
        now = _typical(self._seen)
        if self._starts and self.place.holds(now, _typical(self._starts)):
            now = _typical([*self._starts, now])
        if self.place.holds(now):
            self.R, self.p = np.eye(3), np.zeros(3)
        else:
            self.R, self.p = self.place.alignment(now)


def start_pose(T_pelvis: FloatArray) -> FloatArray:
    """Return the (3,) x, y and yaw at which a motion starts, from the pelvis' poses (T, 4, 4)."""
    first = T_pelvis[:_N_START]
    return _typical(np.column_stack([first[:, :2, 3], np.arctan2(first[:, 1, 0], first[:, 0, 0])]))


def _typical(poses: Iterable[FloatArray]) -> FloatArray:
    """Return the median (3,) of poses (3,); that of the yaws is taken around their circular mean."""
    stacked = np.stack(list(poses))
    mean = np.angle(np.exp(1j * stacked[:, 2]).sum())
    return np.append(np.median(stacked[:, :2], axis=0), mean + np.median(_wrapped(stacked[:, 2] - mean)))


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return angles within [-pi, pi)."""
    wrapped: FloatArray = (angle + np.pi) % (2 * np.pi) - np.pi
    return wrapped
