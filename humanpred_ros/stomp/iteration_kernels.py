"""One iteration of STOMP, compiled: `begin_update` before costs are evaluated, `finish_update` after (P1, 1.6 to 1.8).

For an arm among obstacles and people, `iterate` does several iterations in one call with their costs: Python between
the iterations would hold the threads of other goals up. The trajectory itself stays float64; rollouts are float32.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from humanpred_ros.geometry.compiled import Array, fast, fast_inline, fast_part
from humanpred_ros.stomp.cost_kernels import Obstacles, Occupied, obstacle_sums, occupancy_sums
from humanpred_ros.stomp.smoothness import acceleration_costs, colour, keep_within_limits, solve

#: Normal quantiles at the middle of 65536 equal probabilities: 16 random bits make one draw. The largest is
#: 4.2 standard deviations, and their variance is 1 to within 1e-4.
QUANTILES = np.array([NormalDist().inv_cdf((k + 0.5) / 65536.0) for k in range(65536)], dtype=np.float32)

#: Entries of the counters of a plan in progress: updates done, random bits used, rollouts reused, whether the best
#: trajectory is forbidden, and updates since it last became noticeably cheaper.
DONE, USED, REUSED, FORBIDDEN, STALE, N_COUNTERS = 0, 1, 2, 3, 4, 5
#: Entries of the totals: of the best trajectory, and what it must fall below to count as noticeably cheaper.
BEST, REFERENCE, N_TOTALS = 0, 1, 2


class Rules(NamedTuple):
    """What stays the same in all iterations of a plan."""

    quantiles: Array  #: `QUANTILES`
    std: Array  #: (D,) standard deviations of the noise, float32
    decay: float  #: factor on them per iteration
    factor: Array  #: see `Smoothness`; the second is the first in float32
    factor32: Array
    column_scale: Array
    lower: Array  #: (D,) limits
    upper: Array
    sharpness: float  #: as in `StompConfig`
    n_reused: int
    tolerance: float
    patience: int


class Work(NamedTuple):
    """A plan in progress, changed in place.

    Rollouts lie in one pool with their costs: the reused ones first, then the new ones, then the noiseless trajectory.
    """

    theta: Array  #: (N, D) the trajectory that new rollouts are drawn around, and the best one so far
    best: Array
    counters: Array  #: see `DONE` and `BEST`
    totals: Array
    bits: Array  #: random bits of the whole plan
    rollouts: Array  #: (R + 1, N, D), (R + 1, N) and (R + 1, N, D): the pool, and its costs
    state: Array
    joint: Array


class ArmTerms(NamedTuple):
    """The cost terms that `iterate` evaluates: these three and no others."""

    obstacles: Obstacles
    occupied: Occupied
    smoothness_weight: np.float32


def random_bits(rng: np.random.Generator, draws: int) -> Array:
    """Return 16 random bits for each of `draws` normal draws, each an index into `QUANTILES`.

    About ten times faster than a generator's own normal draws; 65536 levels are plenty for noise that is smoothed.
    """
    words = rng.integers(0, 2**64 - 1, size=(draws + 3) // 4, dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)


@fast
def iterate(count: int, work: Work, rules: Rules, terms: ArmTerms) -> None:
    """Do up to `count` updates, keeping the best noiseless trajectory, in place."""
    sums = np.empty((3, len(work.rollouts) * len(work.theta)), dtype=np.float32)
    for _ in range(count):
        if converged(work.counters, rules.patience):
            return
        first = begin_update(work, rules)
        allowed = _evaluate(work.rollouts[first:], work.state[first:], work.joint[first:], sums, terms)
        finish_update(work, rules, allowed)


@fast_inline
def _evaluate(rollouts: Array, state: Array, joint: Array, sums: Array, terms: ArmTerms) -> bool:
    """Write the weighted costs of rollouts (K, N, D); return whether the last one is allowed."""
    k, n, n_joints = rollouts.shape
    q = rollouts.reshape(k * n, n_joints)
    near, close, hit = sums[0, : k * n], sums[1, : k * n], sums[2, : k * n]
    obstacle_sums(q, n, terms.obstacles, near, close)
    occupancy_sums(q, terms.occupied, hit)
    flat = state.reshape(-1)
    obstacle_weight, human_weight, factor = terms.obstacles.weight, terms.occupied.weight, terms.occupied.factor
    for i in range(k * n):
        flat[i] = obstacle_weight * near[i] + human_weight * (factor * hit[i])
    acceleration_costs(rollouts, joint)
    flat = joint.reshape(-1)
    for i in range(k * n * n_joints):
        flat[i] *= terms.smoothness_weight
    allowed = True
    for i in range((k - 1) * n, k * n):
        allowed &= close[i] >= terms.obstacles.margin
    return allowed


@fast_inline
def converged(counters: Array, patience: int) -> bool:
    """Return whether a plan that is allowed has not become noticeably cheaper for `patience` updates."""
    return patience > 0 and counters[STALE] >= patience and counters[FORBIDDEN] == 0


@fast_inline
def begin_update(work: Work, rules: Rules) -> int:
    """Write the next update's new rollouts behind the reused ones, and theta last (P1, 1.6).

    Returns:
        Number of the first new rollout.
    """
    theta, counters, rollouts = work.theta, work.counters, work.rollouts
    first, used = counters[REUSED], counters[USED]
    scaled = rules.std * np.float32(rules.decay ** counters[DONE])
    sample(theta, work.bits[used:], scaled, rules, rollouts[first:])
    counters[USED] = used + (theta.shape[0] - 2) * theta.shape[1] * (len(rollouts) - 1 - first)
    return int(first)


@fast_inline
def sample(theta: Array, bits: Array, std: Array, rules: Rules, out: Array) -> None:
    """Write K noisy copies of theta (N, D) within the limits, then theta itself; out (K+1, N, D).

    The noise is the `QUANTILES` at the first of `bits`.
    """
    n, n_joints = theta.shape
    noise = np.empty((n - 2, (len(out) - 1) * n_joints), dtype=np.float32)
    _look_up(bits, rules.quantiles, noise.reshape(-1))
    colour(rules.factor32, noise)
    _make_rollouts(theta, noise, std, rules.lower, rules.upper, rules.factor, out)


@fast
def _look_up(bits: Array, table: Array, out: Array) -> None:
    for i in range(len(out)):
        out[i] = table[bits[i]]


@fast_part
def _make_rollouts(
    theta: Array, noise: Array, std: Array, lower: Array, upper: Array, factor: Array, out: Array
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
def finish_update(work: Work, rules: Rules, allowed: bool) -> None:
    """Keep theta if it is the best so far, improve it, and bring the rollouts to be reused to the front (P1, 1.7, 1.8).

    Args:
        allowed: whether theta is allowed.
    """
    counters, n_reused = work.counters, rules.n_reused
    n_rollouts, (n, n_joints) = len(work.rollouts) - 1, work.theta.shape
    total = 0.0
    for t in range(n):
        total += work.state[n_rollouts, t]
        for d in range(n_joints):
            total += work.joint[n_rollouts, t, d]
    _keep(work, allowed, total, rules.tolerance)
    new, new_state, new_joint = work.rollouts[:n_rollouts], work.state[:n_rollouts], work.joint[:n_rollouts]
    improve(work.theta, new, new_state, new_joint, rules)
    if n_reused > 0:
        keep_best(new, new_state, new_joint, n_reused, np.empty(n_reused, dtype=np.int64))
    counters[REUSED] = n_reused
    counters[DONE] += 1


@fast_inline
def _keep(work: Work, allowed: bool, total: float, tolerance: float) -> None:
    """Keep theta if it ranks before the best so far: allowed before forbidden, then by cost."""
    counters, totals = work.counters, work.totals
    forbidden = 0 if allowed else 1
    counters[STALE] += 1
    if forbidden < counters[FORBIDDEN] or (forbidden == counters[FORBIDDEN] and total < totals[BEST]):
        if forbidden < counters[FORBIDDEN] or total < totals[REFERENCE]:
            counters[STALE] = 0
            totals[REFERENCE] = (1.0 - tolerance) * total
        for t in range(work.theta.shape[0]):
            for d in range(work.theta.shape[1]):
                work.best[t, d] = work.theta[t, d]
        counters[FORBIDDEN] = forbidden
        totals[BEST] = total


@fast_inline
def improve(theta: Array, rollouts: Array, state: Array, joint: Array, rules: Rules) -> None:
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
    h = np.float32(rules.sharpness)
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
            change[t, d] = rules.column_scale[t] * moved[k] / total[k]
    solve(rules.factor, change)
    for t in range(n - 2):
        for d in range(n_joints):
            theta[t + 1, d] += change[t, d]
    keep_within_limits(theta, rules.lower, rules.upper, rules.factor)


@fast_part
def _exp(x: np.float32) -> np.float32:
    """e^x in float32 for -100 <= x <= 0: a polynomial of x/256, squared eight times; relative error 3e-5."""
    y = x * np.float32(1.0 / 256.0)
    p = np.float32(1.0) + y * (
        np.float32(1.0) + y * (np.float32(0.5) + y * (np.float32(1.0 / 6.0) + y * np.float32(1.0 / 24.0)))
    )
    for _ in range(8):
        p = p * p
    return p


@fast_part
def keep_best(rollouts: Array, state: Array, joint: Array, n_best: int, copies: Array) -> None:
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
