"""The baseline P1 compares with: no prediction, only the voxels the body occupies now (facts 4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.predictor import OccupancyPredictor, Prediction
from humanpred_ros.occupancy.swept_volume import BodyVoxeliser


class CurrentOccupancyPredictor(OccupancyPredictor):
    """Probability 1 where the body is, 0 elsewhere; recognises nothing.

    Attributes:
        grid: the lattice, world frame.
        accumulate: keep the voxels of all postures since `start`. The code published with P1 did so by never
            clearing its flags (facts 4); the paper describes the current posture only.
    """

    def __init__(
        self,
        human: HumanModel,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        *,
        accumulate: bool = False,
        spacing_m: float = 0.02,
    ) -> None:
        """Prepare for one human, grid and placement (arguments as for `BodyVoxeliser`)."""
        self.grid = grid
        self.accumulate = accumulate
        self._n_dofs = len(human.dof_names)
        self._voxeliser = BodyVoxeliser(human, grid, T_world_human, spacing_m)
        self.start()

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        self._past = np.zeros(self.grid.shape, dtype=np.bool_)

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s` and return where the body is.

        Raises:
            ArrayError: posture of the wrong shape or not finite.
        """
        occupied = self._voxeliser.mask(checked("posture", q, (self._n_dofs,)))
        if self.accumulate:
            occupied |= self._past
            self._past = occupied
        return Prediction(Occupancy(self.grid, occupied.astype(np.float32), t_s), None)
