"""The interface of everything that turns an observed posture into predicted human occupancy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.recognition.classifier import ClassPosterior

#: What predicts unless told otherwise; `predictors.factory` knows them all.
DEFAULT_PREDICTOR = "forecast"


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a predictor says after one posture.

    Attributes:
        occupancy: where the human is going to be.
        posterior: which class it takes the motion for; None where it recognises nothing.
        T_library_tracker: (4, 4) where it takes this person to stand: brings the person to where the library's people
            stood. None where it takes the library's place for granted.
    """

    occupancy: Occupancy
    posterior: ClassPosterior | None
    T_library_tracker: FloatArray | None = None


class OccupancyPredictor(ABC):
    """Predicts the voxels the human will occupy.

    The grid is in the world frame; postures are in the frame of the tracker. `T_world_human` given at
    construction joins the two.
    """

    grid: VoxelGrid

    @abstractmethod
    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""

    @abstractmethod
    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s` and return the prediction that follows from all so far."""
