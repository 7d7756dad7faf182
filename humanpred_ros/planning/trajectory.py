"""Trajectories with times: what controllers, simulated arm and replanner all read the same way.

Between two knots every joint follows the quintic that matches position, velocity and acceleration at both, as
a ROS joint trajectory controller does; so position, velocity and acceleration are continuous everywhere.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen

#: Trajectories made by this package keep to velocity and acceleration limits, between their knots too, to
#: within this share of them.
LIMIT_TOLERANCE = 0.02


State: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]


def quintic(u: FloatArray | float, h: FloatArray | float, start: State, end: State) -> State:
    """Return position, velocity and acceleration at the share `u` of a time `h` between two such states."""
    q0, v0, a0 = start[0], start[1] * h, start[2] * h * h
    q1, v1, a1 = end[0], end[1] * h, end[2] * h * h
    d = q1 - q0 - v0 - 0.5 * a0  # what the first three coefficients leave of position, velocity, acceleration
    e = v1 - v0 - a0
    f = a1 - a0
    c3, c4, c5 = 10.0 * d - 4.0 * e + 0.5 * f, -15.0 * d + 7.0 * e - f, 6.0 * d - 3.0 * e + 0.5 * f
    q = q0 + u * (v0 + u * (0.5 * a0 + u * (c3 + u * (c4 + u * c5))))
    v = (v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h
    a = (a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / (h * h)
    return q, v, a


@dataclass(frozen=True, eq=False)
class TimedTrajectory:
    """Knots of a trajectory of the robot.

    Raises:
        PlanningError: for shapes that disagree, times that do not increase, or a trajectory that does not
            end at rest.
    """

    t_s: FloatArray  #: (T,) strictly increasing, seconds of the data's clock
    q: FloatArray  #: (T, D) position, velocity, acceleration in rad, rad/s, rad/s²; the last v and a are 0
    v: FloatArray
    a: FloatArray

    def __post_init__(self) -> None:
        t = checked("trajectory t_s", self.t_s, ("T",), error=PlanningError)
        q = checked("trajectory q", self.q, (len(t), "D"), error=PlanningError)
        object.__setattr__(self, "t_s", frozen(t))
        object.__setattr__(self, "q", frozen(q))
        for name in ("v", "a"):
            array = checked(f"trajectory {name}", getattr(self, name), q.shape, error=PlanningError)
            object.__setattr__(self, name, frozen(array))
        if len(t) == 0 or (np.diff(t) <= 0.0).any():
            raise PlanningError("trajectory: wanted one or more strictly increasing times, got others")
        if np.abs(self.v[-1]).max() > 0.0 or np.abs(self.a[-1]).max() > 0.0:
            raise PlanningError("trajectory: wanted it to end at rest, got a velocity or acceleration at its end")

    def __len__(self) -> int:
        return len(self.t_s)

    def __eq__(self, other: object) -> bool:
        """Two trajectories are equal if every number is, bit for bit."""
        if not isinstance(other, TimedTrajectory):
            return NotImplemented
        return all(np.array_equal(getattr(self, name), getattr(other, name)) for name in ("t_s", "q", "v", "a"))

    __hash__ = None  # type: ignore[assignment]

    @property
    def start_s(self) -> float:
        """Time of the first knot."""
        return float(self.t_s[0])

    @property
    def end_s(self) -> float:
        """Time from which the robot rests at the last knot."""
        return float(self.t_s[-1])

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last knot."""
        return self.end_s - self.start_s

    def sample(self, t_s: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (..., D) at times (...).

        At a knot they are exactly the knot's. After the end the robot rests at the last knot; before the
        start it is taken to rest at the first.
        """
        t = np.asarray(t_s, dtype=np.float64)
        if len(self) == 1:
            rest = np.zeros((*t.shape, self.q.shape[1]))
            return self.q[0] + rest, rest, rest.copy()
        k = np.clip(np.searchsorted(self.t_s, t, side="right") - 1, 0, len(self) - 2)
        h = (self.t_s[k + 1] - self.t_s[k])[..., None]
        u = np.clip((t - self.t_s[k])[..., None] / h, 0.0, 1.0)
        ends = ((self.q[i], self.v[i], self.a[i]) for i in (k, k + 1))
        q, v, a = quintic(u, h, *ends)
        before = (t < self.t_s[0])[..., None]
        at_end = (t >= self.t_s[-1])[..., None]
        q = np.where(at_end, self.q[-1], q)
        v = np.where(at_end | before, 0.0, v)
        a = np.where(at_end | before, 0.0, a)
        return q, v, a

    def since(self, t_s: float) -> TimedTrajectory:
        """Return what is left of this trajectory at `t_s`."""
        later = self.t_s > t_s
        rows = zip((t_s, *self.sample(t_s)), (self.t_s, self.q, self.v, self.a), strict=True)
        return TimedTrajectory(*(np.concatenate([[now], row[later]]) for now, row in rows))

    def at_pace(self, factor: float) -> TimedTrajectory:
        """Return the same way from the first knot on, run through at `factor` > 0 times the speed."""
        if factor == 1.0:
            return self
        t = self.start_s + (self.t_s - self.start_s) / factor
        return TimedTrajectory(t, self.q, self.v * factor, self.a * factor**2)

    def later(self, by_s: float) -> TimedTrajectory:
        """Return the same motion so much later."""
        return TimedTrajectory(self.t_s + by_s, self.q, self.v, self.a)

    def lasting_until(self, t_s: float) -> TimedTrajectory:
        """Return this trajectory, with rest at its end up to `t_s` if it ends sooner."""
        if self.end_s >= t_s:
            return self
        rest = np.zeros_like(self.q[:1])
        return TimedTrajectory(
            np.append(self.t_s, t_s),
            np.vstack([self.q, self.q[-1:]]),
            np.vstack([self.v, rest]),
            np.vstack([self.a, rest]),
        )


def at_rest(q: ArrayLike, t_s: float) -> TimedTrajectory:
    """Return the trajectory of a robot that rests at `q` (D,) from `t_s` on."""
    q = np.atleast_2d(np.asarray(q, dtype=np.float64))
    return TimedTrajectory(np.array([t_s]), q, np.zeros_like(q), np.zeros_like(q))


#: Trajectories kept; at ten steps a second this is some seconds of changing movement.
_REMEMBERED = 64


class Schedule:
    """Trajectories and the times from which they are executed, the last few of them, or all."""

    def __init__(self, q: ArrayLike, t_s: float, forgets: bool = True) -> None:
        """Begin with a robot at rest at `q` (D,)."""
        rest = checked("start configuration", q, ("D",), error=PlanningError)
        self._entries = [(float(t_s), at_rest(rest, t_s))]
        self._most = _REMEMBERED if forgets else sys.maxsize
        self._forgotten = False

    def add(self, from_s: float, trajectory: TimedTrajectory) -> None:
        """Let `trajectory` take over at `from_s`; whatever was to take over then or later is dropped."""
        kept = [entry for entry in self._entries if entry[0] < from_s] or self._entries[:1]
        self._forgotten = self._forgotten or len(kept) >= self._most
        self._entries = [*kept, (from_s, trajectory)][-self._most :]

    @property
    def entries(self) -> Sequence[tuple[float, TimedTrajectory]]:
        """Trajectories, each with the time from which it is executed."""
        return self._entries

    def at(self, t_s: float) -> TimedTrajectory:
        """Return the trajectory executed at `t_s`; before the first, the robot rests where it began.

        Raises:
            PlanningError: for a time so long ago that it has been forgotten.
        """
        for from_s, trajectory in reversed(self._entries):
            if from_s <= t_s:
                return trajectory
        if self._forgotten:
            raise PlanningError(
                f"state of the robot: wanted {self._entries[0][0]:.3f} s or later, got {t_s:.3f} s; "
                "collect the decisions' trajectories to look farther back"
            )
        return self._entries[0][1]

    @property
    def last_from_s(self) -> float:
        """Time from which the newest trajectory is executed."""
        return self._entries[-1][0]

    def pieces(self, from_s: float, to_s: float) -> list[tuple[float, float, TimedTrajectory]]:
        """Return what is executed between two times: (begin, end, trajectory), in order."""
        begins = [from_s, *(begin_s for begin_s, _ in self._entries if from_s < begin_s < to_s)]
        ends = [*begins[1:], to_s]
        return [(begin_s, end_s, self.at(begin_s)) for begin_s, end_s in zip(begins, ends, strict=True)]

    def motion_from(self, t_s: float) -> TimedTrajectory:
        """Return all that is going to be executed from `t_s` on, as one trajectory that begins with the state then.

        A controller forgets the trajectory under way when a new one comes, so this is what it must be sent.

        Raises:
            PlanningError: as `at`.
        """
        knots = [(t_s, *self.state_at(t_s))]
        for begin_s, end_s, trajectory in self.pieces(t_s, np.inf):
            if begin_s > t_s:
                knots.append((begin_s, *trajectory.sample(begin_s)))
            inside = (trajectory.t_s > begin_s) & (trajectory.t_s < end_s)
            rows = (trajectory.t_s, trajectory.q, trajectory.v, trajectory.a)
            knots += zip(*(row[inside] for row in rows), strict=True)
        t, q, v, a = (np.array(part) for part in zip(*knots, strict=True))
        return TimedTrajectory(t, q, v, a)

    def positions(self, t_s: FloatArray) -> FloatArray:
        """Return the positions (T, D) at increasing times (T,); raises as `at`."""
        begins = [from_s for from_s, _ in self._entries if t_s[0] < from_s <= t_s[-1]]
        parts = np.split(t_s, np.searchsorted(t_s, begins, side="left"))
        return np.concatenate([self.at(float(part[0])).sample(part)[0] for part in parts if len(part)])

    def state_at(self, t_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (D,) at `t_s`."""
        if not np.isfinite(t_s):
            raise PlanningError(f"state of the robot: wanted a finite time, got {t_s}")
        return self.at(t_s).sample(t_s)
