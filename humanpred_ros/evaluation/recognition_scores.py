"""How good a classifier is, as numbers: pure functions of posteriors (N motions, P percents, C classes).

Several of them return their figures by name, as they stand in the JSON file of `humanpred evaluate recognition`. Also
here: what lies beside a library, the published curve and advice on single recordings.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.csv_files import read_rows, read_table

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

#: Where the papers' data folder keeps the published curve and the advice, relative to a library in it.
REFERENCE_BESIDE_LIBRARY = Path("reference") / "authors_fig6_curve.csv"
ADVICE_BESIDE_LIBRARY = "outliers.csv"
_ADVICE_COLUMNS = ("set", "class", "traj_id", "advice")
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


def curve_figures(rate: FloatArray) -> dict[str, Any]:
    """Return the figures of a curve (100,) of the share of motions recognised at each percent.

    Returns:
        `first_50_percent`, `first_90_percent`: percent of the motion from which on so many motions are recognised, None
        if never; `rate_at_60`: share recognised at 60 % of the motion; `least_from_80`: lowest share from 80 % on.
    """
    return {
        "first_50_percent": settled_percent(rate, 0.5),
        "first_90_percent": settled_percent(rate, 0.9),
        "rate_at_60": float(rate[59]),
        "least_from_80": float(rate[79:].min()),
    }


def worst_drop(rate: FloatArray, other: FloatArray, beyond_percent: int = 40) -> tuple[float, int]:
    """Return by how many percentage points `other` is below `rate` at worst, beyond a percent, and at which."""
    drop = np.where(beyond_percent < PERCENTS, 100.0 * (rate - other), -np.inf)
    k = int(np.argmax(drop))
    return float(drop[k]), int(PERCENTS[k])


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


def calibration(
    confidence: FloatArray, right: BoolArray, rng: np.random.Generator, n_draws: int = 200
) -> dict[str, Any]:
    """Return whether motions recognised with a confidence of x are right in a share x of the cases.

    The expected calibration error weights |share right - mean confidence| of ten equal bins by their size. With few
    motions it is well above 0 even for a classifier that is calibrated perfectly; the floors say how far.

    Args:
        confidence: (N, P) probability of the class decided for.
        right: (N, P) whether that class was the true one.
        rng: for the floors.
        n_draws: how many perfectly calibrated classifiers they are averaged over.

    Returns:
        `error`: (P,) per percent of the motion; `error_mean`: averaged over the percents; `error_pooled`: over all
        percents at once; `floor_mean`, `floor_pooled`: what a perfectly calibrated classifier with these confidences
        and this number of motions is expected to show. Its hits are drawn with one random number a motion: as dependent
        along the motion as can be, so the pooled floor is a high one. `count`, `confidence`, `right`: (10,) how many
        there are in each bin over all percents, their mean confidence and the share right; NaN where it is empty.
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
    return {
        "error_mean": error_mean,
        "error_pooled": error_pooled,
        "floor_mean": float(floor_mean),
        "floor_pooled": float(floor_pooled),
        "error": error,
        "count": count,
        "confidence": mean_confidence,
        "right": share_right,
    }


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


def unknown_score(by_class: Mapping[str, FloatArray], known: FloatArray) -> dict[str, Any]:
    """Return how well motions of classes that were never learned are told from left-out motions of learned ones.

    Args:
        by_class: (N_c, 100) probability of no class on the motions of each class, by classifiers that have not learned
            it.
        known: (N, 100) the same on motions of learned classes.

    Returns:
        `says_something`: False if the classifier gives the same probability of no class to all motions; its AUROC is
        then None. `tenths`: (10,) percents of `auroc` (the probability that an unknown motion gets a higher probability
        of no class than a known one) and of `refused_unknown` and `refused_known` (shares of the motions whose
        probability of no class is at least `threshold`). `auroc_at_60`, `auroc_at_60_by_class`,
        `refused_at_60_by_class`: the same at 60 %, over all motions or by the class left out. `quartiles`: (3, 100) of
        the probability of no class over the unknown motions.
    """
    unknown = np.concatenate(list(by_class.values()))
    says_something = bool(np.ptp(np.concatenate([unknown, known])) > 0)
    areas = np.array([auroc(unknown[:, p - 1], known[:, p - 1]) for p in _TENTHS])
    refused = [(scores >= REFUSAL_THRESHOLD)[:, _TENTHS - 1].mean(axis=0) for scores in (unknown, known)]
    area_by_class = {label: auroc(scores[:, 59], known[:, 59]) for label, scores in by_class.items()}
    return {
        "says_something": says_something,
        "threshold": REFUSAL_THRESHOLD,
        "tenths": _TENTHS,
        "auroc": areas if says_something else None,
        "refused_unknown": refused[0],
        "refused_known": refused[1],
        "auroc_at_60": float(areas[5]) if says_something else None,
        "auroc_at_60_by_class": area_by_class if says_something else None,
        "refused_at_60_by_class": {
            label: float((scores[:, 59] >= REFUSAL_THRESHOLD).mean()) for label, scores in by_class.items()
        },
        "quartiles": quartiles(unknown),
    }


def read_reference(path: str | Path) -> dict[str, Any]:
    """Return the curve of a CSV file with the columns phase_percent (1 to 100) and recognition_rate (0 to 1).

    Returns:
        `source`, the name of the file; `rate`, (100,) the share of motions recognised at each percent; `figures` of
        the curve (`curve_figures`).

    Raises:
        LibraryFormatError: no such file, or no table of these columns.
        UsageError: other percents, or rates that are none.
    """
    table = read_table(Path(path), ("phase_percent", "recognition_rate"))
    rate = table["recognition_rate"]
    if table["phase_percent"].tolist() != PERCENTS.tolist() or not ((rate >= 0) & (rate <= 1)).all():
        raise UsageError(
            f"{path}: wanted the percents 1 to 100 in order, each with a rate of 0 to 1, got {len(rate)} rows; "
            "complete it or give another file"
        )
    return {"source": table.path.name, "rate": rate, "figures": curve_figures(rate)}


def reference_beside(library: Path) -> dict[str, Any] | None:
    """Return the published curve that lies beside a library, None if there is none."""
    path = library.resolve().parent / REFERENCE_BESIDE_LIBRARY
    return read_reference(path) if path.exists() else None


def advice_beside(library: Path, name: str) -> dict[str, str]:
    """Return the advice on single motions (`class/index`) of the library called `name` that lies beside it.

    The file has the columns set, class, traj_id and advice, of which the first word counts (exclude, suspect,
    keep). Empty if there is no file.

    Raises:
        LibraryFormatError: a file that cannot be read as CSV.
        UsageError: a file with other columns.
    """
    path = library.resolve().parent / ADVICE_BESIDE_LIBRARY
    if not path.exists():
        return {}
    (_, head), *lines = read_rows(path)
    missing = [column for column in _ADVICE_COLUMNS if column not in head]
    if missing:
        raise UsageError(
            f"{path}: wanted the columns {', '.join(_ADVICE_COLUMNS)}, {', '.join(missing)} is missing; "
            "give a file that has them"
        )
    rows = [dict(zip(head, fields, strict=False)) for _, fields in lines]
    return {
        f"{row['class']}/{row['traj_id']}": row.get("advice", "").split(" ")[0] for row in rows if row["set"] == name
    }
