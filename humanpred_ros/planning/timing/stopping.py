"""How to stop: what a hold does, along the trajectory being executed if there is one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.planning.timing import speed_profile
from humanpred_ros.planning.timing.coming_to_rest import ComingToRest
from humanpred_ros.planning.timing.limit_use import limit_use
from humanpred_ros.planning.timing.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

#: Time step of braking along a trajectory, s, and how long its deceleration takes to build up, in steps.
_STEP_S = 0.004
_SMOOTHING_STEPS = 15
#: Shares of the limit a stop plans with, in turn: what a joint does between two knots is interpolated, which
#: takes a little more where it comes to rest or stops speeding up there.
_USED = (0.95, 0.9, 0.8, 0.7)
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
    a_limit = np.array(np.broadcast_to(np.asarray(acceleration_limit, dtype=np.float64), q0.shape))
    v_limit = np.array(np.broadcast_to(np.asarray(velocity_limit, dtype=np.float64), q0.shape))
    if not ((a_limit > 0.0).all() and (v_limit > 0.0).all() and sample_period_s > 0.0):
        raise PlanningError("stop: wanted limits and a sample period > 0, got others")
    if not (v0.any() or a0.any()):
        return at_rest(q0, start_s)
    allowed_v, allowed_a = np.maximum(v_limit, np.abs(v0)), np.maximum(a_limit, np.abs(a0))
    for used in _USED:
        stop = _stop(q0, ComingToRest(v0, a0, v_limit, used * a_limit), v0, a0, sample_period_s, start_s)
        if limit_use(stop, allowed_v, allowed_a).max() <= 1.0 + LIMIT_TOLERANCE / 2.0:
            break
    return stop


def _stop(
    q0: FloatArray, fading: ComingToRest, v0: FloatArray, a0: FloatArray, sample_period_s: float, start_s: float
) -> TimedTrajectory:
    n_knots = max(2, int(np.ceil(fading.duration_s / sample_period_s - 1e-9)) + 1)
    t = np.linspace(0.0, fading.duration_s, n_knots)
    way, velocity, acceleration = fading.at(t)
    velocity[0], acceleration[0] = v0, a0
    velocity[-1] = acceleration[-1] = 0.0
    return TimedTrajectory(t + start_s, q0 + way, velocity, acceleration)


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
    for share in _SHARES:
        stop = _slowed(trajectory, t_s, share * a_limit, sample_period_s)
        if limit_use(stop, any_v, allowed_a).max() <= 1.0 + LIMIT_TOLERANCE / 2.0:
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
