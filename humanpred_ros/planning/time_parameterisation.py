"""When the robot is where: times for a planned path that take over from whatever the robot is doing.

The path is followed as fast as the limits allow, at first with the part of the present velocity and
acceleration that points along it. What is left of them fades as fast as it can, every joint for itself; where
that leads aside, the path is led back, early enough not to matter at its end. The limits that the path may
use at any moment are what the fading leaves, so the sum stays within them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.planning.path import NODES, SmoothPath, path_parameter, smooth_path
from humanpred_ros.planning.speed_profile import SMOOTHING_S, AveragedProfile, Begin, controllable, fastest
from humanpred_ros.planning.stopping import MOMENTS, ComingToRest, limit_use, stop_trajectory
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

#: Shares of the limits that planned motion uses; the rest is for rounding off and interpolating.
USED_V, USED_A = 0.98, 0.95
#: Share of the acceleration limit used where the path could not be entered as fast as the robot moves otherwise:
#: what brakes already with the usual share needs it, and a little more for rounding.
USED_A_AT_MOST = 0.985


@dataclass(frozen=True)
class State:
    """State at the switch and limits, each (D,)."""

    v: FloatArray
    a: FloatArray
    v_limit: FloatArray
    a_limit: FloatArray


@dataclass
class PathLimits:
    """Limits (NODES, D) that the path may use at each node."""

    v_low: FloatArray
    v_high: FloatArray
    a_low: FloatArray
    a_high: FloatArray

    @classmethod
    def beside(
        cls,
        fading: ComingToRest | None,
        state: State,
        node_t_s: FloatArray,
        slower: FloatArray,
        used_a: float = USED_A,
    ) -> PathLimits:
        """Return what a fading leftover leaves of the limits, if nodes are passed at `node_t_s`."""
        a_limit = used_a * state.a_limit * slower[:, None]
        # A speed that is within the limits may be kept at first.
        lasts = fading.duration_s + SMOOTHING_S if fading else 0.0
        share = np.where(node_t_s <= lasts, 1.0, USED_V)
        v_limit = (share * np.sqrt(slower))[:, None] * state.v_limit
        if fading is None:
            return cls(-v_limit, v_limit, -a_limit, a_limit)
        # What the path does at a node is averaged over the time after it.
        moments = np.stack([node_t_s + part * SMOOTHING_S for part in (0.0, 0.5, 1.0)])
        _, v, a = fading.at(moments.ravel())
        v, a = v.reshape(3, *a_limit.shape), a.reshape(3, *a_limit.shape)
        some_v, some_a = 0.05 * v_limit, 0.03 * state.a_limit
        return cls(
            np.minimum(-v_limit - v.min(axis=0), -some_v),
            np.maximum(v_limit - v.max(axis=0), some_v),
            np.minimum(-a_limit - a.min(axis=0), -some_a),
            np.maximum(a_limit - a.max(axis=0), some_a),
        )


_DS = 1.0 / (NODES - 1)
#: Paths shorter than this lead nowhere, rad.
_NOWHERE_RAD = 1e-9
#: What does not belong to the path takes at least this long to fade, s.
_SHORTEST_FADE_S = 0.1
#: Share of the acceleration limit that leading the path back may take, about.
_LEADING_BACK = 0.25
#: Shares of a limit used, at moments between which it may be a little more: one that needs no more correcting,
#: and one that is accepted.
_GOOD, _ENOUGH = 1.0 + 0.25 * LIMIT_TOLERANCE, 1.0 + 0.8 * LIMIT_TOLERANCE
#: Times the path is slowed down where a limit was exceeded before the next attempt.
_ROUNDS = 8


@dataclass(frozen=True)
class _Attempt:
    """Share of the acceleration limit in which the leftover fades, and how much of the speed along is kept."""

    fading: float
    kept: float


_ATTEMPTS = (_Attempt(0.8, 1.0), _Attempt(0.6, 0.5))


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

    It takes little longer than the fastest motion along the rounded path whose accelerations may jump (tests):
    from rest at most 1.15 times as long plus the 0.08 s over which accelerations are averaged, 7 % longer in
    the median; in motion at most as long as coming to rest first, by the same bound, plus 0.5 s where that leads
    away from the path. A path that goes on as the robot moves costs nothing in the median.

    Where the state does not point along the path, the trajectory leaves the path by what stopping takes, about
    0.9 v² / a for a joint whose velocity v does not belong to it.

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
    return _timed(path, v_limit, a_limit, v0, a0, sample_period_s, start_s)


def _timed(
    path: FloatArray,
    v_limit: FloatArray,
    a_limit: FloatArray,
    v0: FloatArray,
    a0: FloatArray,
    period: float,
    start_s: float,
) -> TimedTrajectory:
    smooth = smooth_path(path)
    state = State(v0, a0, v_limit, a_limit)
    moving = bool(v0.any() or a0.any())
    if smooth.length < _NOWHERE_RAD:
        if moving:
            return _stop_first(path, state, period, start_s)
        rest = np.zeros((2, len(v0)))
        return TimedTrajectory(np.array([start_s, start_s + period]), path[[0, -1]], rest, rest)
    candidates: list[tuple[float, TimedTrajectory]] = []
    for attempt in _ATTEMPTS:
        candidates.append(_follow(smooth, state, attempt, period, start_s))
        if candidates[-1][0] <= _GOOD or not moving:
            break
    excess, trajectory = min(candidates, key=lambda candidate: candidate[0])
    if not moving or (excess <= _ENOUGH and trajectory.duration_s <= _expected_s(smooth, state)):
        return trajectory
    stopped = _stop_first(path, state, period, start_s)
    if excess <= _ENOUGH and trajectory.duration_s <= stopped.duration_s:
        return trajectory
    return stopped


def _expected_s(smooth: SmoothPath, state: State) -> float:
    """Return how long a trajectory may take that need not be compared with one that comes to rest first."""
    stop = ComingToRest(state.v, state.a, state.v_limit, USED_A * state.a_limit)
    bounds = PathLimits.beside(None, state, np.zeros(NODES), np.ones(NODES))
    return 1.1 * (stop.duration_s + _solve(*smooth.nodes(), bounds, Begin.steady(0.0, 0.0))[0].duration_s)


def _stop_first(path: FloatArray, state: State, period: float, start_s: float) -> TimedTrajectory:
    """Come to rest, then go to the path and along it."""
    stop = stop_trajectory(path[0], state.v, state.a, state.a_limit, state.v_limit, period, start_s)
    aside = stop.q[-1] - path[0]
    along = path_parameter(path)
    part = along / along[-1] if along[-1] > _NOWHERE_RAD else np.linspace(0.0, 1.0, len(path))
    onward = path + (1.0 - part)[:, None] * aside
    rest = np.zeros_like(state.v)
    after = _timed(onward, state.v_limit, state.a_limit, rest, rest, period, stop.end_s)
    join = [np.concatenate([getattr(stop, name), getattr(after, name)[1:]]) for name in ("t_s", "q", "v", "a")]
    return TimedTrajectory(*join)


def _follow(
    smooth: SmoothPath, state: State, attempt: _Attempt, period: float, start_s: float
) -> tuple[float, TimedTrajectory]:
    """Follow a path, and let what is left of the present state fade.

    Returns:
        The largest share of any limit used, and the trajectory.
    """
    moving = bool(state.v.any() or state.a.any())
    slower = np.ones(NODES)
    derivatives = smooth.nodes()
    begin = _wish(*derivatives, state, attempt.kept)
    wish, used_a = begin, USED_A
    profile, begin = _solve(*derivatives, PathLimits.beside(None, state, np.zeros(NODES), slower, used_a), wish)
    if begin.speed < wish.speed:
        used_a = USED_A_AT_MOST
        profile, begin = _solve(*derivatives, PathLimits.beside(None, state, np.zeros(NODES), slower, used_a), wish)
    allowed = [
        np.maximum(limit, np.abs(now) * (1.0 + 1e-9))
        for limit, now in ((state.v_limit, state.v), (state.a_limit, state.a))
    ]
    best: tuple[float, TimedTrajectory] | None = None
    fading, path = None, smooth
    for _ in range(_ROUNDS):
        if moving:
            fading, path = _leftover(smooth, derivatives, state, attempt, begin, profile)
        bounds = PathLimits.beside(fading, state, profile.node_t_s, slower, used_a)
        profile, accepted = _solve(*path.nodes(), bounds, begin)
        if accepted.speed < begin.speed and used_a < USED_A_AT_MOST:
            used_a = USED_A_AT_MOST
            continue
        if accepted != begin:
            begin = accepted
            continue
        trajectory = _combined(path, profile, fading, smooth.control[-1], state, period, start_s)
        use = limit_use(trajectory, allowed[0], allowed[1]).ravel()
        if best is None or use.max() < best[0]:
            best = float(use.max()), trajectory
        if best[0] <= _GOOD:
            break
        # Averaging shifts accelerations along the path; go more slowly where that broke a limit.
        over = np.flatnonzero(use > 1.0)
        times = np.interp(over / MOMENTS, np.arange(len(trajectory)), trajectory.t_s)
        low, high = profile.span(times - start_s)
        more = np.ones(NODES)
        for first, last, by in zip(low, high, use[over], strict=True):
            window = slice(max(int(first / _DS) - 1, 0), int(last / _DS) + 3)
            more[window] = np.minimum(more[window], max(USED_A / by, 0.5))
        slower *= more
    return best or (np.inf, at_rest(smooth.control[0], start_s))


def _wish(d1: FloatArray, d2: FloatArray, state: State, kept: float) -> Begin:
    """Return the speed and acceleration along the path that leave least of the state, where 1 is the limit."""
    towards = d1[0] / state.a_limit
    if kept == 0.0 or not towards.any():
        return Begin.steady(0.0, 0.0)
    square = float(towards @ towards)
    speed = kept * max(0.0, float(towards @ (state.v / state.a_limit)) / square)
    change = float(towards @ ((state.a - d2[0] * speed**2) / state.a_limit)) / square
    # Before averaging, the path is followed forwards all the time.
    most = 1.9 * speed / SMOOTHING_S
    return Begin.steady(speed, float(np.clip(change, -most, most)))


def _leftover(
    smooth: SmoothPath,
    derivatives: tuple[FloatArray, FloatArray],
    state: State,
    attempt: _Attempt,
    begin: Begin,
    profile: AveragedProfile,
) -> tuple[ComingToRest, SmoothPath]:
    """Return how what the path does not take of the state fades, and a path that makes up for where that leads."""
    d1, d2 = derivatives[0][0], derivatives[1][0]
    v = state.v - d1 * begin.speed
    a = state.a - d1 * begin.change - d2 * begin.speed**2
    fading = ComingToRest(v, a, USED_V * state.v_limit, attempt.fading * state.a_limit, _SHORTEST_FADE_S)
    # Over a time t, leading back by w takes accelerations of 5.8 w / t².
    back = np.sqrt(5.8 * float((np.abs(fading.way) / state.a_limit).max()) / _LEADING_BACK)
    until = float(profile.at(np.array([fading.duration_s + back]))[0][0])
    return fading, smooth.led_aside(-fading.way, min(max(until, 0.25), 1.0))


def _solve(d1: FloatArray, d2: FloatArray, bounds: PathLimits, wish: Begin) -> tuple[AveragedProfile, Begin]:
    """Return the fastest profile under limits per node, and how it begins: as wished or more slowly."""
    best = controllable(d1, d2, bounds.v_low, bounds.v_high, bounds.a_low, bounds.a_high, _DS)
    begin = _reachable(wish, best)
    x = fastest(d1, d2, bounds.a_low, bounds.a_high, _DS, best, begin.node(_DS), begin.lead, begin.raw_speed**2)
    return AveragedProfile(x, begin, _DS), begin


def _reachable(begin: Begin, best: FloatArray) -> Begin:
    """Slow a begin down until the path's end can be reached at rest from it."""
    for _ in range(100):
        first = begin.node(_DS)
        top = float(np.sqrt(best[: first + 1].min()))
        if first < NODES and begin.raw_speed <= top:
            return begin
        lower = begin.below(top)
        begin = lower if lower.raw_speed < begin.raw_speed else begin.slower(0.95)
    return Begin.steady(0.0, 0.0)


def _combined(
    path: SmoothPath,
    profile: AveragedProfile,
    fading: ComingToRest | None,
    end: FloatArray,
    state: State,
    period: float,
    start_s: float,
) -> TimedTrajectory:
    duration = max(profile.duration_s, fading.duration_s if fading else 0.0)
    t = np.linspace(0.0, duration, max(2, int(np.ceil(duration / period - 1e-9)) + 1))
    s, rate, change = profile.at(t)
    q, d1, d2 = path.at(s)
    v = d1 * rate[:, None]
    a = d1 * change[:, None] + d2 * rate[:, None] ** 2
    if fading:
        way, fading_v, fading_a = fading.at(t)
        q, v, a = q + way, v + fading_v, a + fading_a
    q[0], v[0], a[0] = path.control[0], state.v, state.a
    q[-1], v[-1], a[-1] = end, 0.0, 0.0
    return TimedTrajectory(t + start_s, q, v, a)


def _limits(name: str, value: ArrayLike, n: int) -> FloatArray:
    array = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)))
    if not (np.isfinite(array) & (array > 0.0)).all():
        raise PlanningError(f"{name} limit: wanted finite numbers > 0, got {array}")
    return array


def _state(name: str, value: ArrayLike | None, n: int) -> FloatArray:
    return np.zeros(n) if value is None else checked(f"start {name}", value, (n,), error=PlanningError)
