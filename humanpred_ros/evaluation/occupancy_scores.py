"""Where voxel probabilities are scored (lattice and region), and how good they are beside what was really swept.

Misses are counted apart from other errors, because a swept voxel that was given next to nothing is what hurts.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

from humanpred_ros import plugins
from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.evaluation.leave_one_out import UpdateLog, learned_from_class
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary, pelvis_columns
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.training import REACHING_LINK
from humanpred_ros.viewing.reliability import BIN_EDGES as PREDICTED_EDGES
from humanpred_ros.viewing.reliability import MISSED_BELOW

BoolArray = NDArray[np.bool_]

#: P1's environment box along x, y, z (P1 occupancy); in voxels of 0.05 m it is 80 x 80 x 48.
BOX_M = (4.0, 4.0, 2.4)
P1_RESOLUTION_M = 0.05
#: Shares of the library's places outside of which a place may be a tracker's mistake.
_OUTER_PERCENT = (1.0, 99.0)
#: Probabilities are taken to be within these for the log score, which a single sure mistake would make infinite.
LOG_CLIP = (0.001, 0.999)
#: Edges of the calibration table: ten bins, the first of which is split at what counts as missed. An edge belongs to
#: the bin above, 1 to the last one.
BIN_EDGES = (0.0, *PREDICTED_EDGES)


def grid_around(library: MotionLibrary, human: HumanModel, resolution_m: float = P1_RESOLUTION_M) -> VoxelGrid:
    """Return a lattice of P1's size in the library's own frame, centred where its people stand and reach.

    Horizontally the centre is the middle of all start pelvises and palms (but for the outermost hundredths), vertically
    the middle of the body at the median start. The corner lies on a multiple of the resolution.

    Raises:
        UsageError: people or palms that do not fit into the box, or a resolution that is not a length within it.
        MotionError, HumanModelError: a library whose bodies cannot stand anywhere, or of another human.
    """
    if not 0.0 < resolution_m <= min(BOX_M):
        raise UsageError(f"grid: wanted voxels of a positive size up to {min(BOX_M)} m, got {resolution_m}")
    human.check_dofs(library.dof_names)
    columns = pelvis_columns(library.dof_names)
    starts = np.array([motion.q[0] for motion in library])
    palms = human.forward(np.concatenate([motion.q for motion in library]))[REACHING_LINK]
    boxes = [np.percentile(places, _OUTER_PERCENT, axis=0) for places in (starts[:, columns[:3]], palms)]
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    body_z = human.surface_points(np.median(starts, axis=0))[:, 2]
    low[2], high[2] = min(low[2], body_z.min()), max(high[2], body_z.max())
    middle = (low + high) / 2
    middle[2] = (body_z.min() + body_z.max()) / 2
    box = np.array(BOX_M)
    if (low < middle - box / 2).any() or (high > middle + box / 2).any():
        raise UsageError(
            f"grid: wanted a library whose people fit into {BOX_M} m, {library.name} extends over "
            f"{np.round(high - low, 2).tolist()} m; name a scene with a larger grid"
        )
    # Rounded again, so that -0.6 is -0.6 in a file, too.
    origin = np.round(np.round((middle - box / 2) / resolution_m) * resolution_m, 9)
    x, y, z = (round(length / resolution_m) for length in BOX_M)
    return VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), resolution_m, (x, y, z))


def swept_region(library: MotionLibrary, voxeliser: BodyVoxeliser, margin_voxels: int) -> BoolArray:
    """Return the boolean grid of voxels that some motion sweeps, widened by a margin: where scores are taken.

    Raises:
        UsageError: no motion touches the grid.
    """
    region = np.zeros(voxeliser.grid.shape, dtype=np.bool_)
    for motion in library:
        region |= voxeliser.mask(motion.q)
    if not region.any():
        raise UsageError(
            f"grid: wanted people within it, those of {library.name} are all outside; "
            "check the scene's human placement and the shift"
        )
    return binary_dilation(region, iterations=margin_voxels) if margin_voxels else region


def voxel_scores(probability: ArrayLike, swept: ArrayLike, region: BoolArray) -> dict[str, float]:
    """Score one prediction against what came true.

    The voxels that count are those of `region`, which is the same for all predictors, and wherever else something
    was predicted or happened. Means are taken over the size of the region alone: a prediction outside of it adds
    to the sums and cannot make the mean smaller.

    Args:
        probability: (V,) over the whole grid.
        swept: (V,) whether it came true.
        region: (V,) booleans, at least one True.

    Returns:
        `brier`, the mean of (p - y)^2; `squared_error`, the same as a sum, in voxels; `log_loss`, the mean of -ln of
        the probability given to what came true, clipped to `LOG_CLIP`, in nats; `average_precision`, the area under
        the precision-recall curve; `missed`, the share of swept voxels given less than `MISSED_BELOW`; `n_swept`,
        voxels truly swept; `n_predicted`, the expected number of occupied voxels. Average precision and missed share
        are NaN if nothing was swept.

    Raises:
        ArrayError: shapes that differ, an empty region, or what is no probability.
    """
    p, y = _checked(probability, swept, region)
    size = int(region.sum())
    squared = float(((p - y) ** 2).sum())
    clipped = np.clip(p, *LOG_CLIP)
    # What lies outside the region and is rightly given nothing costs nothing, so it may be left out of the sums.
    return {
        "brier": squared / size,
        "squared_error": squared,
        "log_loss": -float(np.log(np.where(y, clipped, 1.0 - clipped)).sum()) / size,
        "average_precision": _average_precision(p, y) if y.any() else float("nan"),
        "missed": float((p[y] < MISSED_BELOW).mean()) if y.any() else float("nan"),
        "n_swept": int(y.sum()),
        "n_predicted": float(p.sum()),
    }


def _average_precision(p: FloatArray, y: BoolArray) -> float:
    """Return sum_n (R_n - R_(n-1)) P_n over the different probabilities in falling order.

    Voxels of one probability count together, so the order of the voxels does not matter.
    """
    order = np.argsort(-p, kind="stable")
    p, y = p[order], y[order]
    last = np.append(np.flatnonzero(np.diff(p)), len(p) - 1)  # last voxel of each probability
    hits = np.cumsum(y)[last]
    recall, precision = hits / hits[-1], hits / (last + 1.0)
    return float(np.diff(recall, prepend=0.0) @ precision)


def reliability(probability: ArrayLike, swept: ArrayLike, region: BoolArray) -> FloatArray:
    """Return how often voxels of a given probability were swept, for each bin of `BIN_EDGES`; tables add up.

    Returns:
        (3, B) the number of voxels, the sum of their probabilities, and how many of them were swept.

    Raises:
        ArrayError: as `voxel_scores`.
    """
    p, y = _checked(probability, swept, region)
    n = len(BIN_EDGES) - 1
    number = np.clip(np.searchsorted(BIN_EDGES, p, side="right") - 1, 0, n - 1)
    counts = np.bincount(number, minlength=n), np.bincount(number, p, n), np.bincount(number[y], minlength=n)
    return np.array(counts, dtype=np.float64)


def calibration(table: FloatArray) -> dict[str, Any]:
    """Return the calibration that follows from a table (3, B) of `reliability`.

    Returns:
        `edges` of the bins; `count`, `mean_probability` and `observed` (share swept) of each, NaN where it is empty;
        `error`, the mean over all voxels of |mean probability - share swept| of their bin (expected calibration
        error); `error_predicted`, the same over the voxels given `MISSED_BELOW` or more: the rest, far from anybody,
        is many and easy.
    """
    count, probability, swept = table
    with np.errstate(invalid="ignore"):
        return {
            "edges": BIN_EDGES,
            "count": count,
            "mean_probability": probability / count,
            "observed": swept / count,
            "error": float(np.abs(probability - swept).sum() / count.sum()),
            "error_predicted": float(np.abs(probability - swept)[1:].sum() / count[1:].sum()),
        }


def _mean_scores(scores: Sequence[Sequence[dict[str, float]]]) -> dict[str, FloatArray]:
    """Return the (P,) means over motions of the scores (N motions, P percents), by name.

    Where nothing was swept (the body had left the grid) some scores do not exist: means are over the other motions.
    """
    return {name: _mean_of_finite(np.array([[s[name] for s in row] for row in scores])) for name in scores[0][0]}


def _mean_of_finite(values: FloatArray) -> FloatArray:
    """Return the mean over the first axis of what is finite, NaN where nothing is."""
    exists = np.isfinite(values)
    count = exists.sum(axis=0)
    total = np.where(exists, values, 0.0).sum(axis=0)
    mean: FloatArray = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean


@dataclass(frozen=True, eq=False)
class Played:
    """What a predictor made of one motion that it had not learned from."""

    scores: list[dict[str, float]]  #: of the prediction after each percentage of the motion (`voxel_scores`)
    table: FloatArray  #: calibration counts of these predictions together (`reliability`)
    log: UpdateLog  #: of the updates
    #: (2, X, Y) what is swept and what is predicted, the highest value in each column of voxels; None unless this is
    #: the motion to draw
    picture: NDArray[np.float32] | None


def predictor_figures(
    name: str, found: Mapping[str, tuple[Played, Played | None, float]], mistracked: Collection[str]
) -> dict[str, Any]:
    """Return the figures of a predictor (`evaluate_occupancy`).

    Args:
        name: of the predictor.
        found: by motion, what it made of it, the same without the motion's place, and the seconds of training.
        mistracked: motions to leave out once, beside.
    """
    scores = {motion: listed.scores for motion, (listed, _, _) in found.items()}
    good = [scores[motion] for motion in found if motion not in mistracked]
    unlisted = [again.scores for _, again, _ in found.values() if again is not None]
    at_percent = _mean_scores(list(scores.values()))
    unlisted_at_percent = _mean_scores(unlisted) if unlisted else None
    single = {motion: _average(_mean_scores([rows])) for motion, rows in scores.items()}
    update_ms = 1e-6 * np.concatenate([listed.log.update_ns for listed, _, _ in found.values()])
    return {
        "name": name,
        "description": plugins.describe(plugins.PREDICTORS, name),
        "learned_from_class": learned_from_class(name),
        "average": _average(at_percent),
        "without_mistracked": _average(_mean_scores(good)) if 0 < len(good) < len(found) else None,
        "at_percent": at_percent,
        "motions": {motion: {key: means[key] for key in ("brier", "missed")} for motion, means in single.items()},
        "calibration": calibration(np.sum([listed.table for listed, _, _ in found.values()], axis=0)),
        "timing": {
            "median_ms": float(np.median(update_ms)),
            "p99_ms": float(np.percentile(update_ms, 99)),
            "prepare_s": float(np.mean([prepare_s for _, _, prepare_s in found.values()])),
        },
        "refused_postures": sum(listed.log.refused for listed, _, _ in found.values()),
        "unlisted": None if unlisted_at_percent is None else _average(unlisted_at_percent),
        "unlisted_at_percent": unlisted_at_percent,
    }


def _average(at_percent: Mapping[str, FloatArray]) -> dict[str, float]:
    return {name: float(_mean_of_finite(values)) for name, values in at_percent.items()}


def _checked(probability: ArrayLike, swept: ArrayLike, region: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Return probability and truth of the voxels that count."""
    p, y = np.asarray(probability), np.asarray(swept, dtype=np.bool_)
    if not p.shape == y.shape == region.shape or not region.any():
        raise ArrayError(
            f"scores: wanted as many truths as probabilities and a region of that shape with at least one voxel, got "
            f"{p.shape}, {y.shape} and {region.shape}"
        )
    counted = region | (p != 0.0) | y  # NaN counts, and is refused below
    p, y = checked("probabilities", p[counted], ("V",)), y[counted]
    if not (p.min() >= 0.0 and p.max() <= 1.0):
        raise ArrayError(f"scores: wanted probabilities within [0, 1], got {p.min()} to {p.max()}")
    return p, y
