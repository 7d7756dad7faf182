"""The joint_trajectory_controller of ros2_controllers (Jazzy) with position commands: what it refuses, how it moves.

In our words, after its documentation and source. What it refuses is told by `conversions.controller_refusal`.

A trajectory that is taken makes it forget the one under way at once, whatever its start time. Until the first point's
time it interpolates from the state at receipt; a first point in the past is passed over. Between two points it follows
the quintic through positions, velocities and accelerations where both points have them, the cubic where both have
velocities, else the line. A speed factor below 1 makes the trajectory's time run slower. An arm that is farther from
its trajectory than a tolerance ends it: the controller then holds the arm where it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.nodes.conversions import controller_refusal, stamp_ns
from humanpred_ros.planning.trajectory import quintic
from humanpred_ros.settings import Settings, setting

#: An arm that keeps to its velocity limits may need this much more for rounding.
_ROUNDING = 1.0 + 1e-9


class ControllerSettings(Settings):
    """Parameters of the controller; as on the robot, a tolerance of 0 is none."""

    path_tolerance_rad: float = setting(
        0.0, "an arm farther from its trajectory than this ends it; 0: no distance does", unit="rad", low=0.0
    )
    goal_tolerance_rad: float = setting(
        0.0,
        "an arm farther from the last point has not arrived; 0: any distance is near",
        unit="rad",
        low=0.0,
    )
    goal_time_s: float = setting(
        0.0, "an arm that has not arrived so long after the last point's time ends it; 0: never", unit="s", low=0.0
    )


@dataclass(frozen=True, eq=False)
class Tolerances:
    """How far the arm may be from its trajectory; 0 is no bound."""

    path_rad: FloatArray  #: (D,) on the way
    goal_rad: FloatArray  #: (D,) at the end
    goal_time_s: float  #: so long after the end it must be there


@dataclass(frozen=True, eq=False)
class _Knot:
    """A state at a time; velocities and accelerations are None where the message has none."""

    t_ns: int
    q: FloatArray
    v: FloatArray | None
    a: FloatArray | None


class TrajectoryController:
    """A controller and an arm that follows its commands as fast as its joints can.

    Attributes:
        joint_names: of the arm, D of them.
        q, v: (D,) where the arm is, and how fast it moves.
        speed_factor: of the trajectory's time; 0 is a pause.
        stuck: the arm does not move, whatever is commanded: its brakes are on, or somebody holds it.
        wanted_q, wanted_v: (D,) where the trajectory is.
        commanded: whether a trajectory has been taken yet.
        outcome: of the last trajectory, as FollowJointTrajectory's error code: None while it is under way, 0 once its
            end is reached, -4 if it was given up on the way, -5 if at its end.
        ended: why it was given up; empty if it was not.
        default_tolerances: of trajectories that come without their own.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        q: ArrayLike,
        velocity_limit: ArrayLike = np.inf,
        settings: ControllerSettings | None = None,
    ) -> None:
        """Begin with an arm of those joints at rest at `q` (D,), with velocity limits (D,) in rad/s."""
        self.joint_names = tuple(joint_names)
        self.q = np.array(q, dtype=np.float64)
        self.v = np.zeros_like(self.q)
        settings = settings or ControllerSettings()
        self.default_tolerances = self._tolerances = Tolerances(
            np.full_like(self.q, settings.path_tolerance_rad),
            np.full_like(self.q, settings.goal_tolerance_rad),
            settings.goal_time_s,
        )
        self.speed_factor, self.stuck, self.commanded = 1.0, False, False
        self.outcome: int | None = 0
        self.ended = ""
        self._velocity_limit = np.broadcast_to(np.asarray(velocity_limit, dtype=np.float64), self.q.shape)
        self.hold()
        self._now_ns: int | None = None
        self._lag_ns = 0.0

    def command(self, message: Any, now_ns: int, tolerances: Tolerances | None = None) -> str:
        """Take a trajectory in place of the one under way; return why it is refused, empty if it is not."""
        refusal = controller_refusal(message, self.joint_names, now_ns)
        if refusal:
            return refusal
        self.update(now_ns)
        self._lag_ns, self.outcome, self.ended, self.commanded = 0.0, None, "", True
        self._tolerances = tolerances or self.default_tolerances
        column = [list(message.joint_names).index(name) for name in self.joint_names]
        start_ns = stamp_ns(message.header.stamp) or now_ns
        knots = [
            _Knot(
                start_ns + stamp_ns(point.time_from_start),
                np.asarray(point.positions, dtype=np.float64)[column],
                _columns(point.velocities, column),
                _columns(point.accelerations, column),
            )
            for point in message.points
        ]
        if knots[0].t_ns > now_ns:
            # What is measured of the arm is position and velocity: up to the first point it follows a cubic.
            knots.insert(0, _Knot(now_ns, self.q.copy(), self.v.copy(), None))
        self._knots = knots
        return ""

    def update(self, now_ns: int) -> None:
        """Let the time be `now_ns`: the arm moves towards where the trajectory is by now."""
        before_ns, self._now_ns = self._now_ns, now_ns
        if before_ns is None or now_ns <= before_ns:
            self._lag_ns = 0.0 if before_ns is None else self._lag_ns
            return
        self._lag_ns += (1.0 - self.speed_factor) * (now_ns - before_ns)
        self.wanted_q, self.wanted_v = wanted_q, wanted_v = self._sample(now_ns - self._lag_ns)
        step_s = (now_ns - before_ns) * 1e-9
        if self.stuck:
            self.v = np.zeros_like(self.q)
        else:
            most = self._velocity_limit * step_s * _ROUNDING
            follows = (np.abs(wanted_q - self.q) <= most).all()
            moved = wanted_q if follows else self.q + np.clip(wanted_q - self.q, -most, most)
            self.v = wanted_v * self.speed_factor if follows else (moved - self.q) / step_s
            self.q = moved
        self._check_tolerances(wanted_q, now_ns - self._lag_ns)

    def hold(self) -> None:
        """Command rest where the arm is."""
        rest = np.zeros_like(self.q)
        self.wanted_q, self.wanted_v = self.q.copy(), rest
        self._knots = [_Knot(0, self.q.copy(), rest, rest)]

    def _check_tolerances(self, wanted_q: FloatArray, t_ns: float) -> None:
        """Give up a trajectory that the arm does not follow, and hold the arm where it is."""
        if self.outcome is not None:
            return
        over_s = (t_ns - self._knots[-1].t_ns) * 1e-9
        under_way = over_s < 0.0
        allowed = self._tolerances.path_rad if under_way else self._tolerances.goal_rad
        error = np.abs(wanted_q - self.q)
        excess = np.where(allowed > 0.0, error - allowed, -np.inf)
        worst = int(np.argmax(excess))
        if excess[worst] <= 0.0:
            self.outcome = None if under_way else 0
        elif under_way or 0.0 < self._tolerances.goal_time_s < over_s:
            self.outcome = -4 if under_way else -5
            self.ended = (
                f"{'path' if under_way else 'goal'} tolerance: {self.joint_names[worst]} is {error[worst]:.4f} rad "
                f"from where it should be, allowed are {allowed[worst]:g}"
            )
            self.hold()

    def _sample(self, t_ns: float) -> tuple[FloatArray, FloatArray]:
        """Return the commanded position and velocity (D,) at a time of the trajectory."""
        knots = self._knots
        if t_ns >= knots[-1].t_ns:
            return knots[-1].q, np.zeros_like(self.q)
        after = next(k for k, knot in enumerate(knots) if knot.t_ns > t_ns)
        a, b = knots[max(after - 1, 0)], knots[after]
        h = max(b.t_ns - a.t_ns, 1) * 1e-9
        u = min(max((t_ns - a.t_ns) * 1e-9 / h, 0.0), 1.0)
        if a.v is None or b.v is None:
            return a.q + u * (b.q - a.q), (b.q - a.q) / h
        if a.a is None or b.a is None:
            v0, v1 = a.v * h, b.v * h
            c2, c3 = 3.0 * (b.q - a.q) - 2.0 * v0 - v1, -2.0 * (b.q - a.q) + v0 + v1
            return a.q + u * (v0 + u * (c2 + u * c3)), (v0 + u * (2.0 * c2 + u * 3.0 * c3)) / h
        return quintic(u, h, (a.q, a.v, a.a), (b.q, b.v, b.a))[:2]


def _columns(values: Any, column: list[int]) -> FloatArray | None:
    return np.asarray(values, dtype=np.float64)[column] if len(values) else None
