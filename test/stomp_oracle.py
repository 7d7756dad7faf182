"""STOMP once more in plain NumPy and float64, written to be read: the compiled planner is tested against it.

Notation (docs/papers.md, P1 STOMP): θ (N, D) is the trajectory, A its accelerations' finite
differences, R = AᵀA over the free waypoints, ε_k ~ N(0, R⁻¹) the noise of rollout k, S its cost at each waypoint,
P its probability there, M = R⁻¹ with every column scaled to a largest element of 1/n. Given the same generator it
draws the same random bits as `StompPlanner` and gives the same trajectory, to within float32's rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cost_oracle
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from humanpred_ros.geometry.chain import BodyPoints, BodySpheres, KinematicChain
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.smoothness import accelerations_matrix

BoolArray = NDArray[np.bool_]
#: Costs (R, N), or (R, N, D) where the term knows each joint's part; and what it allows, None for everything.
Evaluation = tuple[FloatArray, BoolArray | None]

_LEVELS = 2**16  # 16 random bits make one normal draw
_LEAST_RANGE = 1e-12  # costs that differ by less say nothing
_LIMIT_TOLERANCE_RAD = 1e-6
_LIMIT_PUSHES = 10


@dataclass(frozen=True)
class OracleTerm:
    """A cost term: `evaluate` takes trajectories (R, N, D), rad."""

    name: str
    weight: float
    evaluate: Callable[[FloatArray], Evaluation]


def human_term(chain: KinematicChain, points: BodyPoints, occupancy: Occupancy, weight: float) -> OracleTerm:
    """Return what `HumanOccupancyCost` is."""
    return OracleTerm("human", weight, lambda q: (cost_oracle.human_costs(chain, points, occupancy, q), None))


def obstacle_term(
    chain: KinematicChain,
    spheres: BodySpheres,
    field: SignedDistanceField,
    weight: float,
    clearance_m: float = 0.10,
    margin_m: float = 0.0,
    duration_s: float = 5.0,
) -> OracleTerm:
    """Return what `ObstacleCost` is."""

    def evaluate(q: FloatArray) -> Evaluation:
        costs, nearest = cost_oracle.obstacle_costs(chain, spheres, field, q, clearance_m, duration_s)
        return costs, np.asarray(nearest >= margin_m)

    return OracleTerm("obstacle", weight, evaluate)


def smoothness_term(weight: float) -> OracleTerm:
    """Return what `SmoothnessCost` is."""
    return OracleTerm("smoothness", weight, lambda q: (cost_oracle.acceleration_costs(q), None))


def joint_limit_term(lower: ArrayLike, upper: ArrayLike, weight: float, margin_rad: float) -> OracleTerm:
    """Return what `JointLimitCost` is."""

    def evaluate(q: FloatArray) -> Evaluation:
        inside = (q >= np.asarray(lower)) & (q <= np.asarray(upper))
        return cost_oracle.joint_limit_costs(lower, upper, margin_rad, q), np.asarray(inside.all(axis=2))

    return OracleTerm("joint_limits", weight, evaluate)


@dataclass(frozen=True)
class OraclePlan:
    """The best noiseless trajectory met.

    Attributes:
        waypoints: (N, D), rad.
        total: its weighted cost.
        valid: whether every waypoint is allowed by every term.
    """

    waypoints: FloatArray
    total: float
    valid: bool


@dataclass(frozen=True)
class _Costs:
    """Costs of rollouts: state (R, N), joint (R, N, D), and whether every waypoint is allowed (R,)."""

    state: FloatArray
    joint: FloatArray
    valid: BoolArray

    @property
    def per_joint(self) -> FloatArray:
        """S (R, N, D): what each joint pays at each waypoint."""
        return self.state[..., None] + self.joint

    @property
    def total(self) -> FloatArray:
        """Cost of each rollout (R,)."""
        total: FloatArray = self.state.sum(axis=1) + self.joint.sum(axis=(1, 2))
        return total


class StompOracle:
    """`StompPlanner` in plain NumPy; `initial`, generator and configuration mean the same."""

    def __init__(
        self, terms: Sequence[OracleTerm], lower: ArrayLike, upper: ArrayLike, config: StompConfig | None = None
    ) -> None:
        self.config = config or StompConfig()
        self.terms = tuple(terms)
        self.lower = np.asarray(lower, dtype=np.float64)
        self.upper = np.asarray(upper, dtype=np.float64)
        self.std = np.broadcast_to(np.asarray(self.config.noise_std, dtype=np.float64), self.lower.shape)

    @cached_property
    def R(self) -> FloatArray:  # noqa: N802
        """(n, n) over the n = N - 2 free waypoints."""
        A = accelerations_matrix(self.config.waypoints)[:, 1:-1]
        R: FloatArray = A.T @ A
        return R

    @cached_property
    def R_inverse(self) -> FloatArray:  # noqa: N802
        return np.asarray(np.linalg.inv(self.R))

    @cached_property
    def M(self) -> FloatArray:  # noqa: N802
        """(n, n) smooths an update."""
        M: FloatArray = self.R_inverse / (len(self.R) * np.abs(self.R_inverse).max(axis=0))
        return M

    @cached_property
    def noise_factor(self) -> FloatArray:
        """(n, n) turns white noise z into L⁻ᵀ z ~ N(0, R⁻¹), where R = L Lᵀ."""
        L = np.linalg.cholesky(self.R)
        return np.asarray(np.linalg.inv(L.T))

    def plan(self, initial: ArrayLike, rng: np.random.Generator) -> OraclePlan:
        """Improve a trajectory (N, D), rad; its ends stay."""
        cfg = self.config
        theta = self.within_limits(np.array(initial, dtype=np.float64))
        bits = self._random_bits(rng)
        kept = np.empty((0, *theta.shape))
        best: OraclePlan | None = None
        for iteration in range(cfg.iterations):
            count = cfg.rollouts - len(kept)
            draws, bits = np.split(bits, [count * theta[1:-1].size])
            new = self.rollouts(theta, self.noise(draws, count, cfg.noise_decay**iteration))
            rollouts = np.concatenate([kept, new, theta[None]])
            costs = self.evaluate(rollouts)
            best = _better(best, OraclePlan(theta, float(costs.total[-1]), bool(costs.valid[-1])))
            theta = self.improved(theta, rollouts[:-1], costs.per_joint[:-1])
            cheapest = np.argsort(costs.total[:-1], kind="stable")[: cfg.reused]
            kept = rollouts[np.sort(cheapest)]
        costs = self.evaluate(theta[None])
        return _better(best, OraclePlan(theta, float(costs.total[0]), bool(costs.valid[0])))

    def noise(self, bits: NDArray[np.uint16], count: int, scale: float = 1.0) -> FloatArray:
        """Return ε (count, n, D) from 16 random bits per value, waypoint by waypoint."""
        n, n_joints = len(self.R), len(self.lower)
        z = ndtri((bits.astype(np.float64) + 0.5) / _LEVELS).reshape(n, count, n_joints)
        epsilon = np.einsum("ij,jkd->kid", self.noise_factor, z)
        return np.asarray(scale * self.std * epsilon)

    def rollouts(self, theta: FloatArray, epsilon: FloatArray) -> FloatArray:
        """Return θ + ε_k (K, N, D) within the limits."""
        noisy = np.repeat(theta[None], len(epsilon), axis=0)
        noisy[:, 1:-1] += epsilon
        return np.array([self.within_limits(rollout) for rollout in noisy]).reshape(noisy.shape)

    def evaluate(self, rollouts: FloatArray) -> _Costs:
        """Return the weighted costs of rollouts (R, N, D)."""
        state, joint = np.zeros(rollouts.shape[:2]), np.zeros(rollouts.shape)
        valid = np.ones(len(rollouts), dtype=np.bool_)
        for term in self.terms:
            values, allowed = term.evaluate(rollouts)
            if values.ndim == 3:
                joint += term.weight * values
            else:
                state += term.weight * values
            if allowed is not None:
                valid &= allowed.all(axis=1)
        return _Costs(state, joint, valid)

    def improved(self, theta: FloatArray, rollouts: FloatArray, S: FloatArray) -> FloatArray:
        """Return θ + M δθ within the limits, δθ the mean of the rollouts' noise weighted by P; S (K, N, D)."""
        low, high = S.min(axis=0), S.max(axis=0)
        P = np.exp(-self.config.sharpness * (S - low) / np.maximum(high - low, _LEAST_RANGE))
        P /= P.sum(axis=0)
        change = (P * (rollouts - theta)).sum(axis=0)
        moved = theta.copy()
        moved[1:-1] += self.M @ change[1:-1]
        return self.within_limits(moved)

    def within_limits(self, theta: FloatArray) -> FloatArray:
        """Return θ pushed inside the limits, its ends untouched.

        The worst waypoint of a joint moves onto its limit, its neighbours with it along that waypoint's column of
        R⁻¹, ten times at most; the rest is clipped (docs/papers.md (1.6) to (1.8)).
        """
        inside = theta.copy()
        for d in range(inside.shape[1]):
            free = inside[1:-1, d]
            for _ in range(_LIMIT_PUSHES):
                over = np.maximum(free - self.upper[d], self.lower[d] - free)
                worst = int(np.argmax(over))
                if over[worst] <= _LIMIT_TOLERANCE_RAD:
                    break
                sign = 1.0 if free[worst] < self.lower[d] else -1.0
                column = self.R_inverse[:, worst]
                free += sign * over[worst] * column / column[worst]
            np.clip(free, self.lower[d], self.upper[d], out=free)
        return inside

    def _random_bits(self, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Draw all the bits of a plan at once, as `StompPlanner` does, or the generators would part ways."""
        cfg = self.config
        new = cfg.rollouts - cfg.reused
        draws = len(self.R) * len(self.lower) * (cfg.reused + new * cfg.iterations)
        words = rng.integers(0, 2**64 - 1, size=(draws + 3) // 4, dtype=np.uint64, endpoint=True)
        return words.view(np.uint16)


def _better(one: OraclePlan | None, other: OraclePlan) -> OraclePlan:
    """Return the plan that is allowed, or else cheaper; the earlier one of equals."""
    if one is None or (not other.valid, other.total) < (not one.valid, one.total):
        return other
    return one
