"""Segment frames and joint centres from markers, and from them the 23 DoFs of P2's human; no body lengths are given.

Joint centres are the middles of pairs of markers (P2 IV-B). Frames follow the ISB's joint coordinates: long axes run
through joint centres, and a pair of markers across a segment shows how it is turned about its long axis. NaN makes NaN
of what depends on it and of nothing else.

Three sequences of rotations occur (docs/papers.md, P2 human), r being the axis (0, -1, 0):

    "xrz"  pelvis, torso   Rx(a) Rr(b) Rz(c), b within 90 degrees
    "zxz"  shoulder        Rz(a) Rx(b) Rz(c), b from -180 to 0 degrees (an arm lifted sideways or forwards)
    "rxz"  elbow, wrist    Rr(a) Rx(b) Rz(c), b within 90 degrees

Every rotation has two triples of angles; the ranges of b select the one that the recordings hold. Where the first and
the third axis coincide (b = 0 in "zxz", +-90 degrees in the others) only the sum of their angles is seen: there the
first angle keeps its last value.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.marker_set import MarkerSet
from humanpred_ros.human.model import HumanModel

#: scipy's name of each sequence, and the signs that turn its angles into ours: r is y with the other sign.
_SEQUENCES = {"xrz": ("XYZ", (1.0, -1.0, 1.0)), "zxz": ("ZXZ", (1.0, 1.0, 1.0)), "rxz": ("YXZ", (-1.0, 1.0, 1.0))}
#: Closer (rad) to the alignment of two axes than this, their angles are not seen apart; rounding of the rotation's
#: entries (1e-16) is 1e-10 rad of angle there.
ALIGNED_RAD = 1e-6


@dataclass(frozen=True)
class SegmentFrames:
    """Where the segments are in T frames, in the tracker's frame."""

    #: (T, 3, 3) by segment: waist, torso, upper_arm, forearm, hand (x forward, y left, z up in zero pose)
    rotation: Mapping[str, FloatArray]
    centre_m: Mapping[str, FloatArray]  #: (T, 3) joint centres: torso, shoulder, elbow, wrist


def segment_frames(markers: MarkerSet, points_m: FloatArray) -> SegmentFrames:
    """Return frames and joint centres of markers (T, M, 3)."""

    def at(name: str) -> FloatArray:
        return points_m[:, markers.index[name]]

    def middle(a: str, b: str) -> FloatArray:
        return (at(a) + at(b)) / 2

    torso, shoulder = middle("PX", "T8"), middle("RSF", "RSB")
    elbow, wrist = middle("REL", "REM"), middle("RRS", "RUS")
    left = at("LASI") - at("RASI")
    forwards = middle("LASI", "RASI") - middle("LPSI", "RPSI")
    upwards = middle("IJ", "C7") - torso
    return SegmentFrames(
        rotation={
            "waist": _frame(np.cross(forwards, left), left),
            "torso": _frame(upwards, np.cross(upwards, at("IJ") - at("C7"))),
            "upper_arm": _frame(shoulder - elbow, at("REM") - at("REL")),
            "forearm": _frame(elbow - wrist, at("RUS") - at("RRS")),
            "hand": _frame(wrist - middle("RH2", "RH5"), at("RH5") - at("RH2")),
        },
        centre_m={"torso": torso, "shoulder": shoulder, "elbow": elbow, "wrist": wrist},
    )


def postures_of(frames: SegmentFrames, model: HumanModel, upright_pelvis: bool) -> FloatArray:
    """Return the postures (T, 23), angles unwrapped, of segment frames; NaN where not determined.

    Args:
        frames: the segments.
        model: the 23-DoF human; only the place of its torso in its pelvis is used.
        upright_pelvis: take PelvisRotX and PelvisRotY as 0, as in P2's recordings; the waist gives the heading alone.
    """
    R, centre = frames.rotation, frames.centre_m
    if upright_pelvis:
        yaw = _unwrapped(np.arctan2(R["waist"][:, 1, 0], R["waist"][:, 0, 0]))
        pelvis = np.stack([yaw * 0.0, yaw * 0.0, yaw], axis=1)  # NaN stays NaN
    else:
        pelvis = joint_angles(R["waist"], "xrz") * (1.0, -1.0, 1.0)  # PelvisRotY turns about y, not about r
    R_pelvis = joint_rotation(pelvis * (1.0, -1.0, 1.0), "xrz")
    zero = model.forward(np.zeros(len(model.dof_names)))
    across = np.einsum("tji,tj->ti", R["torso"], centre["shoulder"] - centre["torso"])
    columns = [
        centre["torso"] - R_pelvis @ (zero["torso"] - zero["pelvis"]),
        pelvis,
        joint_angles(_between(R_pelvis, R["torso"]), "xrz"),
        np.stack([across[:, 0], across[:, 2], -across[:, 1]], axis=1),  # ISB: x forward, y up, z to the right
        joint_angles(_between(R["torso"], R["upper_arm"]), "zxz"),
        np.linalg.norm(centre["shoulder"] - centre["elbow"], axis=1, keepdims=True),
        joint_angles(_between(R["upper_arm"], R["forearm"]), "rxz"),
        np.linalg.norm(centre["elbow"] - centre["wrist"], axis=1, keepdims=True),
        joint_angles(_between(R["forearm"], R["hand"]), "rxz"),
    ]
    return np.concatenate(columns, axis=1)


def joint_angles(R: FloatArray, sequence: str) -> FloatArray:
    """Return the angles a, b, c (T, 3), unwrapped over time, of rotations (T, 3, 3); NaN where R has NaN.

    Args:
        R: rotations of one joint over time.
        sequence: "xrz", "zxz" or "rxz".
    """
    name, signs = _SEQUENCES[sequence]
    angles = np.full((len(R), 3), np.nan)
    known = np.isfinite(R).all(axis=(1, 2))
    if known.any():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # aligned axes are treated below
            angles[known] = Rotation.from_matrix(R[known]).as_euler(name) * signs
    if sequence == "zxz":  # scipy's b is from 0 to 180 degrees
        angles[:, 1] *= -1.0
        angles[:, ::2] -= np.copysign(np.pi, angles[:, ::2])
        off = np.sin(angles[:, 1])
    else:
        off = np.cos(angles[:, 1])
    with np.errstate(invalid="ignore"):
        aligned = np.abs(off) < ALIGNED_RAD
    _hold_first(angles, R, sequence, aligned)
    return np.stack([_unwrapped(column) for column in angles.T], axis=1)


def joint_rotation(angles: FloatArray, sequence: str) -> FloatArray:
    """Return the rotations (T, 3, 3) of angles (T, 3), NaN where an angle is: the inverse of `joint_angles`."""
    name, signs = _SEQUENCES[sequence]
    R = np.full((len(angles), 3, 3), np.nan)
    known = np.isfinite(angles).all(axis=1)
    if known.any():
        R[known] = Rotation.from_euler(name, angles[known] * signs).as_matrix()
    return R


def _hold_first(angles: FloatArray, R: FloatArray, sequence: str, aligned: NDArray[np.bool_]) -> None:
    """Give the frames `aligned` (T,) the first angle of the last frame that shows it (or the next, or 0)."""
    shown = np.flatnonzero(~aligned & np.isfinite(angles[:, 0]))
    for t in np.flatnonzero(aligned):
        before = shown[shown < t]
        source = before[-1] if len(before) else shown[0] if len(shown) else None
        a = 0.0 if source is None else float(angles[source, 0])
        rest = joint_rotation(np.array([[-a, 0.0, 0.0]]), sequence)[0] @ R[t]  # the second and third rotation alone
        if sequence == "xrz":
            angles[t] = a, np.arctan2(-rest[0, 2], rest[2, 2]), np.arctan2(rest[1, 0], rest[1, 1])
        else:
            angles[t] = a, np.arctan2(-rest[1, 2], rest[2, 2]), np.arctan2(-rest[0, 1], rest[0, 0])


def _unwrapped(angle: FloatArray) -> FloatArray:
    """Return angles (T,) without jumps of full turns, also over NaN."""
    seen = np.isfinite(angle)
    angle = angle.copy()
    angle[seen] = np.unwrap(angle[seen])
    return angle


def _frame(up: FloatArray, left: FloatArray) -> FloatArray:
    """Return the frames (T, 3, 3) with z along `up` and y as near to `left` as that allows; NaN if parallel."""
    with np.errstate(invalid="ignore", divide="ignore"):
        z = up / np.linalg.norm(up, axis=1, keepdims=True)
        x = np.cross(left, z)
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)


def _between(R_parent: FloatArray, R_child: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(R_parent, 1, 2) @ R_child)
