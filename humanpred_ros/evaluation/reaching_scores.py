"""What predicted reaches score, and what P2 published of the same recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from humanpred_ros.geometry.checks import FloatArray

#: Fields of `ReachDistance`, in the order of columns.
DISTANCES = ("joint_m", "task_as_coded_m", "task_m")
#: The row that compares each recording with itself: what a perfect prediction scores.
ITSELF = "itself"
#: The predictor that others are compared with.
YARDSTICK = "minimum_jerk"
#: P2's seven demonstrations in its order, by the names of their files.
DEMONSTRATIONS = ("0446-0578", "0525-0657", "0444-0585", "0489-0589", "0780-0871", "1537-1608", "2711-2823")
#: The motion of P2's Table III and Fig. 11, as far as can be told.
INTERFERENCE_CASE = "7395-7595"
#: P2 Table I, weights learned from the demonstration itself: (joint, task as coded) by demonstration.
TABLE1: Mapping[str, tuple[float, float]] = MappingProxyType(
    dict(
        zip(
            DEMONSTRATIONS,
            (
                (33.17, 44.44), (37.20, 53.08), (53.37, 76.26), (20.95, 31.39),
                (21.59, 26.50), (10.12, 23.62), (25.56, 45.69),
            ),
            strict=True,
        )
    )
)  # fmt: skip


@dataclass(frozen=True)
class PublishedRow:
    """Averages over the demonstrations, of 10 runs each, as printed in P2.

    Attributes:
        predictor: ours that is made the same way.
        what: the method, in P2's words.
        table: where it stands.
        joint_m, task_as_coded_m: distances.
    """

    predictor: str
    what: str
    table: str
    joint_m: float
    task_as_coded_m: float


PUBLISHED = (
    PublishedRow("own", "own weights", "P2 Table I", 28.85, 42.99),
    PublishedRow("learned", "leave-one-out weights", "P2 Table II", 30.98, 42.18),
    PublishedRow("baseline_0", "baseline 0", "P2 Table II", 34.06, 45.81),
    PublishedRow("baseline_1", "baseline 1", "P2 Table II", 64.96, 57.78),
    PublishedRow("learned_replanned", "leave-one-out weights, re-planned", "P2 Table II", 35.34, 43.56),
    PublishedRow("baseline_0_replanned", "baseline 0, re-planned", "P2 Table II", 39.55, 48.04),
    PublishedRow("baseline_1_replanned", "baseline 1, re-planned", "P2 Table II", 81.01, 63.11),
)
PUBLISHED_INTERFERENCE = (
    PublishedRow("learned", "learned weights", "P2 Table III", 52.89, 49.22),
    PublishedRow("learned_replanned", "learned weights, re-planned", "P2 Table III", 44.91, 36.20),
)


@dataclass(frozen=True, eq=False)
class Scores:
    """One predictor on a set of recordings.

    Attributes:
        name, description, group: which.
        runs: of each recording.
        values: (R, 4, 3) mean, standard deviation, least and largest over the runs of each recording, of the three
            distances, metres summed over frames.
        wrist_m: (n, 3) path of the wrist in the first run of each recording.
        predict_ms: median time of one prediction, while other processes may be working.
    """

    name: str
    description: str
    group: str
    runs: int
    values: FloatArray
    wrist_m: tuple[FloatArray, ...]
    predict_ms: float

    @property
    def average(self) -> FloatArray:
        """(4, 3) averages over the recordings, which is how P2's averages are made."""
        average: FloatArray = self.values.mean(axis=0)
        return average


@dataclass(frozen=True, eq=False)
class ReachingSet:
    """Recordings and what was predicted of them.

    Attributes:
        title: what they are.
        recordings: facts about each: name, n_frames, duration_s, unfit, notes.
        wrist_m: (n, 3) path of the real wrist of each, in that order.
        scores: of the predictors side by side.
        published: what P2 published about these recordings; may be empty.
        left_out: whether the predictors had learned from all recordings but the tested one (otherwise: from others).
    """

    title: str
    recordings: tuple[Mapping[str, Any], ...]
    wrist_m: tuple[FloatArray, ...]
    scores: tuple[Scores, ...]
    published: tuple[PublishedRow, ...]
    left_out: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recordings."""
        return tuple(str(facts["name"]) for facts in self.recordings)

    def of(self, predictor: str) -> Scores | None:
        """Return the scores of a predictor, None if it was not run."""
        return next((scores for scores in self.scores if scores.name == predictor), None)

    def published_of(self, predictor: str) -> PublishedRow | None:
        """Return what P2 published of a predictor that is made the same way, None if nothing."""
        return next((row for row in self.published if row.predictor == predictor), None)

    def average_fit(self, scores: Scores) -> FloatArray | None:
        """Return the averages (4, 3) over recordings without jumps of the reaching person; None if there are none."""
        fit = np.array([facts["unfit"] is None for facts in self.recordings])
        average: FloatArray | None = scores.values[fit].mean(axis=0) if fit.any() else None
        return average

    def wins(self, predictor: str, distance: int) -> int | None:
        """Return on how many recordings a predictor is better than the yardstick; None if one was not run."""
        ours, theirs = self.of(predictor), self.of(YARDSTICK)
        if ours is None or theirs is None:
            return None
        return int((ours.values[:, 0, distance] < theirs.values[:, 0, distance]).sum())
