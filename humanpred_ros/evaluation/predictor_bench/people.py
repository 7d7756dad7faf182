"""Whose reaches are timed: some are played, and the rest is what was learned from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from humanpred_ros.evaluation.occupancy_runs import P1_RESOLUTION_M, grid_around
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel, human_named, name_of_human
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.reaching.places import Places, reach_ends
from humanpred_ros.reaching.reach_knowledge import ReachKnowledge
from humanpred_ros.recognition.training import TrainedModel, train_model

#: Where a library shows fewer places than are told, it is told the same ones again, so much higher.
_HIGHER_M = 0.05


@dataclass(frozen=True, eq=False)
class People:
    """A library in two parts, and what is learned from the first.

    Attributes:
        human_name: whose postures these are.
        training: what is learned from.
        played: what is played.
    """

    human_name: str
    training: MotionLibrary
    played: tuple[Motion, ...]

    @classmethod
    def of(cls, library: MotionLibrary, n_played: int) -> People:
        """Play the first motions of the first class; of a library without classes the first ones, at most half.

        Raises:
            HumanModelError: a library of no human there is.
            LibraryFormatError: nothing is left to learn from.
        """
        name = name_of_human(library.dof_names)
        some = library.of_class(library.labels[0]) if library.labels else library.motions[: len(library) // 2]
        played = {motion.name for motion in some[:n_played]}
        training = library.select(lambda motion: motion.name not in played)
        return cls(name, training, some[:n_played])

    @cached_property
    def human(self) -> HumanModel:
        """The human of that name."""
        return human_named(self.human_name)

    @cached_property
    def model(self) -> TrainedModel | None:
        """The trained model; None without classes."""
        return train_model(self.training, self.human) if self.training.labels else None

    @cached_property
    def knowledge(self) -> ReachKnowledge:
        """What `reaching` learned, as the node learns it."""
        if self.model is not None:
            return ReachKnowledge.of_model(self.model, self.human)
        return ReachKnowledge.of_library(self.training, self.human)

    def grid(self, resolution_m: float = P1_RESOLUTION_M) -> VoxelGrid:
        """Return a grid of P1's size around them."""
        return grid_around(self.training, self.human, resolution_m)

    def places(self, count: int) -> Places:
        """Return `count` places in their frame: of the classes, or where each motion ended if there are none."""
        ends = reach_ends(self.training, self.human)
        shown = Places.of_ends(ends).places_m if self.training.labels else np.array([end.place_m for end in ends])
        k = np.arange(count)
        higher = np.outer(k // len(shown), (0.0, 0.0, _HIGHER_M))
        return Places(tuple(k.tolist()), shown[k % len(shown)] + higher)
