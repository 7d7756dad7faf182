"""Predicts occupancy by reaches to places, also to places that no motion of the library leads to.

P1 weighs the volumes of learned classes by their posterior. Here a class is a place the hand may go to, given at run
time; what a reach there sweeps follows from how people reach in general. A reach to none of the places goes somewhere,
too: to unlisted places, spread over where people's hands go.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary, unwrap_angles
from humanpred_ros.motion.reach_recordings import ACTIVE, find_jumps
from humanpred_ros.occupancy.futures import SampledFutures, SweepSettings
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.voxeliser import checked_placement
from humanpred_ros.reaching.futures import ReachFutures, ReachFuturesSettings
from humanpred_ros.reaching.place_classifier import PlaceClassifier
from humanpred_ros.reaching.place_model import PlaceModel, PlaceSettings, fit_place_model, reach_lessons
from humanpred_ros.reaching.places import Places
from humanpred_ros.reaching.reach_model import ReachModel, ReachProgress
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.reaching.weights import reach_weights
from humanpred_ros.recognition.classifier import ClassPosterior
from humanpred_ros.recognition.forest import evenly_spaced
from humanpred_ros.recognition.stream import StreamClassifier
from humanpred_ros.recognition.training import TrainedModel
from humanpred_ros.settings import Settings, setting

#: P2's cost as its authors learned it.
DEFAULT_WEIGHTS = "authors_dynamic"

#: No length or angle of a body is larger, m and rad.
_LARGEST = 100.0
#: Postures that are learned from of each motion of a model.
_N_POSTURES = 50


@dataclass(frozen=True, eq=False)
class ReachKnowledge:
    """All that is learned for the predictor `reaching`."""

    model: ReachModel  #: how people reach
    place_model: PlaceModel  #: how to tell the place
    places: Places | None  #: where the library's classes end, tracker's frame; None if it has no classes
    source: str  #: name of the library
    left_out: tuple[str, ...] = ()  #: names of the motions that were not learned from, because they are mistracked

    @classmethod
    def of_library(cls, library: MotionLibrary, human: HumanModel) -> ReachKnowledge:
        """Learn from a library; it needs no classes.

        Raises:
            HumanModelError: a library of other DoFs than the human's.
            MotionError: motions that do not suffice.
        """
        human.check_dofs(library.dof_names)
        settings = PlaceSettings()
        lessons = reach_lessons(library, human, settings)
        ends = [lesson.end for lesson in lessons]
        wrong = {end.name for end in ends if not end.tracked}
        # The arms that a depth camera shows jump in every other motion; where motion capture jumps, a marker was
        # mistaken.
        if human.signature == HumanModel.mocap23().signature:
            wrong |= {motion.name for motion in library if find_jumps(motion, ACTIVE, human)}
        fit = [motion for motion in library if motion.name not in wrong] or list(library)
        return cls(
            ReachModel.learn(fit, human),
            fit_place_model(lessons, human, settings),
            Places.of_ends(ends) if library.labels else None,
            library.name,
            tuple(motion.name for motion in library if motion.name in wrong) if len(fit) < len(library) else (),
        )

    @classmethod
    def of_model(cls, model: TrainedModel, human: HumanModel) -> ReachKnowledge:
        """Learn from the motions that a model file holds.

        Raises:
            UsageError: a model that was trained for another human.
        """
        if model.human.signature != human.signature:
            raise UsageError(
                f"predictor: the model was trained for another human than {human.name}; train one for this human"
            )
        return cls.of_library(library_of_model(model), human)


def library_of_model(model: TrainedModel) -> MotionLibrary:
    """Return the motions of a model, thinned to `_N_POSTURES` postures each, evenly spaced from first to last.

    Each motion is taken to last as long as the library's median one.
    """
    duration_s = float(np.median([motion.duration_s for motion in model.library]))
    motions = []
    for motion in model.library:
        q = unwrap_angles(motion).q[evenly_spaced(len(motion), _N_POSTURES)]
        motions.append(replace(motion, t_s=np.linspace(0.0, duration_s, len(q)), q=q))
    return MotionLibrary(model.library.name, tuple(motions), model.library.provenance)


class ReachingSettings(Settings):
    """How reaches to places are predicted."""

    weights: str = setting(DEFAULT_WEIGHTS, "Weights of P2's cost: a name, or a .json file of learned weights")
    futures: ReachFuturesSettings = setting(ReachFuturesSettings(), "How the rest of a reach is sampled")
    sweep: SweepSettings = setting(SweepSettings(), "How samples become voxels")
    least_probability: float = setting(
        0.01,
        "A place less probable than this is given no futures; the same holds for all unlisted places together",
        low=0.0,
        high=0.99,
    )


class ReachingPredictor(Predictor):
    """P2: plans the reach to each place the hand may go to; needs no motion to that place.

    p(voxel) = sum over places of P(place) times the share of futures towards it that touch the voxel. The body is where
    it is with probability 1. A reach to none of the places goes to unlisted ones (`PlaceClassifier.elsewhere`), with
    one future each.

    Attributes:
        grid: the lattice, world frame.
        settings: how it predicts.
        human: whose body occupies.
    """

    settings_type = ReachingSettings
    needs_model = True

    def __init__(
        self,
        knowledge: ReachKnowledge,
        grid: VoxelGrid,
        T_world_human: ArrayLike,
        places: Mapping[str, ArrayLike] | None = None,
        *,
        onsets: bool = False,
        obstacles: Sequence[Obstacle] = (),
        settings: ReachingSettings | None = None,
    ) -> None:
        """Prepare, and compile now rather than with the first posture.

        Args:
            knowledge: what was learned about reaches.
            grid: the lattice, world frame.
            T_world_human: (4, 4) rigid transform from the tracker's frame to the world.
            places: (3,) of the palm by label, tracker's frame; the library's if None.
            onsets: find where motions begin and end, and judge each anew (`StreamClassifier`).
            obstacles: what stands in a reach's way, world frame.
            settings: how it predicts.

        Raises:
            UsageError: no places at all, or unknown weights.
            ArrayError: a placement that is not a rigid transform.
            ModelFileError: a file of weights that cannot be used.
        """
        self.human, self.grid = knowledge.model.human, grid
        self.settings = s = settings or ReachingSettings()
        self._knowledge = knowledge
        self._classifier = PlaceClassifier(self.human, model=knowledge.place_model, places=self._checked(places))
        self._recogniser = StreamClassifier(self._classifier) if onsets else self._classifier
        surroundings = Surroundings.of_obstacles(obstacles, np.linalg.inv(checked_placement(T_world_human)))
        self._futures = ReachFutures(knowledge.model, reach_weights(s.weights), surroundings, s.futures)
        self._at_rest = ReachProgress(self.human)
        self._sampled = SampledFutures(self.human, grid, T_world_human, s.sweep)
        self.start()
        self.update(np.clip(np.zeros(len(self.human.dof_names)), self.human.lower, self.human.upper), 0.0)
        self.start()

    @classmethod
    def from_request(cls, request: PredictorRequest) -> ReachingPredictor:
        knowledge = ReachKnowledge.of_model(request.trained_model(), request.human)
        settings = request.settings if isinstance(request.settings, ReachingSettings) else None
        return cls(
            knowledge, request.grid, request.T_world_human, request.places, onsets=request.onsets,
            obstacles=request.obstacles, settings=settings,
        )  # fmt: skip

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know about the library, to be told once."""
        left_out = self._knowledge.left_out
        return (f"mistracked, not learned from: {', '.join(left_out)}",) if left_out else ()

    @property
    def places(self) -> Mapping[str, FloatArray]:
        """(3,) by label, tracker's frame: the places weighed against each other."""
        return self._places.by_label

    def set_places(self, places: Mapping[str, ArrayLike] | None) -> None:
        """Weigh other places from the next posture on, the library's if None; the reach under way is judged anew.

        Raises:
            UsageError: no places at all.
        """
        self._classifier.set_places(self._checked(places))
        if isinstance(self._recogniser, StreamClassifier):
            self._recogniser.classes_changed()

    def warnings(self, q: FloatArray) -> dict[str, str]:
        """Return which places a person in posture (D,) cannot get to, as a text for each."""
        return {f"place {label}": text for label, text in self._places.out_of_reach(self.human, q).items()}

    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""
        self._recogniser.start()

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s`; raises what the classifier raises, and then changes nothing.

        Raises:
            MotionError: also for lengths or angles that no body has: what is compiled for speed counts on bodies.
        """
        q = checked("posture", q, (len(self.human.dof_names),))
        if np.abs(q).max() > _LARGEST:
            name = self.human.dof_names[int(np.argmax(np.abs(q)))]
            raise MotionError(
                f"posture: wanted lengths and angles within {_LARGEST:g} m and rad, got {name} {np.abs(q).max():.3g}; "
                "check its units"
            )
        posterior = self._recogniser.update(q, t_s)
        progress = self._classifier.progress
        if not posterior.n_frames:
            # At rest the classifier is not asked; whatever comes begins here and now.
            progress = self._at_rest
            progress.start()
            progress.update(q)
        p = self._sampled.probability(q, self._groups(progress, posterior))
        return Prediction(Occupancy(self.grid, p, t_s), posterior)

    @property
    def _places(self) -> Places:
        places = self._classifier.places
        assert places is not None
        return places

    def _checked(self, places: Mapping[str, ArrayLike] | None) -> Places:
        """Return the places, or the library's (UsageError if there are none)."""
        if places:
            return Places.of(places)
        if self._knowledge.places is None:
            raise UsageError(
                "predictor reaching: wanted at least one place where the hand may go, got none, and "
                f"{self._knowledge.source} has no classes to take them from; give some"
            )
        return self._knowledge.places

    def _groups(self, progress: ReachProgress, posterior: ClassPosterior) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield groups of futures with their probabilities, for places that are probable and can be reached."""
        n, places, least = self.settings.futures.n_samples, self._places, self.settings.least_probability
        if progress.turned:
            # There is one way back, wherever the hand comes from.
            yield np.full(n, 1.0 / n), self._futures.towards(progress, places.places_m[0])
            return
        far = np.isin(places.labels, list(places.out_of_reach(self.human, progress.start_posture)))
        # If all places are out of reach, a reach towards them is expected rather than none.
        share = posterior.given_known
        share = share if far.all() else np.where(far, 0.0, share)
        share = np.where(share >= min(least, share.max()), share, 0.0)
        elsewhere, unknown = self._elsewhere(posterior)
        for probable, place in zip(((1.0 - unknown) * share / share.sum()).tolist(), places.places_m, strict=True):
            if probable > 0.0:
                yield np.full(n, probable / n), self._futures.towards(progress, place)
        if unknown > 0.0:
            k = len(elsewhere)
            yield np.full(k, unknown / k), self._futures.towards_each(progress, elsewhere)

    def _elsewhere(self, posterior: ClassPosterior) -> tuple[FloatArray, float]:
        """Return unlisted places (K, 3) and how probable they are together; 0 if they are not needed."""
        # At rest the classifier still holds the last reach.
        if not posterior.n_frames or posterior.unknown < self.settings.least_probability:
            return np.empty((0, 3)), 0.0
        # The less probable they are together, the fewer there are, so that each future counts about the same.
        most = self.settings.futures.n_samples
        places = self._classifier.elsewhere(min(math.ceil(2 * most * posterior.unknown), most))
        return places, posterior.unknown if len(places) else 0.0
