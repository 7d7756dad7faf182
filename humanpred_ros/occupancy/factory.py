"""Predictors are chosen by name, in a node's parameter or on the command line."""

from __future__ import annotations

from numpy.typing import ArrayLike

from humanpred_ros.errors import UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.constant_velocity import ConstantVelocityPredictor
from humanpred_ros.occupancy.current import CurrentOccupancyPredictor
from humanpred_ros.occupancy.grid import VoxelGrid
from humanpred_ros.occupancy.p1 import SweptVolumePredictor
from humanpred_ros.occupancy.predictor import OccupancyPredictor
from humanpred_ros.recognition.registry import trained_classifier
from humanpred_ros.recognition.training import TrainedModel

#: Names users know the predictors by, and what they predict.
PREDICTORS = {
    "swept_volume": "P1: posterior of the classes times the volumes they sweep",
    "current": "baseline: the body where it is now",
    "current_accumulated": "baseline: everywhere the body was since the motion began (published code of P1)",
    "constant_velocity": "baseline: the body where it is, and where it gets to if it goes on as it moves now",
}


def needs_model(name: str) -> bool:
    """Return whether a predictor learns from a motion library; the baselines do not."""
    return name == "swept_volume"


def make_predictor(
    name: str,
    model: TrainedModel | None,
    human: HumanModel,
    grid: VoxelGrid,
    T_world_human: ArrayLike,
    *,
    classifier: str = "gmm",
    **online: object,
) -> OccupancyPredictor:
    """Return a predictor by name.

    Args:
        name: one of `PREDICTORS`.
        model: what was learned; the baselines need none.
        human: whose body occupies.
        grid: the lattice, world frame.
        T_world_human: (4, 4) from the tracker's frame to the world.
        classifier: name of the classifier that recognises the class.
        online: settings of the classifier that differ from the model's (`GmmConfig`, those free to change).

    Raises:
        UsageError: unknown name, no model where one is needed, or a model for another human.
        ArrayError: a placement that is not a rigid transform.
    """
    if name == "swept_volume":
        if model is None:
            raise UsageError("predictor swept_volume: wanted a trained model, got none; train one first")
        recogniser = trained_classifier(classifier, model, human, **online)
        return SweptVolumePredictor.from_model(model, human, grid, T_world_human, classifier=recogniser)
    if name == "constant_velocity":
        return ConstantVelocityPredictor(human, grid, T_world_human)
    if name in ("current", "current_accumulated"):
        return CurrentOccupancyPredictor(human, grid, T_world_human, accumulate=name == "current_accumulated")
    raise UsageError(f"predictor: wanted one of {', '.join(PREDICTORS)}, got {name!r}")
