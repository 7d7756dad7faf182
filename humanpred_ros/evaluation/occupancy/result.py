"""The figures of an evaluation of occupancy: what is printed, drawn and written as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from humanpred_ros.evaluation.leave_one_out import learned_from_class
from humanpred_ros.evaluation.occupancy.runs import MotionOutcome, Picture
from humanpred_ros.evaluation.occupancy.scores import BIN_EDGES, Reliability, VoxelScores
from humanpred_ros.evaluation.outputs import plain
from humanpred_ros.geometry.checks import FloatArray


@dataclass(frozen=True, eq=False)
class VoxelFigures:
    """Means over motions; each attribute is as in `VoxelScores`, one number or (P,) for the percents.

    Where nothing was swept (the body had left the grid) average precision and missed share do not exist; their
    means are over the other motions.
    """

    brier: FloatArray
    squared_error: FloatArray
    log_loss: FloatArray
    average_precision: FloatArray
    missed: FloatArray
    n_swept: FloatArray
    n_predicted: FloatArray

    @classmethod
    def at_percents(cls, scores: Sequence[Sequence[VoxelScores]]) -> VoxelFigures:
        """Return the means over motions at each percent, from the scores (N motions, P percents)."""
        names = cls.__dataclass_fields__
        return cls(**{name: _mean(np.array([[getattr(s, name) for s in row] for row in scores])) for name in names})

    def averaged(self) -> VoxelFigures:
        """Return the means over the percents."""
        return VoxelFigures(**{name: _mean(getattr(self, name)) for name in self.__dataclass_fields__})


@dataclass(frozen=True, eq=False)
class CalibrationTable:
    """How often voxels of a given probability were swept, over all motions and percents.

    Attributes:
        edges: of the bins; the first bin holds what nobody was warned of.
        count, mean_probability, observed: of each bin; NaN where it is empty.
        error: expected calibration error over all voxels of the region.
        error_predicted: the same over voxels in all but the first bin.
    """

    edges: tuple[float, ...]
    count: FloatArray
    mean_probability: FloatArray
    observed: FloatArray
    error: float
    error_predicted: float

    @classmethod
    def of(cls, outcomes: Sequence[MotionOutcome]) -> CalibrationTable:
        """Return the table of all predictions."""
        total = sum((score.reliability for outcome in outcomes for score in outcome.scores), Reliability.none())
        return cls(
            BIN_EDGES,
            total.count.astype(np.float64),
            total.mean_probability,
            total.observed,
            total.error,
            total.error_predicted,
        )


@dataclass(frozen=True)
class UpdateTiming:
    """How long things took on this machine.

    Attributes:
        median_ms, p99_ms: of one update with a posture.
        prepare_s: mean time to train without one motion, what is shared not counted except where it is made.
    """

    median_ms: float
    p99_ms: float
    prepare_s: float


@dataclass(frozen=True, eq=False)
class PredictorResult:
    """What was found out about one predictor.

    Attributes:
        name, description: of the predictor.
        learned_from_class: whether it had learned from other motions of the tested one's class: yes, no or –.
        average: over motions and percents.
        without_mistracked: the same without test motions that the tracker plainly got wrong; None if there are none.
        at_percent: over motions, at each percent.
        motions: by name, the mean Brier score and missed share of each motion over the percents.
        calibration: of all predictions.
        timing: of updates and training.
        refused_postures: how many the predictor refused, over all motions.
        picture: the moment that is drawn.
        untold, untold_at_percent: as `average` and `at_percent`, of a predictor that is told places, had it not been
            told the tested motion's; None for who is told none.
    """

    name: str
    description: str
    learned_from_class: str
    average: VoxelFigures
    without_mistracked: VoxelFigures | None
    at_percent: VoxelFigures
    motions: Mapping[str, Mapping[str, float]]
    calibration: CalibrationTable
    timing: UpdateTiming
    refused_postures: int
    picture: Picture | None
    untold: VoxelFigures | None = None
    untold_at_percent: VoxelFigures | None = None

    @classmethod
    def of(
        cls, name: str, description: str, outcomes: Sequence[MotionOutcome], mistracked: frozenset[str]
    ) -> PredictorResult:
        """Return the figures of a predictor's outcomes; `mistracked` names motions to leave out once, beside."""
        at_percent = VoxelFigures.at_percents([outcome.scores for outcome in outcomes])
        good = [outcome.scores for outcome in outcomes if outcome.name not in mistracked]
        some_bad = 0 < len(good) < len(outcomes)
        again = [outcome.untold for outcome in outcomes if outcome.untold is not None]
        untold = VoxelFigures.at_percents(again) if again else None
        single = {o.name: VoxelFigures.at_percents([o.scores]).averaged() for o in outcomes}
        update_ms = np.concatenate([outcome.update_ns for outcome in outcomes]) * 1e-6
        return cls(
            name,
            description,
            learned_from_class(name),
            at_percent.averaged(),
            VoxelFigures.at_percents(good).averaged() if some_bad else None,
            at_percent,
            {motion: {"brier": float(f.brier), "missed": float(f.missed)} for motion, f in single.items()},
            CalibrationTable.of(outcomes),
            UpdateTiming(
                float(np.median(update_ms)),
                float(np.percentile(update_ms, 99)),
                float(np.mean([outcome.prepare_s for outcome in outcomes])),
            ),
            sum(outcome.refused for outcome in outcomes),
            next((outcome.picture for outcome in outcomes if outcome.picture is not None), None),
            None if untold is None else untold.averaged(),
            untold,
        )


@dataclass(frozen=True, eq=False)
class OccupancyEvaluation:
    """The whole evaluation.

    Attributes:
        library: facts about it.
        settings: everything the figures depend on.
        machine: what the times depend on.
        percents: of a motion after which predictions were scored.
        tested, mistracked: names of the motions tested, and of those among them that are plainly mistracked.
        region_voxels: size of the region over which scores are means.
        predictors: side by side.
    """

    library: Mapping[str, Any]
    settings: Mapping[str, Any]
    machine: Mapping[str, Any]
    percents: tuple[int, ...]
    tested: tuple[str, ...]
    mistracked: tuple[str, ...]
    region_voxels: int
    predictors: tuple[PredictorResult, ...]

    @property
    def unseen_beside_seen(self) -> float | None:
        """Brier score of `reaching`, which never saw the class, over that of P1, which has learned it.

        The target is at most 1. None unless both are there.
        """
        brier = {result.name: float(result.average.brier) for result in self.predictors}
        unseen, seen = brier.get("reaching"), brier.get("swept_volume")
        return unseen / seen if unseen is not None and seen else None

    def to_json(self) -> dict[str, Any]:
        """Return everything as plain values; the pictures stay out."""
        value: dict[str, Any] = plain(self) | {"unseen_beside_seen": self.unseen_beside_seen}
        for predictor in value["predictors"]:
            del predictor["picture"]
        return value


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean over the first axis of what exists, NaN where nothing does."""
    exists = np.isfinite(values)
    count = exists.sum(axis=0)
    total = np.where(exists, values, 0.0).sum(axis=0)
    mean: FloatArray = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean
