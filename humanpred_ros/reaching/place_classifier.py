"""Says for which of given places a person reaches, also for places that nobody was seen to reach for.

`recognition` asks which class of motions looks like this one; this asks to which place this motion would be a good way.
So it needs no motion to a place, only the place, and places may change while it runs.
"""

from __future__ import annotations

import math

import numpy as np

from humanpred_ros.errors import ArrayError, HumanModelError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.reaching.excess_cost import OUTLIER, RESTARTED, HandFollower, best_reach
from humanpred_ros.reaching.place_model import (
    PlaceModel,
    PlaceSettings,
    ReachLesson,
    fit_place_model,
    reach_lessons,
    unknown_probability,
)
from humanpred_ros.reaching.places import Places, UnlistedPlaces, evenly_picked
from humanpred_ros.reaching.reach_model import ReachProgress
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior, check_trainable
from humanpred_ros.recognition.reach_features import N_START, point_links

#: More would keep the sensor's next frame waiting.
_BEST_REACHES_A_POSTURE = 8
#: Nobody is tracked from farther away, and squares of larger distances would not stay finite.
_FARTHEST_M = 1e4


class PlaceClassifier(Classifier):
    """P(place | the reach so far) and P(none of the places | the reach so far).

    All places are equally probable beforehand. They are in the tracker's frame, and stay where they are when a person
    stands elsewhere. A posture takes the same time however long the reach has lasted. One that shows the hand where it
    cannot be (`excess_cost.LostHand`) changes nothing.

    Attributes:
        human: whose postures come.
        settings: how places are learned and inferred.
        model: how much parts of a reach's cost count; the prior model until something is learned.
        places: weighed against each other; None if there are none yet.
        progress: how far the reach under way has got.
    """

    settings_type = PlaceSettings
    settings: PlaceSettings

    def __init__(
        self,
        human: HumanModel | None = None,
        settings: PlaceSettings | None = None,
        model: PlaceModel | None = None,
        places: Places | None = None,
    ) -> None:
        """Make a classifier that is ready for use once it has places; the human is P1's by default.

        Raises:
            HumanModelError: a human without the links that are followed, or a model with end postures of another.
        """
        super().__init__(HumanModel.kinect12() if human is None else human, settings)
        self.model = PlaceModel.prior() if model is None else model
        ends = self.model.ends
        if ends is not None and ends.human.signature != self.human.signature:
            raise HumanModelError(
                f"places: wanted end postures of {self.human.name}, got a model with those of {ends.human.name}; its "
                "weights alone serve another human, too: PlaceModel(model.weights)"
            )
        self._links = point_links(self.human)
        self._unlisted = self.model.unlisted or UnlistedPlaces.around_shoulder(self.human)
        #: Unlisted places and ln of their shares, and for which listed places and which start posture.
        self._others: tuple[tuple[Places | None, bytes], tuple[FloatArray, FloatArray]] | None = None
        self.places = places
        self.progress = ReachProgress(self.human)
        #: What was learned from, for `fit_without`, and the models learned without a class.
        self._lessons: tuple[ReachLesson, ...] = ()
        self._without: dict[str, PlaceModel] = {}
        self.start()

    def set_places(self, places: Places) -> None:
        """Take other places, at any time: the reach under way is judged by them from the next posture on."""
        self.places = places

    def fit(self, library: MotionLibrary) -> PlaceClassifier:
        """Learn what parts of a reach count, and take the places of the library's classes; return self.

        Raises:
            LibraryFormatError: motions without a label, one class only, a class of one motion, or one that does not
                move.
            HumanModelError: a library of another human.
        """
        check_trainable(library)
        self._lessons = reach_lessons(library, self.human, self.settings)
        self._without = {}
        self.model = fit_place_model(self._lessons, self.human, self.settings)
        self._unlisted, self._others = self.model.unlisted or self._unlisted, None
        self.set_places(Places.of_ends([lesson.end for lesson in self._lessons]))
        self.start()
        return self

    def fit_without(self, library: MotionLibrary, name: str) -> PlaceClassifier:
        """Return a classifier that has learned from no motion of that motion's class, for evaluations.

        It has the place of that class nevertheless, from the class's other motions: the place is given, how people
        reach for it is not; nor does it learn from a mislabelled motion that ends there. This is stricter than leaving
        one motion out. Which motions are mistracked is judged once, on the whole library.

        Raises:
            UsageError: this one was not fitted to the library, or no motion of that name.
            LibraryFormatError: the class has no other motion.
        """
        motion = library.find(name)
        if tuple(lesson.end.name for lesson in self._lessons) != tuple(other.name for other in library):
            raise UsageError("places: wanted a classifier fitted to this library, got another; call fit(library) first")
        places = Places.of_ends([lesson.end for lesson in self._lessons], without_motion=motion.name)
        label = motion.label or ""
        if label not in self._without:
            self._without[label] = fit_place_model(self._lessons, self.human, self.settings, without=(label,))
        return PlaceClassifier(self.human, self.settings, self._without[label], places)

    def start(self) -> None:
        """Forget the reach that was observed."""
        self._hand = HandFollower()
        self._last_s = -math.inf
        self._n_frames = 0
        self._best: dict[tuple[float, ...], FloatArray] = {}
        self.progress.start()

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` and return the posterior over the places, and of none of them.

        Raises:
            ArrayError: posture of the wrong shape, not finite, or kilometres away.
            MotionError: a stamp that is not finite or not later than the one before.
            UsageError: there are no places yet.
        """
        places = self.places
        if places is None:
            raise UsageError("places: wanted some to choose from, got none yet; call set_places or fit first")
        q = checked("posture", q, (len(self.human.dof_names),))
        if not math.isfinite(t_s) or t_s <= self._last_s:
            later = "" if self._last_s == -math.inf else f" later than {self._last_s} s"
            raise MotionError(
                f"classifier: wanted a finite stamp{later}, got {t_s} s; call start() when a new motion begins"
            )
        points = np.ascontiguousarray(self.human.link_poses(q)[self._links][:, :3, 3])
        if np.abs(points).max() > _FARTHEST_M:
            raise ArrayError(f"posture: wanted a body within {_FARTHEST_M:g} m of the tracker, got one beyond; drop it")
        self._last_s = t_s
        self._n_frames += 1
        conclusion = self._hand.observe(points, t_s)
        if conclusion == RESTARTED:
            self._best = {}
            self.progress.start()
        if conclusion != OUTLIER:
            self.progress.update(q)
        if self.progress.sets_out_again:
            self.start()
            return self.update(q, t_s)
        log_evidence = self.model.log_likelihood(self._hand.row[None], places.places_m, self._best_reaches(places))[0]
        # Best reaches of the whole body are known for listed places only, so listed and unlisted ones are compared by
        # the hand alone.
        listed = self._by_hand(places.places_m) - np.log(len(places))
        others, log_share = self._unlisted_places()
        unknown = unknown_probability(listed, log_share + self._by_hand(others), self.settings.unknown_prior)
        likelihood = np.exp(log_evidence - log_evidence.max())
        probability = likelihood / likelihood.sum() * (1.0 - unknown)
        return ClassPosterior(places.labels, probability, log_evidence, t_s, self._n_frames, unknown)

    def elsewhere(self, n: int) -> FloatArray:
        """Return n unlisted places (n, 3) that stand for where the reach goes if it goes to none of the listed ones.

        All are equally probable, given the reach so far; there are none if listed places are everywhere.
        """
        others, log_share = self._unlisted_places()
        return evenly_picked(others, log_share + self._by_hand(others), n) if len(others) else others

    def _by_hand(self, places_m: FloatArray) -> FloatArray:
        """Return ln P(reach of the hand so far | place) (G,) of places (G, 3), up to a constant."""
        log_likelihood: FloatArray = self.model.log_likelihood(self._hand.row[None], places_m)[0]
        return log_likelihood

    def _unlisted_places(self) -> tuple[FloatArray, FloatArray]:
        """Return unlisted places (M, 3), tracker's frame, and ln P(place) (M,), given that it is one of them.

        None is so near to a listed one that it might be that; both stay the same while a reach lasts.
        """
        key = (self.places, self.progress.start_posture.tobytes())
        if self._others is None or self._others[0] != key:
            others = self._unlisted.around(self.progress.start_posture)
            listed = np.empty((0, 3)) if self.places is None else self.places.places_m
            apart = (np.linalg.norm(others[:, None] - listed, axis=2) >= self.settings.apart_m).all(axis=1)
            share = self._unlisted.share[apart]
            self._others = key, (others[apart], np.log(share / share.sum()))
        return self._others[1]

    def _best_reaches(self, places: Places) -> list[FloatArray] | None:
        """Return the best reach to each place; None until the start posture is known and all have been computed.

        Each takes about a millisecond, so only a few are computed per posture, once a reach.
        """
        if self.model.ends is None or self._hand.reach.n_seen[0] < N_START:
            return None
        wanted = [tuple(place) for place in places.places_m.tolist()]
        missing = [place for place in dict.fromkeys(wanted) if place not in self._best]
        self._best = {place: self._best[place] for place in wanted if place in self._best}
        for place in missing[:_BEST_REACHES_A_POSTURE]:
            start_q = self.progress.start_posture
            self._best[place] = best_reach(self.human, self.model.ends, start_q, np.array(place))
        return [self._best[place] for place in wanted] if len(missing) <= _BEST_REACHES_A_POSTURE else None
