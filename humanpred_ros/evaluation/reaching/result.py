"""The figures of an evaluation of predicted reaches: what is printed, drawn and written as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from humanpred_ros.evaluation.reaching.reference import PublishedRow
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.distances import ReachDistance

#: Fields of `ReachDistance`, in the order of columns.
DISTANCES = ("joint_m", "task_as_coded_m", "task_m")


@dataclass(frozen=True)
class Statistic:
    """Of runs, as P2 prints it: average, population standard deviation, least, largest."""

    mean: float
    sd: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Statistic:
        """Return the statistic of at least one value."""
        array = np.asarray(values, dtype=np.float64)
        return cls(float(array.mean()), float(array.std()), float(array.min()), float(array.max()))

    @classmethod
    def average(cls, statistics: Sequence[Statistic]) -> Statistic:
        """Return the average of each of the four over recordings, which is how P2's averages are made."""
        table = np.array([(s.mean, s.sd, s.low, s.high) for s in statistics])
        return cls(*(float(value) for value in table.mean(axis=0)))


@dataclass(frozen=True)
class DistanceFigures:
    """Statistics of the three distances, metres summed over frames (see `ReachDistance`)."""

    joint_m: Statistic
    task_as_coded_m: Statistic
    task_m: Statistic

    @classmethod
    def of(cls, runs: Sequence[ReachDistance]) -> DistanceFigures:
        """Return the figures of one recording's runs."""
        return cls(*(Statistic.of([getattr(run, name) for run in runs]) for name in DISTANCES))

    @classmethod
    def average(cls, figures: Sequence[DistanceFigures]) -> DistanceFigures:
        """Return the averages over recordings."""
        return cls(*(Statistic.average([getattr(f, name) for f in figures]) for name in DISTANCES))

    @property
    def means(self) -> tuple[float, float, float]:
        """The three averages."""
        return self.joint_m.mean, self.task_as_coded_m.mean, self.task_m.mean


@dataclass(frozen=True)
class RecordingFigures:
    """One predictor on one recording.

    Attributes:
        recording: its name.
        figures: of the runs.
        wrist_m: (n, 3) path of the wrist of the first run; drawn, not written.
    """

    recording: str
    figures: DistanceFigures
    wrist_m: FloatArray


@dataclass(frozen=True)
class PredictorFigures:
    """One predictor on all recordings.

    Attributes:
        name, description, group: which.
        runs: of each recording.
        recordings: one by one.
        average: over all recordings.
        average_fit: over those without marked jumps of the reaching person; None if there are none.
        predict_ms: median time of one prediction, beside whatever else the machine did.
    """

    name: str
    description: str
    group: str
    runs: int
    recordings: tuple[RecordingFigures, ...]
    average: DistanceFigures
    average_fit: DistanceFigures | None
    predict_ms: float

    def of(self, recording: str) -> DistanceFigures:
        """Return the figures of a recording by name."""
        return next(entry.figures for entry in self.recordings if entry.recording == recording)


@dataclass(frozen=True)
class ReachingSet:
    """Recordings and what was predicted of them.

    Attributes:
        title: what they are.
        recordings: facts about each: name, frames, duration_s, unfit, notes.
        wrist_m: (n, 3) path of the real wrist of each, in that order; drawn, not written.
        predictors: side by side.
        published: rows to print beside them; empty where P2 published nothing about these recordings.
        left_out: whether the predictors had learned from all recordings but the tested one (otherwise: from others).
    """

    title: str
    recordings: tuple[Mapping[str, Any], ...]
    wrist_m: tuple[FloatArray, ...]
    predictors: tuple[PredictorFigures, ...]
    published: tuple[PublishedRow, ...]
    left_out: bool

    def predictor(self, name: str) -> PredictorFigures | None:
        """Return the figures of a predictor, None if it was not run."""
        return next((figures for figures in self.predictors if figures.name == name), None)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recordings."""
        return tuple(str(facts["name"]) for facts in self.recordings)

    def published_of(self, predictor: str) -> PublishedRow | None:
        """Return what P2 published of a predictor that is made the same way, None if nothing."""
        return next((row for row in self.published if row.predictor == predictor), None)

    def better_than(self, predictor: str, other: str, distance: str) -> int | None:
        """Return on how many recordings the average of one predictor is lower than another's, by a name of `DISTANCES`.

        None if one of them was not run.
        """
        ours, theirs = self.predictor(predictor), self.predictor(other)
        if ours is None or theirs is None:
            return None
        pairs = (
            (getattr(ours.of(name), distance).mean, getattr(theirs.of(name), distance).mean) for name in self.names
        )
        return sum(bool(mine < its) for mine, its in pairs)
