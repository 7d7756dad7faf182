"""What the predictor `reaching` learns from a library: how people reach, and how to tell where to."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary, unwrap_angles
from humanpred_ros.motion.reach_recordings import ACTIVE, find_jumps
from humanpred_ros.reaching.place_model import PlaceModel, learn_place_model
from humanpred_ros.reaching.places import Places, mistracked
from humanpred_ros.reaching.reach_model import ReachModel
from humanpred_ros.recognition.forest import evenly_spaced
from humanpred_ros.recognition.training import TrainedModel

#: Postures that are learned from of each motion of a model.
_N_POSTURES = 50


@dataclass(frozen=True, eq=False)
class ReachKnowledge:
    """All that is learned for the predictor `reaching`.

    Attributes:
        model: how people reach.
        place_model: how to tell the place.
        places: where the library's classes end, tracker's frame; None if it has no classes.
        source: name of the library.
        left_out: names of the motions that were not learned from, because they are mistracked.
    """

    model: ReachModel
    place_model: PlaceModel
    places: Places | None
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
            # A tracker will also lose arms when the place is to be told, so the place model learns from such motions.
            learn_place_model(library, human),
            Places.of_library(library, human) if library.labels else None,
            library.name,
            tuple(motion.name for motion in library if motion.name in wrong) if len(fit) < len(library) else (),
        )

    @classmethod
    def of_model(cls, model: TrainedModel, human: HumanModel) -> ReachKnowledge:
        """Learn from the motions that a model file holds.

        Raises:
            UsageError: a model that was trained for another human.
        """
        if model.human.signature != human.signature:
            raise UsageError(
                f"predictor: the model was trained for another human than {human.name}; train one for this human"
            )
        return cls.of_library(library_of_model(model), human)


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


def _unfit(library: MotionLibrary, human: HumanModel) -> frozenset[str]:
    """Return the names of motions that nothing should be learned from.

    The arms that a depth camera shows jump in every other motion; where motion capture jumps, a marker was mistaken.
    """
    unfit = set(mistracked(library, human))
    if human.signature == HumanModel.mocap23().signature:
        unfit.update(motion.name for motion in library if find_jumps(motion, ACTIVE, human))
    return frozenset(unfit)
