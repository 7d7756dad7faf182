"""How to stop: what a hold does, along the trajectory being executed if there is one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.checks import FloatArray, checked
from humanpred_ros.errors import PlanningError
from humanpred_ros.planning import speed_profile
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

#: Time step of braking along a trajectory, s, and how long its deceleration takes to build up, in steps.
_STEP_S = 0.004
_SMOOTHING_STEPS = 15
#: Time in which a joint that is speeding up stops doing so, s.
_LEVEL_OFF_S = 0.05
#: Share of the limit a stop plans with: a joint that comes to rest between two knots is interpolated.
_USED = 0.95
#: Shares of the acceleration limit tried in turn: averaging the deceleration can exceed what was planned.
_SHARES = (0.95, 0.8, 0.65, 0.5, 0.35)


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
    a_limit = np.broadcast_to(np.asarray(acceleration_limit, dtype=np.float64), q0.shape)
    v_limit = np.broadcast_to(np.asarray(velocity_limit, dtype=np.float64), q0.shape)
    if not ((a_limit > 0.0).all() and (v_limit > 0.0).all() and sample_period_s > 0.0):
        raise PlanningError("stop: wanted limits and a sample period > 0, got others")
    if not (v0.any() or a0.any()):
        return at_rest(q0, start_s)
    # A joint that is speeding up first stops doing so: any gentler change would take it beyond its limit.
    first = np.where(v0 * a0 > 0.0, _LEVEL_OFF_S, 0.0)
    v1, a1 = v0 + a0 * first / 3.0, np.where(first > 0.0, 0.0, a0)
    then = _stop_times(v1, a1, v_limit, _USED * a_limit)
    duration = float((first + then).max())
    t = np.linspace(0.0, duration, max(2, int(np.ceil(duration / sample_period_s - 1e-9)) + 1))[:, None]
    before, after = np.minimum(t, first), np.clip((t - first) / then, 0.0, 1.0)
    level_q, level_v, level_a = _levelling(before, np.where(first > 0.0, first, 1.0), v0, a0)
    down_q, down_v, down_a = _coming_down(after, then, v1, a1)
    levelling = t < first
    position = q0 + level_q + down_q
    velocity = np.where(levelling, level_v, down_v)
    acceleration = np.where(levelling, level_a, down_a)
    velocity[0], acceleration[0] = v0, a0
    velocity[-1] = acceleration[-1] = 0.0
    return TimedTrajectory(t[:, 0] + start_s, position, velocity, acceleration)


def _levelling(
    t: FloatArray, lasts: FloatArray, v0: FloatArray, a0: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the way made, velocity and acceleration while the acceleration a0 (1 - u)² vanishes."""
    u = t / lasts
    w = 1.0 - u
    way = v0 * t + a0 * lasts**2 * (u / 3.0 - (1.0 - w**4) / 12.0)
    return way, v0 + a0 * lasts * (1.0 - w**3) / 3.0, a0 * w**2


def _coming_down(
    u: FloatArray, lasts: FloatArray, v0: FloatArray, a0: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the way made, velocity and acceleration at share u of the cubic v = w² ((1 + 2u) v0 + u T a0)."""
    w = 1.0 - u
    way = lasts * (v0 * (u - u**3 + 0.5 * u**4) + lasts * a0 * u**2 * (0.5 - 2.0 / 3.0 * u + 0.25 * u**2))
    velocity = w**2 * ((1.0 + 2.0 * u) * v0 + u * lasts * a0)
    return way, velocity, -6.0 * u * w * v0 / lasts + w * (1.0 - 3.0 * u) * a0


def _stop_times(v0: FloatArray, a0: FloatArray, v_limit: FloatArray, a_limit: FloatArray) -> FloatArray:
    """Return each joint's stopping time (D,): the shortest within the limits, or the one that exceeds them least."""
    longest = 4.0 * np.abs(v0) / a_limit + np.abs(a0) / a_limit + 0.05
    share = np.linspace(0.02, 1.0, 200)[:, None, None]
    times = share * longest  # (200, 1, D)
    _, v, a = _coming_down(np.linspace(0.0, 1.0, 41)[:, None], times, v0, a0)
    over_v = np.abs(v).max(axis=1) / np.maximum(v_limit, np.abs(v0))
    over_a = np.abs(a).max(axis=1) / np.maximum(a_limit, np.abs(a0))
    over = np.maximum(np.maximum(over_v, over_a), 1.0 + 1e-9)  # within the limits, all are as good
    chosen = np.argmin(over, axis=0)  # the first, so the shortest, of the best
    stop_times: FloatArray = times[chosen, 0, np.arange(len(v0))]
    return stop_times


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
    for share in _SHARES:
        stop = _slowed(trajectory, t_s, share * a_limit, sample_period_s)
        fine = np.linspace(stop.start_s, stop.end_s, 10 * len(stop))
        # What the trajectory does already is allowed.
        if (np.abs(stop.sample(fine)[2]) <= np.maximum(a_limit, np.abs(a0)) * (1.0 + LIMIT_TOLERANCE)).all():
            return stop
    return stop_trajectory(q0, v0, a0, a_limit, np.inf, sample_period_s, t_s)


def _slowed(trajectory: TimedTrajectory, t_s: float, a_limit: FloatArray, sample_period_s: float) -> TimedTrajectory:
    """Run through the rest of a trajectory ever more slowly, as fast as `a_limit` allows."""
    q0, v0, a0 = trajectory.sample(t_s)
    nodes: FloatArray = np.arange(int(np.ceil((trajectory.end_s - t_s) / _STEP_S)) + 1, dtype=np.float64) * _STEP_S
    _, v, a = trajectory.sample(t_s + nodes)
    x: FloatArray = speed_profile.braking(v, a, np.maximum(a_limit, np.abs(a)), _STEP_S)
    t, tau, rate, acceleration = _smoothed(nodes, np.asarray(np.sqrt(x), dtype=np.float64))
    keep = np.unique(np.append(np.arange(0, len(t), max(1, int(sample_period_s / _STEP_S))), len(t) - 1))
    t, tau, rate, acceleration = t[keep], tau[keep], rate[keep], acceleration[keep]
    q, v, a = trajectory.sample(t_s + tau)
    velocity = v * rate[:, None]
    acceleration = v * acceleration[:, None] + a * rate[:, None] ** 2
    q[0], velocity[0], acceleration[0] = q0, v0, a0
    velocity[-1] = acceleration[-1] = 0.0
    return TimedTrajectory(t_s + t, q, velocity, acceleration)


def _smoothed(tau: FloatArray, rate: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return t, tau(t), tau'(t), tau''(t) with the rate averaged over time, so that it does not jump."""
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
    return t, np.minimum(travelled, tau[-1]), smooth, acceleration
