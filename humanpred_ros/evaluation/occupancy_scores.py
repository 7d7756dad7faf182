"""How good voxel probabilities are: pure functions of the probabilities and of the voxels that were really swept.

Misses are counted apart from other errors, because a swept voxel that was given next to nothing is what hurts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked

BoolArray = NDArray[np.bool_]

#: Probabilities are taken to be within these for the log score, which a single sure mistake would make infinite.
LOG_CLIP = (0.001, 0.999)
#: A swept voxel given less than this was missed.
MISSED_BELOW = 0.01
#: Edges of the calibration table: ten bins, the first of which is split at what counts as missed.
BIN_EDGES = (0.0, MISSED_BELOW, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)


def squared_error(probability: ArrayLike, swept: ArrayLike) -> float:
    """Return the sum over voxels of (p - y)^2; divided by the number of voxels it is the Brier score.

    Args:
        probability: (V,) predicted.
        swept: (V,) whether it came true.

    Raises:
        ArrayError: shapes that differ, or what is no probability; so do the functions below.
    """
    p, y = _checked(probability, swept)
    return float(((p - y) ** 2).sum())


def log_loss(probability: ArrayLike, swept: ArrayLike) -> float:
    """Return the sum over voxels of -ln of the probability given to what came true, clipped to `LOG_CLIP`."""
    p, y = _checked(probability, swept)
    p = np.clip(p, *LOG_CLIP)
    return -float(np.log(np.where(y, p, 1.0 - p)).sum())


def average_precision(probability: ArrayLike, swept: ArrayLike) -> float:
    """Return the area under the precision-recall curve as a sum of steps; NaN if no voxel was swept.

    AP = sum_n (R_n - R_(n-1)) P_n over the different probabilities in falling order: voxels of one probability count
    together, so the order of the voxels does not matter.
    """
    p, y = _checked(probability, swept)
    if not y.any():
        return float("nan")
    order = np.argsort(-p, kind="stable")
    p, y = p[order], y[order]
    last = np.append(np.flatnonzero(np.diff(p)), len(p) - 1)  # last voxel of each probability
    hits = np.cumsum(y)[last]
    recall, precision = hits / hits[-1], hits / (last + 1.0)
    return float(np.diff(recall, prepend=0.0) @ precision)


def missed_share(probability: ArrayLike, swept: ArrayLike) -> float:
    """Return the share of swept voxels that were given less than `MISSED_BELOW`; NaN if no voxel was swept."""
    p, y = _checked(probability, swept)
    return float((p[y] < MISSED_BELOW).mean()) if y.any() else float("nan")


@dataclass(frozen=True, eq=False)
class Reliability:
    """How often voxels of a given probability were swept; tables of several predictions add up.

    Attributes:
        count: (B,) voxels whose probability falls into each bin of `BIN_EDGES`; an edge belongs to the bin above,
            1 to the last one.
        probability: (B,) sum of their probabilities.
        swept: (B,) how many of them were swept.
    """

    count: NDArray[np.int64]
    probability: FloatArray
    swept: NDArray[np.int64]

    @classmethod
    def of(cls, probability: ArrayLike, swept: ArrayLike) -> Reliability:
        """Return the table of one prediction."""
        p, y = _checked(probability, swept)
        number = np.clip(np.searchsorted(BIN_EDGES, p, side="right") - 1, 0, len(BIN_EDGES) - 2)
        n = len(BIN_EDGES) - 1
        return cls(
            np.bincount(number, minlength=n).astype(np.int64),
            np.bincount(number, weights=p, minlength=n).astype(np.float64),
            np.bincount(number[y], minlength=n).astype(np.int64),
        )

    @classmethod
    def none(cls) -> Reliability:
        """Return the table of no voxels at all."""
        return cls.of([], [])

    def __add__(self, other: Reliability) -> Reliability:
        return Reliability(self.count + other.count, self.probability + other.probability, self.swept + other.swept)

    @property
    def mean_probability(self) -> FloatArray:
        """(B,) mean probability of each bin's voxels, NaN where there are none."""
        return _ratio(self.probability, self.count)

    @property
    def observed(self) -> FloatArray:
        """(B,) share of each bin's voxels that were swept, NaN where there are none."""
        return _ratio(self.swept, self.count)

    @property
    def error(self) -> float:
        """Mean over all voxels of |mean probability - share swept| of their bin (expected calibration error)."""
        return _mean_gap(self.probability, self.swept, self.count)

    @property
    def error_predicted(self) -> float:
        """The same over the voxels given `MISSED_BELOW` or more: the rest, far from anybody, is many and easy."""
        return _mean_gap(self.probability[1:], self.swept[1:], self.count[1:])


@dataclass(frozen=True, eq=False)
class VoxelScores:
    """All scores of one prediction.

    Attributes:
        squared_error: sum over voxels, in voxels.
        brier: the same as a mean over the region.
        log_loss: mean over the region, nats.
        average_precision: NaN if no voxel was swept.
        missed: share of swept voxels given less than `MISSED_BELOW`; NaN if no voxel was swept.
        n_swept: voxels truly swept.
        n_predicted: expected number of occupied voxels, the sum of the probabilities.
        reliability: counts for calibration.
    """

    squared_error: float
    brier: float
    log_loss: float
    average_precision: float
    missed: float
    n_swept: int
    n_predicted: float
    reliability: Reliability


def voxel_scores(probability: ArrayLike, swept: ArrayLike, region: BoolArray) -> VoxelScores:
    """Score one prediction against what came true.

    The voxels that count are those of `region`, which is the same for all predictors, and wherever else something
    was predicted or happened. Means are taken over the size of the region alone: a prediction outside of it adds
    to the sums and cannot make the mean smaller.

    Args:
        probability: (V,) over the whole grid.
        swept: (V,) booleans.
        region: (V,) booleans, at least one True.

    Raises:
        ArrayError: shapes that differ, an empty region, or what is no probability.
    """
    p, y = np.asarray(probability), np.asarray(swept, dtype=np.bool_)
    if not p.shape == y.shape == region.shape or not region.any():
        raise ArrayError(
            f"scores: wanted as many truths as probabilities and a region of that shape with at least one voxel, got "
            f"{p.shape}, {y.shape} and {region.shape}"
        )
    counted = region | (p != 0.0) | y  # NaN counts, and is refused below
    p, y = p[counted], y[counted]
    size = int(region.sum())
    squared = squared_error(p, y)
    # What lies outside the region and is rightly given nothing costs nothing, so it may be left out of the sums.
    return VoxelScores(
        squared,
        squared / size,
        log_loss(p, y) / size,
        average_precision(p, y),
        missed_share(p, y),
        int(y.sum()),
        float(p.sum()),
        Reliability.of(p, y),
    )


def _checked(probability: ArrayLike, swept: ArrayLike) -> tuple[FloatArray, BoolArray]:
    p = checked("probabilities", probability, ("V",))
    y = np.asarray(swept, dtype=np.bool_)
    if y.shape != p.shape:
        raise ArrayError(f"scores: wanted as many truths as probabilities, got {y.shape} and {p.shape}")
    if len(p) and not (p.min() >= 0.0 and p.max() <= 1.0):
        raise ArrayError(f"scores: wanted probabilities within [0, 1], got {p.min()} to {p.max()}")
    return p, y


def _ratio(part: ArrayLike, whole: NDArray[np.int64]) -> FloatArray:
    ratio: FloatArray = np.divide(part, whole, out=np.full(len(whole), np.nan), where=whole > 0)
    return ratio


def _mean_gap(probability: FloatArray, swept: NDArray[np.int64], count: NDArray[np.int64]) -> float:
    total = int(count.sum())
    return float(np.abs(probability - swept).sum() / total) if total else float("nan")


@dataclass(frozen=True, eq=False)
class Picture:
    """One moment seen from above: the highest value in each column of voxels.

    Attributes:
        percent: share of the motion seen.
        swept: (X, Y) 1 where the body is from then on, else 0.
        predicted: (X, Y) probability.
    """

    percent: int
    swept: NDArray[np.float32]
    predicted: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class MotionOutcome:
    """What a predictor made of one motion that it had not learned from.

    Attributes:
        name: the motion.
        scores: of the prediction after each percentage of the motion.
        update_ns: (T,) how long each update took.
        refused: postures the predictor refused; its prediction then stays what it was.
        prepare_s: how long it took to train without this motion.
        picture: the moment asked for, if this is the motion asked for.
        unlisted: the scores of a place-based predictor that was shown the motion once more, with the motion's place
            taken off its list; None of other predictors, or if no place would be left.
    """

    name: str
    scores: tuple[VoxelScores, ...]
    update_ns: NDArray[np.int64]
    refused: int
    prepare_s: float
    picture: Picture | None
    unlisted: tuple[VoxelScores, ...] | None = None


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
        edges: of the bins; the first bin holds voxels given next to nothing.
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
        count = total.count.astype(np.float64)
        return cls(BIN_EDGES, count, total.mean_probability, total.observed, total.error, total.error_predicted)


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
        unlisted, unlisted_at_percent: as `average` and `at_percent`, of a place-based predictor without the tested
            motion's place; None of other predictors.
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
    unlisted: VoxelFigures | None = None
    unlisted_at_percent: VoxelFigures | None = None

    def figures(self) -> dict[str, Any]:
        """Return everything but the picture, by name."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "picture"}

    @classmethod
    def of(
        cls,
        name: str,
        description: str,
        learned_from_class: str,
        outcomes: Sequence[MotionOutcome],
        mistracked: frozenset[str],
    ) -> PredictorResult:
        """Return the figures of a predictor's outcomes; `mistracked` names motions to leave out once, beside."""
        at_percent = VoxelFigures.at_percents([outcome.scores for outcome in outcomes])
        good = [outcome.scores for outcome in outcomes if outcome.name not in mistracked]
        some_bad = 0 < len(good) < len(outcomes)
        again = [outcome.unlisted for outcome in outcomes if outcome.unlisted is not None]
        unlisted = VoxelFigures.at_percents(again) if again else None
        single = {o.name: VoxelFigures.at_percents([o.scores]).averaged() for o in outcomes}
        update_ms = np.concatenate([outcome.update_ns for outcome in outcomes]) * 1e-6
        return cls(
            name,
            description,
            learned_from_class,
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
            None if unlisted is None else unlisted.averaged(),
            unlisted,
        )


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean over the first axis of what exists, NaN where nothing does."""
    exists = np.isfinite(values)
    count = exists.sum(axis=0)
    total = np.where(exists, values, 0.0).sum(axis=0)
    mean: FloatArray = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean
