"""Says for which of given places a person reaches, also for places that nobody was ever seen to reach for.

Where `recognition` asks which class of motions looks like this one, this asks to which place this motion would be a
good way. So it needs no motion towards a place, only the place; places may come and go while it runs.
"""

from __future__ import annotations

import math

import numpy as np

from humanpred_ros.errors import ArrayError, HumanModelError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.reaching.best_reaches import best_reach
from humanpred_ros.reaching.excess_cost import N_COLUMNS, HandState, observe
from humanpred_ros.reaching.hand_outliers import ANEW, LEFT_OUT
from humanpred_ros.reaching.place_learning import ReachLesson, fit_goal_model, learn_goal_model, reach_lessons
from humanpred_ros.reaching.place_model import GoalConfig, GoalModel, unknown_probability
from humanpred_ros.reaching.places import GoalPlaces
from humanpred_ros.reaching.progress import ReachProgress
from humanpred_ros.reaching.unlisted_places import UntoldPlaces, evenly_picked
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior, check_trainable
from humanpred_ros.recognition.reach_features import N_START, point_links

__all__ = ["GoalClassifier", "GoalConfig", "GoalModel", "GoalPlaces", "learn_goal_model"]

#: More would keep the sensor's next frame waiting.
_BEST_REACHES_A_POSTURE = 8
#: Beyond this nothing is measured, and squares of distances would not stay finite.
_FARTHEST_M = 1e4


class GoalClassifier(Classifier):
    """P(place | the reach so far) and P(none of the places | the reach so far).

    All places are equally probable beforehand. The places are in the tracker's frame, and stay where they are when a
    person stands elsewhere. One posture takes the same time however long the reach has lasted. One with the hand where
    it cannot have got (`believing`) changes nothing.

    Attributes:
        human: whose postures come.
        config: the settings.
        model: how much parts of a reach's cost count; the prior ones until something is learned.
        progress: how far the reach under way has got.
    """

    def __init__(
        self,
        human: HumanModel | None = None,
        config: GoalConfig | None = None,
        model: GoalModel | None = None,
        goals: GoalPlaces | None = None,
    ) -> None:
        """Make a classifier that is ready for use once it has goals; the human is P1's by default.

        Raises:
            HumanModelError: a human without the links that are followed, or a model with end postures of another.
        """
        self.human = HumanModel.kinect12() if human is None else human
        self.config = GoalConfig() if config is None else config
        self.model = GoalModel.prior() if model is None else model
        ends = self.model.ends
        if ends is not None and ends.human.signature != self.human.signature:
            raise HumanModelError(
                f"goals: wanted end postures of {self.human.name}, got a model with those of {ends.human.name}; its "
                "weights alone serve another human, too: GoalModel(model.weights)"
            )
        self._links = point_links(self.human)
        self._untold = self.model.untold or UntoldPlaces.around_shoulder(self.human)
        #: Places nobody told, and for which goals and posture.
        self._others: tuple[tuple[GoalPlaces | None, bytes], tuple[FloatArray, FloatArray]] | None = None
        self._goals = goals
        self.progress = ReachProgress(self.human)
        #: What was learned from, for `fit_without`, and the models learned without a class.
        self._lessons: tuple[ReachLesson, ...] = ()
        self._without: dict[int, GoalModel] = {}
        self.start()

    @property
    def goals(self) -> GoalPlaces | None:
        """The places weighed against each other; None if there are none yet."""
        return self._goals

    def set_goals(self, goals: GoalPlaces) -> None:
        """Take other places, at any time: the reach under way is judged by them from the next posture on."""
        self._goals = goals

    def fit(self, library: MotionLibrary) -> GoalClassifier:
        """Learn what parts of a reach count, and take the places of the library's classes; return self.

        Raises:
            LibraryFormatError: motions without a label, one class only, a class of one motion, or one that does not
                move.
            HumanModelError: a library of another human.
        """
        check_trainable(library)
        self._lessons = reach_lessons(library, self.human, self.config)
        self._without = {}
        self.model = fit_goal_model(self._lessons, self.human, self.config)
        self._untold, self._others = self.model.untold or self._untold, None
        self.set_goals(GoalPlaces.of_ends([lesson.end for lesson in self._lessons]))
        self.start()
        return self

    def fit_without(self, library: MotionLibrary, name: str) -> GoalClassifier:
        """Return a classifier that has learned from no motion of that motion's class.

        It knows the place of that class nevertheless, from the class's other motions: the goal is given, how people
        reach for it is not; nor does it learn from a mislabelled motion that ends there. Stricter than the interface
        asks for. Which motions are plainly mistracked is judged once, on the whole library.

        Raises:
            UsageError: this one was not fitted to the library, or no motion of that name.
            LibraryFormatError: the class has no other motion.
        """
        motion = library.find(name)
        if tuple(lesson.end.name for lesson in self._lessons) != tuple(other.name for other in library):
            raise UsageError("goals: wanted a classifier fitted to this library, got another; call fit(library) first")
        goals = GoalPlaces.of_ends([lesson.end for lesson in self._lessons], without_motion=motion.name)
        label = -1 if motion.label is None else motion.label
        if label not in self._without:
            self._without[label] = fit_goal_model(self._lessons, self.human, self.config, without=(label,))
        return GoalClassifier(self.human, self.config, self._without[label], goals)

    def start(self) -> None:
        """Forget the reach that was observed."""
        self._state = HandState.fresh()
        self._row = np.zeros(N_COLUMNS)
        self._last_s = -math.inf
        self._n_frames = 0
        self._best: dict[tuple[float, ...], FloatArray] = {}
        self.progress.start()

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` and return the posterior over the goals, and of none of them.

        Raises:
            ArrayError: posture of the wrong shape, not finite, or kilometres away.
            MotionError: a stamp that is not finite or not later than the one before.
            UsageError: there are no goals yet.
        """
        goals = self._goals
        if goals is None:
            raise UsageError("goals: wanted places to choose from, got none yet; call set_goals or fit first")
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
        conclusion = observe(self._state, points, t_s, self._row)
        if conclusion == ANEW:
            self._best = {}
            self.progress.start()
        if conclusion != LEFT_OUT:
            self.progress.update(q)
        if self.progress.sets_out_again:
            self.start()
            return self.update(q, t_s)
        log_evidence = self.model.log_likelihood(self._row[None], goals.places_m, self._best_reaches(goals))[0]
        # How the whole body would reach is known for told places only, so told and untold are compared by the hand.
        told = self._by_hand(goals.places_m) - np.log(len(goals))
        others, log_share = self._untold_places()
        unknown = unknown_probability(told, log_share + self._by_hand(others), self.config.unknown_prior)
        likelihood = np.exp(log_evidence - log_evidence.max())
        return ClassPosterior(
            goals.labels,
            likelihood / likelihood.sum() * (1.0 - unknown),
            log_evidence,
            t_s,
            self._n_frames,
            unknown,
        )

    def elsewhere(self, n: int) -> FloatArray:
        """Return n places (n, 3) nobody told that stand for where the reach goes if it goes to none that was told.

        All are equally probable, given the reach so far; there are none if told places are everywhere.
        """
        others, log_share = self._untold_places()
        return evenly_picked(others, log_share + self._by_hand(others), n) if len(others) else others

    def _by_hand(self, places_m: FloatArray) -> FloatArray:
        """Return ln P(reach of the hand so far | place) (G,) of places (G, 3), up to a constant."""
        log_likelihood: FloatArray = self.model.log_likelihood(self._row[None], places_m)[0]
        return log_likelihood

    def _untold_places(self) -> tuple[FloatArray, FloatArray]:
        """Return places (M, 3) nobody told, tracker's frame, and ln P(place) (M,), given that it is one of them.

        None is so near to a told one that it might be that; both stay the same while a reach lasts.
        """
        key = (self._goals, self.progress.start_posture.tobytes())
        if self._others is None or self._others[0] != key:
            others = self._untold.around(self.progress.start_posture)
            told = np.empty((0, 3)) if self._goals is None else self._goals.places_m
            apart = (np.linalg.norm(others[:, None] - told, axis=2) >= self.config.apart_m).all(axis=1)
            share = self._untold.share[apart]
            self._others = key, (others[apart], np.log(share / share.sum()))
        return self._others[1]

    def _best_reaches(self, goals: GoalPlaces) -> list[FloatArray] | None:
        """Return the best reach to each goal; None until the start posture is known and all have been worked out.

        Each takes about a millisecond, so only a few are worked out per posture, once a reach.
        """
        if self.model.ends is None or self._state.reach.n_seen[0] < N_START:
            return None
        wanted = [tuple(place) for place in goals.places_m.tolist()]
        missing = [place for place in dict.fromkeys(wanted) if place not in self._best]
        self._best = {place: self._best[place] for place in wanted if place in self._best}
        for place in missing[:_BEST_REACHES_A_POSTURE]:
            start_q = self.progress.start_posture
            self._best[place] = best_reach(self.human, self.model.ends, start_q, np.array(place))
        return [self._best[place] for place in wanted] if len(missing) <= _BEST_REACHES_A_POSTURE else None
