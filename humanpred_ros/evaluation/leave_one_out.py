"""Classifiers and predictors are tested on motions that they have not learned from: what that needs and how it is done.

One predictor is made for each motion left out; what is learned from the other motions is shared where it can be.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.forecast import ForecastPredictor
from humanpred_ros.occupancy.predictor import (
    Predictor,
    PredictorRequest,
    make_predictor,
    needed_classifiers,
    predictor_type,
)
from humanpred_ros.occupancy.swept_volume_predictor import SweptVolumePredictor, swept_volume
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.reaching.places import Places, ReachEnd, reach_ends, reaching_for
from humanpred_ros.reaching.reach_knowledge import ReachKnowledge
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.classifier import Classifier, classifier_type
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.gmm_classifier import GmmClassifier, GmmSettings
from humanpred_ros.recognition.training import classifier_settings, train_model


@dataclass(frozen=True)
class Needs:
    """What must be in a library for motions to be left out of it; every motion needs a class in any case.

    Attributes:
        n_classes, why_classes: the least number of classes, and what for.
        n_motions, why_motions: the least number of motions in every class, and what for.
    """

    n_classes: int
    why_classes: str
    n_motions: int
    why_motions: str

    def lacking(self, library: MotionLibrary) -> str | None:
        """Return what is missing, as the middle of a sentence; None if nothing is."""
        if len(library.labels) < self.n_classes:
            return f"at least {self.n_classes} classes {self.why_classes}, got {len(library.labels)}"
        counts = ((label, len(library.of_class(label))) for label in library.labels)
        few = next(((label, count) for label, count in counts if count < self.n_motions), None)
        if few is None:
            return None
        return f"at least {self.n_motions} motions in every class {self.why_motions}, class {few[0]} has {few[1]}"


#: For classifiers and predictors that learn the motions of all classes, the tested one's among them.
LEARNS_CLASSES = Needs(2, "to tell apart", 3, "to have two left to learn from when one is left out")
#: For those that learn from the other classes, and know the place of the tested motion's class.
LEARNS_FROM_OTHERS = Needs(
    2,
    "to learn from others than the tested motion's",
    2,
    "to take the class's place from when one is left out",
)


def check_needs(library: MotionLibrary, needs: Mapping[str, Needs | None], option: str) -> None:
    """Check that a library suffices for all entries that were asked for; those that can do without need None.

    Args:
        library: of which motions are left out.
        needs: by name of the entry.
        option: which takes the names, for the advice to leave some out.

    Raises:
        LibraryFormatError: names those that cannot be evaluated, what is missing, and the option that leaves them out.
    """
    learned = {name: need for name, need in needs.items() if need is not None}
    unlabelled = [motion.name for motion in library if motion.label is None]
    lacking: dict[str, list[str]] = {}
    for name, need in learned.items():
        if unlabelled:
            found: str | None = f"a class for every motion, {unlabelled[0]} and {len(unlabelled) - 1} more have none"
        else:
            found = need.lacking(library)
        if found is not None:
            lacking.setdefault(found, []).append(name)
    if not lacking:
        return
    refused = {name for names in lacking.values() for name in names}
    wanted = "; ".join(f"for {' and '.join(names)} {found}" for found, names in lacking.items())
    if unlabelled:
        remedy = "label them or leave them out"
    elif any(len(library.labels) < learned[name].n_classes for name in refused):
        remedy = "record more"
    else:
        remedy = "record more or leave the class out"
    others = [name for name in needs if name not in refused]
    if others:
        remedy += f", or evaluate only the others: {option} {','.join(others)}"
    raise LibraryFormatError(f"library {library.name}: wanted {wanted}; {remedy}")


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
    gmm: GmmSettings = field(default_factory=GmmSettings)
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
    def without(self, name: str) -> Predictor:
        """Return the predictor trained without the motion `name` (`class/index`); raises what training raises."""


class Untrained(LeaveOneOut):
    """For predictors that learn nothing: always the same one, started anew."""

    learned_from_class = "–"

    def __init__(self, settings: FoldSettings, predictor: str) -> None:
        super().__init__(settings, predictor)
        self._predictor = make_predictor(
            predictor, PredictorRequest(settings.human, settings.grid, settings.T_world_human)
        )

    def without(self, name: str) -> Predictor:
        """Return the predictor."""
        self._predictor.start()
        return self._predictor


class TrainedAnew(LeaveOneOut):
    """For any predictor: trains a model on the rest of the library, which takes as long as that takes."""

    def __init__(self, settings: FoldSettings, predictor: str) -> None:
        super().__init__(settings, predictor)
        self._name = predictor

    def without(self, name: str) -> Predictor:
        """Return a predictor whose model never saw the motion."""
        s = self.settings
        rest = s.library.select(lambda motion: motion.name != name)
        classifier = DEFAULT_CLASSIFIER if self._name == "forecast" else s.classifier
        names = needed_classifiers(self._name, classifier)
        settings = {name: s.gmm if name == "gmm" else classifier_settings(name, s.gmm.seed) for name in names}
        model = train_model(rest, s.human, settings)
        request = PredictorRequest(s.human, s.grid, s.T_world_human, model, classifier)
        return make_predictor(self._name, request)


class SweptVolumes(LeaveOneOut):
    """For P1's predictor: only the left-out motion's class is learned, regressed and swept anew."""

    def __init__(self, settings: FoldSettings, predictor: str = "swept_volume") -> None:
        super().__init__(settings, predictor)
        self._voxeliser = BodyVoxeliser(settings.human, settings.grid, settings.T_world_human)

    def without(self, name: str) -> SweptVolumePredictor:
        """Return P1's predictor as if trained without the motion."""
        s = self.settings
        if all(motion.name != name for motion in s.library):
            return SweptVolumePredictor(self._fitted.fresh(), self._swept_by_all, s.grid)
        label = s.library.find(name).label
        if label is None:
            raise LibraryFormatError(f"leaving out {name}: wanted a motion of some class, this one has none")
        classifier = fitted_without(self._fitted, s.library, name)
        gmm = classifier if self._gmm is self._fitted else self._gmm.fit_without(s.library, name)
        assert isinstance(gmm, GmmClassifier)
        anew = swept_volume(self._voxeliser, gmm.expected_q[s.library.labels.index(label)])
        return SweptVolumePredictor(classifier, {**self._swept_by_all, label: anew}, s.grid)

    @cached_property
    def _fitted(self) -> Classifier:
        s = self.settings
        kind = classifier_type(s.classifier)
        return kind(s.human, s.gmm if s.classifier == "gmm" else None).fit(s.library)

    @cached_property
    def _gmm(self) -> GmmClassifier:
        """P1's classifier of the whole library with the phase, from which its expected motions follow."""
        if isinstance(self._fitted, GmmClassifier) and self._fitted.settings.phase_feature:
            return self._fitted
        with_phase = self.settings.gmm.replaced(phase_feature=True)
        return GmmClassifier(self.settings.human, with_phase).fit(self.settings.library)

    @cached_property
    def _swept_by_all(self) -> dict[int, NDArray[np.bool_]]:
        motions = zip(self.settings.library.labels, self._gmm.expected_q, strict=True)
        return {label: swept_volume(self._voxeliser, q) for label, q in motions}


class Forecasts(LeaveOneOut):
    """For the default predictor: only trees that learned from the left-out motion are grown anew."""

    def __init__(self, settings: FoldSettings, predictor: str = "forecast") -> None:
        super().__init__(settings, predictor)

    def without(self, name: str) -> ForecastPredictor:
        """Return the forecast as if trained without the motion."""
        s = self.settings
        known = any(motion.name == name for motion in s.library)
        forest = self._fitted.fit_without(s.library, name) if known else self._fitted.fresh()
        return ForecastPredictor(forest, s.grid, s.T_world_human)

    @cached_property
    def _fitted(self) -> ForestClassifier:
        settings = ForestSettings(seed=self.settings.gmm.seed)
        return ForestClassifier(self.settings.human, settings).fit(self.settings.library)


class UnseenClass(LeaveOneOut):
    """For the predictor that is given places: learns from no motion of the left-out one's class.

    The class's place is among those given, as a scene would state it: where the other motions of the class end. Places
    are where the tested people are (`FoldSettings.T_shift`), since they are given, not learned.
    """

    learned_from_class = "no"

    def __init__(self, settings: FoldSettings, predictor: str = "reaching") -> None:
        super().__init__(settings, predictor)
        self._knowledge: dict[str, ReachKnowledge] = {}

    def without(self, name: str) -> ReachingPredictor:
        """Return the predictor as if no reach to that motion's place had been recorded."""
        s = self.settings
        label = _class_of(name)
        if label not in self._knowledge:
            left_out = {end.label for end in self._ends if _class_of(end.name) == label and end.label is not None}
            strayed = reaching_for(self._ends, left_out)
            others = s.library.select(lambda motion: motion.name not in strayed)
            self._knowledge[label] = ReachKnowledge.of_library(others, s.human)
        # The left-out motion is not counted in the place of its class.
        places = Places.of_ends(self._ends, without_motion=name).moved(s.T_shift).by_label
        return ReachingPredictor(self._knowledge[label], s.grid, s.T_world_human, places)

    @cached_property
    def _ends(self) -> tuple[ReachEnd, ...]:
        return reach_ends(self.settings.library, self.settings.human)


def fitted_without(whole: Classifier, library: MotionLibrary, name: str) -> Classifier:
    """Return a classifier like one that was fitted to the whole library, fitted without one of its motions.

    Classifiers that can do so more quickly than by learning everything again have a method `fit_without`.
    """
    shortcut = getattr(whole, "fit_without", None)
    if shortcut is not None:
        without: Classifier = shortcut(library, name)
        return without
    return type(whole)(whole.human, whole.settings).fit(library.select(lambda motion: motion.name != name))


#: How predictors are trained without one motion, where there is something to share between the trainings.
SHARED: Mapping[str, type[LeaveOneOut]] = MappingProxyType(
    {"swept_volume": SweptVolumes, "forecast": Forecasts, "reaching": UnseenClass}
)


def leave_one_out(predictor: str, settings: FoldSettings) -> LeaveOneOut:
    """Return what makes the predictors of an evaluation.

    Args:
        predictor: its name.
        settings: library, human, grid and classifier.

    Raises:
        UsageError: an unknown predictor or classifier.
    """
    return _kind(predictor)(settings, predictor)


def learned_from_class(predictor: str) -> str:
    """Return whether a predictor of an evaluation has learned from the left-out motion's class: yes, no or –."""
    return _kind(predictor).learned_from_class


def _kind(predictor: str) -> type[LeaveOneOut]:
    return SHARED.get(predictor, TrainedAnew) if predictor_type(predictor).needs_model else Untrained


def _class_of(name: str) -> str:
    """Return the class in a motion's name, `class/index`; a motion that nobody learns from is in no library."""
    return name.rpartition("/")[0]
