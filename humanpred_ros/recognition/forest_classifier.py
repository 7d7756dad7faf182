"""The default classifier: a calibrated forest over features of the reach, which knows what it has not learned."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.recognition.calibration import COLUMNS, Calibration, Novelty
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior, check_trainable
from humanpred_ros.recognition.forest import (
    PELVIS,
    Exemplars,
    Forest,
    ForestSettings,
    IntArray,
    Tree,
    add_resemblance,
    grow_tree,
)
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
from humanpred_ros.recognition.standing_place import PlaceTracker, StandingPlace
from humanpred_ros.settings import Settings

#: Columns that tell one moment of a reach from another: palm now, farthest point, headings over 15 and 30 cm; and
#: what a unit of each is worth in metres.
_MOMENT = np.array([*range(3), *range(FAR, FAR + 3), *range(HEADINGS + 6, HEADINGS + 12)])
_MOMENT_SCALE_M = np.repeat(np.array([1.0, 0.1], dtype=np.float32), 6)
_MOMENT_WIDTH_M = 0.05
#: Neighbouring postures say the same, and calibration has five parameters: every fourth one is enough.
_CALIBRATED_ON = slice(None, None, 4)
_EXEMPLARS = ("label", "first", "q", "features", "start_pose", "duration_s")


def drawn_motions(names: tuple[str, ...], settings: ForestSettings) -> NDArray[np.bool_]:
    """Return (K, B) which motions each tree learns from; whether a motion is drawn depends on no other motion."""
    chance = [np.random.default_rng([settings.seed, *name.encode()]).random(settings.n_trees) for name in names]
    drawn: NDArray[np.bool_] = np.array(chance) < settings.motion_share
    drawn[:, ~drawn.any(axis=0)] = True  # of very few motions none may be drawn; better then to learn from all
    return drawn


@dataclass(frozen=True, eq=False)
class ForestModel:
    """What the classifier has learned: immutable."""

    labels: tuple[str, ...]  #: C class labels
    exemplars: Exemplars  #: the postures it learned from
    forest: Forest  #: the trees, with their votes
    calibration: Calibration  #: from votes to probabilities
    novelty: Novelty  #: from distances to the probability of no class
    place: StandingPlace  #: where the library's people stand

    @classmethod
    def learned(
        cls,
        labels: tuple[str, ...],
        exemplars: Exemplars,
        settings: ForestSettings,
        known: Sequence[Tree | None] = (),
    ) -> ForestModel:
        """Grow the trees that are not known yet, and learn the rest; the same arguments give the same model."""
        drawn, of_class = drawn_motions(exemplars.names, settings), exemplars.label[exemplars.motion]
        trees = list(known) or [None] * settings.n_trees
        for b, tree in enumerate(trees):
            if tree is None:
                mine = drawn[exemplars.motion, b]
                x, label = exemplars.features[mine], of_class[mine]
                trees[b] = grow_tree(x, label, settings.seed + b, settings.min_samples_leaf)
        forest = _joined(labels, exemplars, [tree for tree in trees if tree is not None], settings)
        some = _CALIBRATED_ON
        votes = forest.vote(forest.sample_leaves[some], ~drawn[exemplars.motion][some])
        reached_m = exemplars.features[some, REACHED].astype(np.float64)
        return cls(
            labels,
            exemplars,
            forest,
            Calibration.fit(votes, reached_m, of_class[some]),
            Novelty.fit(exemplars.features, exemplars.first, exemplars.label),
            StandingPlace.of_starts(exemplars.start_pose),
        )

    def without(self, name: str, settings: ForestSettings) -> ForestModel:
        """Return the model learned without one motion: only trees that had learned from it are grown anew."""
        exemplars = self.exemplars.without(name)
        before, now = (drawn_motions(some.names, settings) for some in (self.exemplars, exemplars))
        k = self.exemplars.names.index(name)
        changed = before[k] | (np.delete(before, k, axis=0) != now).any(axis=0)
        kept = [None if changed[b] else self.forest.tree(b) for b in range(settings.n_trees)]
        return ForestModel.learned(self.labels, exemplars, settings, kept)


def _joined(labels: tuple[str, ...], exemplars: Exemplars, trees: Sequence[Tree], settings: ForestSettings) -> Forest:
    """Return the forest of trees grown on these exemplars. Raises ArrayError if their numbers do not fit."""
    if len(trees) != settings.n_trees or set(exemplars.label.tolist()) != set(range(len(labels))):
        raise ArrayError(
            f"forest: wanted {settings.n_trees} trees and exemplars of each of the {len(labels)} classes, "
            f"got {len(trees)} and those of classes {sorted(set(exemplars.label.tolist()))}"
        )
    learned = drawn_motions(exemplars.names, settings)[exemplars.motion]
    return Forest.of_trees(trees, exemplars.features, exemplars.label[exemplars.motion], learned, len(labels))


class ForestClassifier(Classifier):
    """Calibrated trees over features of the reach that know no time, with a probability of no class.

    P(class | the reach so far) and P(no class | the reach so far).

    Each posture's features (`reach_features`), brought to where the library's people stood (`standing_place`), fall
    through randomised trees (`forest`); what these vote is made a probability (`Calibration`); and their distance from
    the library says how probable it is that the reach is of no class at all (`Novelty`). Stamps are checked, not
    used: the same postures at another speed get the same answers.

    Attributes:
        model: what was learned, None before `fit`.
    """

    settings_type = ForestSettings
    settings: ForestSettings

    def __init__(self, human: HumanModel, settings: Settings | None = None) -> None:
        """Make one to be fitted. Raises HumanModelError for a human without the links that are followed."""
        super().__init__(human, settings)
        self.model: ForestModel | None = None
        self._links = point_links(human)
        self._pelvis = human.link_names.index(PELVIS)

    def fit(self, library: MotionLibrary) -> ForestClassifier:
        """Learn; return self; the same library, settings and seed give the same model.

        Raises:
            LibraryFormatError: motions without a label, one class only, a class of one motion, or one that does not
                move.
            HumanModelError: a library of other DoFs than the human's.
        """
        check_trainable(library)
        self.human.check_dofs(library.dof_names)
        exemplars = Exemplars.of_motions(library.motions, library.labels, self.human, self.settings.n_postures)
        return self._take(ForestModel.learned(library.labels, exemplars, self.settings))

    def fit_without(self, library: MotionLibrary, name: str) -> ForestClassifier:
        """Return a classifier learned without one motion; only trees that had seen it are grown anew."""
        return ForestClassifier(self.human, self.settings)._take(self._fitted().without(name, self.settings))

    def fresh(self, settings: Settings | None = None) -> ForestClassifier:
        return ForestClassifier(self.human, settings or self.settings)._take(self._fitted())

    def state(self) -> dict[str, NDArray[Any]]:
        model = self._fitted()
        return {
            "labels": np.array(model.labels),
            "motions": np.array(model.exemplars.names),
            **{name: getattr(model.exemplars, name) for name in _EXEMPLARS},
            "n_nodes": np.diff(model.forest.first),
            **{f"node_{name}": getattr(model.forest, name) for name in Tree._fields},
            "calibration": model.calibration.parameters,
            "novelty": model.novelty.weights,
            "place_pose": model.place.pose,
            "place_spread": model.place.spread,
        }

    @classmethod
    def from_state(cls, human: HumanModel, settings: Settings, state: Mapping[str, NDArray[Any]]) -> ForestClassifier:
        self = cls(human, settings)
        labels = tuple(str(label) for label in state["labels"])
        exemplars = Exemplars(
            tuple(str(name) for name in state["motions"]),
            state["label"].astype(np.intp),
            state["first"].astype(np.int64),
            checked("exemplars", state["q"], ("M", len(human.dof_names))),
            np.ascontiguousarray(state["features"], dtype=np.float32),
            state["start_pose"],
            state.get("duration_s", np.full(len(state["motions"]), np.nan)),  # a model of an older version has none
        )
        ends = np.cumsum(state["n_nodes"])[:-1]
        kinds = {"threshold": np.float64}
        parts = [np.split(state[f"node_{name}"].astype(kinds.get(name, np.int32)), ends) for name in Tree._fields]
        trees = [Tree(*tree) for tree in zip(*parts, strict=True)]
        points = np.ascontiguousarray(exemplars.features[:, COLUMNS])
        return self._take(
            ForestModel(
                labels,
                exemplars,
                _joined(labels, exemplars, trees, self.settings),
                Calibration(state["calibration"]),
                Novelty(points, exemplars.first, state["novelty"]),
                StandingPlace(state["place_pose"], state["place_spread"]),
            )
        )

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
        add_resemblance(self._leaves[0], *model.forest.leaf_members, weight)
        similar = np.flatnonzero(weight)
        if not len(similar):  # of a model from elsewhere: leaves that no exemplar falls into
            return weight
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

    def _take(self, model: ForestModel) -> ForestClassifier:
        self.model = model
        self._place = PlaceTracker(model.place)
        self._features = np.zeros((1, N_FEATURES))
        self._x = self._features.astype(np.float32)
        prior = self.settings.unknown_prior
        self._prior_log_odds = math.log(prior / (1.0 - prior))
        self.start()
        return self

    def _fitted(self) -> ForestModel:
        if self.model is None:
            raise UsageError("classifier: wanted one that has learned, got a new one; call fit(library) first")
        return self.model


def _moment(features: Float32Array) -> Float32Array:
    scaled: Float32Array = features[:, _MOMENT] * _MOMENT_SCALE_M
    return scaled
