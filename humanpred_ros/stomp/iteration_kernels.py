"""One STOMP iteration but for the evaluation of costs, compiled: `begin_update` before it, `finish_update` after it.

Lanes (columns of a right-hand side, or waypoint and joint pairs) are contiguous in memory and innermost, so that every
loop over lanes packs into vector instructions. The trajectory itself stays float64; rollouts are float32.

R = L Lᵀ is banded: `factor[k, i] = L[i + k, i]` holds four bands below the diagonal and reaches past the end
as zeros. What needs R⁻¹ is an O(n) sweep, never a dense inverse.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from humanpred_ros.geometry.compiled import fast, fast_inline, fast_part

#: Normal quantiles at the middle of 65536 equal probabilities: 16 random bits make one draw. The largest is
#: 4.2 standard deviations, and their variance is 1 to within 1e-4.
QUANTILES = ndtri((np.arange(65536) + 0.5) / 65536.0).astype(np.float32)

#: Entries of the counters of a plan in progress: updates done, random bits used, rollouts reused, whether the best
#: trajectory is forbidden, and updates since it last became noticeably cheaper.
DONE, USED, REUSED, FORBIDDEN, STALE, N_COUNTERS = 0, 1, 2, 3, 4, 5
#: Entries of the totals: of the best trajectory, and what it must fall below to count as noticeably cheaper.
BEST, REFERENCE, N_TOTALS = 0, 1, 2
#: Violations below this are rounding, rad.
_LIMIT_TOLERANCE = 1e-6
_LIMIT_ITERATIONS = 10


@fast
def colour(factor: NDArray[Any], x: NDArray[Any]) -> None:
    """Solve Lᵀ x = z in place, z (n, L): white noise becomes N(0, R⁻¹)."""
    n, lanes = x.shape
    for i in range(n - 1, -1, -1):
        for k in range(1, min(5, n - i)):
            below = factor[k, i]
            for lane in range(lanes):
                x[i, lane] -= below * x[i + k, lane]
        scale = 1.0 / factor[0, i]
        for lane in range(lanes):
            x[i, lane] *= scale


@fast
def solve(factor: NDArray[Any], x: NDArray[Any]) -> None:
    """Solve R x = b in place, b (n, L)."""
    n, lanes = x.shape
    for i in range(n):
        for k in range(1, min(5, i + 1)):
            left = factor[k, i - k]
            for lane in range(lanes):
                x[i, lane] -= left * x[i - k, lane]
        scale = 1.0 / factor[0, i]
        for lane in range(lanes):
            x[i, lane] *= scale
    colour(factor, x)


@fast_part
def solve_unit(factor: NDArray[Any], j: int, x: NDArray[Any]) -> None:
    """Write column j of R⁻¹ into x (n,)."""
    n = len(x)
    for i in range(n):
        x[i] = 0.0
    x[j] = 1.0
    for i in range(j, n):
        value = x[i]
        for k in range(1, min(5, i - j + 1)):
            value -= factor[k, i - k] * x[i - k]
        x[i] = value / factor[0, i]
    for i in range(n - 1, -1, -1):
        value = x[i]
        for k in range(1, min(5, n - i)):
            value -= factor[k, i] * x[i + k]
        x[i] = value / factor[0, i]


def random_bits(rng: np.random.Generator, draws: int) -> NDArray[np.uint16]:
    """Return 16 random bits for each of `draws` normal draws, each an index into `QUANTILES`.

    About ten times faster than a generator's own normal draws; 65536 levels are plenty for noise that is smoothed.
    """
    words = rng.integers(0, 2**64 - 1, size=(draws + 3) // 4, dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)


@fast
def _look_up(bits: NDArray[Any], table: NDArray[Any], out: NDArray[Any]) -> None:
    for i in range(len(out)):
        out[i] = table[bits[i]]


@fast_inline
def sample(
    theta: NDArray[Any],
    bits: NDArray[Any],
    table: NDArray[Any],
    std: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
    factor: NDArray[Any],
    factor32: NDArray[Any],
    out: NDArray[Any],
) -> None:
    """Write K noisy copies of theta (N, D) within the limits, then theta itself; out (K+1, N, D).

    The noise is `table`, the `QUANTILES`, at the first of `bits`.
    """
    n, n_joints = theta.shape
    noise = np.empty((n - 2, (len(out) - 1) * n_joints), dtype=np.float32)
    _look_up(bits, table, noise.reshape(-1))
    colour(factor32, noise)
    make_rollouts(theta, noise, std, lower, upper, factor, out)


@fast
def keep_within_limits(x: NDArray[Any], lower: NDArray[Any], upper: NDArray[Any], factor: NDArray[Any]) -> int:
    """Push the free waypoints of x (N, D) inside the limits, in place; return how many joints were clipped.

    The worst waypoint of a joint is moved onto its limit together with its neighbours, along the column of
    R⁻¹ that belongs to it, which keeps the trajectory smooth (docs/papers.md, P1 STOMP). What is still outside after
    ten such pushes is clipped.
    """
    n, n_joints = x.shape
    column = np.empty(n - 2, dtype=np.float64)
    clipped = 0
    for d in range(n_joints):
        outside = False
        for t in range(1, n - 1):
            outside |= x[t, d] > upper[d] or x[t, d] < lower[d]
        if not outside:
            continue
        for attempt in range(_LIMIT_ITERATIONS + 1):
            worst, where = 0.0, -1
            for t in range(1, n - 1):
                over = max(x[t, d] - upper[d], lower[d] - x[t, d])
                if over > worst:
                    worst, where = over, t
            if worst <= _LIMIT_TOLERANCE:
                break
            if attempt == _LIMIT_ITERATIONS:
                clipped += 1
                break
            solve_unit(factor, where - 1, column)
            push = (worst if x[where, d] < lower[d] else -worst) / column[where - 1]
            for t in range(1, n - 1):
                x[t, d] += push * column[t - 1]
        for t in range(1, n - 1):
            x[t, d] = min(max(x[t, d], lower[d]), upper[d])
    return clipped


@fast_part
def make_rollouts(
    theta: NDArray[Any],
    noise: NDArray[Any],
    std: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
    factor: NDArray[Any],
    out: NDArray[Any],
) -> None:
    """Write theta (N, D) plus noise (N-2, K·D) x std (D,) as K rollouts, then theta itself; out (K+1, N, D)."""
    n, n_joints = theta.shape
    count = len(out) - 1
    for r in range(count):
        for t in range(n):
            for d in range(n_joints):
                out[r, t, d] = theta[t, d]
        for t in range(1, n - 1):
            for d in range(n_joints):
                out[r, t, d] += std[d] * noise[t - 1, r * n_joints + d]
        keep_within_limits(out[r], lower, upper, factor)
    for t in range(n):
        for d in range(n_joints):
            out[count, t, d] = theta[t, d]


@fast_inline
def improve(
    theta: NDArray[Any],
    rollouts: NDArray[Any],
    state: NDArray[Any],
    joint: NDArray[Any],
    sharpness: float,
    factor: NDArray[Any],
    column_scale: NDArray[Any],
    lower: NDArray[Any],
    upper: NDArray[Any],
) -> None:
    """Move theta (N, D) towards the cheaper of the rollouts (R, N, D), in place.

    With S = state (R, N) + joint (R, N, D) costs, each rollout has at each waypoint and joint the probability
    exp(-h (S - min) / (max - min)), normalised over rollouts; the mean noise goes through M into theta.
    """
    n_rollouts, n, n_joints = rollouts.shape
    lanes = n * n_joints
    cost = np.empty((n_rollouts, lanes), dtype=np.float32)
    low, high = np.empty(lanes, dtype=np.float32), np.empty(lanes, dtype=np.float32)
    for k in range(lanes):
        low[k], high[k] = np.float32(np.inf), np.float32(-np.inf)
    for r in range(n_rollouts):
        for t in range(n):
            for d in range(n_joints):
                cost[r, t * n_joints + d] = state[r, t] + joint[r, t, d]
        row = cost[r]
        for k in range(lanes):
            low[k] = min(low[k], row[k])
            high[k] = max(high[k], row[k])
    total = np.zeros(lanes, dtype=np.float32)
    moved = np.zeros(lanes, dtype=np.float32)
    flat_theta = np.empty(lanes, dtype=np.float32)
    for t in range(n):
        for d in range(n_joints):
            flat_theta[t * n_joints + d] = theta[t, d]
    h = np.float32(sharpness)
    for k in range(lanes):
        # Equal costs say nothing: the probabilities are then all the same.
        high[k] = -h / max(high[k] - low[k], np.float32(1e-12))
    for r in range(n_rollouts):
        row, flat = cost[r], rollouts[r].reshape(-1)
        for k in range(lanes):
            p = _exp((row[k] - low[k]) * high[k])
            total[k] += p
            moved[k] += p * (flat[k] - flat_theta[k])
    change = np.empty((n - 2, n_joints), dtype=np.float64)
    for t in range(n - 2):
        for d in range(n_joints):
            k = (t + 1) * n_joints + d
            change[t, d] = column_scale[t] * moved[k] / total[k]
    solve(factor, change)
    for t in range(n - 2):
        for d in range(n_joints):
            theta[t + 1, d] += change[t, d]
    keep_within_limits(theta, lower, upper, factor)


@fast_part
def _exp(x: Any) -> Any:
    """e^x in float32 for -100 <= x <= 0: a polynomial of x/256, squared eight times; relative error 3e-5."""
    y = x * np.float32(1.0 / 256.0)
    p = np.float32(1.0) + y * (
        np.float32(1.0) + y * (np.float32(0.5) + y * (np.float32(1.0 / 6.0) + y * np.float32(1.0 / 24.0)))
    )
    for _ in range(8):
        p = p * p
    return p


@fast_part
def keep_best(
    rollouts: NDArray[Any], state: NDArray[Any], joint: NDArray[Any], n_best: int, copies: NDArray[Any]
) -> None:
    """Move the `n_best` cheapest of the rollouts to the front, with their costs.

    `copies` is an index array (n_best,) to work in. Of equals the earlier rollout is kept.
    """
    n_rollouts, n, n_joints = rollouts.shape
    total = np.zeros(n_rollouts, dtype=np.float64)
    for r in range(n_rollouts):
        per_joint = joint[r].reshape(-1)
        value = 0.0
        for k in range(n * n_joints):
            value += per_joint[k]
        for t in range(n):
            value += state[r, t]
        total[r] = value
    for b in range(n_best):
        best = -1
        for r in range(n_rollouts):
            if best < 0 or total[r] < total[best]:
                best = r
        copies[b] = best
        total[best] = np.inf
    # In ascending order no copy overwrites a rollout that is still needed.
    for b in range(1, n_best):
        r, place = copies[b], b
        while place > 0 and copies[place - 1] > r:
            copies[place] = copies[place - 1]
            place -= 1
        copies[place] = r
    for b in range(n_best):
        r = copies[b]
        if r != b:
            for t in range(n):
                state[b, t] = state[r, t]
                for d in range(n_joints):
                    rollouts[b, t, d] = rollouts[r, t, d]
                    joint[b, t, d] = joint[r, t, d]


@fast_inline
def converged(counters: NDArray[Any], patience: int) -> bool:
    """Return whether a plan that is allowed has not become noticeably cheaper for `patience` updates."""
    return patience > 0 and counters[STALE] >= patience and counters[FORBIDDEN] == 0


@fast_inline
def begin_update(
    theta: NDArray[Any],
    counters: NDArray[Any],
    bits: NDArray[Any],
    noise: Any,
    smooth: Any,
    lower: NDArray[Any],
    upper: NDArray[Any],
    rollouts: NDArray[Any],
) -> int:
    """Write the next update's new rollouts behind the reused ones, and theta last (P1, 1.6).

    Args:
        theta: (N, D) the trajectory.
        counters: of the plan; see `DONE`.
        bits: of the whole plan.
        noise: `QUANTILES`, standard deviations (D,), decay.
        smooth: factor, the same in float32, column scale; see `Smoothness`.
        lower, upper: (D,) limits.
        rollouts: (R + 1, N, D), the reused ones first.

    Returns:
        Number of the first new rollout.
    """
    table, std, decay = noise
    factor, factor32, _ = smooth
    first, used = counters[REUSED], counters[USED]
    scaled = std * np.float32(decay ** counters[DONE])
    sample(theta, bits[used:], table, scaled, lower, upper, factor, factor32, rollouts[first:])
    counters[USED] = used + (theta.shape[0] - 2) * theta.shape[1] * (len(rollouts) - 1 - first)
    return int(first)


@fast_inline
def finish_update(
    theta: NDArray[Any],
    best: NDArray[Any],
    allowed: bool,
    counters: NDArray[Any],
    totals: NDArray[Any],
    rollouts: NDArray[Any],
    state: NDArray[Any],
    joint: NDArray[Any],
    settings: Any,
    smooth: Any,
    lower: NDArray[Any],
    upper: NDArray[Any],
) -> None:
    """Keep theta if it is the best so far, improve it, and bring the rollouts to be reused to the front (P1, 1.7, 1.8).

    Args:
        theta, best: (N, D) the trajectory that all rollouts but the reused ones were drawn around, and the best one.
        allowed: whether theta is allowed.
        counters, totals: of the plan; see `DONE` and `BEST`.
        rollouts, state, joint: (R + 1, N, D), (R + 1, N) and (R + 1, N, D): rollouts and costs, theta's last.
        settings: sharpness, rollouts to reuse, tolerance.
        smooth, lower, upper: as in `begin_update`.
    """
    sharpness, n_reused, tolerance = settings
    factor, _, column_scale = smooth
    n_rollouts, (n, n_joints) = len(rollouts) - 1, theta.shape
    total = 0.0
    for t in range(n):
        total += state[n_rollouts, t]
        for d in range(n_joints):
            total += joint[n_rollouts, t, d]
    _keep(theta, best, allowed, total, tolerance, counters, totals)
    new, new_state, new_joint = rollouts[:n_rollouts], state[:n_rollouts], joint[:n_rollouts]
    improve(theta, new, new_state, new_joint, sharpness, factor, column_scale, lower, upper)
    if n_reused > 0:
        keep_best(new, new_state, new_joint, n_reused, np.empty(n_reused, dtype=np.int64))
    counters[REUSED] = n_reused
    counters[DONE] += 1


@fast_inline
def _keep(
    theta: NDArray[Any],
    best: NDArray[Any],
    allowed: bool,
    total: float,
    tolerance: float,
    counters: NDArray[Any],
    totals: NDArray[Any],
) -> None:
    """Keep theta if it ranks before the best so far: allowed before forbidden, then by cost."""
    forbidden = 0 if allowed else 1
    counters[STALE] += 1
    if forbidden < counters[FORBIDDEN] or (forbidden == counters[FORBIDDEN] and total < totals[BEST]):
        if forbidden < counters[FORBIDDEN] or total < totals[REFERENCE]:
            counters[STALE] = 0
            totals[REFERENCE] = (1.0 - tolerance) * total
        for t in range(theta.shape[0]):
            for d in range(theta.shape[1]):
                best[t, d] = theta[t, d]
        counters[FORBIDDEN] = forbidden
        totals[BEST] = total
