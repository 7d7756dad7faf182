"""STOMP: stochastic trajectory optimisation for any number of joints and any cost terms (P1 IV-B, facts 4).

One iteration samples smooth noise around the trajectory, costs every noisy rollout, averages the noise at
each waypoint with probabilities that favour cheap rollouts, and smooths the average into the trajectory.
Everything heavy runs compiled and without Python's lock, so that goals planned in threads run side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.checks import FloatArray, checked, frozen
from humanpred_ros.errors import PlanningError
from humanpred_ros.planning import stomp_kernels
from humanpred_ros.planning.costs import CostTerm, JointCostTerm
from humanpred_ros.planning.smoothness import smoothness

Float32Array = NDArray[np.float32]
#: Limits may be exceeded by rounding only, rad.
_LIMIT_TOLERANCE = 1e-6


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


@dataclass
class _Pool:
    """Rollouts and their costs: reused ones first, then new ones, then the noiseless trajectory."""

    rollouts: Float32Array
    state: Float32Array
    joint: Float32Array


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
        std = np.asarray(self.config.noise_std, dtype=np.float64)
        if std.shape not in ((), (n,)):
            raise PlanningError(f"STOMP: wanted one noise_std or {n} of them, got {std.shape[0]}")
        self._std = np.broadcast_to(std, (n,)).astype(np.float32)
        self._smooth = smoothness(self.config.n_waypoints)
        self._factor32 = self._smooth.factor.astype(np.float32)

    def plan(
        self,
        initial: ArrayLike,
        rng: np.random.Generator,
        deadline: Callable[[], bool] | None = None,
    ) -> Plan:
        """Improve a trajectory; start and goal stay exactly as given.

        Args:
            initial: (N, D) waypoints in rad to begin with, e.g. a straight line or the last plan.
            rng: source of all noise: the same state gives the same plan, in any thread.
            deadline: asked before each update; once it says True the best so far is returned.

        Raises:
            PlanningError: if `initial` has the wrong shape or is not finite.
        """
        cfg, n_joints = self.config, len(self.lower)
        theta = np.array(checked("initial trajectory", initial, (cfg.n_waypoints, n_joints), error=PlanningError))
        stomp_kernels.keep_within_limits(theta, self.lower, self.upper, self._smooth.factor)
        shape = (cfg.n_rollouts + 1, cfg.n_waypoints, n_joints)
        pool = _Pool(
            np.empty(shape, np.float32),
            np.empty(shape[:2], np.float32),
            np.empty(shape, np.float32),
        )
        # All the randomness of a plan is drawn at once: many small draws cost more than the noise itself.
        lanes = self._smooth.n_free * n_joints
        new = cfg.n_rollouts - cfg.n_reused
        bits = stomp_kernels.random_bits(rng, lanes * (cfg.n_reused + new * cfg.n_iterations))
        used = 0
        best, best_rank = theta.copy(), (True, np.inf)
        done, reused = 0, 0
        while done < cfg.n_iterations and not (deadline is not None and deadline()):
            stomp_kernels.sample(
                theta, bits[used:], self._std * np.float32(cfg.noise_decay**done), self.lower, self.upper,
                self._smooth.factor, self._factor32, pool.rollouts[reused:],
            )  # fmt: skip
            used += lanes * (cfg.n_rollouts - reused)
            valid = self._evaluate(pool, reused)
            rank = (not valid, self._noiseless_total(pool))
            if rank < best_rank:
                best, best_rank = theta.copy(), rank
            k = cfg.n_rollouts
            reused = cfg.n_reused
            stomp_kernels.update(
                theta, pool.rollouts[:k], pool.state[:k], pool.joint[:k], cfg.sharpness,
                self._smooth.factor, self._smooth.column_scale, self.lower, self.upper, reused,
            )  # fmt: skip
            done += 1
        pool.rollouts[-1] = theta
        valid = self._evaluate(pool, cfg.n_rollouts)
        if (not valid, self._noiseless_total(pool)) < best_rank:
            best = theta
        return self.assess(best, done)

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

    def _evaluate(self, pool: _Pool, first: int) -> bool:
        """Cost the rollouts from `first` on; return whether the noiseless one, the last, is allowed."""
        batch, state, joint = pool.rollouts[first:], pool.state[first:], pool.joint[first:]
        state[:] = 0.0
        joint[:] = 0.0
        valid = True
        for term in self.terms:
            weight = np.float32(term.weight)
            if isinstance(term, JointCostTerm):
                values, allowed = term.evaluate_joints(batch)
                joint += weight * values
            else:
                values, allowed = term.evaluate(batch)
                state += weight * values
            valid = valid and (allowed is None or bool(allowed[-1].all()))
        return valid

    @staticmethod
    def _noiseless_total(pool: _Pool) -> float:
        return float(pool.state[-1].sum(dtype=np.float64) + pool.joint[-1].sum(dtype=np.float64))

    def _outside_limits(self, path: FloatArray) -> str:
        outside = (path < self.lower - _LIMIT_TOLERANCE) | (path > self.upper + _LIMIT_TOLERANCE)
        if not outside.any():
            return ""
        t, d = (int(i) for i in np.argwhere(outside)[0])
        return f"limits: joint {d} at waypoint {t} of {len(path)} is {path[t, d]:.4f} rad"
