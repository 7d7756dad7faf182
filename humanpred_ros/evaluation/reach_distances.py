"""How far a predicted reach is from the recorded one: the two distances of P2, and a corrected third.

Reaches are compared by dynamic time warping (docs/papers.md, "P2 distances").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from humanpred_ros.errors import HumanModelError, MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.human.model import HumanModel

#: Links whose origins the joint-centre distance compares.
CENTRES = ("pelvis", "torso", "right_shoulder", "right_elbow", "right_wrist")
PALM = "right_palm"
#: Metres that a radian of the palm's orientation counts; agrees with P2's Table I.
ORIENTATION_M_PER_RAD = 0.2
#: Above this the authors' code takes two orientations for equal.
_EQUAL = 0.99999999


class ReachDistance(NamedTuple):
    """Distances of two reaches: metres, summed over the frames of the best time warping."""

    joint_m: float  #: of pelvis, torso, shoulder, elbow and wrist, summed
    #: of the palm and its orientation as in the authors' code. A wrong sign makes it depend on the absolute
    #: orientation: a reach is 10 to 33 from itself. Only this can be compared with P2's tables.
    task_as_coded_m: float
    task_m: float  #: of the palm and its orientation, as meant: 0 for equal reaches


def reach_distance(model: HumanModel, predicted: ArrayLike, real: ArrayLike) -> ReachDistance:
    """Return the distances between reaches (n, J) and (m, J) of one human.

    P2 compares them at 100 Hz, both with the frames of the recording.

    Raises:
        MotionError: an empty reach, or values that are not finite.
        HumanModelError: another number of DoFs, or a model without one of the links.
    """
    lacking = [name for name in (*CENTRES, PALM) if name not in model.link_names]
    if lacking:
        raise HumanModelError(
            f"comparing reaches of {model.name}: wanted the links {', '.join((*CENTRES, PALM))}, "
            f"it has no {', '.join(lacking)}"
        )
    ours = model.link_poses(checked("predicted reach", predicted, ("n", "J"), error=MotionError))
    theirs = model.link_poses(checked("real reach", real, ("m", "J"), error=MotionError))
    *centres, palm = ((ours[:, k], theirs[:, k]) for k in map(model.link_names.index, (*CENTRES, PALM)))
    joint = np.zeros((len(ours), len(theirs)))
    for a, b in centres:
        joint += cdist(a[:, :3, 3], b[:, :3, 3])
    away = cdist(palm[0][:, :3, 3], palm[1][:, :3, 3])
    p, q = (quaternions(poses[:, :3, :3]) for poses in palm)
    return ReachDistance(
        joint_m=warped_sum(joint),
        task_as_coded_m=warped_sum(away + ORIENTATION_M_PER_RAD * _angle_as_coded(p, q)),
        task_m=warped_sum(away + ORIENTATION_M_PER_RAD * angles(p, q)),
    )


def quaternions(R: FloatArray) -> FloatArray:
    """Return unit quaternions (n, 4), w first, of rotations (n, 3, 3).

    The sign matters to the distance as coded, and is chosen as the authors' library does: w > 0 where the trace is
    positive, elsewhere the component of the largest diagonal element is positive.
    """
    found = np.roll(Rotation.from_matrix(np.array(R)).as_quat(), 1, axis=1)
    diagonal = np.diagonal(R, axis1=1, axis2=2)
    which = np.where(diagonal.sum(axis=1) > 0.0, 0, 1 + diagonal.argmax(axis=1))
    signed: FloatArray = found * np.where(found[np.arange(len(R)), which] < 0.0, -1.0, 1.0)[:, None]
    return signed


def angles(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return the angles (n, m) in rad, 0 to pi, between orientations (n, 4) and (m, 4) as unit quaternions."""
    # From the chord, which loses no digits near zero; the nearer of q and -q.
    chord = np.minimum(cdist(p, q), cdist(p, -q))
    angle: FloatArray = 4.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0))
    return angle


def _angle_as_coded(p: FloatArray, q: FloatArray) -> FloatArray:
    D = 1.0 - np.outer(p[:, 0], q[:, 0]) + p[:, 1:] @ q[:, 1:].T
    angle: FloatArray = np.where(D < _EQUAL, np.arccos(np.clip(2.0 * D**2 - 1.0, -1.0, 1.0)), 0.0)
    return angle


def warped_sum(costs: FloatArray) -> float:
    """Return the least sum of `costs` (n, m) over all warpings of two sequences from their first to their last frames.

    costs[i, j] is the distance of frame i of one sequence from frame j of the other. Steps are (1, 0), (0, 1) and
    (1, 1), each with weight 1; there is no window, and the sum is not divided by the path's length.

    Raises:
        MotionError: an empty table, or values that are not finite.
    """
    table = np.ascontiguousarray(checked("costs", costs, ("n", "m"), error=MotionError))
    if table.size == 0:
        raise MotionError(f"time warping: wanted at least one frame on both sides, got {table.shape}")
    return float(_warp(table))


@exact
def _warp(costs: FloatArray) -> float:
    n, m = costs.shape
    row = np.cumsum(costs[0])
    for i in range(1, n):
        diagonal = row[0]
        row[0] += costs[i, 0]
        for j in range(1, m):
            above = row[j]
            row[j] = costs[i, j] + min(above, row[j - 1], diagonal)
            diagonal = above
    last: float = row[m - 1]
    return last
