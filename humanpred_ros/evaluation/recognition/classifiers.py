"""What an evaluation of recognition can evaluate: all of `recognition`, and goal inference, which comes after it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TypeAlias

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.recognition.needs import LEARNS_CLASSES, LEARNS_FROM_OTHERS, Needs
from humanpred_ros.reaching.place_classifier import GoalClassifier
from humanpred_ros.reaching.place_model import GoalConfig
from humanpred_ros.recognition.classifier import IntentClassifier
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.recognition.registry import CLASSIFIERS, make_classifier

ClassifierConfig: TypeAlias = ForestConfig | GmmConfig | GoalConfig

#: Infers to which of the classes' places a reach goes.
REACHING = "reaching"
#: Names of what can be evaluated, and what they are; the default classifier first.
EVALUATED: Mapping[str, str] = MappingProxyType(
    {**CLASSIFIERS, REACHING: "P2's idea: to which of the classes' places would this be a good way?"}
)


def make_evaluated(name: str, config: ClassifierConfig | None = None) -> IntentClassifier:
    """Return a classifier by name, to be fitted, with its own kind of settings or the default ones.

    Raises:
        UsageError: unknown name, with the valid ones, or settings of another classifier.
    """
    if name not in EVALUATED:
        raise UsageError(f"classifier: wanted one of {', '.join(EVALUATED)}, got {name!r}")
    if name == REACHING:
        if config is not None and not isinstance(config, GoalConfig):
            raise UsageError(f"classifier {name}: wanted its own settings, got {type(config).__name__}")
        return GoalClassifier(config=config)
    if isinstance(config, GoalConfig):
        raise UsageError(f"classifier {name}: wanted its own settings, got {type(config).__name__}")
    return make_classifier(name, config)


def needs_of(name: str) -> Needs:
    """Return what a library must have for a classifier to be tested on motions left out of it."""
    return LEARNS_FROM_OTHERS if name == REACHING else LEARNS_CLASSES


def learned_of_class(name: str) -> str:
    """Return in words what a classifier knows of the class of the motion it is tested on."""
    return "its place only" if name == REACHING else "its motions"
