"""What reaches the planner while one person moves: made once, and read by every run with that person."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.evaluation.direct_run import predicted
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.motion.motion import Motion
from humanpred_ros.occupancy.predictor import Predictor


class PredictedOccupancies:
    """The occupancies that follow from a motion, posture by posture, then from its last posture, held.

    Predictions do not depend on what the arm does, so runs with different seeds or methods share them. They are made
    as far as somebody reads, and kept as the few voxels that are not zero.
    """

    def __init__(self, predictor: Predictor, motion: Motion, threshold: float, n_held: int) -> None:
        """Take a predictor that nobody else uses meanwhile; other arguments as for `run_direct`."""
        self._grid: VoxelGrid = predictor.grid
        self._source = predicted(predictor, motion, threshold, n_held)
        self._made: list[tuple[float, NDArray[np.int64], NDArray[np.float32]]] = []

    def __iter__(self) -> Iterator[Occupancy]:
        return self.since(0)

    def since(self, posture: int) -> Iterator[Occupancy]:
        """Yield the occupancies from that of one posture on, counted from 0."""
        while self._make(posture):
            yield self.after(posture)
            posture += 1

    def after(self, posture: int) -> Occupancy:
        """Return the occupancy that follows from the postures up to one.

        Raises:
            IndexError: the person makes no such posture.
        """
        if not self._make(posture):
            raise IndexError(f"wanted one of {len(self._made)} postures, got {posture}")
        t_s, flat, values = self._made[posture]
        probability = np.zeros(self._grid.size, dtype=np.float32)
        probability[flat] = values
        return Occupancy(self._grid, probability.reshape(self._grid.shape), t_s)

    def _make(self, posture: int) -> bool:
        while len(self._made) <= posture:
            occupancy = next(self._source, None)
            if occupancy is None:
                return False
            flat = occupancy.voxels_above(0.0)
            self._made.append((occupancy.t_s, flat, occupancy.probability.ravel()[flat]))
        return True


def nobody(grid: VoxelGrid, motion: Motion, n_held: int) -> Iterator[Occupancy]:
    """Yield occupancies of the same stamps without anybody in them: what a planner sees that knows of no human."""
    nothing = np.zeros(grid.shape, dtype=np.float32)
    for offset_ns in motion.timeline(n_held)[0]:
        yield Occupancy(grid, nothing, offset_ns * 1e-9)
