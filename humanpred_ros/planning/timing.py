"""When the robot is where: times for a planned path that take over from whatever the robot is doing.

The path is followed as fast as the limits allow, at first with the part of the present velocity that points
along it. What is left of the present velocity and acceleration is added and decays within a fraction of a
second, so that position, velocity and acceleration are continuous at the switch. While it decays, the path
is allowed only a share of the limits; the sum then stays within them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.checks import FloatArray, checked
from humanpred_ros.errors import PlanningError
from humanpred_ros.planning import speed_profile
from humanpred_ros.planning.smooth_path import NODES, SmoothPath, smooth_path
from humanpred_ros.planning.stopping import stop_trajectory
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

_DS = 1.0 / (NODES - 1)
#: Share of the limits that planned motion uses; the rest is for rounding off and interpolating.
_USED = 0.95
#: Accelerations are averaged over this long, so that they do not jump, s.
_SMOOTHING_S = 0.08
#: An acceleration that does not belong to the path decays within this time, s.
_ACCELERATION_DECAY_S = 0.2
#: The same for a velocity, at least, s; longer if the limits ask for it.
_VELOCITY_DECAY_S = 0.1

# Quintics on u in [0, 1] that end in rest at 0: f begins with slope 1, g with curvature 1 (0 otherwise).
_F = [np.polynomial.Polynomial([0.0, 1.0, 0.0, -6.0, 8.0, -3.0]).deriv(k) for k in range(3)]
_G = [np.polynomial.Polynomial([0.0, 0.0, 0.5, -1.5, 1.5, -0.5]).deriv(k) for k in range(3)]
_F_PEAK_ACCELERATION = 3.94  # max |f''|
_F_LOWEST_SLOPE = 0.512  # max of -f'
_G_PEAK_SLOPE = 0.068  # max |g'|


@dataclass(frozen=True)
class _Attempt:
    """How much of the acceleration limit the path and the decaying rest may use, and how fast to begin."""

    path: float
    decay: float
    begin: float


_ATTEMPTS = (_Attempt(0.40, 0.55, 1.0), _Attempt(0.20, 0.60, 0.5), _Attempt(0.05, 0.60, 0.0))
#: Times the path is slowed down where a limit was exceeded before the next attempt.
_ROUNDS = 6


def time_parameterise(
    waypoints: ArrayLike,
    velocity_limit: ArrayLike,
    acceleration_limit: ArrayLike,
    start_velocity: ArrayLike | None = None,
    start_acceleration: ArrayLike | None = None,
    sample_period_s: float = 0.02,
    start_s: float = 0.0,
) -> TimedTrajectory:
    """Return a trajectory along a path that begins in a given state and ends at rest.

    Args:
        waypoints: (N, D) path in rad; the first is the position at `start_s`. Corners are rounded off.
        velocity_limit, acceleration_limit: (D,) or one number, rad/s and rad/s².
        start_velocity, start_acceleration: (D,) state at the switch; zero if not given. Where the state
            itself is beyond a limit, that joint may stay beyond until it has been brought back.
        sample_period_s: largest time between knots.
        start_s: time of the first knot.

    Returns:
        Knots from `start_s` on, the first exactly the given state. Limits hold to within `LIMIT_TOLERANCE`.

    Raises:
        PlanningError: for wrong shapes or limits and periods that are not positive.
    """
    path = checked("waypoints", waypoints, ("N", "D"), error=PlanningError)
    if len(path) < 2:
        raise PlanningError(f"waypoints: wanted at least 2, got {len(path)}")
    n = path.shape[1]
    v_limit, a_limit = _limits("velocity", velocity_limit, n), _limits("acceleration", acceleration_limit, n)
    v0, a0 = _state("velocity", start_velocity, n), _state("acceleration", start_acceleration, n)
    if not (np.isfinite(sample_period_s) and sample_period_s > 0.0):
        raise PlanningError(f"time parameterisation: wanted a sample period > 0 s, got {sample_period_s}")
    if not (v0.any() or a0.any()) and not np.ptp(path, axis=0).any():
        return at_rest(path[0], start_s)
    return _timed(path, v_limit, a_limit, v0, a0, sample_period_s, start_s, may_stop_first=True)


def _timed(
    path: FloatArray,
    v_limit: FloatArray,
    a_limit: FloatArray,
    v0: FloatArray,
    a0: FloatArray,
    period: float,
    start_s: float,
    may_stop_first: bool,
) -> TimedTrajectory:
    smooth = smooth_path(path)
    state = _State(v0, a0, v_limit, a_limit)
    candidates: list[tuple[float, TimedTrajectory]] = []
    for attempt in _ATTEMPTS:
        candidates.append(_follow(smooth, state, attempt, period, start_s))
        if candidates[-1][0] <= 1.0:
            break
    excess, trajectory = min(candidates, key=lambda candidate: candidate[0])
    if excess <= 1.0 + LIMIT_TOLERANCE or not may_stop_first:
        return trajectory
    # The state fits no blend onto this path: come to rest first, then go to the path and along it.
    stop = stop_trajectory(path[0], v0, a0, a_limit, v_limit, period, start_s)
    rest = np.zeros_like(v0)
    onward = np.concatenate([stop.q[-1:], path[1:]])
    after = _timed(onward, v_limit, a_limit, rest, rest, period, stop.end_s, may_stop_first=False)
    join = [np.concatenate([getattr(stop, name), getattr(after, name)[1:]]) for name in ("t_s", "q", "v", "a")]
    return TimedTrajectory(*join)


@dataclass(frozen=True)
class _State:
    """State at the switch and limits, each (D,)."""

    v: FloatArray
    a: FloatArray
    v_limit: FloatArray
    a_limit: FloatArray


def _follow(
    smooth: SmoothPath, state: _State, attempt: _Attempt, period: float, start_s: float
) -> tuple[float, TimedTrajectory]:
    """Follow a path with its share of the limits, and let the rest of the present state decay.

    Returns:
        The largest share of any limit used, and the trajectory.
    """
    if smooth.length < 1e-9:
        blend = _Blend(state, state.v, state.a, attempt)
        trajectory = _combined(smooth, None, blend, state, period, start_s)
        return float(_use(trajectory, state)[1].max()), trajectory
    d1, d2 = smooth.nodes()
    v_cap = np.broadcast_to(_USED * state.v_limit, d1.shape).copy()
    a_cap = np.broadcast_to(_USED * state.a_limit, d1.shape).copy()
    # The start's velocity along the path, in the metric in which every joint's limit is 1.
    towards = d1[0] / state.v_limit
    wish = attempt.begin * max(0.0, float(towards @ (state.v / state.v_limit)) / float(towards @ towards))
    profile, begin = _solve(d1, d2, v_cap, a_cap, wish)
    blend = _Blend(state, state.v - d1[0] * begin, state.a - d2[0] * begin**2, attempt)
    if blend.velocity_time.any():
        # While the leftover decays the path has only its share; beyond the place it has then reached, all.
        reached = profile.at(np.array([blend.duration_s]))[0][0]
        shared = np.arange(NODES) * _DS <= reached + _DS
        a_cap[shared] = attempt.path * state.a_limit
        v_cap[shared] = blend.velocity_left(np.sign(d1[shared]), state)
    best: tuple[float, TimedTrajectory] | None = None
    for _ in range(_ROUNDS):
        profile, begin = _solve(d1, d2, v_cap, a_cap, wish)
        blend = _Blend(state, state.v - d1[0] * begin, state.a - d2[0] * begin**2, attempt)
        trajectory = _combined(smooth, profile, blend, state, period, start_s)
        times, use = _use(trajectory, state)
        if best is None or use.max() < best[0]:
            best = float(use.max()), trajectory
        if best[0] <= 1.0:
            break
        # Averaging shifts accelerations along the path; go more slowly where that broke a limit.
        low, high = profile.span(times[use > 1.0] - start_s)
        slower = np.ones(NODES)
        for first, last, by in zip(low, high, use[use > 1.0], strict=True):
            window = slice(max(int(first / _DS) - 1, 0), int(last / _DS) + 3)
            slower[window] = np.minimum(slower[window], max(_USED / by, 0.5))
        a_cap *= slower[:, None]
    if best is None:
        raise PlanningError("time parameterisation: wanted one or more rounds")
    return best


def _solve(d1: FloatArray, d2: FloatArray, v_cap: FloatArray, a_cap: FloatArray, wish: float) -> tuple[_Profile, float]:
    """Return the fastest profile under limits per node, and the speed ṡ <= wish it begins with."""
    best = speed_profile.controllable(d1, d2, v_cap, a_cap, _DS)
    begin = _reachable(wish, best)
    lead, first = _lead(begin)
    x = speed_profile.fastest(d1, d2, a_cap, _DS, best, first, lead, begin**2)
    return _Profile(x, begin), begin


def _combined(
    smooth: SmoothPath, profile: _Profile | None, blend: _Blend, state: _State, period: float, start_s: float
) -> TimedTrajectory:
    duration = max(profile.duration_s if profile else 0.0, blend.duration_s)
    t = np.linspace(0.0, duration, max(2, int(np.ceil(duration / period - 1e-9)) + 1))
    q, v, a = blend.at(t)
    if profile:
        s, rate, acceleration = profile.at(t)
        on_path, d1, d2 = smooth.at(s)
        q += on_path
        v += d1 * rate[:, None]
        a += d1 * acceleration[:, None] + d2 * rate[:, None] ** 2
    else:
        q += smooth.control[0]
    q[0], v[0], a[0] = smooth.control[0], state.v, state.a
    q[-1], v[-1], a[-1] = smooth.control[-1], 0.0, 0.0
    return TimedTrajectory(t + start_s, q, v, a)


class _Blend:
    """What is left of the state at the switch, each joint decaying to nothing by a quintic of its own."""

    def __init__(self, state: _State, v: FloatArray, a: FloatArray, attempt: _Attempt) -> None:
        self._v, self._a = v, a
        needed = _F_PEAK_ACCELERATION * np.abs(v) / (attempt.decay * state.a_limit)
        self.velocity_time = np.where(v != 0.0, np.maximum(needed, _VELOCITY_DECAY_S), 0.0)
        self._acceleration_time = np.where(a != 0.0, _ACCELERATION_DECAY_S, 0.0)
        self.duration_s = float(max(self.velocity_time.max(), self._acceleration_time.max()))

    def velocity_left(self, direction: FloatArray, state: _State) -> FloatArray:
        """Return the velocity (M, D) that is left for a path going in `direction` (M, D) of signs."""
        along = direction * self._v
        used = np.where(along > 0.0, along, -_F_LOWEST_SLOPE * along)
        used = used + _G_PEAK_SLOPE * _ACCELERATION_DECAY_S * np.abs(self._a)
        left: FloatArray = np.maximum(_USED * state.v_limit - used, 0.05 * state.v_limit)
        return left

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration (T, D) of the leftover at times (T,)."""
        q, v, a = (np.zeros((len(t), len(self._v))) for _ in range(3))
        for kind, amount, time, power in (
            (_F, self._v, self.velocity_time, 1),
            (_G, self._a, self._acceleration_time, 2),
        ):
            if not time.any():
                continue
            lasts = np.where(time > 0.0, time, 1.0)
            u = np.minimum(t[:, None] / lasts, 1.0)
            q += amount * lasts**power * kind[0](u)
            v += amount * lasts ** (power - 1) * kind[1](u)
            a += amount * lasts ** (power - 2) * kind[2](u)
        return q, v, a


def _lead(begin: float) -> tuple[float, int]:
    """Return where s is while its average is still 0 at speed `begin`, and the first node after that."""
    lead = begin * _SMOOTHING_S / 2.0
    return lead, int(lead / _DS) + 1


def _reachable(begin: float, best: FloatArray) -> float:
    """Lower a first speed until the path's end can be reached at rest from it."""
    for _ in range(100):
        first = _lead(begin)[1]
        if first < NODES and begin**2 <= best[: first + 1].min():
            return begin
        begin *= 0.95
    return 0.0


class _Profile:
    """s(t) of a path followed with x = ṡ² at its nodes, averaged over the last `_SMOOTHING_S`."""

    def __init__(self, x: FloatArray, begin: float) -> None:
        speed = np.sqrt(x)
        lead, first = _lead(begin)
        s = np.concatenate([[lead], np.arange(first, len(x)) * _DS])
        rate = np.concatenate([[begin], speed[first:]])
        step = 2.0 * np.diff(s) / np.maximum(rate[1:] + rate[:-1], 1e-9)
        keep = np.concatenate([[True], step > 1e-12])
        s, rate, step = s[keep], rate[keep], step[keep[1:]]
        self._t = np.concatenate([[0.0], np.cumsum(step)])
        self._s, self._rate = s, rate
        self._u = np.append(np.diff(rate) / step, 0.0)
        pieces = s[:-1] * step + rate[:-1] * step**2 / 2.0 + self._u[:-1] * step**3 / 6.0
        self._area = np.concatenate([[0.0], np.cumsum(pieces)])
        self.duration_s = float(self._t[-1]) + _SMOOTHING_S

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return s, ṡ and s̈ (T,) at times (T,)."""
        now, before = self._raw(t), self._raw(t - _SMOOTHING_S)
        s, rate, acceleration = ((x - y) / _SMOOTHING_S for x, y in zip(now, before, strict=True))
        return np.clip(s, 0.0, 1.0), rate, acceleration

    def span(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the stretches of s (T,) to (T,) that the averages at times (T,) look at."""
        ends = self._raw(t - _SMOOTHING_S)[1], self._raw(t)[1]
        return np.clip(ends[0], 0.0, 1.0), np.clip(ends[1], 0.0, 1.0)

    def _raw(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the integral of s, s and ṡ; constant speed before the start, rest after the end."""
        k = np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, len(self._t) - 1)
        d = t - self._t[k]
        # Before the start d is negative and the first piece must not accelerate; after the end all is at rest.
        u = np.where(t < 0.0, 0.0, self._u[k])
        area = self._area[k] + self._s[k] * d + self._rate[k] * d**2 / 2.0 + u * d**3 / 6.0
        s = self._s[k] + self._rate[k] * d + u * d**2 / 2.0
        return area, s, self._rate[k] + u * d


def _use(trajectory: TimedTrajectory, state: _State) -> tuple[FloatArray, FloatArray]:
    """Return four times per knot (T,) and the largest share of any limit used then; the given state is excused."""
    fine = np.interp(np.arange(4 * len(trajectory) - 3) / 4.0, np.arange(len(trajectory)), trajectory.t_s)
    _, v, a = trajectory.sample(fine)
    allowed_v = np.maximum(state.v_limit, np.abs(state.v) * (1.0 + 1e-9))
    allowed_a = np.maximum(state.a_limit, np.abs(state.a) * (1.0 + 1e-9))
    use: FloatArray = np.maximum((np.abs(v) / allowed_v).max(axis=1), (np.abs(a) / allowed_a).max(axis=1))
    return fine, use


def _limits(name: str, value: ArrayLike, n: int) -> FloatArray:
    array = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)))
    if not (np.isfinite(array) & (array > 0.0)).all():
        raise PlanningError(f"{name} limit: wanted finite numbers > 0, got {array}")
    return array


def _state(name: str, value: ArrayLike | None, n: int) -> FloatArray:
    return np.zeros(n) if value is None else checked(f"start {name}", value, (n,), error=PlanningError)
