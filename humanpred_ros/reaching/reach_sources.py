"""The predictor `reaching` learns how people reach, not where to: from a library, or from a model trained on one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.geometry.shapes import Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary, unwrap_angles
from humanpred_ros.motion.reach_recordings import ACTIVE, find_jumps
from humanpred_ros.occupancy.voxeliser import checked_placement
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.place_classifier import GoalClassifier, learn_goal_model
from humanpred_ros.reaching.place_model import GoalModel
from humanpred_ros.reaching.places import GoalPlaces, mistracked
from humanpred_ros.reaching.reach_model import ReachModel
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.reaching.weights import load_weights
from humanpred_ros.recognition.forest import evenly_spaced
from humanpred_ros.recognition.training import TrainedModel

#: Postures that are kept of each motion of a model.
_N_POSTURES = 50


@dataclass(frozen=True, eq=False)
class ReachKnowledge:
    """All that is learned for the predictor `reaching`.

    Attributes:
        model: how people reach.
        goal_model: what tells where to.
        places: where the library's classes end, tracker's frame; None if it has no classes.
        source: name of the library.
        left_out: names of the motions that were not learned from: plainly mistracked ones.
    """

    model: ReachModel
    goal_model: GoalModel
    places: GoalPlaces | None
    source: str
    left_out: tuple[str, ...] = ()

    @classmethod
    def of_library(cls, library: MotionLibrary, human: HumanModel) -> ReachKnowledge:
        """Learn from a library; it needs no classes.

        Raises:
            HumanModelError: a library of other DoFs than the human's.
            MotionError: motions that do not suffice.
        """
        human.check_dofs(library.dof_names)
        wrong = _unfit(library, human)
        fit = [motion for motion in library if motion.name not in wrong] or list(library)
        return cls(
            ReachModel.learn(fit, human),
            # A tracker goes on losing arms: what tells the goal must have seen that.
            learn_goal_model(library, human),
            GoalPlaces.of_library(library, human) if library.labels else None,
            library.name,
            tuple(motion.name for motion in library if motion.name in wrong) if len(fit) < len(library) else (),
        )

    @classmethod
    def of_model(cls, model: TrainedModel, human: HumanModel) -> ReachKnowledge:
        """Learn from the motions that a model file remembers.

        Raises:
            UsageError: a model that was trained for another human.
        """
        if model.human.signature != human.signature:
            raise UsageError(
                f"predictor: the model was trained for another human than {human.name}; train one for this human"
            )
        return cls.of_library(library_of_model(model), human)

    def predictor(
        self,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        goals: GoalPlaces | None = None,
        *,
        onsets: bool = False,
        weights: ArrayLike | None = None,
        obstacles: Sequence[Obstacle] = (),
    ) -> ReachingPredictor:
        """Return the predictor for these places, or for the library's.

        Args:
            grid: the lattice, world frame.
            T_world_human: (4, 4) from the tracker's frame to the world.
            goals: places of the hand, tracker's frame; the library's if None.
            onsets: find where motions begin and end.
            weights: (24,) of P2's cost; the default ones if None.
            obstacles: what stands in a reach's way, world frame.

        Raises:
            UsageError: no places at all.
        """
        places = goals or self.places
        if places is None:
            raise UsageError(
                f"predictor reaching: wanted places where the hand may go, got none, and {self.source} has no classes "
                "to take them from; give some"
            )
        classifier = GoalClassifier(self.model.human, model=self.goal_model, goals=places)
        scene = Surroundings.of_obstacles(obstacles, np.linalg.inv(checked_placement(T_world_human)))
        return ReachingPredictor(
            self.model, classifier, grid, T_world_human, onsets=onsets, weights=weights, scene=scene
        )


def library_of_model(model: TrainedModel) -> MotionLibrary:
    """Return the motions of a model, thinned to `_N_POSTURES` postures each, evenly spaced from first to last.

    Each motion is taken to last as long as the library's median one.
    """
    duration_s = float(np.median([motion.duration_s for motion in model.library]))
    motions = []
    for motion in model.library:
        q = unwrap_angles(motion).q[evenly_spaced(len(motion), _N_POSTURES)]
        motions.append(replace(motion, t_s=np.linspace(0.0, duration_s, len(q)), q=q))
    return MotionLibrary(model.library.name, tuple(motions), model.library.provenance)


def reach_weights(name_or_file: str) -> FloatArray:
    """Return (24,) weights of P2's cost: of a name (`NAMED_WEIGHTS`), or from a file (`weights_file`).

    Raises:
        UsageError: no such name, and no JSON file either.
        ModelFileError: a file that cannot be used.
    """
    if name_or_file in NAMED_WEIGHTS:
        return NAMED_WEIGHTS[name_or_file]
    if name_or_file.endswith(".json"):
        return load_weights(name_or_file).weights
    raise UsageError(
        f"reach weights: wanted one of {', '.join(NAMED_WEIGHTS)}, or a .json file of learned weights, "
        f"got {name_or_file!r}"
    )


def _unfit(library: MotionLibrary, human: HumanModel) -> frozenset[str]:
    """Return the names of motions that nothing should be learned from.

    The arms that a depth camera shows jump in every other motion; where motion capture jumps, a marker was mistaken.
    """
    unfit = set(mistracked(library, human))
    if human.signature == HumanModel.mocap23().signature:
        unfit.update(motion.name for motion in library if find_jumps(motion, ACTIVE, human))
    return frozenset(unfit)
