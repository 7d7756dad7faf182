"""How to stop: every joint for itself, or along the trajectory being executed, as a hold does.

A joint for itself: its velocity follows the cubic in time that begins with its velocity and acceleration and ends with
both zero; a joint that is speeding up levels off first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.planning.path_following import braking
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

#: Time in which a joint that is speeding up stops doing so, s.
_LEVEL_OFF_S = 0.05
#: Stopping times tried per joint; the longest is some three times what braking at the limit takes.
_TIMES = 200
#: Time step of braking along a trajectory, s, and how long its deceleration takes to build up, in steps.
_STEP_S = 0.004
_SMOOTHING_STEPS = 15
#: Shares of the limit a stop plans with, in turn: what a joint does between two knots is interpolated, which
#: takes a little more where it comes to rest or stops speeding up there.
_USED = (0.95, 0.9, 0.8, 0.7)
#: Shares of the acceleration limit tried in turn: averaging the deceleration can exceed what was planned.
_SHARES = (0.95, 0.8, 0.65, 0.5, 0.35)
#: Moments at which the use of limits is looked at, per knot: its own and those between it and the next.
MOMENTS = 8


class ComingToRest:
    """The movement from a state to rest.

    Attributes:
        duration_s: when the last joint has come to rest.
        way: (D,) what each joint has moved by then, rad.
    """

    def __init__(
        self, v0: FloatArray, a0: FloatArray, v_limit: FloatArray, a_limit: FloatArray, shortest_s: float = 0.0
    ) -> None:
        """Take a state and limits, each (D,), and the least time to take.

        Where the state is beyond the limits already, or accelerates towards the velocity limit, the time
        that exceeds them least is taken.
        """
        self._v0, self._a0 = v0, a0
        # A joint that is speeding up first stops doing so: any gentler change would take it beyond its limit.
        speeding_up = v0 * a0 > 0.0
        self._first = np.where(speeding_up, _LEVEL_OFF_S, 0.0)
        self._v1, self._a1 = v0 + a0 * self._first / 3.0, np.where(speeding_up, 0.0, a0)
        moves = (self._v1 != 0.0) | (self._a1 != 0.0)
        self._then = np.where(moves, _stop_times(self._v1, self._a1, v_limit, a_limit, shortest_s), 0.0)
        self.duration_s = float((self._first + self._then).max())
        self.way: FloatArray = self.at(np.array([self.duration_s]))[0][0]

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return the way made, velocity and acceleration (3, T, D) at times (T,) >= 0; at rest after the end."""
        found: FloatArray = _fade(t_s, self._v0, self._a0, self._first, self._v1, self._a1, self._then)
        return found


@exact
def _fade(
    t_s: FloatArray, v0: FloatArray, a0: FloatArray, first: FloatArray, v1: FloatArray, a1: FloatArray, then: FloatArray
) -> FloatArray:
    """Return way, velocity, acceleration (3, T, D): levelling off for `first` seconds, coming down for `then`."""
    out = np.empty((3, len(t_s), len(v0)))
    for j in range(len(v0)):
        for i in range(len(t_s)):
            t = t_s[i]
            way, speed, change = 0.0, 0.0, 0.0
            if first[j] > 0.0:
                # The acceleration vanishes as a0 (1 - u)².
                u = min(t / first[j], 1.0)
                w = 1.0 - u
                way = v0[j] * first[j] * u + a0[j] * first[j] ** 2 * (u / 3.0 - (1.0 - w**4) / 12.0)
                speed = v0[j] + a0[j] * first[j] * (1.0 - w**3) / 3.0
                change = a0[j] * w**2
            if t >= first[j] and then[j] > 0.0:
                # The velocity is the cubic w² ((1 + 2 u) v1 + u T a1).
                lasts = then[j]
                u = min((t - first[j]) / lasts, 1.0)
                w = 1.0 - u
                way += lasts * v1[j] * u * (1.0 - u**2 + 0.5 * u**3)
                way += lasts**2 * a1[j] * u**2 * (0.5 - 2.0 / 3.0 * u + 0.25 * u**2)
                speed = w**2 * ((1.0 + 2.0 * u) * v1[j] + u * lasts * a1[j])
                change = -6.0 * u * w * v1[j] / lasts + w * (1.0 - 3.0 * u) * a1[j]
            out[0, i, j], out[1, i, j], out[2, i, j] = way, speed, change
    return out


@exact_part
def _excess(v0: float, a0: float, lasts: float, v_limit: float, a_limit: float) -> float:
    """Return the largest share of a limit that coming down in `lasts` seconds uses; the state is excused."""
    # Acceleration a0 + b u + c u² and its extremum; the velocity's lies where the acceleration crosses 0.
    b, c = -6.0 * v0 / lasts - 4.0 * a0, 6.0 * v0 / lasts + 3.0 * a0
    peak_a, peak_v = abs(a0), abs(v0)
    if c != 0.0:
        u = -b / (2.0 * c)
        if 0.0 < u < 1.0:
            peak_a = max(peak_a, abs(a0 + b * u + c * u * u))
        u = a0 / c
        if 0.0 < u < 1.0:
            peak_v = max(peak_v, abs((1.0 - u) ** 2 * ((1.0 + 2.0 * u) * v0 + u * lasts * a0)))
    return max(peak_v / max(v_limit, abs(v0)), peak_a / max(a_limit, abs(a0)))


@exact
def _stop_times(
    v0: FloatArray, a0: FloatArray, v_limit: FloatArray, a_limit: FloatArray, shortest: float
) -> FloatArray:
    """Return each joint's stopping time (D,): the shortest within the limits, or the one that exceeds them least."""
    times = np.zeros(len(v0))
    for j in range(len(v0)):
        longest = 4.0 * abs(v0[j]) / a_limit[j] + abs(a0[j]) / a_limit[j] + 0.05
        longest = max(longest, 2.0 * shortest)
        begin = max(0.02 * longest, shortest)
        least = np.inf
        for k in range(_TIMES):
            lasts = begin + (longest - begin) * k / (_TIMES - 1)
            over = _excess(v0[j], a0[j], lasts, v_limit[j], a_limit[j])
            if over < least:
                least, times[j] = over, lasts
            if over <= 1.0 + 1e-9:
                break
    return times


def stop_trajectory(
    q: ArrayLike,
    v: ArrayLike,
    a: ArrayLike,
    acceleration_limit: ArrayLike,
    velocity_limit: ArrayLike = np.inf,
    sample_period_s: float = 0.02,
    start_s: float = 0.0,
) -> TimedTrajectory:
    """Return the way from a state to rest, every joint for itself and as soon as its limits allow.

    Each joint's velocity follows the cubic in time that begins with the given velocity and acceleration and
    ends with both zero; a joint that is speeding up levels off first. Use `brake_along` where there is a
    trajectory to stay on.

    Args:
        q, v, a: (D,) state in rad, rad/s, rad/s².
        acceleration_limit, velocity_limit: (D,) or one number. Where the state is beyond them already, or
            accelerates towards the velocity limit, the time that exceeds them least is taken.
        sample_period_s: largest time between knots.
        start_s: time of the state.

    Raises:
        PlanningError: for wrong shapes or limits and periods that are not positive.
    """
    q0 = checked("position", q, ("D",), error=PlanningError)
    v0 = checked("velocity", v, q0.shape, error=PlanningError)
    a0 = checked("acceleration", a, q0.shape, error=PlanningError)
    a_limit = np.array(np.broadcast_to(np.asarray(acceleration_limit, dtype=np.float64), q0.shape))
    v_limit = np.array(np.broadcast_to(np.asarray(velocity_limit, dtype=np.float64), q0.shape))
    if not ((a_limit > 0.0).all() and (v_limit > 0.0).all() and sample_period_s > 0.0):
        raise PlanningError("stop: wanted limits and a sample period > 0, got others")
    if not (v0.any() or a0.any()):
        return at_rest(q0, start_s)
    allowed_v, allowed_a = np.maximum(v_limit, np.abs(v0)), np.maximum(a_limit, np.abs(a0))
    for used in _USED:
        fading = ComingToRest(v0, a0, v_limit, used * a_limit)
        t = np.linspace(0.0, fading.duration_s, n_knots(fading.duration_s, sample_period_s))
        way, velocity, acceleration = fading.at(t)
        velocity[0], acceleration[0] = v0, a0
        velocity[-1] = acceleration[-1] = 0.0
        stop = TimedTrajectory(t + start_s, q0 + way, velocity, acceleration)
        if limit_use(stop, allowed_v, allowed_a).max() <= 1.0 + LIMIT_TOLERANCE / 2.0:
            break
    return stop


def n_knots(duration_s: float, period_s: float) -> int:
    """Return how many knots, at least two and at most a period apart, a movement takes."""
    return max(2, int(np.ceil(duration_s / period_s - 1e-9)) + 1)


def brake_along(
    trajectory: TimedTrajectory,
    t_s: float,
    acceleration_limit: ArrayLike,
    sample_period_s: float = 0.02,
) -> TimedTrajectory:
    """Return a stop that stays on the trajectory being executed, from its state at `t_s`.

    The trajectory is run through ever more slowly: q(tau(t)) with tau' falling from 1 to 0. The robot thus
    stops on the path that was checked, which a stop of every joint for itself would leave.

    Where the trajectory itself is too close to its limits for that, every joint stops for itself.

    Raises:
        PlanningError: for limits or a period that are not positive.
    """
    q0, v0, a0 = trajectory.sample(t_s)
    a_limit = np.array(np.broadcast_to(np.asarray(acceleration_limit, dtype=np.float64), q0.shape))
    if not ((a_limit > 0.0).all() and sample_period_s > 0.0):
        raise PlanningError("stop: wanted acceleration limits and a sample period > 0, got others")
    if trajectory.end_s <= t_s or not (v0.any() or a0.any()):
        return at_rest(q0, t_s)
    # What the trajectory does already is allowed; and it is never run through faster.
    any_v, allowed_a = np.full(q0.shape, np.inf), np.maximum(a_limit, np.abs(a0))
    nodes = np.arange(int(np.ceil((trajectory.end_s - t_s) / _STEP_S)) + 1, dtype=np.float64) * _STEP_S
    _, v, a = trajectory.sample(t_s + nodes)
    for share in _SHARES:
        x = braking(v, a, np.maximum(share * a_limit, np.abs(a)), _STEP_S)
        t, tau, rate, change = _smoothed(nodes, np.sqrt(x), max(1, int(sample_period_s / _STEP_S)))
        q, velocity, acceleration = trajectory.sample(t_s + tau)
        acceleration = velocity * change[:, None] + acceleration * rate[:, None] ** 2
        velocity = velocity * rate[:, None]
        q[0], velocity[0], acceleration[0] = q0, v0, a0
        velocity[-1] = acceleration[-1] = 0.0
        stop = TimedTrajectory(t_s + t, q, velocity, acceleration)
        if limit_use(stop, any_v, allowed_a).max() <= 1.0 + LIMIT_TOLERANCE / 2.0:
            return stop
    return stop_trajectory(q0, v0, a0, a_limit, np.inf, sample_period_s, t_s)


def _smoothed(tau: FloatArray, rate: FloatArray, every: int) -> tuple[FloatArray, ...]:
    """Return t, tau(t), tau'(t), tau''(t) at every so many steps and the end, the rate averaged over time.

    Without averaging the rate would jump.
    """
    end = int(np.argmax(rate <= 1e-9)) if (rate <= 1e-9).any() else len(rate) - 1
    step = 2.0 * np.diff(tau[: end + 1]) / np.maximum(rate[1 : end + 1] + rate[:end], 1e-6)
    at = np.concatenate([[0.0], np.cumsum(step)])
    count = int(np.ceil(at[-1] / _STEP_S)) + _SMOOTHING_STEPS
    t: FloatArray = np.arange(count + 1, dtype=np.float64) * _STEP_S
    raw = np.interp(t, at, rate[: end + 1], right=0.0)
    padded = np.concatenate([np.ones(_SMOOTHING_STEPS), raw])
    total = np.concatenate([[0.0], np.cumsum(padded)])
    smooth: FloatArray = (total[_SMOOTHING_STEPS + 1 :] - total[1:-_SMOOTHING_STEPS]) / _SMOOTHING_STEPS
    acceleration = (raw - padded[: len(raw)]) / (_SMOOTHING_STEPS * _STEP_S)
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (smooth[1:] + smooth[:-1]) * _STEP_S)])
    smooth[-1] = 0.0
    keep = np.unique(np.append(np.arange(0, len(t), every), len(t) - 1))
    return t[keep], np.minimum(travelled, tau[-1])[keep], smooth[keep], acceleration[keep]


def limit_use(trajectory: TimedTrajectory, v_limit: FloatArray, a_limit: FloatArray) -> FloatArray:
    """Return the largest share of any limit used (T, MOMENTS) at each knot and between it and the next.

    Args:
        v_limit, a_limit: (D,) rad/s and rad/s².
    """
    use: FloatArray = _use(trajectory.t_s, trajectory.q, trajectory.v, trajectory.a, v_limit, a_limit)
    return use


@exact
def _use(
    t: FloatArray, q: FloatArray, v: FloatArray, a: FloatArray, v_limit: FloatArray, a_limit: FloatArray
) -> FloatArray:
    use = np.zeros((len(t), MOMENTS))
    for j in range(q.shape[1]):
        per_v, per_a = 1.0 / v_limit[j], 1.0 / a_limit[j]
        for k in range(len(t) - 1):
            h = t[k + 1] - t[k]
            v0, a0 = v[k, j] * h, a[k, j] * h * h
            # The same quintic as `TimedTrajectory.sample`.
            d = q[k + 1, j] - q[k, j] - v0 - 0.5 * a0
            e = v[k + 1, j] * h - v0 - a0
            f = a[k + 1, j] * h * h - a0
            c3, c4, c5 = 10.0 * d - 4.0 * e + 0.5 * f, -15.0 * d + 7.0 * e - f, 6.0 * d - 3.0 * e + 0.5 * f
            for m in range(MOMENTS):
                u = m / MOMENTS
                speed = (v0 + u * (a0 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)))) / h
                change = (a0 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5))) / (h * h)
                use[k, m] = max(use[k, m], max(abs(speed) * per_v, abs(change) * per_a))
        last = len(t) - 1
        use[last, 0] = max(use[last, 0], max(abs(v[last, j]) * per_v, abs(a[last, j]) * per_a))
    return use
