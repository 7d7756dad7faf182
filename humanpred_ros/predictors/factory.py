"""Predictors are chosen by name, in a node's parameter or on the command line."""

from __future__ import annotations

from numpy.typing import ArrayLike

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.constant_velocity import ConstantVelocityPredictor
from humanpred_ros.occupancy.current import CurrentOccupancyPredictor
from humanpred_ros.occupancy.forecast import ForecastPredictor
from humanpred_ros.occupancy.p1 import SweptVolumePredictor
from humanpred_ros.occupancy.predictor import OccupancyPredictor
from humanpred_ros.predictors.reach_sources import ReachKnowledge
from humanpred_ros.reaching.places import GoalPlaces
from humanpred_ros.recognition.classifier import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.registry import trained_classifier
from humanpred_ros.recognition.stream import StreamClassifier
from humanpred_ros.recognition.training import TrainedModel

#: Names users know the predictors by, and what they predict; the default first.
PREDICTORS = {
    "forecast": "where the body goes on to, as the library's people went on from moments like this one",
    "swept_volume": "P1: posterior of the classes times the volumes they sweep",
    "reaching": "P2: plans the reach to each place the hand may go to, and asks which one fits the motion so far; "
    "needs no motion to that place",
    "current": "baseline: the body where it is now",
    "current_accumulated": "baseline: everywhere the body was since the motion began (published code of P1)",
    "constant_velocity": "baseline: the body where it is, and where it gets to if it goes on as it moves now",
}


def needs_model(name: str) -> bool:
    """Return whether a predictor learns from a motion library; the baselines do not."""
    return name in ("forecast", "swept_volume", "reaching")


def uses_classifier(name: str) -> bool:
    """Return whether a predictor asks a classifier of classes; `reaching` infers places in its own way."""
    return needs_model(name) and name != "reaching"


def check_predictor(name: str, classifier: str) -> None:
    """Check names before anything expensive is done.

    Raises:
        UsageError: an unknown predictor, or one that does not go with the classifier.
    """
    if name not in PREDICTORS:
        raise UsageError(f"predictor: wanted one of {', '.join(PREDICTORS)}, got {name!r}")
    if name == "forecast" and classifier != "forest":
        raise UsageError(
            f"predictor forecast: wanted the classifier forest, whose recorded motions it follows, got {classifier!r}; "
            "with another classifier use swept_volume"
        )


def make_predictor(
    name: str,
    model: TrainedModel | None,
    human: HumanModel,
    grid: VoxelGrid,
    T_world_human: ArrayLike,
    *,
    classifier: str = DEFAULT_CLASSIFIER,
    onsets: bool = False,
    goals: GoalPlaces | None = None,
    reach_weights: ArrayLike | None = None,
    **online: object,
) -> OccupancyPredictor:
    """Return a predictor by name.

    Args:
        name: one of `PREDICTORS`.
        model: what was learned; the baselines need none.
        human: whose body occupies.
        grid: the lattice, world frame.
        T_world_human: (4, 4) from the tracker's frame to the world.
        classifier: name of the classifier that recognises the class; `forecast` needs `forest`, and `reaching`, which
            recognises places, none.
        onsets: the postures are those of a person who mostly stands: find where motions begin and end, and recognise
            each anew (`StreamClassifier`). Without it, the first posture after `start` begins a motion.
        goals: of `reaching`: places of the hand, tracker's frame; those of the model's classes if None.
        reach_weights: of `reaching`: (24,) of P2's cost; the default ones if None.
        online: settings of `gmm` that differ from the model's (`GmmConfig`, those free to change).

    Raises:
        UsageError: unknown name, no model where one is needed, a model for another human, or a predictor that does not
            go with the classifier.
        ArrayError: a placement that is not a rigid transform.
    """
    check_predictor(name, classifier)
    if name == "constant_velocity":
        return ConstantVelocityPredictor(human, grid, T_world_human)
    if not needs_model(name):
        return CurrentOccupancyPredictor(human, grid, T_world_human, accumulate=name == "current_accumulated")
    if model is None:
        raise UsageError(f"predictor {name}: wanted a trained model, got none; train one first")
    if model.human_signature != human.signature:
        raise UsageError(
            f"predictor: the model was trained for another human than {human.name}; train one for this human"
        )
    if name == "reaching":
        knowledge = ReachKnowledge.of_model(model, human)
        return knowledge.predictor(grid, T_world_human, goals, onsets=onsets, weights=reach_weights)
    recogniser = trained_classifier(classifier, model, human, **online)
    stream = StreamClassifier(recogniser, human=human) if onsets else recogniser
    if isinstance(recogniser, ForestClassifier) and name == "forecast":
        return ForecastPredictor(recogniser, grid, T_world_human, recogniser=stream)
    return SweptVolumePredictor.from_model(model, human, grid, T_world_human, classifier=stream)
