"""The interface of every classifier of a partial motion, and the posterior it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from humanpred_ros import plugins
from humanpred_ros.errors import ArrayError, LibraryFormatError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.settings import Settings


@dataclass(frozen=True)
class ClassPosterior:
    """P(C_m | observed part of the motion), and the probability that the motion belongs to no class.

    Attributes:
        labels: (C,) class labels.
        probability: (C,) non-negative; they and `unknown` sum to 1.
        log_evidence: (C,) what the probabilities were made of (per class, up to a common constant).
        t_s: stamp of the last posture seen.
        n_frames: number of postures seen since the start of the motion.
        unknown: probability that this motion belongs to none of the classes; 0 from classifiers that, like P1's,
            take it for granted that it belongs to one. Always less than 1.
    """

    labels: tuple[str, ...]
    probability: FloatArray
    log_evidence: FloatArray
    t_s: float
    n_frames: int
    unknown: float = 0.0

    def __post_init__(self) -> None:
        p = checked("posterior", self.probability, (len(self.labels),))
        if not 0.0 <= self.unknown < 1.0:
            raise ArrayError(f"posterior: wanted a probability of no class within [0, 1), got {self.unknown}")
        if (p < 0).any() or abs(float(p.sum()) + self.unknown - 1.0) > 1e-9:
            raise ArrayError(
                f"posterior: wanted non-negative probabilities with sum {1.0 - self.unknown} "
                f"(1 less the probability of no class), got {p}"
            )
        object.__setattr__(self, "probability", p)

    @property
    def best(self) -> str:
        """Label of the most probable class."""
        return self.labels[int(np.argmax(self.probability))]

    @property
    def given_known(self) -> FloatArray:
        """(C,) probabilities if the motion is known to belong to one of the classes; they sum to 1."""
        conditional: FloatArray = self.probability / self.probability.sum()
        return conditional

    def of(self, label: str) -> float:
        """Return the probability of one class."""
        return float(self.probability[self.labels.index(label)])


class Classifier(ABC):
    """Recognises to which class a motion belongs while it is still under way.

    Use: `fit` once, then for every motion `start`, and `update` per posture. The cost of one update
    does not grow with the number of postures seen.

    Classifiers that are chosen by name (entry points `humanpred_ros.classifiers`, see `humanpred_ros.plugins`) are made
    with the human and their settings, and give what they have learned to the model file (`state`, `from_state`).

    Attributes:
        settings_type: class of the settings.
        online_settings: names of the settings that may change after training.
        human: whose postures come.
        settings: how it learns and recognises.
    """

    settings_type: ClassVar[type[Settings]] = Settings
    online_settings: ClassVar[tuple[str, ...]] = ()
    human: HumanModel
    settings: Settings

    def __init__(self, human: HumanModel, settings: Settings | None = None) -> None:
        """Make one to be fitted.

        Args:
            human: whose postures come.
            settings: of the class `settings_type`; the default ones if None.

        Raises:
            UsageError: settings of another class.
        """
        if settings is not None and not isinstance(settings, self.settings_type):
            raise UsageError(
                f"{type(self).__name__}: wanted settings of the class {self.settings_type.__name__}, "
                f"got {type(settings).__name__}"
            )
        self.human = human
        self.settings = self.settings_type() if settings is None else settings

    @abstractmethod
    def fit(self, library: MotionLibrary) -> Classifier:
        """Learn the classes of `library`; return self. Raises LibraryFormatError if it does not suffice."""

    @abstractmethod
    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""

    @abstractmethod
    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` (seconds, any origin, increasing) and return the posterior.

        A call that raises leaves the classifier as it was.
        """

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what was learned, as named arrays of numbers, truth values or texts, for the model file.

        Raises:
            UsageError: nothing was learned yet, or a classifier that cannot be kept in a file.
        """
        raise UsageError(f"{type(self).__name__}: wanted a classifier that says what it has learned, it does not")

    @classmethod
    def from_state(cls, human: HumanModel, settings: Settings, state: Mapping[str, NDArray[Any]]) -> Classifier:
        """Return the classifier that gave `state`, ready for use.

        Args:
            human, settings: it was made with; `online_settings` may differ.
            state: as it was given; not to be trusted, as the file may come from anywhere.

        Raises:
            HumanPredError, KeyError, TypeError, ValueError: parts that are missing or do not fit each other.
        """
        raise UsageError(f"{cls.__name__}: wanted a classifier that can be kept in a model file, this one cannot")

    def fresh(self, settings: Settings | None = None) -> Classifier:
        """Return a classifier that has learned the same, nothing observed yet.

        Args:
            settings: differ from these at most in `online_settings`; these if None.
        """
        return type(self).from_state(self.human, settings or self.settings, self.state())


def classifier_type(name: str) -> type[Classifier]:
    """Return a classifier's class by name. Raises UsageError for an unknown name, with those there are."""
    # Abstract classes are types, too; mypy asks for concrete ones.
    return plugins.load(plugins.CLASSIFIERS, name, Classifier)  # type: ignore[type-abstract]


def check_trainable(library: MotionLibrary) -> None:
    """Raise LibraryFormatError unless there are two classes or more, each of two motions or more, all different."""
    unlabelled = [motion.name for motion in library if motion.label is None]
    if unlabelled:
        raise LibraryFormatError(
            f"library {library.name}: wanted a class for every motion to learn from, {unlabelled[0]} and "
            f"{len(unlabelled) - 1} more have none; label them or leave them out"
        )
    if len(library.labels) < 2:
        raise LibraryFormatError(
            f"library {library.name}: wanted at least two classes to tell apart, got only class {library.labels[0]}"
        )
    for label in library.labels:
        motions = library.of_class(label)
        if len(motions) < 2:
            raise LibraryFormatError(
                f"library {library.name}: wanted at least two motions per class, class {label} has only "
                f"{motions[0].name}; record more or leave the class out (--leave-out)"
            )
        if not any(np.ptp(motion.q, axis=0).any() for motion in motions):
            raise LibraryFormatError(
                f"library {library.name}: wanted motions that move, in class {label} no degree of freedom ever changes"
            )
    seen: dict[bytes, Motion] = {}
    for motion in library:
        # A recording counted twice weighs twice, and leaving one of the two out would test on the other.
        twin = seen.setdefault(motion.q.tobytes(), motion)
        if twin is not motion:
            raise LibraryFormatError(
                f"library {library.name}: wanted every motion once, {twin.name} and {motion.name} have the same "
                "postures; leave one of them out"
            )
