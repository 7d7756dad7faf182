"""The default classifier: a calibrated forest over features of the reach, which knows what it has not learned."""

from __future__ import annotations

import math

import numpy as np

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.forest import IntArray, add_resemblance
from humanpred_ros.recognition.forest_config import ForestSettings
from humanpred_ros.recognition.forest_model import PELVIS, ForestModel, fit_forest, refit_without
from humanpred_ros.recognition.reach_features import (
    FAR,
    HEADINGS,
    N_FEATURES,
    REACHED,
    Float32Array,
    ReachState,
    advance,
    in_library_frame,
    point_links,
)
from humanpred_ros.recognition.standing_place import PlaceTracker

__all__ = ["ForestClassifier", "ForestSettings"]


#: Columns that tell one moment of a reach from another: palm now, farthest point, headings over 15 and 30 cm; and
#: what a unit of each is worth in metres.
_MOMENT = np.array([*range(3), *range(FAR, FAR + 3), *range(HEADINGS + 6, HEADINGS + 12)])
_MOMENT_SCALE_M = np.repeat(np.array([1.0, 0.1], dtype=np.float32), 6)
_MOMENT_WIDTH_M = 0.05


class ForestClassifier(Classifier):
    """Calibrated trees over features of the reach that know no time, with a probability of no class.

    P(class | the reach so far) and P(no class | the reach so far).

    Each posture's features (`reach_features`), brought to where the library's people stood (`standing_place`), fall
    through randomised trees (`forest`); what these vote is made a probability (`calibration`); and their distance from
    the library says how probable it is that the reach is of no class at all (`novelty`). Stamps are checked, not
    used: the same postures at another speed get the same answers.

    Attributes:
        model: what was learned, None before `fit`.
    """

    settings_type = ForestSettings
    settings: ForestSettings

    def __init__(
        self, human: HumanModel, settings: ForestSettings | None = None, model: ForestModel | None = None
    ) -> None:
        """Make a classifier to fit, or, with `model`, one that is ready for use.

        Raises:
            HumanModelError: a human without the links that are followed.
        """
        super().__init__(human, model.config if settings is None and model is not None else settings)
        self.model: ForestModel | None = None
        self._links = point_links(self.human)
        self._pelvis = self.human.link_names.index(PELVIS)
        if model is not None:
            self._take(model)

    def fit(self, library: MotionLibrary) -> ForestClassifier:
        """Learn; return self. Raises LibraryFormatError if the library does not suffice."""
        self._take(fit_forest(library, self.human, self.settings))
        return self

    def fit_without(self, library: MotionLibrary, name: str) -> ForestClassifier:
        """Return a classifier learned without one motion; only trees that had seen it are grown anew."""
        return ForestClassifier(self.human, self.settings, refit_without(self._fitted(), name))

    def start(self) -> None:
        """Forget the reach that was observed; where the person stands is remembered."""
        self._state = ReachState.fresh()
        self._last_s = -math.inf
        self._leaves: IntArray | None = None
        self._place.start()

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` and return the posterior over the classes, and of no class.

        Raises:
            ArrayError: posture of the wrong shape or not finite.
            MotionError: a stamp that is not finite or not later than the one before.
            UsageError: nothing was learned yet.
        """
        model = self._fitted()
        q = checked("posture", q, (len(self.human.dof_names),))
        if not math.isfinite(t_s) or t_s <= self._last_s:
            later = "" if self._last_s == -math.inf else f" later than {self._last_s} s"
            raise MotionError(
                f"classifier: wanted a finite stamp{later}, got {t_s} s; call start() when a new motion begins"
            )
        poses = self.human.link_poses(q)
        self._last_s = t_s
        self._place.update(poses[self._pelvis])
        advance(self._state, np.ascontiguousarray(poses[self._links][:, :3, 3]), self._features[0])
        self._x = in_library_frame(self._features, self._place.R, self._place.p)
        self._leaves = model.forest.leaves(self._x)
        votes = model.forest.vote(self._leaves)
        given_known = model.calibration(votes, self._x[:, REACHED].astype(np.float64))[0]
        log_odds = float(model.novelty.log_ratio(self._x)[0]) + self._prior_log_odds
        # Never quite sure of it, so that the classes' shares stay defined.
        unknown = 1.0 / (1.0 + math.exp(-min(max(log_odds, -20.0), 20.0)))
        self._given_known = given_known = given_known / given_known.sum()
        return ClassPosterior(
            model.labels,
            given_known * (1.0 - unknown),
            np.log(given_known),
            t_s,
            int(self._state.n_seen[0]),
            unknown,
        )

    def exemplar_weights(self) -> FloatArray:
        """Return (M,) how much each of the model's exemplar postures resembles the present moment of the reach.

        Two postures resemble each other as often as they end in the same leaf (Meinshausen 2006), and the more the
        nearer palm, farthest point and heading are: a leaf that is sure of the class cares no more for the moment.
        Within a class the weights are scaled to the class's probability, given that the reach is of some class. What
        follows the exemplars in their motions thus is a sample of what follows now. Their sum falls short of 1 by
        the probability of classes no exemplar of which shares a leaf with the present moment.

        Raises:
            UsageError: nothing was observed since `start`.
        """
        model = self._fitted()
        if self._leaves is None:
            raise UsageError("classifier: wanted a posture observed first, got none since start; call update")
        weight = np.zeros(len(model.exemplars.q))
        add_resemblance(self._leaves[0], *model.leaf_members, weight)
        similar = np.flatnonzero(weight)
        difference = _moment(model.exemplars.features[similar]) - _moment(self._x)
        square = (difference**2).sum(axis=1)
        # As wide as the twentieth nearest, so that there always are some.
        width = max(_MOMENT_WIDTH_M**2, np.partition(square, min(20, len(square)) - 1)[min(20, len(square)) - 1])
        weight[similar] *= np.exp(-0.5 * square / width)
        of_class = model.exemplars.label[model.exemplars.motion]
        total = np.bincount(of_class, weight, minlength=len(model.labels))
        scaled: FloatArray = weight * (self._given_known / np.where(total > 0, total, 1.0))[of_class]
        return scaled

    @property
    def elsewhere(self) -> bool:
        """Whether the person does not stand where the library was recorded, so that postures are moved there."""
        return self._place.elsewhere

    @property
    def alignment(self) -> FloatArray:
        """(4, 4) T_library_tracker: brings this person to where the people of the library stand."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self._place.R, self._place.p
        return T

    def _take(self, model: ForestModel) -> None:
        self.model = model
        self._place = PlaceTracker(model.place)
        self._features = np.zeros((1, N_FEATURES))
        self._x = self._features.astype(np.float32)
        prior = model.config.unknown_prior
        self._prior_log_odds = math.log(prior / (1.0 - prior))
        self.start()

    def _fitted(self) -> ForestModel:
        if self.model is None:
            raise UsageError("classifier: wanted one that has learned, got a new one; call fit(library) first")
        return self.model


def _moment(features: Float32Array) -> Float32Array:
    scaled: Float32Array = features[:, _MOMENT] * _MOMENT_SCALE_M
    return scaled
