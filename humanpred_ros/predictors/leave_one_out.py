"""A predictor is judged on motions it has not learned from; this makes one per motion left out, and shares the rest."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.occupancy.forecast import ForecastPredictor
from humanpred_ros.occupancy.p1 import SweptVolumePredictor
from humanpred_ros.occupancy.predictor import OccupancyPredictor
from humanpred_ros.occupancy.swept_volume import swept_volume
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.predictors.factory import make_predictor, needs_model
from humanpred_ros.predictors.folds import FoldSettings, LeaveOneOut
from humanpred_ros.predictors.unseen_class import UnseenClass
from humanpred_ros.recognition.class_mixtures import ClassMixtures, fit_class_mixtures, refit_class_mixtures
from humanpred_ros.recognition.classifier import DEFAULT_CLASSIFIER, IntentClassifier
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_classifier import GmmClassifier
from humanpred_ros.recognition.mixture import GaussianMixture
from humanpred_ros.recognition.registry import make_classifier
from humanpred_ros.recognition.regression import regress
from humanpred_ros.recognition.training import train_model


class Untrained(LeaveOneOut):
    """For predictors that learn nothing: always the same one, started anew."""

    learned_from_class = "–"

    def __init__(self, settings: FoldSettings, predictor: str) -> None:
        super().__init__(settings, predictor)
        self._predictor = make_predictor(predictor, None, settings.human, settings.grid, settings.T_world_human)

    def without(self, name: str) -> OccupancyPredictor:
        """Return the predictor."""
        self._predictor.start()
        return self._predictor


class TrainedAnew(LeaveOneOut):
    """For any predictor: trains a model on the rest of the library, which takes as long as that takes."""

    def __init__(self, settings: FoldSettings, predictor: str) -> None:
        super().__init__(settings, predictor)
        self._name = predictor

    def without(self, name: str) -> OccupancyPredictor:
        """Return a predictor whose model never saw the motion."""
        s = self.settings
        rest = s.library.select(lambda motion: motion.name != name)
        model = train_model(rest, s.human, s.gmm)
        classifier = DEFAULT_CLASSIFIER if self._name == "forecast" else s.classifier
        return make_predictor(self._name, model, s.human, s.grid, s.T_world_human, classifier=classifier)


class SweptVolumes(LeaveOneOut):
    """For P1's predictor: only the left-out motion's class is learned, regressed and swept anew."""

    def __init__(self, settings: FoldSettings, predictor: str = "swept_volume") -> None:
        super().__init__(settings, predictor)
        self._voxeliser = BodyVoxeliser(settings.human, settings.grid, settings.T_world_human)
        self._phase = np.arange(settings.gmm.n_phase_frames, dtype=np.float64)

    def without(self, name: str) -> SweptVolumePredictor:
        """Return P1's predictor as if trained without the motion."""
        s = self.settings
        if all(motion.name != name for motion in s.library):
            # A copy: what a classifier remembers of one person's place must not reach the next motion.
            return SweptVolumePredictor(copy.deepcopy(self._fitted), self._swept_by_all, s.grid)
        label = s.library.find(name).label
        if label is None:
            raise LibraryFormatError(f"leaving out {name}: wanted a motion of some class, this one has none")
        classifier = self._fitted.fit_without(s.library, name)
        classes = _with_phase(classifier)
        if classes is None:
            rest = s.library.select(lambda motion: motion.name != name)
            classes = refit_class_mixtures(self._joint, rest, label, s.gmm.with_phase())
        anew = self._swept(classes.mixtures[classes.labels.index(label)])
        return SweptVolumePredictor(classifier, {**self._swept_by_all, label: anew}, s.grid)

    @cached_property
    def _fitted(self) -> IntentClassifier:
        s = self.settings
        classifier = make_classifier(s.classifier, s.gmm) if s.classifier == "gmm" else make_classifier(s.classifier)
        return classifier.fit(s.library)

    @cached_property
    def _joint(self) -> ClassMixtures:
        """Mixtures over phase and posture of the whole library, from which its expected motions follow."""
        learned = _with_phase(self._fitted)
        return learned or fit_class_mixtures(self.settings.library, self.settings.gmm.with_phase())

    @cached_property
    def _swept_by_all(self) -> dict[int, NDArray[np.bool_]]:
        joint = self._joint
        return {label: self._swept(mixture) for label, mixture in zip(joint.labels, joint.mixtures, strict=True)}

    def _swept(self, mixture: GaussianMixture) -> NDArray[np.bool_]:
        return swept_volume(self._voxeliser, regress(mixture, self._phase).mean)


class Forecasts(LeaveOneOut):
    """For the default predictor: only trees that learned from the left-out motion are grown anew."""

    def __init__(self, settings: FoldSettings, predictor: str = "forecast") -> None:
        super().__init__(settings, predictor)

    def without(self, name: str) -> ForecastPredictor:
        """Return the forecast as if trained without the motion."""
        s = self.settings
        if all(motion.name != name for motion in s.library):
            forest = ForestClassifier(human=s.human, model=self._fitted.model)
        else:
            forest = self._fitted.fit_without(s.library, name)
        return ForecastPredictor(forest, s.grid, s.T_world_human)

    @cached_property
    def _fitted(self) -> ForestClassifier:
        config = ForestConfig(seed=self.settings.gmm.seed)
        return ForestClassifier(config, self.settings.human).fit(self.settings.library)


def _with_phase(classifier: IntentClassifier) -> ClassMixtures | None:
    """Return what a classifier learned, if motions can be regressed from it."""
    classes = classifier.classes if isinstance(classifier, GmmClassifier) else None
    return classes if classes is not None and classes.has_phase else None


#: How predictors are trained without one motion, where there is something to share between the trainings.
SHARED: Mapping[str, type[LeaveOneOut]] = MappingProxyType(
    {"swept_volume": SweptVolumes, "forecast": Forecasts, "reaching": UnseenClass}
)


def leave_one_out(predictor: str, settings: FoldSettings) -> LeaveOneOut:
    """Return what makes the predictors of an evaluation.

    Args:
        predictor: a name of `factory.PREDICTORS`.
        settings: library, human, grid and classifier.

    Raises:
        UsageError: an unknown predictor or classifier.
    """
    return _kind(predictor)(settings, predictor)


def learned_from_class(predictor: str) -> str:
    """Return whether a predictor of an evaluation has learned from the left-out motion's class: yes, no or –."""
    return _kind(predictor).learned_from_class


def _kind(predictor: str) -> type[LeaveOneOut]:
    return SHARED.get(predictor, TrainedAnew) if needs_model(predictor) else Untrained
