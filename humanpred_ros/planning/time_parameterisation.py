"""When the robot is where: times for a planned path that take over from whatever the robot is doing.

The path is followed as fast as the limits allow, at first with the part of the present velocity and
acceleration that points along it. What is left of them fades as fast as it can, every joint for itself; where
that leads aside, the path is led back, early enough not to matter at its end. The limits that the path may
use at any moment are what the fading leaves, so the sum stays within them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.planning.path import path_parameter
from humanpred_ros.planning.path_following import (
    NODE_STEP,
    NODES,
    SMOOTHING_S,
    AveragedProfile,
    Begin,
    PathLimits,
    SmoothPath,
    controllable,
    fastest,
)
from humanpred_ros.planning.stopping import MOMENTS, ComingToRest, limit_use, n_knots, stop_trajectory
from humanpred_ros.planning.trajectory import LIMIT_TOLERANCE, TimedTrajectory, at_rest

#: Shares of the limits that planned motion uses; the rest is for rounding off and interpolating.
USED_V, USED_A = 0.98, 0.95
#: Share of the acceleration limit used where the path could not be entered as fast as the robot moves otherwise:
#: what brakes already with the usual share needs it, and a little more for rounding.
USED_A_AT_MOST = 0.985
#: Paths shorter than this lead nowhere, rad.
_NOWHERE_RAD = 1e-9
#: What does not belong to the path takes at least this long to fade, s.
_SHORTEST_FADE_S = 0.1
#: Share of the acceleration limit that leading the path back may take, about.
_LEADING_BACK = 0.25
#: Attempts, in turn: the share of the acceleration limit in which the leftover fades, and how much of the speed along
#: the path is kept.
_ATTEMPTS = ((0.8, 1.0), (0.6, 0.5))
#: Shares of a limit used, at moments between which it may be a little more: one that needs no more correcting,
#: and one that is accepted.
_GOOD, _ENOUGH = 1.0 + 0.25 * LIMIT_TOLERANCE, 1.0 + 0.8 * LIMIT_TOLERANCE
#: Times the path is slowed down where a limit was exceeded before the next attempt.
_ROUNDS = 8


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
    v0, a0 = _state("velocity", start_velocity, n), _state("acceleration", start_acceleration, n)
    v_limit, a_limit = _limits("velocity", velocity_limit, n), _limits("acceleration", acceleration_limit, n)
    if not (np.isfinite(sample_period_s) and sample_period_s > 0.0):
        raise PlanningError(f"time parameterisation: wanted a sample period > 0 s, got {sample_period_s}")
    if not (v0.any() or a0.any() or np.ptp(path, axis=0).any()):
        return at_rest(path[0], start_s)
    return _timed(path, _Switch(v0, a0, v_limit, a_limit, sample_period_s, start_s))


class _Switch(NamedTuple):
    """What a trajectory begins with: velocity and acceleration, limits, each (D,), longest time between knots, time."""

    v: FloatArray
    a: FloatArray
    v_limit: FloatArray
    a_limit: FloatArray
    period_s: float
    start_s: float

    @property
    def moving(self) -> bool:
        return bool(self.v.any() or self.a.any())


def _timed(path: FloatArray, switch: _Switch) -> TimedTrajectory:
    smooth = SmoothPath.rounding(path)
    if smooth.length < _NOWHERE_RAD:
        if switch.moving:
            return _stop_first(path, switch)
        rest = np.zeros((2, path.shape[1]))
        times = np.array([switch.start_s, switch.start_s + switch.period_s])
        return TimedTrajectory(times, path[[0, -1]], rest, rest)
    found: list[tuple[float, TimedTrajectory]] = []
    for fading_share, kept in _ATTEMPTS:
        found.append(_follow(smooth, switch, fading_share, kept))
        if found[-1][0] <= _GOOD or not switch.moving:
            break
    excess, trajectory = min(found, key=lambda attempt: attempt[0])
    if not switch.moving or (excess <= _ENOUGH and trajectory.duration_s <= _expected_s(smooth, switch)):
        return trajectory
    stopped = _stop_first(path, switch)
    if excess <= _ENOUGH and trajectory.duration_s <= stopped.duration_s:
        return trajectory
    return stopped


def _expected_s(smooth: SmoothPath, switch: _Switch) -> float:
    """Return how long a trajectory may take that need not be compared with one that comes to rest first."""
    stop = ComingToRest(switch.v, switch.a, switch.v_limit, USED_A * switch.a_limit)
    limits = _limits_beside(None, switch, np.zeros(NODES), np.ones(NODES))
    return 1.1 * (stop.duration_s + _solve(*smooth.nodes(), limits, Begin.steady(0.0, 0.0))[0].duration_s)


def _stop_first(path: FloatArray, switch: _Switch) -> TimedTrajectory:
    """Come to rest, then go to the path and along it."""
    v, a, v_limit, a_limit, period_s, start_s = switch
    stop = stop_trajectory(path[0], v, a, a_limit, v_limit, period_s, start_s)
    along = path_parameter(path)
    part = along / along[-1] if along[-1] > _NOWHERE_RAD else np.linspace(0.0, 1.0, len(path))
    onward = path + (1.0 - part)[:, None] * (stop.q[-1] - path[0])
    rest = np.zeros_like(v)
    after = _timed(onward, switch._replace(v=rest, a=rest, start_s=stop.end_s))
    return TimedTrajectory(
        *(np.concatenate([getattr(stop, name), getattr(after, name)[1:]]) for name in ("t_s", "q", "v", "a"))
    )


def _follow(smooth: SmoothPath, switch: _Switch, fading_share: float, kept: float) -> tuple[float, TimedTrajectory]:
    """Follow a path, and let what is left of the present state fade.

    Returns:
        The largest share of any limit used, and the trajectory.
    """
    slower, unhurried = np.ones(NODES), np.zeros(NODES)
    derivatives = smooth.nodes()
    wish, used_a = _wish(*derivatives, switch, kept), USED_A
    profile, begin = _solve(*derivatives, _limits_beside(None, switch, unhurried, slower, used_a), wish)
    if begin.speed < wish.speed:
        used_a = USED_A_AT_MOST
        profile, begin = _solve(*derivatives, _limits_beside(None, switch, unhurried, slower, used_a), wish)
    allowed_v = np.maximum(switch.v_limit, np.abs(switch.v) * (1.0 + 1e-9))
    allowed_a = np.maximum(switch.a_limit, np.abs(switch.a) * (1.0 + 1e-9))
    best: tuple[float, TimedTrajectory] | None = None
    fading, path = None, smooth
    for _ in range(_ROUNDS):
        if switch.moving:
            fading, path = _leftover(smooth, derivatives, switch, fading_share, begin, profile)
        limits = _limits_beside(fading, switch, profile.node_t_s, slower, used_a)
        profile, accepted = _solve(*path.nodes(), limits, begin)
        if accepted.speed < begin.speed and used_a < USED_A_AT_MOST:
            used_a = USED_A_AT_MOST
            continue
        if accepted != begin:
            begin = accepted
            continue
        trajectory = _combined(path, profile, fading, smooth.control[-1], switch)
        use = limit_use(trajectory, allowed_v, allowed_a).ravel()
        if best is None or use.max() < best[0]:
            best = float(use.max()), trajectory
        if best[0] <= _GOOD:
            break
        # Averaging shifts accelerations along the path; go more slowly where that broke a limit.
        over = np.flatnonzero(use > 1.0)
        times = np.interp(over / MOMENTS, np.arange(len(trajectory)), trajectory.t_s)
        more = np.ones(NODES)
        for (first, last), by in zip(profile.span(times - switch.start_s).T, use[over], strict=True):
            window = slice(max(int(first / NODE_STEP) - 1, 0), int(last / NODE_STEP) + 3)
            more[window] = np.minimum(more[window], max(USED_A / by, 0.5))
        slower *= more
    return best or (np.inf, at_rest(smooth.control[0], switch.start_s))


def _limits_beside(
    fading: ComingToRest | None, switch: _Switch, node_t_s: FloatArray, slower: FloatArray, used_a: float = USED_A
) -> PathLimits:
    """Return what a fading leftover leaves of the limits, if nodes are passed at `node_t_s`."""
    a_limit = used_a * switch.a_limit * slower[:, None]
    # A speed that is within the limits may be kept at first.
    lasts = fading.duration_s + SMOOTHING_S if fading else 0.0
    share = np.where(node_t_s <= lasts, 1.0, USED_V)
    v_limit = (share * np.sqrt(slower))[:, None] * switch.v_limit
    if fading is None:
        return PathLimits(-v_limit, v_limit, -a_limit, a_limit)
    # What the path does at a node is averaged over the time after it.
    moments = np.stack([node_t_s + part * SMOOTHING_S for part in (0.0, 0.5, 1.0)])
    _, v, a = fading.at(moments.ravel()).reshape(3, 3, *a_limit.shape)
    some_v, some_a = 0.05 * v_limit, 0.03 * switch.a_limit
    return PathLimits(
        np.minimum(-v_limit - v.min(axis=0), -some_v),
        np.maximum(v_limit - v.max(axis=0), some_v),
        np.minimum(-a_limit - a.min(axis=0), -some_a),
        np.maximum(a_limit - a.max(axis=0), some_a),
    )


def _wish(d1: FloatArray, d2: FloatArray, switch: _Switch, kept: float) -> Begin:
    """Return the speed and acceleration along the path that leave least of the state, where 1 is the limit."""
    towards = d1[0] / switch.a_limit
    if not towards.any():
        return Begin.steady(0.0, 0.0)
    square = float(towards @ towards)
    speed = kept * max(0.0, float(towards @ (switch.v / switch.a_limit)) / square)
    change = float(towards @ ((switch.a - d2[0] * speed**2) / switch.a_limit)) / square
    # Before averaging, the path is followed forwards all the time.
    most = 1.9 * speed / SMOOTHING_S
    return Begin.steady(speed, float(np.clip(change, -most, most)))


def _leftover(
    smooth: SmoothPath,
    derivatives: tuple[FloatArray, FloatArray],
    switch: _Switch,
    fading_share: float,
    begin: Begin,
    profile: AveragedProfile,
) -> tuple[ComingToRest, SmoothPath]:
    """Return how what the path does not take of the state fades, and a path that makes up for where that leads."""
    d1, d2 = derivatives[0][0], derivatives[1][0]
    v = switch.v - d1 * begin.speed
    a = switch.a - d1 * begin.change - d2 * begin.speed**2
    fading = ComingToRest(v, a, USED_V * switch.v_limit, fading_share * switch.a_limit, _SHORTEST_FADE_S)
    # Over a time t, leading back by w takes accelerations of 5.8 w / t².
    back = np.sqrt(5.8 * float((np.abs(fading.way) / switch.a_limit).max()) / _LEADING_BACK)
    until = float(profile.at(np.array([fading.duration_s + back]))[0][0])
    return fading, smooth.led_aside(-fading.way, min(max(until, 0.25), 1.0))


def _solve(d1: FloatArray, d2: FloatArray, limits: PathLimits, wish: Begin) -> tuple[AveragedProfile, Begin]:
    """Return the fastest profile under limits per node, and how it begins: as wished, or slowed down.

    It is slowed down until the path's end can be reached at rest.
    """
    best = controllable(d1, d2, limits, NODE_STEP)
    begin, tries = wish, 100
    while tries:
        first = begin.node(NODE_STEP)
        top = float(np.sqrt(best[: first + 1].min()))
        if first < NODES and begin.raw_speed <= top:
            break
        lower, tries = begin.below(top), tries - 1
        begin = lower if lower.raw_speed < begin.raw_speed else begin.slower(0.95)
    if not tries:
        begin = Begin.steady(0.0, 0.0)
    x = fastest(d1, d2, limits, NODE_STEP, best, begin.node(NODE_STEP), begin.lead, begin.raw_speed**2)
    return AveragedProfile(x, begin, NODE_STEP), begin


def _combined(
    path: SmoothPath, profile: AveragedProfile, fading: ComingToRest | None, end: FloatArray, switch: _Switch
) -> TimedTrajectory:
    duration_s = max(profile.duration_s, fading.duration_s if fading else 0.0)
    t = np.linspace(0.0, duration_s, n_knots(duration_s, switch.period_s))
    s, rate, change = profile.at(t)
    q, d1, d2 = path.at(s)
    v = d1 * rate[:, None]
    a = d1 * change[:, None] + d2 * rate[:, None] ** 2
    if fading:
        way, fading_v, fading_a = fading.at(t)
        q, v, a = q + way, v + fading_v, a + fading_a
    q[0], v[0], a[0] = path.control[0], switch.v, switch.a
    q[-1], v[-1], a[-1] = end, 0.0, 0.0
    return TimedTrajectory(t + switch.start_s, q, v, a)


def _limits(name: str, value: ArrayLike, n: int) -> FloatArray:
    array = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)))
    if not (np.isfinite(array) & (array > 0.0)).all():
        raise PlanningError(f"{name} limit: wanted finite numbers > 0, got {array}")
    return array


def _state(name: str, value: ArrayLike | None, n: int) -> FloatArray:
    return np.zeros(n) if value is None else checked(f"start {name}", value, (n,), error=PlanningError)
