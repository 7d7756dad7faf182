"""Joint angles of rotations in ISB's order, in closed form and continuous in time, because postures are angles.

Three sequences occur in the 23-DoF human (facts: icra2015, 2.4), r being the axis (0, -1, 0):

    "xrz"  torso           Rx(a) Rr(b) Rz(c), b within 90 degrees
    "zxz"  shoulder        Rz(a) Rx(b) Rz(c), b from -180 to 0 degrees (an arm lifted sideways or forwards)
    "rxz"  elbow, wrist    Rr(a) Rx(b) Rz(c), b within 90 degrees

Every rotation has two triples of angles; the ranges of b pick the one that the recordings hold. Where the first and the
third axis fall together (b = 0 in "zxz", +-90 degrees in the others) only their sum is seen: there the first angle
stays what it was last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.rotations import rotation

#: How near (rad) to the alignment of two axes their angles are taken as not seen apart; rounding of the rotation's
#: entries (1e-16) is 1e-10 rad of angle there.
ALIGNED_RAD = 1e-6


def joint_angles(R: FloatArray, sequence: str) -> FloatArray:
    """Return the angles a, b, c (T, 3), unwrapped over time, of rotations (T, 3, 3); NaN where R has NaN.

    Args:
        R: rotations of one joint over time.
        sequence: "xrz", "zxz" or "rxz".
    """
    if sequence == "zxz":
        b = -np.arctan2(np.hypot(R[:, 2, 0], R[:, 2, 1]), R[:, 2, 2])
        a, c = np.arctan2(-R[:, 0, 2], R[:, 1, 2]), np.arctan2(-R[:, 2, 0], -R[:, 2, 1])
        aligned = np.abs(np.sin(b)) < ALIGNED_RAD
    elif sequence == "rxz":
        b = np.arctan2(-R[:, 1, 2], np.hypot(R[:, 1, 0], R[:, 1, 1]))
        a, c = np.arctan2(-R[:, 0, 2], R[:, 2, 2]), np.arctan2(R[:, 1, 0], R[:, 1, 1])
        aligned = np.abs(np.cos(b)) < ALIGNED_RAD
    else:
        b = np.arctan2(-R[:, 0, 2], np.hypot(R[:, 0, 0], R[:, 0, 1]))
        a, c = np.arctan2(-R[:, 1, 2], R[:, 2, 2]), np.arctan2(-R[:, 0, 1], R[:, 0, 0])
        aligned = np.abs(np.cos(b)) < ALIGNED_RAD
    angles = np.stack([a, b, c], axis=1)
    if aligned.any():
        _hold_first(angles, R, sequence, aligned)
    for column in angles.T:
        unwrap(column)
    return angles


def joint_rotation(angles: FloatArray, sequence: str) -> FloatArray:
    """Return the rotations (T, 3, 3) of angles (T, 3): the inverse of `joint_angles`."""
    R = np.broadcast_to(np.eye(3), (len(angles), 3, 3))
    for axis, angle in zip(sequence, angles.T, strict=True):
        R = R @ (rotation("y", -angle) if axis == "r" else rotation(axis, angle))
    return R


def _hold_first(angles: FloatArray, R: FloatArray, sequence: str, aligned: NDArray[np.bool_]) -> None:
    """Give the frames `aligned` (T,) the first angle of the last frame that shows it (or the next, or 0)."""
    shown = np.flatnonzero(~aligned & np.isfinite(angles[:, 0]))
    for t in np.flatnonzero(aligned):
        before = shown[shown < t]
        source = before[-1] if len(before) else shown[0] if len(shown) else None
        a = 0.0 if source is None else float(angles[source, 0])
        turn_back = joint_rotation(np.array([[-a, 0.0, 0.0]]), sequence)[0]
        rest = turn_back @ R[t]  # the second and third rotation alone
        if sequence == "xrz":
            angles[t] = a, np.arctan2(-rest[0, 2], rest[2, 2]), np.arctan2(rest[1, 0], rest[1, 1])
        else:
            angles[t] = a, np.arctan2(-rest[1, 2], rest[2, 2]), np.arctan2(-rest[0, 1], rest[0, 0])


def unwrap(angle: FloatArray) -> None:
    """Remove jumps of full turns in place, over NaN, from angles (T,)."""
    seen = np.isfinite(angle)
    angle[seen] = np.unwrap(angle[seen])
