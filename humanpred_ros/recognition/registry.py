"""Classifiers are chosen by name, in a node's parameter or on the command line."""

from __future__ import annotations

from humanpred_ros.errors import UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.recognition.classifier import IntentClassifier
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_classifier import GmmClassifier
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.recognition.training import TrainedModel

#: Names users know the classifiers by; the default first.
CLASSIFIERS = {
    "forest": "calibrated trees over features of the reach that know no time, with a probability of no class",
    "gmm": "P1: a Gaussian mixture per class over phase and posture",
}


def make_classifier(name: str, config: ForestConfig | GmmConfig | None = None) -> IntentClassifier:
    """Return a classifier by name, to be fitted, with its own kind of settings or the default ones.

    Raises:
        UsageError: unknown name, with the valid ones, or settings of another classifier.
    """
    _check(name)
    if name == "forest" and (config is None or isinstance(config, ForestConfig)):
        return ForestClassifier(config)
    if name == "gmm" and (config is None or isinstance(config, GmmConfig)):
        return GmmClassifier(config)
    raise UsageError(f"classifier {name}: wanted its own settings, got {type(config).__name__}")


def trained_classifier(name: str, model: TrainedModel, human: HumanModel, **online: object) -> IntentClassifier:
    """Return a classifier by name, ready for use, from a trained model.

    Args:
        name: one of `CLASSIFIERS`.
        model: what was learned.
        human: whose postures come.
        online: settings of `gmm` that differ from the model's (`GmmConfig`, those free to change).

    Raises:
        UsageError: unknown name, or a setting that a trained model cannot change.
    """
    _check(name)
    if name == "gmm":
        return model.gmm_classifier(**online)
    if online:
        raise UsageError(f"classifier {name}: wanted no settings, got {', '.join(online)}; they belong to gmm")
    return model.forest_classifier(human)


def _check(name: str) -> None:
    if name not in CLASSIFIERS:
        raise UsageError(f"classifier: wanted one of {', '.join(CLASSIFIERS)}, got {name!r}")
