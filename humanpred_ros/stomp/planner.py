"""STOMP: stochastic trajectory optimisation for any number of joints and any cost terms (P1 IV-B, facts 4).

One iteration samples smooth noise around the trajectory, costs every noisy rollout, averages the noise at
each waypoint with probabilities that favour cheap rollouts, and smooths the average into the trajectory.
Everything heavy runs compiled and without Python's lock, so that goals planned in threads run side by side.

A plan may be made in portions (`StompRun`): whoever plans to several goals before a deadline gives each its turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.stomp import arm_loop, iteration_kernels
from humanpred_ros.stomp.costs import CostTerm, JointCostTerm
from humanpred_ros.stomp.smoothness import smoothness

Float32Array = NDArray[np.float32]
#: Limits may be exceeded by rounding only, rad.
_LIMIT_TOLERANCE = 1e-6
#: A deadline is looked at after about this much work, s.
_PORTION_S = 0.001


@dataclass(frozen=True)
class StompConfig:
    """Everything STOMP can be told; defaults are P1's (facts section 4), but for the obstacle weight.

    Attributes:
        n_waypoints: N, with start and goal.
        n_iterations: updates.
        n_rollouts: rollouts an update averages over.
        n_reused: of these, the cheapest ones of the update before; the others are new.
        noise_std: standard deviation of the noise in units of R⁻¹, for all joints or one each. 0.002 is
            0.14 rad at the middle of 100 waypoints.
        noise_decay: factor on the noise per iteration.
        sharpness: h of exp(-h (S - min) / (max - min)).
        patience: a plan that is allowed and has not become better by `tolerance` in so many updates is done;
            0 does all of them, as P1 does.
        tolerance: share of the cost that counts as better.
        obstacle_weight, human_weight, smoothness_weight: of the terms a planner is usually given. P1's
            obstacle weight of 0.1 goes with its number of spheres and its unit of speed, which are not known;
            with ours it would let the arm pass through the table rather than bend. 100 frees 28 of 30 straight
            lines of the side-by-side scene within 50 iterations.
    """

    n_waypoints: int = 100
    n_iterations: int = 50
    n_rollouts: int = 10
    n_reused: int = 5
    noise_std: float | tuple[float, ...] = 0.002
    noise_decay: float = 1.0
    sharpness: float = 10.0
    patience: int = 0
    tolerance: float = 0.01
    obstacle_weight: float = 100.0
    human_weight: float = 1.0
    smoothness_weight: float = 10000.0

    def __post_init__(self) -> None:
        if self.n_waypoints < 5 or self.n_iterations < 0 or not 0 <= self.n_reused < self.n_rollouts:
            raise PlanningError(
                "STOMP: wanted n_waypoints >= 5, n_iterations >= 0 and 0 <= n_reused < n_rollouts, "
                f"got {self.n_waypoints}, {self.n_iterations}, {self.n_reused} and {self.n_rollouts}"
            )
        if not (np.asarray(self.noise_std) > 0.0).all() or not 0.0 < self.noise_decay <= 1.0:
            raise PlanningError(
                f"STOMP: wanted noise_std > 0 and noise_decay in (0, 1], got {self.noise_std} and {self.noise_decay}"
            )
        if self.patience < 0 or not 0.0 <= self.tolerance < 1.0:
            raise PlanningError(
                f"STOMP: wanted patience >= 0 and tolerance in [0, 1), got {self.patience} and {self.tolerance}"
            )
        # The compiled exponential holds for arguments down to -100.
        if not 0.0 < self.sharpness <= 100.0:
            raise PlanningError(f"STOMP: wanted a sharpness in (0, 100], got {self.sharpness}")


@dataclass(frozen=True)
class Plan:
    """The best noiseless trajectory STOMP met.

    Attributes:
        waypoints: (N, D), rad; first and last are exactly the start and goal asked for.
        cost: weighted share of each term, summed over waypoints.
        total: sum of the shares.
        iterations: updates done.
        valid: whether every waypoint is allowed by every term and within the limits.
        reason: why it is not valid; empty if it is.
    """

    waypoints: FloatArray
    cost: dict[str, float]
    total: float
    iterations: int
    valid: bool
    reason: str = ""


class StompPlanner:
    """Plans trajectories for one set of cost terms; holds no state between plans, so threads may share it."""

    def __init__(
        self, terms: Sequence[CostTerm], lower: ArrayLike, upper: ArrayLike, config: StompConfig | None = None
    ) -> None:
        """Take the cost terms and the joint limits (D,), rad; infinite where there is none.

        Raises:
            PlanningError: for limits that do not fit each other, two terms of one name, or no terms.
        """
        self.config = config or StompConfig()
        self.terms = tuple(terms)
        names = [term.name for term in self.terms]
        if not names or len(set(names)) != len(names):
            raise PlanningError(f"STOMP: wanted one or more cost terms of different names, got {names}")
        self.lower, self.upper = (
            np.array(np.clip(np.asarray(limit, dtype=np.float64), -1e9, 1e9)) for limit in (lower, upper)
        )
        n = len(self.lower) if self.lower.ndim == 1 else 0
        if self.upper.shape != (n,) or n == 0 or not (self.lower < self.upper).all():
            raise PlanningError(f"STOMP: wanted limits lower < upper of one length, got {lower!r} and {upper!r}")
        self.noise_std = self.checked_noise(self.config.noise_std)
        smooth = smoothness(self.config.n_waypoints)
        self.smoothness = smooth
        self.compiled_smoothness = (smooth.factor, smooth.factor.astype(np.float32), smooth.column_scale)
        self.compiled_terms = arm_loop.arm_terms(self.terms, self.config.n_waypoints)

    def checked_noise(self, noise_std: ArrayLike) -> Float32Array:
        """Return standard deviations (D,) of the noise, in units of R⁻¹.

        Raises:
            PlanningError: for a number of them that is neither one nor D, or one that is not positive.
        """
        n = len(self.lower)
        std = np.asarray(noise_std, dtype=np.float64)
        if std.shape not in ((), (n,)):
            raise PlanningError(f"STOMP: wanted one noise_std or {n} of them, got shape {std.shape}")
        if not (np.isfinite(std) & (std > 0.0)).all():
            raise PlanningError(f"STOMP: wanted noise_std > 0, got {std}")
        return np.array(np.broadcast_to(std, (n,)), dtype=np.float32)

    def plan(
        self,
        initial: ArrayLike,
        rng: np.random.Generator,
        deadline: Callable[[], bool] | None = None,
        noise_std: ArrayLike | None = None,
    ) -> Plan:
        """Improve a trajectory; start and goal stay exactly as given.

        Args:
            initial: (N, D) waypoints in rad to begin with, e.g. a straight line or the last plan.
            rng: source of all noise: the same state gives the same plan, in any thread.
            deadline: asked about every millisecond; once it says True the best so far is returned. It is also
                how a plan is cancelled from another thread.
            noise_std: of this plan, as in `StompConfig`; the configuration's if not given.

        Raises:
            PlanningError: if `initial` has the wrong shape or is not finite.
        """
        run = self.begin(initial, rng, noise_std)
        run.advance(self.config.n_iterations, deadline)
        return run.result()

    def begin(self, initial: ArrayLike, rng: np.random.Generator, noise_std: ArrayLike | None = None) -> StompRun:
        """Return a plan of which nothing has been done yet; arguments and errors as in `plan`."""
        return StompRun(self, initial, rng, self.noise_std if noise_std is None else self.checked_noise(noise_std))

    def assess(self, waypoints: ArrayLike, iterations: int = 0) -> Plan:
        """Return a trajectory (N, D) as it is, costed term by term and checked."""
        path = np.array(checked("trajectory", waypoints, ("N", len(self.lower)), error=PlanningError))
        batch = path.astype(np.float32)[None]
        cost: dict[str, float] = {}
        reason = self._outside_limits(path)
        for term in self.terms:
            values, allowed = term.evaluate(batch)
            cost[term.name] = term.weight * float(values.sum(dtype=np.float64))
            if allowed is not None and not reason and not allowed.all():
                reason = f"{term.name}: waypoint {int(np.argmin(allowed[0]))} of {len(path)} is not allowed"
        waypoints = frozen(path)
        return Plan(waypoints, cost, sum(cost.values()), iterations, not reason, reason)  # type: ignore[arg-type]

    def _outside_limits(self, path: FloatArray) -> str:
        outside = (path < self.lower - _LIMIT_TOLERANCE) | (path > self.upper + _LIMIT_TOLERANCE)
        if not outside.any():
            return ""
        t, d = (int(i) for i in np.argwhere(outside)[0])
        return f"limits: joint {d} at waypoint {t} of {len(path)} is {path[t, d]:.4f} rad"


class StompRun:
    """One plan being made, in as many portions as one likes: they do not change what comes out.

    Rollouts lie in one pool with their costs: the reused ones first, then the new ones, then the noiseless
    trajectory itself.
    """

    def __init__(
        self, planner: StompPlanner, initial: ArrayLike, rng: np.random.Generator, noise_std: Float32Array
    ) -> None:
        cfg, n_joints = planner.config, len(planner.lower)
        self._planner, self._std = planner, noise_std
        self._theta = np.array(checked("initial trajectory", initial, (cfg.n_waypoints, n_joints), error=PlanningError))
        iteration_kernels.keep_within_limits(self._theta, planner.lower, planner.upper, planner.smoothness.factor)
        self._best = self._theta.copy()
        shape = (cfg.n_rollouts + 1, cfg.n_waypoints, n_joints)
        self._rollouts, self._joint = np.empty(shape, np.float32), np.empty(shape, np.float32)
        self._state = np.empty(shape[:2], np.float32)
        # All the randomness of a plan is drawn at once: many small draws cost more than the noise itself.
        new = cfg.n_rollouts - cfg.n_reused
        lanes = planner.smoothness.n_free * n_joints
        self._bits = iteration_kernels.random_bits(rng, lanes * (cfg.n_reused + new * cfg.n_iterations))
        self._counters = np.zeros(arm_loop.N_COUNTERS, dtype=np.int64)
        self._counters[arm_loop.FORBIDDEN] = 1
        self._totals = np.full(arm_loop.N_TOTALS, np.inf)
        self._portion = 1

    @property
    def iterations(self) -> int:
        """Updates done."""
        return int(self._counters[arm_loop.DONE])

    @property
    def rollouts(self) -> Float32Array:
        """The noisy trajectories (R, N, D) of the last update; none before the first."""
        return self._rollouts[:-1].copy() if self.iterations else self._rollouts[:0].copy()

    @property
    def limit(self) -> int:
        """Updates it will have had at most."""
        return self._planner.config.n_iterations

    @property
    def finished(self) -> bool:
        """Whether all updates are done, or the plan has converged."""
        cfg, counters = self._planner.config, self._counters
        converged = cfg.patience > 0 and counters[arm_loop.STALE] >= cfg.patience and not counters[arm_loop.FORBIDDEN]
        return bool(self.iterations >= cfg.n_iterations or converged)

    def advance(self, iterations: int, deadline: Callable[[], bool] | None = None) -> None:
        """Do up to `iterations` more updates, fewer if the plan is finished or the deadline says True."""
        until = min(self.iterations + iterations, self._planner.config.n_iterations)
        step = self._compiled if self._planner.compiled_terms is not None else self._term_by_term
        while not self.finished and self.iterations < until and not (deadline is not None and deadline()):
            began, before = time.perf_counter(), self.iterations
            step(until - self.iterations if deadline is None else min(self._portion, until - self.iterations))
            each_s = (time.perf_counter() - began) / max(self.iterations - before, 1)
            self._portion = max(1, int(_PORTION_S / max(each_s, 1e-6)))

    def result(self) -> Plan:
        """Return the best trajectory so far: allowed before forbidden, then by total cost."""
        best, last = (self._planner.assess(path, self.iterations) for path in (self._best, self._theta))
        return min(best, last, key=lambda plan: (not plan.valid, plan.total))

    def _compiled(self, count: int) -> None:
        planner, cfg = self._planner, self._planner.config
        arm_loop.iterate(
            count, self._theta, self._best, self._counters, self._totals,
            self._rollouts, self._state, self._joint, self._bits,
            (iteration_kernels.QUANTILES, self._std, cfg.noise_decay), planner.compiled_smoothness,
            planner.lower, planner.upper, (cfg.sharpness, cfg.n_reused, cfg.patience, cfg.tolerance),
            planner.compiled_terms,
        )  # fmt: skip

    def _term_by_term(self, count: int) -> None:
        """Do what `arm_loop.iterate` does, for terms of any kind."""
        planner, cfg, counters = self._planner, self._planner.config, self._counters
        factor, factor32, column_scale = planner.compiled_smoothness
        for _ in range(count):
            if self.finished:
                return
            first, k = int(counters[arm_loop.REUSED]), cfg.n_rollouts
            std = self._std * np.float32(cfg.noise_decay**self.iterations)
            iteration_kernels.sample(
                self._theta, self._bits[counters[arm_loop.USED] :], std, planner.lower, planner.upper,
                factor, factor32, self._rollouts[first:],
            )  # fmt: skip
            counters[arm_loop.USED] += planner.smoothness.n_free * len(planner.lower) * (k - first)
            allowed = self._evaluate(first)
            total = float(self._state[-1].sum(dtype=np.float64) + self._joint[-1].sum(dtype=np.float64))
            arm_loop.keep(self._theta, self._best, allowed, total, cfg.tolerance, counters, self._totals)
            iteration_kernels.update(
                self._theta, self._rollouts[:k], self._state[:k], self._joint[:k], cfg.sharpness, factor, column_scale,
                planner.lower, planner.upper, cfg.n_reused,
            )  # fmt: skip
            counters[arm_loop.REUSED] = cfg.n_reused
            counters[arm_loop.DONE] += 1

    def _evaluate(self, first: int) -> bool:
        """Cost the rollouts from `first` on; return whether the noiseless one, the last, is allowed."""
        batch, state, joint = self._rollouts[first:], self._state[first:], self._joint[first:]
        state[:] = 0.0
        joint[:] = 0.0
        allowed_by_all = True
        for term in self._planner.terms:
            weight = np.float32(term.weight)
            if isinstance(term, JointCostTerm):
                values, allowed = term.evaluate_joints(batch)
                joint += weight * values
            else:
                values, allowed = term.evaluate(batch)
                state += weight * values
            allowed_by_all = allowed_by_all and (allowed is None or bool(allowed[-1].all()))
        return allowed_by_all
