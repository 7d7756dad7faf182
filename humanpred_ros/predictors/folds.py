"""What every evaluation that leaves motions out shares: from what predictors are made, and who makes them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.predictor import OccupancyPredictor
from humanpred_ros.recognition.gmm_config import GmmConfig


@dataclass(frozen=True, eq=False)
class FoldSettings:
    """What every predictor of an evaluation is made from.

    Attributes:
        library: of which one motion at a time is left out; a motion that is not in it need not be.
        human: whose body occupies.
        grid: the lattice, world frame.
        T_world_human: (4, 4) from the library's frame to the world.
        classifier: name of the classifier that recognises the class.
        gmm: settings of P1's mixtures; also those that its swept volumes are regressed from.
        T_shift: (4, 4) how the tested people are moved in the library's frame. Of use only to who is told where they
            may reach; what was learned stays where it was.
    """

    library: MotionLibrary
    human: HumanModel
    grid: VoxelGrid
    T_world_human: FloatArray
    classifier: str = "gmm"
    gmm: GmmConfig = field(default_factory=GmmConfig)
    T_shift: FloatArray = field(default_factory=lambda: np.eye(4))


class LeaveOneOut(ABC):
    """Makes predictors of one kind, each as if trained on the library without one of its motions.

    Attributes:
        learned_from_class: whether the predictors have learned from other motions of the left-out one's class: yes,
            no, or – for who learns nothing.
        settings: what they are made from.
    """

    learned_from_class: ClassVar[str] = "yes"

    def __init__(self, settings: FoldSettings, predictor: str) -> None:
        self.settings = settings

    @abstractmethod
    def without(self, name: str) -> OccupancyPredictor:
        """Return the predictor trained without the motion `name` (`class/index`); raises what training raises."""
