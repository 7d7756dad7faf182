"""What a person may be minimising while reaching beside a partner: P2's 24 features of a reach (P2 III-A).

Eight say how smooth it is (length, velocity, acceleration, jerk, of the posture and of the wrist), sixteen how close
pelvis, wrist, elbow and shoulder come to those of the partner. A reach's cost is `weights . features`.

Values are those of P2's published pipeline (facts section 4), its scales included; they bring the features to
similar sizes and carry no meaning of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import ArrayError, MotionError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching import feature_kernels
from humanpred_ros.reaching.feature_kernels import REACH
from humanpred_ros.reaching.stencils import PADDING, RULES

#: Links whose distances to the partner's are features (P2 III-A), in that order.
LINK_POINTS = ("pelvis", "right_wrist", "right_elbow", "right_shoulder")
_SHORT = {"pelvis": "pelvis", "right_wrist": "wrist", "right_elbow": "elbow", "right_shoulder": "shoulder"}
SMOOTHNESS_NAMES = (
    "posture length", "posture velocity", "posture acceleration", "posture jerk",
    "wrist length", "wrist velocity", "wrist acceleration", "wrist jerk",
)  # fmt: skip
DISTANCE_NAMES = tuple(f"{_SHORT[mine]} to {_SHORT[theirs]}" for mine in LINK_POINTS for theirs in LINK_POINTS)
FEATURE_NAMES = (*SMOOTHNESS_NAMES, *DISTANCE_NAMES)
N_SMOOTHNESS, N_FEATURES = len(SMOOTHNESS_NAMES), len(FEATURE_NAMES)

#: What each feature is multiplied by, as in P2's code (facts section 4); metres and radians count alike.
SMOOTHNESS_SCALES = (1e-1, 1e-5, 1e-10, 1e-15, 1e1, 1e-3, 1e-9, 1e-13)
SCALES: FloatArray = frozen(np.array([*SMOOTHNESS_SCALES, *([1.0] * len(DISTANCE_NAMES))]))  # type: ignore[assignment]


@dataclass(frozen=True)
class FeatureConfig:
    """How features are computed (facts section 4).

    Attributes:
        n_waypoints: a reach is resampled to so many waypoints, evenly in time.
        closeness_height: value of a distance feature's integrand at distance zero.
        closeness_base, closeness_range_m: it falls to one `base`-th with every `range_m`.
        closeness_cutoff_m: it is zero from here on.
    """

    n_waypoints: int = 100
    closeness_height: float = 5.0
    closeness_base: float = 6.0
    closeness_range_m: float = 0.16
    closeness_cutoff_m: float = 0.80


@dataclass(frozen=True, eq=False)
class ReachSituation:
    """What the features of a reach depend on beside its postures.

    Attributes:
        duration_s: from first to last waypoint.
        partner_m: (4, 3) pelvis, wrist, elbow and shoulder of the partner, who stands still (P2 III-A).
        history: (6, J) postures at the reach's own spacing before its first waypoint, the latest last; None for a
            person who was at rest.

    Raises:
        MotionError: no positive duration, or arrays of other shapes.
    """

    duration_s: float
    partner_m: FloatArray
    history: FloatArray | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration_s) and self.duration_s > 0.0):
            raise MotionError(f"reach: wanted a positive duration in seconds, got {self.duration_s}")
        partner = checked("partner_m", self.partner_m, (len(LINK_POINTS), 3), error=MotionError)
        object.__setattr__(self, "partner_m", frozen(partner))
        if self.history is not None:
            object.__setattr__(self, "history", frozen(checked("history", self.history, (PADDING, "J"))))


class ReachFeatures:
    """The features of batches of reaches of one human; immutable.

    Attributes:
        model: the reaching human: one chain of joints that carries `LINK_POINTS`.
        config: settings.

    Raises:
        HumanModelError: another kind of model.
        ArrayError: settings with too few waypoints.
    """

    def __init__(self, model: HumanModel, config: FeatureConfig | None = None) -> None:
        self.model = model
        self.config = config or FeatureConfig()
        self._points = ChainPoints(model, LINK_POINTS)
        self._wrist = LINK_POINTS.index("right_wrist")
        if self.config.n_waypoints < 2 * REACH + 1:
            raise ArrayError(f"features: wanted at least {2 * REACH + 1} waypoints, got {self.config.n_waypoints}")

    def link_points(self, q: ArrayLike) -> FloatArray:
        """Return the points (..., 4, 3) of `LINK_POINTS` of postures (..., J), metres: also the partner's."""
        return np.asarray(self._points.positions(np.asarray(q, dtype=np.float64)), dtype=np.float64)

    def waypoint_values(self, q: ArrayLike, situation: ReachSituation) -> FloatArray:
        """Return what each waypoint adds to each feature, (R, N, 24), for reaches (R, N, J).

        Raises:
            ArrayError: reaches of another shape, or values that are not finite.
        """
        reaches, before, scales = self._prepared(q, situation)
        n_reaches, n, _ = reaches.shape
        points = self.link_points(reaches)
        values = np.empty((n_reaches, n, N_FEATURES))
        for first, (signal, earlier) in enumerate(self._signals(reaches, points, before)):
            part = np.empty((n_reaches, n, 4))
            feature_kernels.differences(signal, earlier, RULES, part)
            values[..., 4 * first : 4 * first + 4] = part
        close = np.empty((n_reaches * n, N_FEATURES - N_SMOOTHNESS))
        feature_kernels.closeness(points.reshape(-1, 4, 3), situation.partner_m, *self._closeness, close)
        values[..., N_SMOOTHNESS:] = close.reshape(n_reaches, n, -1)
        values *= scales
        return values

    def values(self, q: ArrayLike, situation: ReachSituation) -> FloatArray:
        """Return the features (R, 24) of reaches (R, N, J), or (24,) of one reach (N, J)."""
        batch = np.asarray(q, dtype=np.float64)
        values: FloatArray = self.waypoint_values(batch[None] if batch.ndim == 2 else batch, situation).sum(axis=1)
        return values[0] if batch.ndim == 2 else values

    def cost_gradient(
        self, q: ArrayLike, weights: ArrayLike, situation: ReachSituation
    ) -> tuple[FloatArray, FloatArray]:
        """Return costs (R,) and their gradients (R, N, J) by all waypoints of reaches (R, N, J).

        First and last waypoint count where they are repeated outside the reach.
        """
        w = checked("weights", weights, (N_FEATURES,))
        costs: FloatArray = self.waypoint_values(q, situation).sum(axis=1) @ w
        reaches, before, scales = self._prepared(q, situation)
        n_reaches, n, _ = reaches.shape
        points = self.link_points(reaches)
        factors = w * scales
        by_signal = []
        for first, (signal, earlier) in enumerate(self._signals(reaches, points, before)):
            part = np.zeros_like(signal)
            feature_kernels.differences_back(signal, earlier, RULES, factors[4 * first : 4 * first + 4], part)
            by_signal.append(part)
        force = np.zeros((n_reaches * n, len(LINK_POINTS), 3))
        feature_kernels.closeness_back(
            points.reshape(-1, 4, 3), situation.partner_m, *self._closeness, factors[N_SMOOTHNESS:], force
        )
        force = force.reshape(n_reaches, n, -1, 3)
        force[:, :, self._wrist] += by_signal[1]
        return costs, by_signal[0] + self._points.pull_back(reaches, force)

    def _prepared(self, q: ArrayLike, situation: ReachSituation) -> tuple[FloatArray, FloatArray, FloatArray]:
        n, n_dofs = self.config.n_waypoints, len(self.model.dof_names)
        reaches = np.ascontiguousarray(checked("reaches", q, ("R", n, n_dofs)))
        before = np.zeros((0, n_dofs)) if situation.history is None else situation.history
        if before.shape[1] != n_dofs:
            raise ArrayError(f"history: wanted {n_dofs} DoFs as the reach has, got {before.shape[1]}")
        dt_s = situation.duration_s / (n - 1)
        per_derivative = np.array([1.0, dt_s**-2, dt_s**-4, dt_s**-6])
        units = np.concatenate([per_derivative, per_derivative, np.full(N_FEATURES - N_SMOOTHNESS, dt_s)])
        return reaches, before, SCALES * units

    def _signals(
        self, reaches: FloatArray, points: FloatArray, before: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
        wrist = np.ascontiguousarray(points[:, :, self._wrist])
        earlier = self.link_points(before)[:, self._wrist] if len(before) else np.zeros((0, 3))
        return (reaches, before), (wrist, np.ascontiguousarray(earlier))

    @property
    def _closeness(self) -> tuple[float, float, float]:
        c = self.config
        return c.closeness_height, float(np.log(c.closeness_base)) / c.closeness_range_m, c.closeness_cutoff_m
