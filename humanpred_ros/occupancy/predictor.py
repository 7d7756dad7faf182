"""The interface of everything that turns an observed posture into predicted human occupancy, and how one is made."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, OccupancyInTime, VoxelGrid
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.plugins import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.stream import StreamClassifier
from humanpred_ros.recognition.training import TrainedModel
from humanpred_ros.settings import Settings

#: Enough for a motion to begin, go on and end.
_WARM_UP_POSTURES = 40
#: Slices of time that are predicted, s: 0.2 each up to 3, and all after it.
SLICES_S = np.append(np.round(0.2 * np.arange(16), 9), np.inf)


@dataclass(frozen=True, eq=False)
class Prediction:
    """What a predictor says after one posture.

    Attributes:
        occupancy: where the human is going to be.
        posterior: which class it takes the motion for; None where it recognises nothing.
        T_library_tracker: (4, 4) where it takes this person to stand: brings the person to where the library's people
            stood. None where it takes the library's place for granted.
    """

    occupancy: Occupancy
    posterior: ClassPosterior | None
    T_library_tracker: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class PredictorRequest:
    """All that a predictor can be made from; each takes what it needs."""

    human: HumanModel  #: whose body occupies
    grid: VoxelGrid  #: the lattice, world frame
    T_world_human: ArrayLike  #: (4, 4) rigid transform from the tracker's frame to the world
    model: TrainedModel | None = None  #: what was learned; the baselines need none
    #: name of the classifier that recognises the class, for predictors that ask one
    classifier: str = DEFAULT_CLASSIFIER
    #: settings of that classifier that differ from those trained with (`Classifier.online_settings`)
    classifier_settings: Mapping[str, object] = field(default_factory=dict)
    #: the postures are those of a person who mostly stands: find where motions begin and end, and recognise each anew
    #: (`StreamClassifier`). Without it, the first posture after `start` begins a motion.
    onsets: bool = False
    settings: Settings | None = None  #: of the predictor, of its `settings_type`; the default ones if None
    #: where the palm may go, (3,) by label, tracker's frame; those of the model's classes if None
    places: Mapping[str, ArrayLike] | None = None
    obstacles: Sequence[Obstacle] = ()  #: what stands in a reach's way, world frame

    def trained_model(self) -> TrainedModel:
        """Return the model (UsageError without one)."""
        if self.model is None:
            raise UsageError("predictor: wanted a trained model, got none; train one first")
        return self.model

    def make_classifier(self) -> Classifier:
        """Return the classifier from the model, ready for use.

        Raises:
            UsageError: no model, one without this classifier, or settings that a trained one cannot change.
        """
        return self.trained_model().classifier(self.classifier, **self.classifier_settings)

    def on_stream(self, classifier: Classifier) -> Classifier:
        """Return a classifier, run on a stream of postures if onsets are to be found."""
        return StreamClassifier(classifier) if self.onsets else classifier


class Predictor(ABC):
    """Predicts the voxels the human will occupy.

    The grid is in the world frame; postures are in the frame of the tracker. `T_world_human` given at
    construction joins the two. Predictors are chosen by name (entry points `humanpred_ros.predictors`, see
    `humanpred_ros.plugins`).

    Attributes:
        settings_type: class of the settings.
        needs_model: whether it learns from people, and so needs a trained model.
        classifiers: names of the classifiers that can recognise for it; None stands for all, () for none.
        also_trained: classifiers that must be in the model whichever recognises.
        grid: the lattice, world frame.
    """

    settings_type: ClassVar[type[Settings]] = Settings
    needs_model: ClassVar[bool] = False
    classifiers: ClassVar[tuple[str, ...] | None] = ()
    also_trained: ClassVar[tuple[str, ...]] = ()
    grid: VoxelGrid

    @classmethod
    def from_request(cls, request: PredictorRequest) -> Predictor:
        """Return a predictor made from what it needs of `request`; `make_predictor` has checked the class attributes.

        Raises:
            HumanPredError: something that it needs is missing or cannot be used.
        """
        raise UsageError(f"{cls.__name__}: wanted a predictor with `from_request`, to be made by name; it has none")

    @abstractmethod
    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""

    @abstractmethod
    def update(self, q: FloatArray, t_s: float) -> Prediction:
        """Take one posture (D,) stamped `t_s` and return the prediction that follows from all so far."""

    def in_time(self, edges_s: FloatArray) -> OccupancyInTime | None:
        """Return when the voxels will be occupied, after the posture that was updated with last.

        Args:
            edges_s: (S + 1,) where slices begin and end, as of `OccupancyInTime`.

        Returns:
            None of a predictor that does not know times, and before the first posture.
        """
        return None


def predictor_type(name: str) -> type[Predictor]:
    """Return a predictor's class by name. Raises UsageError for an unknown name, with those there are."""
    # Abstract classes are types, too; mypy asks for concrete ones.
    return plugins.load(plugins.PREDICTORS, name, Predictor)  # type: ignore[type-abstract]


def check_predictor(name: str, classifier: str = DEFAULT_CLASSIFIER) -> None:
    """Check names before anything expensive is done.

    Raises:
        UsageError: an unknown predictor or classifier, or two that do not go together.
    """
    found = predictor_type(name)
    plugins.check_name(plugins.CLASSIFIERS, classifier)
    if found.classifiers and classifier not in found.classifiers:
        raise UsageError(
            f"predictor {name}: wanted the classifier {' or '.join(found.classifiers)}, got {classifier!r}; "
            "with another classifier use swept_volume"
        )


def needed_classifiers(name: str, classifier: str = DEFAULT_CLASSIFIER) -> tuple[str, ...]:
    """Return which classifiers a model must have for a predictor; none for those that need only a library, or nothing.

    Raises:
        UsageError: as `check_predictor`.
    """
    check_predictor(name, classifier)
    found = predictor_type(name)
    asked = () if found.classifiers == () else (classifier,)
    return tuple(dict.fromkeys((*asked, *found.also_trained)))


def make_predictor(name: str, request: PredictorRequest) -> Predictor:
    """Return a predictor by name.

    Raises:
        UsageError: unknown name, no model where one is needed, a model for another human, a predictor that does not
            go with the classifier, or settings of another predictor.
        ArrayError: a placement that is not a rigid transform.
    """
    found = predictor_type(name)
    if found.classifiers != ():
        check_predictor(name, request.classifier)
    if request.settings is not None and not isinstance(request.settings, found.settings_type):
        raise UsageError(
            f"predictor {name}: wanted settings of the class {found.settings_type.__name__}, "
            f"got {type(request.settings).__name__}"
        )
    if found.needs_model:
        if request.model is None:
            raise UsageError(f"predictor {name}: wanted a trained model, got none; train one first")
        if request.model.human.signature != request.human.signature:
            raise UsageError(
                f"predictor {name}: the model was trained for another human than {request.human.name}; "
                "train one for this human"
            )
    return found.from_request(request)


def warm_up(predictor: Predictor, human: HumanModel, motion: Motion | None = None) -> None:
    """Predict from some postures: what is compiled at its first use must not cost a posture its time.

    Args:
        predictor: of this human, to be thrown away: a new motion does not make it forget all.
        human: whose postures they are.
        motion: a motion such as the predictor is going to see; None if two postures at rest will do.
    """
    predictor.start()
    if motion is None:
        for t_s in (0.0, 0.1):
            predictor.update(np.clip(np.zeros(len(human.dof_names)), human.lower, human.upper), t_s)
    else:
        for k in np.unique(np.linspace(0, len(motion) - 1, _WARM_UP_POSTURES).astype(int)):
            predictor.update(motion.q[k], float(motion.t_s[k]))
    predictor.start()
