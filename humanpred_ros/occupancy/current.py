"""The baseline P1 compares with: no prediction, only the voxels the body occupies now (facts 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser


class CurrentOccupancyPredictor(Predictor):
    """Baseline: the body where it is now.

    Probability 1 there, 0 elsewhere; recognises nothing.

    Attributes:
        grid: the lattice, world frame.
    """

    def __init__(
        self,
        human: HumanModel,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        *,
        spacing_m: float = 0.02,
    ) -> None:
        """Prepare for one human, grid and placement (arguments as for `BodyVoxeliser`)."""
        self.grid = grid
        self._n_dofs = len(human.dof_names)
        self._voxeliser = BodyVoxeliser(human, grid, T_world_human, spacing_m)
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
