"""Classifiers and predictors are tested on motions they have not learned from: what that takes and how it is done.

What is learned from the other motions is shared between the tests where it can be. A motion is shown posture by
posture, as a sensor would deliver it (`answers`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanPredError, LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, resample
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
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor, ReachKnowledge
from humanpred_ros.recognition.classifier import Classifier, classifier_type
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.gmm_classifier import GmmClassifier, GmmSettings
from humanpred_ros.recognition.training import classifier_settings, train_model


@dataclass
class UpdateLog:
    """What happened while motions were shown: how long each update took, and how many postures were refused."""

    update_ns: list[int] = field(default_factory=list)
    refused: int = 0


def answers(algorithm: Classifier | Predictor, q: FloatArray, t_s: FloatArray, log: UpdateLog) -> Iterator[Any]:
    """Show a motion to a classifier or predictor; give what it said last after each posture.

    Args:
        algorithm: is started anew; it learns neither how long the motion is nor what it is.
        q: (T, D) postures.
        t_s: (T,) their stamps.
        log: receives times and refusals; a refused posture leaves the answer as it was.

    Yields:
        ClassPosterior | Prediction | None: None until the first posture that it accepts.
    """
    algorithm.start()
    last = None
    for posture, stamp_s in zip(q, t_s.tolist(), strict=True):
        begun = time.perf_counter_ns()
        try:
            last = algorithm.update(posture, stamp_s)
        except HumanPredError:
            log.refused += 1
        log.update_ns.append(time.perf_counter_ns() - begun)
        yield last


def at_speed(motion: Motion, speed: float) -> Motion:
    """Return the motion as a sensor of the same period would see it, done `speed` times as fast.

    Postures between frames are interpolated linearly, which takes some of the tracker's noise away.

    Raises:
        MotionError: so fast that fewer than two postures are left.
    """
    step_s = speed * motion.period_s
    # Stamps are rounded to nanoseconds: a step that ends this little after the last frame ends on it.
    n = int((motion.duration_s + 1e-9 * len(motion)) / step_s) + 1
    stamps = np.minimum(motion.t_s[0] + step_s * np.arange(n), motion.t_s[-1])
    seen = resample(motion, t_s=stamps)
    return Motion(
        motion.period_s * np.arange(n, dtype=np.float64), seen.q, seen.dof_names, seen.label, seen.index, seen.frame_id
    )


class Needs(NamedTuple):
    """What must be in a library for motions to be left out of it; every motion needs a class in any case."""

    n_classes: int  #: the least number of classes, and what for
    why_classes: str
    n_motions: int  #: the least number of motions in every class, and what for
    why_motions: str

    def lacking(self, library: MotionLibrary) -> str | None:
        """Return what is missing, as the middle of a sentence; None if nothing is."""
        unlabelled = [motion.name for motion in library if motion.label is None]
        if unlabelled:
            return f"a class for every motion, {unlabelled[0]} and {len(unlabelled) - 1} more have none"
        if len(library.labels) < self.n_classes:
            return f"at least {self.n_classes} classes {self.why_classes}, got {len(library.labels)}"
        for label in library.labels:
            count = len(library.of_class(label))
            if count < self.n_motions:
                return f"at least {self.n_motions} motions in every class {self.why_motions}, class {label} has {count}"
        return None


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
    found = {name: need.lacking(library) for name, need in needs.items() if need is not None}
    refused = [name for name, lacking in found.items() if lacking is not None]
    if not refused:
        return
    reasons = {found[name]: [other for other in refused if found[other] == found[name]] for name in refused}
    wanted = "; ".join(f"for {' and '.join(names)} {lacking}" for lacking, names in reasons.items())
    if any(motion.label is None for motion in library):
        remedy = "label them or leave them out"
    elif any(need is not None and len(library.labels) < need.n_classes for need in map(needs.get, refused)):
        remedy = "record more"
    else:
        remedy = "record more or leave the class out"
    others = [name for name in needs if name not in refused]
    if others:
        remedy += f", or evaluate only the others: {option} {','.join(others)}"
    raise LibraryFormatError(f"library {library.name}: wanted {wanted}; {remedy}")


def fitted_without(whole: Classifier, library: MotionLibrary, name: str) -> Classifier:
    """Return a classifier like one that was fitted to the whole library, fitted without one of its motions.

    Classifiers that can do so more quickly than by learning everything again have a method `fit_without`.
    """
    shortcut = getattr(whole, "fit_without", None)
    if shortcut is not None:
        without: Classifier = shortcut(library, name)
        return without
    return type(whole)(whole.human, whole.settings).fit(library.select(lambda motion: motion.name != name))


def learned_from_class(predictor: str) -> str:
    """Return whether a predictor of an evaluation has learned from the left-out motion's class: yes, no or –."""
    if not predictor_type(predictor).needs_model:
        return "–"
    return "no" if predictor == "reaching" else "yes"


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """Makes predictors of one kind, each as if trained on the library without one of its motions.

    Baselines learn nothing. Of `swept_volume` only the left-out motion's class is learned, regressed and swept anew; of
    `forecast` only the trees that learned from the motion are grown anew. `reaching` learns from no motion of the
    left-out one's class. The class's place is among those it is given, as a scene would state it: where the other
    motions of the class end. All other predictors are trained anew, which takes as long as that takes.
    """

    predictor: str  #: its name
    library: MotionLibrary  #: of which one motion at a time is left out; a motion that is not in it need not be
    human: HumanModel  #: whose body occupies
    grid: VoxelGrid  #: the lattice, world frame
    T_world_human: FloatArray  #: (4, 4) from the library's frame to the world
    classifier: str = "gmm"  #: name of the classifier that recognises the class
    #: settings of P1's mixtures; also those that its swept volumes are regressed from
    gmm: GmmSettings = field(default_factory=GmmSettings)
    #: (4, 4) how the tested people are moved in the library's frame. Only given places move with them; what was learned
    #: stays where it was.
    T_shift: FloatArray = field(default_factory=lambda: np.eye(4))
    shared: bool = True  #: False trains everything anew for each motion

    def without(self, name: str) -> Predictor:
        """Return the predictor trained without the motion `name` (`class/index`); raises what training raises."""
        if not predictor_type(self.predictor).needs_model:
            return make_predictor(self.predictor, PredictorRequest(self.human, self.grid, self.T_world_human))
        ways = {"swept_volume": self._swept_volume, "forecast": self._forecast, "reaching": self._reaching}
        return ways.get(self.predictor, self._trained_anew)(name) if self.shared else self._trained_anew(name)

    def _trained_anew(self, name: str) -> Predictor:
        rest = self.library.select(lambda motion: motion.name != name)
        classifier = DEFAULT_CLASSIFIER if self.predictor == "forecast" else self.classifier
        names = needed_classifiers(self.predictor, classifier)
        settings = {name: self.gmm if name == "gmm" else classifier_settings(name, self.gmm.seed) for name in names}
        model = train_model(rest, self.human, settings)
        request = PredictorRequest(self.human, self.grid, self.T_world_human, model, classifier)
        return make_predictor(self.predictor, request)

    def _forecast(self, name: str) -> ForecastPredictor:
        known = any(motion.name == name for motion in self.library)
        forest = self._forest.fit_without(self.library, name) if known else self._forest.fresh()
        return ForecastPredictor(forest, self.grid, self.T_world_human)

    @cached_property
    def _forest(self) -> ForestClassifier:
        return ForestClassifier(self.human, ForestSettings(seed=self.gmm.seed)).fit(self.library)

    def _swept_volume(self, name: str) -> SweptVolumePredictor:
        if all(motion.name != name for motion in self.library):
            return SweptVolumePredictor(self._fitted.fresh(), self._swept_by_all, self.grid)
        label = self.library.find(name).label
        if label is None:
            raise LibraryFormatError(f"leaving out {name}: wanted a motion of some class, this one has none")
        classifier = fitted_without(self._fitted, self.library, name)
        gmm = classifier if self._gmm is self._fitted else self._gmm.fit_without(self.library, name)
        assert isinstance(gmm, GmmClassifier)
        anew = swept_volume(self._voxeliser, gmm.expected_q[self.library.labels.index(label)])
        return SweptVolumePredictor(classifier, {**self._swept_by_all, label: anew}, self.grid)

    @cached_property
    def _voxeliser(self) -> BodyVoxeliser:
        return BodyVoxeliser(self.human, self.grid, self.T_world_human)

    @cached_property
    def _fitted(self) -> Classifier:
        kind = classifier_type(self.classifier)
        return kind(self.human, self.gmm if self.classifier == "gmm" else None).fit(self.library)

    @cached_property
    def _gmm(self) -> GmmClassifier:
        """P1's classifier of the whole library with the phase, from which its expected motions follow."""
        if isinstance(self._fitted, GmmClassifier) and self._fitted.settings.phase_feature:
            return self._fitted
        return GmmClassifier(self.human, self.gmm.replaced(phase_feature=True)).fit(self.library)

    @cached_property
    def _swept_by_all(self) -> dict[str, NDArray[np.bool_]]:
        motions = zip(self.library.labels, self._gmm.expected_q, strict=True)
        return {label: swept_volume(self._voxeliser, q) for label, q in motions}

    def _reaching(self, name: str) -> ReachingPredictor:
        label = _class_of(name)
        if label not in self._knowledge:
            left_out = {end.label for end in self._ends if _class_of(end.name) == label and end.label is not None}
            strayed = reaching_for(self._ends, left_out)
            others = self.library.select(lambda motion: motion.name not in strayed)
            self._knowledge[label] = ReachKnowledge.of_library(others, self.human)
        # The left-out motion is not counted in the place of its class.
        places = Places.of_ends(self._ends, without_motion=name).moved(self.T_shift).by_label
        return ReachingPredictor(self._knowledge[label], self.grid, self.T_world_human, places)

    @cached_property
    def _knowledge(self) -> dict[str, ReachKnowledge]:
        """What was learned without each class, by the class."""
        return {}

    @cached_property
    def _ends(self) -> tuple[ReachEnd, ...]:
        return reach_ends(self.library, self.human)


def _class_of(name: str) -> str:
    """Return the class in a motion's name, `class/index`; a motion that nothing is learned from is in no library."""
    return name.rpartition("/")[0]
