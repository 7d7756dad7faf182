"""How good a classifier is, as numbers: pure functions of posteriors (N motions, P percents, C classes)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from humanpred_ros.geometry.checks import FloatArray

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

#: Percents of a motion at which the posterior is looked at.
PERCENTS = np.arange(1, 101)
N_BINS = 10
#: A posterior this probable of no class counts as a refusal.
REFUSAL_THRESHOLD = 0.5
_TENTHS = np.arange(10, 101, 10)


def percent_indices(n_frames: int) -> IntArray:
    """Return (100,) the index of the last posture seen at each percent p: ceil(p / 100 * n_frames) - 1."""
    return (PERCENTS * n_frames + 99) // 100 - 1  # in whole numbers: 0.07 * 100 is more than 7


def decided_right(probability: FloatArray, truth: IntArray) -> BoolArray:
    """Return (N, P) whether the true class alone is the most probable one; a tie is no recognition.

    Args:
        probability: (N, P, C).
        truth: (N,) column of the true class of each motion.
    """
    true = np.take_along_axis(probability, truth[:, None, None], axis=2)
    others = np.where(np.arange(probability.shape[2]) == truth[:, None, None], -np.inf, probability)
    right: BoolArray = true[..., 0] > others.max(axis=2)
    return right


def settled_percent(rate: FloatArray, level: float) -> int | None:
    """Return the first percent from which on the rate (100,) stays at `level` or above; None if it ends below."""
    below = np.flatnonzero(rate < level - 1e-12)  # 120 of 200 is 60 %, whatever rounding says
    since = int(below[-1]) + 1 if len(below) else 0
    return None if since == len(rate) else int(PERCENTS[since])


@dataclass(frozen=True)
class CurveFigures:
    """The figures a recognition curve is known by.

    Attributes:
        first_50_percent, first_90_percent: percent of the motion from which on so many motions are recognised.
        rate_at_60: share recognised at 60 % of the motion.
        least_from_80: lowest share recognised from 80 % of the motion on.
    """

    first_50_percent: int | None
    first_90_percent: int | None
    rate_at_60: float
    least_from_80: float


def curve_figures(rate: FloatArray) -> CurveFigures:
    """Return the figures of a curve (100,) of the share of motions recognised at each percent."""
    return CurveFigures(settled_percent(rate, 0.5), settled_percent(rate, 0.9), float(rate[59]), float(rate[79:].min()))


def worst_drop(rate: FloatArray, other: FloatArray, beyond_percent: int = 40) -> tuple[float, int]:
    """Return by how many percentage points `other` is below `rate` at worst, beyond a percent, and at which."""
    drop = np.where(beyond_percent < PERCENTS, 100.0 * (rate - other), -np.inf)
    k = int(np.argmax(drop))
    return float(drop[k]), int(PERCENTS[k])


def rms_difference(a: FloatArray, b: FloatArray) -> float:
    """Return the root of the mean squared difference of two curves."""
    return float(np.sqrt(np.mean((a - b) ** 2)))


def log_loss(probability: FloatArray, truth: IntArray, clip: float) -> FloatArray:
    """Return (P,) the mean over motions of -ln of the true class's probability, taken as `clip` where it is less."""
    true = np.take_along_axis(probability, truth[:, None, None], axis=2)[..., 0]
    loss: FloatArray = -np.log(np.maximum(true, clip)).mean(axis=0)
    return loss


def brier_score(probability: FloatArray, truth: IntArray) -> FloatArray:
    """Return (P,) the mean over motions of the squared distance between posterior and truth, 0 to 2."""
    target = np.arange(probability.shape[2]) == truth[:, None, None]
    score: FloatArray = ((probability - target) ** 2).sum(axis=2).mean(axis=0)
    return score


@dataclass(frozen=True)
class Calibration:
    """Whether motions recognised with a confidence of x are right in a share x of the cases.

    The expected calibration error weights |share right - mean confidence| of ten equal bins by their size. With few
    motions it is well above 0 even for a classifier that is calibrated perfectly; the floors say how far.

    Attributes:
        error_mean: error of each percent of the motion, averaged over the percents.
        error_pooled: error over all percents at once.
        floor_mean, floor_pooled: what a perfectly calibrated classifier with these confidences and this number of
            motions is expected to show. Its hits are drawn with one random number a motion: as dependent along the
            motion as can be, so the pooled floor is a high one.
        error: (100,) per percent.
        count, confidence, right: (10,) reliability table over all percents: how many, their mean confidence and
            the share right; NaN where a bin is empty.
    """

    error_mean: float
    error_pooled: float
    floor_mean: float
    floor_pooled: float
    error: FloatArray
    count: IntArray
    confidence: FloatArray
    right: FloatArray


def calibration(confidence: FloatArray, right: BoolArray, rng: np.random.Generator, n_draws: int = 200) -> Calibration:
    """Compare confidences (N, P) with whether they were justified (N, P).

    Args:
        confidence: probability of the class decided for.
        right: whether that class was the true one.
        rng: for the floors.
        n_draws: how many perfectly calibrated classifiers they are averaged over.
    """
    n, n_percents = confidence.shape
    bins = np.minimum((confidence * N_BINS).astype(np.int64), N_BINS - 1)
    cell = (np.arange(n_percents) * N_BINS + bins).ravel()

    def gaps(hits: BoolArray) -> FloatArray:
        """Return (P, 10) the sum of hits less the sum of confidences."""
        weights: Any = (hits - confidence).ravel()
        return np.bincount(cell, weights, n_percents * N_BINS).reshape((n_percents, N_BINS)).astype(np.float64)

    floor_mean, floor_pooled = np.mean(
        [_errors(gaps(rng.random((n, 1)) < confidence), n)[1:] for _ in range(n_draws)], axis=0
    )
    error, error_mean, error_pooled = _errors(gaps(right), n)
    count = np.bincount(bins.ravel(), minlength=N_BINS)
    with np.errstate(invalid="ignore"):
        mean_confidence = np.bincount(bins.ravel(), confidence.ravel(), N_BINS) / count
        share_right = np.bincount(bins.ravel(), right.ravel(), N_BINS) / count
    return Calibration(
        error_mean, error_pooled, float(floor_mean), float(floor_pooled), error, count, mean_confidence, share_right
    )


def _errors(gaps: FloatArray, n: int) -> tuple[FloatArray, float, float]:
    """Return the error per percent, its mean, and the error of all percents pooled."""
    error: FloatArray = np.abs(gaps).sum(axis=1) / n
    return error, float(error.mean()), float(np.abs(gaps.sum(axis=0)).sum() / (n * len(gaps)))


def confusion(probability: FloatArray, truth: IntArray) -> IntArray:
    """Return (C, C + 1) counts, true class by decision; the last column counts ties, which decide nothing.

    Args:
        probability: (N, C) at one percent of the motion.
        truth: (N,) column of the true class.
    """
    n_classes = probability.shape[1]
    best = probability.max(axis=1)
    tied = (probability == best[:, None]).sum(axis=1) > 1
    decision = np.where(tied, n_classes, probability.argmax(axis=1))
    counts = np.zeros((n_classes, n_classes + 1), dtype=np.int64)
    np.add.at(counts, (truth, decision), 1)
    return counts


def auroc(positive: FloatArray, negative: FloatArray) -> float:
    """Return the probability that a score (N,) of a positive exceeds one (M,) of a negative; ties count half."""
    ranks = rankdata(np.concatenate([positive, negative]))
    n, m = len(positive), len(negative)
    return float((ranks[:n].sum() - n * (n + 1) / 2) / (n * m))


def quartiles(values: FloatArray) -> FloatArray:
    """Return (3, P) lower quartile, median and upper quartile over the first axis of (N, P)."""
    found: FloatArray = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    return found


@dataclass(frozen=True)
class UnknownScore:
    """How well motions of classes that were never learned are told from left-out motions of learned ones.

    Attributes:
        says_something: False if the classifier gives the same probability of no class to all motions; its AUROC
            is then None.
        tenths: (10,) percents 10, 20, .. 100 of the following.
        auroc: (10,) probability that an unknown motion gets a higher probability of no class than a known one.
        refused_unknown, refused_known: (10,) share of unknown and known motions whose probability of no class is
            at least `threshold`.
        auroc_at_60: the sixth of `auroc`.
        auroc_at_60_by_class: the same for the motions of each class when it is the one left out.
        refused_at_60_by_class: share of them refused.
        quartiles: (3, 100) quartiles of the probability of no class over the unknown motions.
    """

    says_something: bool
    threshold: float
    tenths: IntArray
    auroc: FloatArray | None
    refused_unknown: FloatArray
    refused_known: FloatArray
    auroc_at_60: float | None
    auroc_at_60_by_class: Mapping[int, float] | None
    refused_at_60_by_class: Mapping[int, float]
    quartiles: FloatArray


def unknown_score(by_class: Mapping[int, FloatArray], known: FloatArray) -> UnknownScore:
    """Compare the probability of no class on motions of classes left out with that on motions of known ones.

    Args:
        by_class: (N_c, 100) of the motions of each class, by classifiers that have not learned it.
        known: (N, 100) of motions of learned classes.
    """
    unknown = np.concatenate(list(by_class.values()))
    says_something = bool(np.ptp(np.concatenate([unknown, known])) > 0)
    areas = np.array([auroc(unknown[:, p - 1], known[:, p - 1]) for p in _TENTHS])
    refused_unknown, refused_known = (
        (scores[:, _TENTHS - 1] >= REFUSAL_THRESHOLD).mean(axis=0) for scores in (unknown, known)
    )
    area_by_class = {label: auroc(scores[:, 59], known[:, 59]) for label, scores in by_class.items()}
    return UnknownScore(
        says_something=says_something,
        threshold=REFUSAL_THRESHOLD,
        tenths=_TENTHS,
        auroc=areas if says_something else None,
        refused_unknown=refused_unknown,
        refused_known=refused_known,
        auroc_at_60=float(areas[5]) if says_something else None,
        auroc_at_60_by_class=area_by_class if says_something else None,
        refused_at_60_by_class={
            label: float((scores[:, 59] >= REFUSAL_THRESHOLD).mean()) for label, scores in by_class.items()
        },
        quartiles=quartiles(unknown),
    )


@dataclass(frozen=True)
class SpeedScore:
    """How well the same motions are recognised when done faster or slower.

    Attributes:
        speed: factor of the recorded speed.
        rate: (100,) share recognised at each percent of the motion.
        worst_drop_points, worst_drop_percent: by how many percentage points the share is below that at the recorded
            speed at worst, beyond 40 % of the motion, and at which percent.
    """

    speed: float
    rate: FloatArray
    worst_drop_points: float
    worst_drop_percent: int


@dataclass(frozen=True)
class GroupScore:
    """The curve's figures for part of the motions.

    Attributes:
        group: which motions, in words.
        n_motions: how many.
        figures: of their curve.
    """

    group: str
    n_motions: int
    figures: CurveFigures


@dataclass(frozen=True)
class Timing:
    """Times; the only part of a result that differs from run to run.

    Attributes:
        fit_s: median time to learn the whole library, one BLAS thread.
        n_fits: number of fits timed.
        update_us, update_us_p99: median and 99 % quantile of the time of one update, over all frames of all left-out
            motions.
        wall_s: from start to end of this classifier's evaluation, process start and reading included.
        cpu_s: processor time by part, summed over the processes; fitting the whole library in each comes on top.
    """

    fit_s: float
    n_fits: int
    update_us: float
    update_us_p99: float
    wall_s: float
    cpu_s: Mapping[str, float]


@dataclass(frozen=True)
class ClassifierResult:
    """Leave-one-out figures of one classifier. All but the speeds and the unknown motions are at recorded speed.

    Attributes:
        name, settings: which classifier.
        learned_of_class: what it knew of the tested motion's class, in words; nothing of the motion in any case.
        rate: (100,) share of motions whose true class alone is the most probable, after each percent of postures.
        figures: of that curve.
        reference_rms: root mean square difference to the published curve, if there is one.
        log_loss: mean over motions and percents of -ln of the true class's probability, given that the motion is of
            some class, by the least probability counted ("clip"); one motion given up for certain costs
            -ln(clip) at each percent.
        log_loss_curve: (100,) the same per percent, for the larger clip.
        brier, brier_curve: mean squared distance of posterior and truth, 0 to 2; over all, and per percent.
        calibration: of the probability of the most probable class, given that the motion is of some class.
        calibration_with_unknown: the same without that condition, so that a probability of no class lowers it.
        confusion_at_60: (C, C + 1) true class by decision, undecided last, in the order of the labels.
        unknown_on_known: mean probability of no class at 10, 30, 60 and 90 % of motions of known classes.
        unknown_quartiles: (3, 100) its quartiles over them.
        speeds: further speeds.
        unknown: motions of classes never learned; None if not asked for, or with too few classes.
        groups: parts of the motions that somebody has flagged, if the library has such flags.
        refused_postures: how many postures of the left-out motions the classifier refused.
        timing: times.
    """

    name: str
    settings: Mapping[str, Any]
    learned_of_class: str
    rate: FloatArray
    figures: CurveFigures
    reference_rms: float | None
    log_loss: Mapping[str, float]
    log_loss_curve: FloatArray
    brier: float
    brier_curve: FloatArray
    calibration: Calibration
    calibration_with_unknown: Calibration
    confusion_at_60: IntArray
    unknown_on_known: Mapping[int, float]
    unknown_quartiles: FloatArray
    speeds: tuple[SpeedScore, ...]
    unknown: UnknownScore | None
    groups: tuple[GroupScore, ...]
    refused_postures: int
    timing: Timing
