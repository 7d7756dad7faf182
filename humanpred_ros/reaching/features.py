"""P2's 24 features of a reach: what people may be minimising when they reach beside a partner (P2 III-A).

Eight features measure smoothness: length, velocity, acceleration and jerk, first of the posture, then of the wrist.
Sixteen measure how close the person's pelvis, wrist, elbow and shoulder come to those of the partner. The cost of a
reach is `weights . features`. Values and scales are those of docs/papers.md ("P2 features").
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist

from humanpred_ros.errors import ArrayError, MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel

#: Links whose distances to the partner's links are features, in this order (P2 III-A).
LINK_POINTS = ("pelvis", "right_wrist", "right_elbow", "right_shoulder")
SMOOTHNESS_NAMES = (
    "posture length", "posture velocity", "posture acceleration", "posture jerk",
    "wrist length", "wrist velocity", "wrist acceleration", "wrist jerk",
)  # fmt: skip
_SHORT = [name.removeprefix("right_") for name in LINK_POINTS]
DISTANCE_NAMES = tuple(f"{mine} to {theirs}" for mine in _SHORT for theirs in _SHORT)
FEATURE_NAMES = (*SMOOTHNESS_NAMES, *DISTANCE_NAMES)
N_SMOOTHNESS, N_FEATURES = len(SMOOTHNESS_NAMES), len(FEATURE_NAMES)

#: Factors of the features, as published; metres and radians count alike.
SCALES: FloatArray = frozen(np.array([1e-1, 1e-5, 1e-10, 1e-15, 1e1, 1e-3, 1e-9, 1e-13, *([1.0] * 16)]))  # type: ignore[assignment]
#: How many waypoints a difference rule looks to each side.
REACH = 3
#: First, second and third difference over offsets -3..+3, in units of the time step, (3, 7). As published; they are
#: not centred.
RULES = np.array(
    [
        [c / 6.0 for c in (0.0, 0.0, -2.0, -3.0, 6.0, -1.0, 0.0)],
        [c / 12.0 for c in (0.0, -1.0, 16.0, -30.0, 16.0, -1.0, 0.0)],
        [c / 12.0 for c in (0.0, 1.0, -17.0, 46.0, -46.0, 17.0, -1.0)],
    ]
)
_STEP = np.array([0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0])
#: Reaches whose features are computed together, so that they stay in the cache.
_TOGETHER = 32
#: Postures kept of what came before a reach (P2: 6), more than the rules look back.
PADDING = 6


def _weights(smoothness: tuple[float, ...], distances: tuple[float, ...]) -> FloatArray:
    w = np.zeros(N_FEATURES)
    w[: len(smoothness)] = smoothness
    w[N_SMOOTHNESS:] = distances
    return frozen(w)  # type: ignore[return-value]


#: Weights (24,) that need no learning. "baseline_0" is smooth and ignores the partner, "baseline_1" also avoids every
#: link of the partner (P2 IV-D); 1000 is P2's weight 100 with the factors of its files. "authors_static" and
#: "authors_dynamic" are the means over what P2's authors learned from each of the seven reaches alone, without and with
#: cuts; they have seen the reaches that are tested here.
NAMED_WEIGHTS: Mapping[str, FloatArray] = MappingProxyType(
    {
        "baseline_0": _weights((0.0, 1000.0), (0.0,) * 16),
        "baseline_1": _weights((0.0, 1000.0), (10.0,) * 16),
        "authors_static": _weights(
            (129, 150, 154, 150, 134, 156, 201, 180),
            (174, 60, 36, 123, 115, 50, 4, 10, 103, 41, 0, 15, 55, 69, 7, 14),
        ),
        "authors_dynamic": _weights(
            (113, 170, 145, 143, 95, 177, 132, 202),
            (112, 46, 30, 121, 75, 49, 47, 67, 74, 0, 43, 83, 121, 98, 0, 5),
        ),
    }
)
#: Waypoints that a reach is resampled to, evenly in time.
N_WAYPOINTS = 100
#: A distance feature's integrand (docs/papers.md (2.2)): at distance 0, its fall (to 1/6 with every 0.16 m), its end.
CLOSENESS_HEIGHT, CLOSENESS_DECAY_PER_M, CLOSENESS_CUTOFF_M = 5.0, float(np.log(6.0)) / 0.16, 0.80


@dataclass(frozen=True, eq=False)
class ReachSituation:
    """What the features of a reach depend on besides its postures.

    Raises:
        MotionError: a duration that is not positive, or arrays of other shapes.
    """

    duration_s: float  #: from the first to the last waypoint
    partner_m: FloatArray  #: (4, 3) `LINK_POINTS` of the partner, who stands still (P2 III-A)
    #: (6, J) postures before the first waypoint, at the spacing of the waypoints, the latest last; None for a person
    #: who was at rest
    history: FloatArray | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.duration_s) and self.duration_s > 0.0):
            raise MotionError(f"reach: wanted a positive duration in seconds, got {self.duration_s}")
        partner = checked("partner_m", self.partner_m, (len(LINK_POINTS), 3), error=MotionError)
        object.__setattr__(self, "partner_m", frozen(partner))
        if self.history is not None:
            object.__setattr__(self, "history", frozen(checked("history", self.history, (PADDING, "J"))))


class ReachFeatures:
    """Computes the features of batches of reaches of one human; immutable.

    Attributes:
        model: the reaching human: one chain of joints that carries `LINK_POINTS`.
        n_waypoints: that a reach is resampled to.

    Raises:
        HumanModelError: another kind of model.
        SettingsError: fewer waypoints than the difference rules look at.
    """

    def __init__(self, model: HumanModel, n_waypoints: int = N_WAYPOINTS) -> None:
        if n_waypoints <= 2 * REACH:
            raise SettingsError(f"features: wanted n_waypoints of at least {2 * REACH + 1}, got {n_waypoints}")
        self.model, self.n_waypoints = model, n_waypoints
        self._points = ChainPoints(model, LINK_POINTS)
        self._wrist = LINK_POINTS.index("right_wrist")

    def link_points(self, q: ArrayLike) -> FloatArray:
        """Return the positions (..., 4, 3) of `LINK_POINTS` in postures (..., J), metres; also those of a partner."""
        return np.asarray(self._points.positions(np.asarray(q, dtype=np.float64)), dtype=np.float64)

    def waypoint_values(self, q: ArrayLike, situation: ReachSituation) -> FloatArray:
        """Return what each waypoint adds to each feature, (R, N, 24), for reaches (R, N, J).

        Raises:
            ArrayError: reaches or a history of another shape, or values that are not finite.
        """
        n, n_dofs = self.n_waypoints, len(self.model.dof_names)
        reaches = np.ascontiguousarray(checked("reaches", q, ("R", n, n_dofs)))
        before = np.zeros((0, n_dofs)) if situation.history is None else situation.history
        if before.shape[1] != n_dofs:
            raise ArrayError(f"history: wanted {n_dofs} DoFs as the reach has, got {before.shape[1]}")
        points = self.link_points(reaches)
        wrist = np.ascontiguousarray(points[:, :, self._wrist])
        wrist_before = self.link_points(before)[:, self._wrist] if len(before) else np.zeros((0, 3))
        away = cdist(points.reshape(-1, 3), situation.partner_m)
        close = np.where(away < CLOSENESS_CUTOFF_M, CLOSENESS_HEIGHT * np.exp(-CLOSENESS_DECAY_PER_M * away), 0.0)
        parts = (_differences(reaches, before), _differences(wrist, wrist_before), close.reshape(len(reaches), n, -1))
        values = np.concatenate(parts, axis=2)
        dt_s = situation.duration_s / (n - 1)
        per_derivative = np.array([1.0, dt_s**-2, dt_s**-4, dt_s**-6])
        values *= SCALES * np.concatenate([per_derivative, per_derivative, np.full(16, dt_s)])
        return values

    def values(self, q: ArrayLike, situation: ReachSituation) -> FloatArray:
        """Return the features (R, 24) of reaches (R, N, J), or (24,) of one reach (N, J); raises as above."""
        batch = np.asarray(q, dtype=np.float64)
        if batch.ndim == 2:
            return np.asarray(self.values(batch[None], situation)[0], dtype=np.float64)
        parts = [batch[first : first + _TOGETHER] for first in range(0, len(batch), _TOGETHER)] or [batch]
        return np.concatenate([self.waypoint_values(part, situation).sum(axis=1) for part in parts])


def _differences(y: FloatArray, before: FloatArray) -> FloatArray:
    """Return the squares (R, N, 4), summed over C, of the step to the next waypoint and of `RULES`, for y (R, N, C).

    `before` (H, C) came before the first waypoint; with H = 0 the first waypoint is repeated there. After the last
    waypoint it is repeated, so it has no step.
    """
    n = y.shape[1]
    earlier = np.broadcast_to(before[-REACH:], (len(y), REACH, y.shape[2])) if len(before) else y[:, [0] * REACH]
    padded = np.concatenate([earlier, y, y[:, [-1] * REACH]], axis=1)
    found = np.empty((len(y), n, 1 + len(RULES)))
    for k, rule in enumerate((_STEP, *RULES)):
        value = sum(factor * padded[:, i : i + n] for i, factor in enumerate(rule) if factor)
        np.einsum("rnc,rnc->rn", value, value, out=found[:, :, k])
    return found
