"""Segment frames and joint centres from anatomical markers, and from them the 23 DoFs, with no lengths of a body given.

Joint centres are the middles of pairs of markers (P2 IV-B); frames follow the ISB's joint coordinates: long axes run
through joint centres, and a pair of markers across shows how a segment is turned about its long axis. Whatever is NaN
makes NaN of what depends on it and of nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.rotations import rotate_back
from humanpred_ros.human.joint_angles import joint_angles, joint_rotation, unwrap
from humanpred_ros.human.marker_set import MarkerSet
from humanpred_ros.human.model import HumanModel


@dataclass(frozen=True)
class SegmentFrames:
    """Where the segments are in T frames, in the tracker's frame.

    Attributes:
        rotation: (T, 3, 3) by segment: waist, torso, upper_arm, forearm, hand (x forward, y left, z up in zero pose).
        centre_m: (T, 3) joint centres: torso, shoulder, elbow, wrist.
    """

    rotation: Mapping[str, FloatArray]
    centre_m: Mapping[str, FloatArray]


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
        model: the 23-DoF human; only where its torso lies in its pelvis enters.
        upright_pelvis: take PelvisRotX and PelvisRotY as 0, as in P2's recordings; the waist gives the heading alone.
    """
    R, centre = frames.rotation, frames.centre_m
    pelvis = _pelvis_angles(R["waist"], upright_pelvis)
    R_pelvis = joint_rotation(pelvis * (1.0, -1.0, 1.0), "xrz")
    zero = model.forward(np.zeros(len(model.dof_names)))
    across = rotate_back(R["torso"], centre["shoulder"] - centre["torso"])
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


def _frame(up: FloatArray, left: FloatArray) -> FloatArray:
    """Return the frames (T, 3, 3) with z along `up` and y as near to `left` as that allows; NaN if parallel."""
    with np.errstate(invalid="ignore", divide="ignore"):
        z = up / np.linalg.norm(up, axis=1, keepdims=True)
        x = np.cross(left, z)
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=2)


def _between(R_parent: FloatArray, R_child: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(R_parent, 1, 2) @ R_child)


def _pelvis_angles(R: FloatArray, upright: bool) -> FloatArray:
    """Return PelvisRotX, Y, Z (T, 3) of Rx Ry Rz = R; the first two 0 if `upright`."""
    if upright:
        yaw = np.arctan2(R[:, 1, 0], R[:, 0, 0])
        unwrap(yaw)
        return np.stack([yaw * 0.0, yaw * 0.0, yaw], axis=1)  # NaN stays NaN
    # Ry(b) is Rr(-b): the torso's sequence with the second angle turned round.
    return joint_angles(R, "xrz") * (1.0, -1.0, 1.0)
