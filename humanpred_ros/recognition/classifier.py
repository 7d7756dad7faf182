"""The interface of every classifier of a partial motion, and the posterior it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.motion.motion import MotionLibrary

#: What recognises unless told otherwise; `recognition.registry` knows them all.
DEFAULT_CLASSIFIER = "forest"


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

    labels: tuple[int, ...]
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
    def best(self) -> int:
        """Label of the most probable class."""
        return self.labels[int(np.argmax(self.probability))]

    @property
    def given_known(self) -> FloatArray:
        """(C,) probabilities if the motion is known to belong to one of the classes; they sum to 1."""
        conditional: FloatArray = self.probability / self.probability.sum()
        return conditional

    def of(self, label: int) -> float:
        """Return the probability of one class."""
        return float(self.probability[self.labels.index(label)])


class IntentClassifier(ABC):
    """Recognises to which class a motion belongs while it is still under way.

    Use: `fit` once, then for every motion `start`, and `update` per posture. The cost of one update
    does not grow with the number of postures seen.
    """

    @abstractmethod
    def fit(self, library: MotionLibrary) -> IntentClassifier:
        """Learn one model per class of `library`; return self. Raises LibraryFormatError if it does not suffice."""

    @abstractmethod
    def fit_without(self, library: MotionLibrary, name: str) -> IntentClassifier:
        """Return a new classifier, as if learned from `library` without its motion `name` (`class/index`).

        For leave-one-out evaluations: what does not depend on that motion may be shared with the classifier that
        was fitted to the whole `library`; `self` must be that one and does not change.
        """

    @abstractmethod
    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""

    @abstractmethod
    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` (seconds, any origin, increasing) and return the posterior.

        A call that raises leaves the classifier as it was.
        """
