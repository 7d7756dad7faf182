"""The interface of every classifier of a partial motion, and the posterior it returns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from humanpred_ros.checks import FloatArray, checked
from humanpred_ros.errors import ArrayError
from humanpred_ros.motion.motion import MotionLibrary


@dataclass(frozen=True)
class ClassPosterior:
    """P(C_m | observed part of the motion).

    Attributes:
        labels: (C,) class labels.
        probability: (C,) non-negative, sums to 1.
        log_evidence: (C,) what the probabilities were made of (per class, up to a common constant).
        t_s: stamp of the last posture seen.
        n_frames: number of postures seen since the start of the motion.
    """

    labels: tuple[int, ...]
    probability: FloatArray
    log_evidence: FloatArray
    t_s: float
    n_frames: int

    def __post_init__(self) -> None:
        p = checked("posterior", self.probability, (len(self.labels),))
        if (p < 0).any() or abs(float(p.sum()) - 1.0) > 1e-9:
            raise ArrayError(f"posterior: wanted non-negative probabilities with sum 1, got {p}")
        object.__setattr__(self, "probability", p)

    @property
    def best(self) -> int:
        """Label of the most probable class."""
        return self.labels[int(np.argmax(self.probability))]

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
    def start(self) -> None:
        """Forget what was observed: the next posture is the first of a new motion."""

    @abstractmethod
    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        """Take one posture (D,) stamped `t_s` (seconds, any origin, increasing) and return the posterior."""
