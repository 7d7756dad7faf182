"""Predicts occupancy next to reaches that no library contains: which place, and how the reach there goes on.

P1 weighs the volumes of learned classes by their posterior. Here a class is a place the hand may go to, given at run
time; what its reaches sweep is made up from how people reach in general. A reach to none of the places goes somewhere,
too: to places nobody told, where people's hands go.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.sampled_futures import SampledFutures, SweepSettings
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.futures import ReachFutures, ReachFuturesConfig
from humanpred_ros.reaching.place_classifier import GoalClassifier
from humanpred_ros.reaching.places import GoalPlaces
from humanpred_ros.reaching.progress import ReachProgress
from humanpred_ros.reaching.reach_model import ReachModel
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.recognition.classifier import ClassPosterior
from humanpred_ros.recognition.stream import StreamClassifier

#: P2's cost as its authors learned it (facts: icra2015, section 4).
DEFAULT_WEIGHTS = "authors_dynamic"


@dataclass(frozen=True)
class ReachingConfig:
    """How reaches to places are predicted.

    Attributes:
        futures: how the rest of a reach is sampled.
        sweep: how samples become voxels.
        least_probability: places less probable than this are given no futures, nor are places out of reach, unless all
            are, nor places nobody told, if they are all together; their probability goes to the others.
    """

    futures: ReachFuturesConfig = field(default_factory=ReachFuturesConfig)
    sweep: SweepSettings = field(default_factory=SweepSettings)
    least_probability: float = 0.01

    def __post_init__(self) -> None:
        if not 0.0 <= self.least_probability < 1.0:
            raise UsageError(f"reaching: wanted a least probability within [0, 1), got {self.least_probability}")


class ReachingPredictor(Predictor):
    """P2: plans the reach to each place the hand may go to; needs no motion to that place.

    p(voxel) = sum over places of P(place) times the share of futures towards it that touch the voxel.

    Where the body is now has probability 1, and nothing else has. Given that the reach is for none of the places, as
    probable as the posterior says, it is for others that nobody told (`GoalClassifier.elsewhere`), one future each.

    Attributes:
        grid: the lattice, world frame.
        config: the settings.
    """

    needs_model = True

    def __init__(
        self,
        model: ReachModel,
        goals: GoalClassifier,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        *,
        onsets: bool = False,
        weights: ArrayLike | None = None,
        scene: Surroundings | None = None,
        config: ReachingConfig | None = None,
    ) -> None:
        """Prepare; the first call on a machine compiles, and the first posture need not wait for that.

        Args:
            model: what was learned about reaches.
            goals: a classifier that has learned, with its places; its state belongs to this object.
            grid: the lattice, world frame.
            T_world_human: (4, 4) rigid transform from the tracker's frame to the world.
            onsets: find where motions begin and end, and judge each anew (`StreamClassifier`).
            weights: (24,) of the features of P2's cost; `DEFAULT_WEIGHTS` if None.
            scene: what stands in a reach's way, tracker's frame; nothing if None.
            config: settings.

        Raises:
            UsageError: a model for another human than the classifier's.
            ArrayError: a placement that is not a rigid transform.
            PlanningError: weights that cannot be.
        """
        human = model.human
        if goals.human.signature != human.signature:
            raise UsageError(
                f"reaching: wanted goals inferred for {human.name}, got a classifier for {goals.human.name}; "
                "learn both for one human"
            )
        self.grid = grid
        self.config = config or ReachingConfig()
        self._goals = goals
        self._recogniser = StreamClassifier(goals) if onsets else goals
        w = NAMED_WEIGHTS[DEFAULT_WEIGHTS] if weights is None else weights
        self._futures = ReachFutures(model, w, scene, self.config.futures)
        self._at_rest = ReachProgress(human)
        self._sampled = SampledFutures(human, grid, T_world_human, self.config.sweep)
        self._warm_up(human)

    @classmethod
    def from_request(cls, request: PredictorRequest) -> ReachingPredictor:
        from humanpred_ros.reaching.reach_sources import ReachKnowledge

        knowledge = ReachKnowledge.of_model(request.trained_model(), request.human)
        places = None
        if request.places is not None:
            places = GoalPlaces(tuple(request.places), np.array(list(request.places.values()), dtype=np.float64))
        return knowledge.predictor(
            request.grid, request.T_world_human, places, onsets=request.onsets, obstacles=request.obstacles
        )

    @property
    def human(self) -> HumanModel:
        """Whose body occupies."""
        return self._sampled.human

    @property
    def goals(self) -> GoalPlaces:
        """The places weighed against each other."""
        return self._places()

    def set_goals(self, goals: GoalPlaces) -> None:
        """Weigh these places from the next posture on; the reach under way is judged anew."""
        self._goals.set_goals(goals)
        if isinstance(self._recogniser, StreamClassifier):
            self._recogniser.classes_changed()

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        self._recogniser.start()

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s`; raises what the classifier raises, and then changes nothing."""
        posterior = self._recogniser.update(q, t_s)
        progress = self._goals.progress
        if not posterior.n_frames:
            # At rest the classifier is not asked; whatever comes begins here and now.
            progress = self._at_rest
            progress.start()
            progress.update(q)
        p = self._sampled.probability(q, self._groups(progress, posterior))
        return Prediction(Occupancy(self.grid, p, t_s), posterior)

    def _groups(self, progress: ReachProgress, posterior: ClassPosterior) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield groups of futures with their probabilities, for places that are probable and can be reached."""
        n, goals = self.config.futures.n_samples, self.goals
        if progress.turned:
            # One way back, wherever from.
            yield np.full(n, 1.0 / n), self._futures.towards(progress, goals.places_m[0])
            return
        far = np.isin(goals.labels, [place.label for place in goals.out_of_reach(self.human, progress.start_posture)])
        # Told only places that nobody gets to, it is better to expect a reach that way than none at all.
        share = posterior.given_known
        share = share if far.all() else np.where(far, 0.0, share)
        share = np.where(share >= min(self.config.least_probability, share.max()), share, 0.0)
        elsewhere, unknown = self._elsewhere(posterior)
        for probable, place in zip(((1.0 - unknown) * share / share.sum()).tolist(), goals.places_m, strict=True):
            if probable > 0.0:
                yield np.full(n, probable / n), self._futures.towards(progress, place)
        if unknown > 0.0:
            k = len(elsewhere)
            yield np.full(k, unknown / k), self._futures.towards_each(progress, elsewhere)

    def _elsewhere(self, posterior: ClassPosterior) -> tuple[FloatArray, float]:
        """Return places (K, 3) nobody told, and how probable they are together: 0 if there is no need of them."""
        # At rest the classifier knows of the last reach.
        if not posterior.n_frames or posterior.unknown < self.config.least_probability:
            return np.empty((0, 3)), 0.0
        # Improbable, they are worth little time: so many futures that each counts as little as one to a probable place.
        most = self.config.futures.n_samples
        places = self._goals.elsewhere(min(math.ceil(2 * most * posterior.unknown), most))
        return places, posterior.unknown if len(places) else 0.0

    def _warm_up(self, human: HumanModel) -> None:
        """Use what is compiled at its first use."""
        q = np.clip(np.zeros(len(human.dof_names)), human.lower, human.upper)
        self._places()
        self.start()
        self.update(q, 0.0)
        self.start()

    def _places(self) -> GoalPlaces:
        goals = self._goals.goals
        if goals is None:
            raise UsageError("reaching: wanted places to reach for, got none; give the classifier its goals first")
        return goals
