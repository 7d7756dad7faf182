"""Baselines: the body where it is, where it has been, and where it gets to if it goes on as it moves now.

They know no library. What sets a prediction learned from recordings apart from them is what was learned.
"""

from __future__ import annotations

import itertools
import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import Occupancy, OccupancyInTime, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import is_angle
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.settings import Settings, setting

_TURN = 2 * np.pi
#: A joint that may turn this far has no end it could stop at (limits written as plus and minus pi, rounded).
_FULL_TURN = _TURN - 1e-3
#: Postures of a slice of time that are looked at.
_LOOKS = 7


class CurrentOccupancyPredictor(Predictor):
    """Baseline: the body where it is now.

    Probability 1 there, 0 elsewhere; recognises nothing.

    Attributes:
        grid: the lattice, world frame.
    """

    def __init__(self, human: HumanModel, grid: VoxelGrid, T_world_human: ArrayLike) -> None:
        """Prepare for one human, grid and placement (arguments as for `BodyVoxeliser`)."""
        self.grid = grid
        self._n_dofs = len(human.dof_names)
        self._voxeliser = BodyVoxeliser(human, grid, T_world_human)
        self.start()

    @classmethod
    def from_request(cls, request: PredictorRequest) -> CurrentOccupancyPredictor:
        return cls(request.human, request.grid, request.T_world_human)

    def start(self) -> None:
        """Nothing was observed that could be forgotten."""

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s` and return where the body is.

        Raises:
            ArrayError: posture of the wrong shape or not finite.
        """
        occupied = self._occupied(self._voxeliser.mask(checked("posture", q, (self._n_dofs,))))
        return Prediction(Occupancy(self.grid, occupied.astype(np.float32), t_s), None)

    def _occupied(self, now: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the voxels to call occupied, from those the body is in."""
        return now


class AccumulatedOccupancyPredictor(CurrentOccupancyPredictor):
    """Baseline: everywhere the body was since the motion began (published code of P1).

    The code published with P1 never cleared its flags of occupied voxels; the paper describes the current posture only
    (docs/papers.md, P1 occupancy).
    """

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        self._past = np.zeros(self.grid.shape, dtype=np.bool_)

    def _occupied(self, now: NDArray[np.bool_]) -> NDArray[np.bool_]:
        self._past = self._past | now
        return self._past


class ConstantVelocitySettings(Settings):
    """Settings of the predictor `constant_velocity`: how the velocity is estimated and how far it is followed.

    Of windows of 0.1 to 0.25 s and horizons of 0.05 to 0.8 s the defaults have the lowest Brier score on library_b;
    farther ahead it misses less and is wrong more often.
    """

    window_s: float = setting(
        0.1, "the velocity is the one of the postures of this last while", unit="s", low=1e-3, high=1e3
    )
    horizon_s: float = setting(
        0.15,
        "how long the body is taken to go on; a velocity that falls evenly to zero within twice that time sweeps the "
        "same voxels",
        unit="s",
        low=1e-3,
        high=1e3,
    )
    step_voxels: float = setting(
        0.5, "postures on the way are so many voxels apart, at the link that moves most", low=1e-3, high=1e3
    )
    most_postures: int = setting(40, "postures on the way, at most", low=1, high=100_000)


class ConstantVelocityPredictor(Predictor):
    """Baseline: the body where it is, and where it gets to if it goes on as it moves now.

    Probability 1 on that way, 0 elsewhere; recognises nothing.

    Joints stop at their limits. The velocity of each joint is the median of the slopes between postures half a
    window apart (Theil's incomplete method), which a single mistracked posture does not move.

    Attributes:
        grid: the lattice, world frame.
        settings: how the velocity is estimated and followed.
    """

    settings_type = ConstantVelocitySettings

    def __init__(
        self,
        human: HumanModel,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        *,
        settings: ConstantVelocitySettings | None = None,
    ) -> None:
        """Prepare for one human, grid and placement (arguments as for `BodyVoxeliser`)."""
        self.grid = grid
        self.settings = settings or ConstantVelocitySettings()
        self._human = human
        self._voxeliser = BodyVoxeliser(human, grid, T_world_human)
        self._is_angle = np.array([is_angle(name) for name in human.dof_names])
        endless = self._is_angle & (human.upper - human.lower >= _FULL_TURN)
        self._lower = np.where(endless, -np.inf, human.lower)
        self._upper = np.where(endless, np.inf, human.upper)
        self.start()

    @classmethod
    def from_request(cls, request: PredictorRequest) -> ConstantVelocityPredictor:
        settings = request.settings if isinstance(request.settings, ConstantVelocitySettings) else None
        return cls(request.human, request.grid, request.T_world_human, settings=settings)

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        #: Stamps and postures of the last while, angles continuous from one to the next.
        self._recent: deque[tuple[float, FloatArray]] = deque()

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s` and return where the body is and goes on to.

        A call that raises leaves the predictor as it was.

        Raises:
            ArrayError: posture of the wrong shape or not finite.
            MotionError: a stamp that is not finite or not later than the one before.
        """
        q = checked("posture", q, (len(self._is_angle),))
        if not math.isfinite(t_s) or (self._recent and t_s <= self._recent[-1][0]):
            raise MotionError(
                f"constant velocity: wanted a finite stamp, later than the last one, got {t_s} s; "
                "call start() when a new motion begins"
            )
        continuous = q
        if self._recent:
            continuous = q - _TURN * np.round((q - self._recent[-1][1]) / _TURN) * self._is_angle
        self._recent.append((t_s, continuous))
        while self._recent[0][0] < t_s - self.settings.window_s and len(self._recent) > 2:
            self._recent.popleft()
        occupied = self._voxeliser.mask(self._ahead(q))
        return Prediction(Occupancy(self.grid, occupied.astype(np.float32), t_s), None)

    def in_time(self, edges_s: FloatArray) -> OccupancyInTime | None:
        """Return where the body gets in each slice: its velocity falls evenly to zero within twice `horizon_s`."""
        if not self._recent:
            return None
        t_s, q = self._recent[-1]
        stop_s = 2.0 * self.settings.horizon_s
        masks = []
        for begin_s, end_s in itertools.pairwise(edges_s):
            t = np.minimum(np.linspace(begin_s, min(end_s, max(begin_s, stop_s)), _LOOKS), stop_s)
            way_s = t - t * t / (2.0 * stop_s)
            masks.append(self._voxeliser.mask(self._clipped(q + way_s[:, None] * self.velocity(), q)).ravel())
        occupied = np.stack(masks, axis=1)
        voxels = np.flatnonzero(occupied.any(axis=1))
        return OccupancyInTime(self.grid, edges_s, voxels, occupied[voxels].astype(np.float32), t_s)

    def velocity(self) -> FloatArray:
        """Return the joint velocities (D,) of the last while, per second; zero before the second posture."""
        if len(self._recent) < 2:
            return np.zeros(len(self._is_angle))
        t_s = np.array([stamp for stamp, _ in self._recent])
        postures = np.array([posture for _, posture in self._recent])
        half = len(t_s) // 2
        slopes = (postures[half:] - postures[:-half]) / (t_s[half:] - t_s[:-half])[:, None]
        median: FloatArray = np.median(slopes, axis=0)
        return median

    def _ahead(self, q: FloatArray) -> FloatArray:
        """Return postures (N, D) from the present one to the one at the horizon."""
        end = self._clipped(q + self.velocity() * self.settings.horizon_s, q)
        poses = self._human.link_poses(np.stack([q, end]))
        way_m = float(np.linalg.norm(poses[1, :, :3, 3] - poses[0, :, :3, 3], axis=1).max())
        steps = math.ceil(way_m / (self.settings.step_voxels * self.grid.resolution_m))
        share = np.linspace(0.0, 1.0, 1 + min(steps, self.settings.most_postures - 1))
        postures: FloatArray = q + share[:, None] * (end - q)
        return postures

    def _clipped(self, ahead: FloatArray, q: FloatArray) -> FloatArray:
        """Return postures (..., D) with joints at their limits; one tracked beyond already does not snap back."""
        within: FloatArray = np.clip(ahead, np.minimum(self._lower, q), np.maximum(self._upper, q))
        return within
