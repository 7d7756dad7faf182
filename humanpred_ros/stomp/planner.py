"""STOMP: stochastic trajectory optimisation for any number of joints and any cost terms (docs/papers.md, P1 STOMP).

One iteration samples smooth noise around the trajectory, costs every noisy rollout, averages the noise at
each waypoint with probabilities that favour cheap rollouts, and smooths the average into the trajectory.
Everything heavy runs compiled and without Python's lock, so that goals planned in threads run side by side.

A plan may be made in portions (`StompRun`), so that several plans can share the time before a deadline
(`advance_all`).
"""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import PlanningError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.stomp import iteration_kernels as kernels
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.costs import (
    CostTerm,
    Float32Array,
    HumanOccupancyCost,
    ObstacleCost,
    SmoothnessCost,
    evaluated,
)
from humanpred_ros.stomp.smoothness import keep_within_limits, smoothness

#: Limits may be exceeded by rounding only, rad.
_LIMIT_TOLERANCE = 1e-6
#: A deadline is looked at after about this much work, s.
_PORTION_S = 0.001
#: Updates of a turn of `advance_all`: some two milliseconds of P1's problem.
TURN = 5
#: The terms whose iterations run compiled: these three and no others.
COMPILED_TERMS = {ObstacleCost, HumanOccupancyCost, SmoothnessCost}


@dataclass(frozen=True)
class Plan:
    """The best noiseless trajectory STOMP met."""

    waypoints: FloatArray  #: (N, D), rad; first and last are exactly the start and goal asked for
    cost: dict[str, float]  #: weighted share of each term, summed over waypoints
    total: float  #: sum of the shares
    iterations: int  #: updates done
    valid: bool  #: whether every waypoint is allowed by every term and within the limits
    reason: str = ""  #: why it is not valid; empty if it is


class StompPlanner:
    """Plans trajectories for one set of cost terms; holds no state between plans, so threads may share it.

    Attributes:
        terms, lower, upper, config: as given; limits (D,).
        compiled_terms: what whole iterations run compiled with, an obstacle, a human and a smoothness term; None for
            other terms, which are evaluated one by one.
    """

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
        self.smoothness = smoothness(self.config.waypoints)
        self.compiled_terms = _compiled_terms(self.terms, self.config.waypoints)

    def checked_noise(self, noise_std: ArrayLike) -> Float32Array:
        """Return standard deviations (D,) of the noise, in units of R^-1/2.

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
        run.advance(self.config.iterations, deadline)
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
            values, allowed = evaluated(term, batch)
            per_waypoint = values.sum(axis=2) if values.ndim == 3 else values
            cost[term.name] = term.weight * float(per_waypoint.sum(dtype=np.float64))
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
    """One plan being made, in as many portions as one likes: they do not change what comes out."""

    def __init__(
        self, planner: StompPlanner, initial: ArrayLike, rng: np.random.Generator, noise_std: Float32Array
    ) -> None:
        cfg, smooth, n_joints = planner.config, planner.smoothness, len(planner.lower)
        self._planner = planner
        theta = np.array(checked("initial trajectory", initial, (cfg.waypoints, n_joints), error=PlanningError))
        keep_within_limits(theta, planner.lower, planner.upper, smooth.factor)
        pool = (cfg.rollouts + 1, cfg.waypoints, n_joints)
        # All the randomness of a plan is drawn at once: many small draws cost more than the noise itself.
        draws = cfg.reused + (cfg.rollouts - cfg.reused) * cfg.iterations
        self._work = kernels.Work(
            theta,
            best=theta.copy(),
            counters=np.zeros(kernels.N_COUNTERS, dtype=np.int64),
            totals=np.full(kernels.N_TOTALS, np.inf),
            bits=kernels.random_bits(rng, (cfg.waypoints - 2) * n_joints * draws),
            rollouts=np.empty(pool, np.float32),
            state=np.empty(pool[:2], np.float32),
            joint=np.empty(pool, np.float32),
        )
        self._work.counters[kernels.FORBIDDEN] = 1
        self._rules = kernels.Rules(
            kernels.QUANTILES, noise_std, cfg.noise_decay,
            smooth.factor, smooth.factor.astype(np.float32), smooth.column_scale, planner.lower, planner.upper,
            cfg.sharpness, cfg.reused, cfg.tolerance, cfg.patience,
        )  # fmt: skip
        self._portion = 1

    @property
    def iterations(self) -> int:
        """Updates done."""
        return int(self._work.counters[kernels.DONE])

    @property
    def rollouts(self) -> Float32Array:
        """The noisy trajectories (R, N, D) of the last update; none before the first."""
        return self._work.rollouts[: -1 if self.iterations else 0].copy()

    @property
    def limit(self) -> int:
        """Updates it will have had at most."""
        return self._planner.config.iterations

    @property
    def finished(self) -> bool:
        """Whether all updates are done, or the plan has converged."""
        return self.iterations >= self.limit or bool(kernels.converged(self._work.counters, self._rules.patience))

    def advance(self, iterations: int, deadline: Callable[[], bool] | None = None) -> None:
        """Do up to `iterations` more updates, fewer if the plan is finished or the deadline says True."""
        until = min(self.iterations + iterations, self.limit)
        while not self.finished and self.iterations < until and not (deadline is not None and deadline()):
            began, before = time.perf_counter(), self.iterations
            count = until - self.iterations if deadline is None else min(self._portion, until - self.iterations)
            if self._planner.compiled_terms is not None:
                kernels.iterate(count, self._work, self._rules, self._planner.compiled_terms)
            else:
                self._term_by_term(count)
            each_s = (time.perf_counter() - began) / max(self.iterations - before, 1)
            self._portion = max(1, int(_PORTION_S / max(each_s, 1e-6)))

    def result(self) -> Plan:
        """Return the best trajectory so far: allowed before forbidden, then by total cost."""
        best, last = (self._planner.assess(path, self.iterations) for path in (self._work.best, self._work.theta))
        return min(best, last, key=lambda plan: (not plan.valid, plan.total))

    def _term_by_term(self, count: int) -> None:
        """Do up to `count` updates with terms of any kind."""
        work = self._work
        for _ in range(count):
            if self.finished:
                return
            first = kernels.begin_update(work, self._rules)
            allowed = self._evaluate(work.rollouts[first:], work.state[first:], work.joint[first:])
            kernels.finish_update(work, self._rules, allowed)

    def _evaluate(self, batch: Float32Array, state: Float32Array, joint: Float32Array) -> bool:
        """Write the costs of rollouts (K, N, D); return whether the noiseless one, the last, is allowed."""
        state[:] = 0.0
        joint[:] = 0.0
        allowed_by_all = True
        for term in self._planner.terms:
            values, allowed = evaluated(term, batch)
            weighted = np.float32(term.weight) * values
            if values.ndim == 3:
                joint += weighted
            else:
                state += weighted
            allowed_by_all = allowed_by_all and (allowed is None or bool(allowed[-1].all()))
        return allowed_by_all


def _compiled_terms(terms: Sequence[CostTerm], n_waypoints: int) -> kernels.ArmTerms | None:
    """Return what the compiled loop wants of its three terms, in any order; None for other terms."""
    found: dict[type, Any] = {type(term): term for term in terms}
    if len(terms) != len(found) or found.keys() != COMPILED_TERMS:
        return None
    obstacles = found[ObstacleCost].table(n_waypoints)
    return kernels.ArmTerms(obstacles, found[HumanOccupancyCost].table, np.float32(found[SmoothnessCost].weight))


def advance_all(
    runs: Sequence[StompRun],
    iterations: int,
    pool: ThreadPoolExecutor | None,
    n_threads: int,
    deadline: Callable[[], bool] | None = None,
) -> None:
    """Do up to `iterations` more updates of every plan, always the one that has had the fewest.

    What comes out depends neither on threads nor on turns, unless the deadline cuts it short; then no plan has
    had more than one turn more than another that could go on.
    """
    wanted = {k: min(run.iterations + iterations, run.limit) for k, run in enumerate(runs)}
    waiting = [(run.iterations, k) for k, run in enumerate(runs)]
    heapq.heapify(waiting)
    lock = threading.Lock()

    def work() -> None:
        while True:
            with lock:
                if not waiting:
                    return
                done, k = heapq.heappop(waiting)
            run = runs[k]
            run.advance(min(TURN, wanted[k] - done) if deadline is not None else wanted[k] - done, deadline)
            cut_short = deadline is not None and deadline()
            if not run.finished and run.iterations < wanted[k] and not cut_short:
                with lock:
                    heapq.heappush(waiting, (run.iterations, k))

    if pool is None or len(runs) < 2:
        work()
        return
    for worker in [pool.submit(work) for _ in range(min(n_threads, len(runs)))]:
        worker.result()
