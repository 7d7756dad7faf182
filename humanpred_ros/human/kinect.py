"""Converts between the 15 points of an OpenNI skeleton and the 12 DoFs of P1's human.

The construction is P1's (docs/papers.md, P1 human): pelvis below the torso point, yaw from the hips, lean from the
neck, twist from the left shoulder, then the right arm from elbow and hand, starting at the MODEL's right shoulder. So
the forearm keeps the model's length (the tracker's is discarded), the upper arm takes the tracker's length (rArmTrans),
and the points head, right_shoulder, left_elbow, left_hand, knees and feet are not used.

P1's formulas for the arm assume that the bones of the zero pose lie exactly on the y axis. The model's lie up to 1
degree off it. Here the same constraints are solved on the model itself, so that points made from a posture give that
posture back. On P1's libraries the two differ by about 0.015 rad, and by up to 0.11 rad in rShoulderY near a straight
elbow.

A DoF that the points do not determine is NaN and reported, never guessed:
- rShoulderY when the elbow is straight (nothing shows how the upper arm is rolled);
- rShoulderX and rShoulderY when the upper arm lies along the torso's x axis (they turn about the same line).
Two branches give the same points; the one returned has rShoulderZ within 90 degrees and an elbow that bends forwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel

#: Each skeleton point, in the order trackers deliver them, and the model's link whose origin it is.
LINK_OF_POINT = MappingProxyType(
    {
        "head": "head", "neck": "neck", "torso": "kinect_torso",
        "left_shoulder": "kinect_left_shoulder", "left_elbow": "left_elbow", "left_hand": "left_palm",
        "right_shoulder": "right_shoulder", "right_elbow": "right_elbow", "right_hand": "right_palm",
        "left_hip": "left_hip", "left_knee": "left_knee", "left_foot": "left_foot",
        "right_hip": "right_hip", "right_knee": "right_knee", "right_foot": "right_foot",
    }
)  # fmt: skip

#: The DoFs of P1's human, in the order of its libraries' columns.
KINECT12_DOFS = (
    "PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotZ", "TorsoX", "TorsoY", "TorsoZ",
    "rShoulderX", "rShoulderZ", "rShoulderY", "rArmTrans", "rElbowZ",
)  # fmt: skip


# What still counts as a person. P1's libraries hold rArmTrans from -0.06 to 0.22 m without the marked outliers. Of an
# elbow bent by 0.05 rad, a hand seen 2 cm off turns the upper arm's roll by about 90 degrees.
_BONE_RATIO = (0.5, 1.6)  #: plausible bones, as shares of the model's
_ARM_TRANS_M = (-0.1, 0.25)  #: plausible rArmTrans
_STRAIGHT_ELBOW_RAD = 0.05  #: straighter elbows do not show the arm's roll
_ALIGNED_ARM_RAD = 0.02  #: arms closer to the torso's x axis hide rShoulderX


class KinectPostures:
    """The postures of T frames, as far as the tracker's points determine them.

    Attributes:
        q: (T, 12) postures, NaN where undetermined.
        reasons: by frame, DoF -> why it is not determined: a lost point, a DoF that it needs, or a measure that no
            person has.
    """

    def __init__(self, frames: int, model: HumanModel, slack_rad: float = 0.0) -> None:
        self._model, self._slack_rad = model, slack_rad
        self.q: FloatArray = np.full((frames, len(model.dof_names)), np.nan)
        self.reasons: list[dict[str, str]] = [{} for _ in range(frames)]

    @property
    def complete(self) -> NDArray[np.bool_]:
        """(T,) True where every DoF is determined."""
        return np.asarray(np.isfinite(self.q).all(axis=1))

    def column(self, dof: str) -> FloatArray:
        """Return the values (T,) of one DoF."""
        return self.q[:, self._model.dof_index[dof]]

    def put(
        self, values: Mapping[str, FloatArray], points: Mapping[str, FloatArray], after: Sequence[str] = ()
    ) -> None:
        """Store DoFs (T,) that follow from `points` (name -> (T, 3), NaN where lost) and from the DoFs `after`.

        They are not determined where one of those is not, nor outside the model's limits. The first reason stays: what
        a DoF needs is judged before it.
        """
        seen = math.isfinite(sum(float(place.sum()) for place in points.values()))
        if seen and not any(self.reasons) and all(self._usual(dof, value) for dof, value in values.items()):
            for dof, value in values.items():
                self.q[:, self._model.dof_index[dof]] = value
            return
        for dof, value in values.items():
            d = self._model.dof_index[dof]
            self.q[:, d] = np.where([dof in reasons for reasons in self.reasons], np.nan, value)
            for name, place in points.items():
                self.doubt(np.asarray(np.isnan(place).any(axis=1)), (dof,), f"the point {name} is lost")
            for earlier in after:
                self.doubt(np.isnan(self.column(earlier)), (dof,), f"it needs {earlier}, which is not determined")
            self.doubt(np.isnan(self.q[:, d]), (dof,), "points that should be apart coincide")
            lower, upper = self._limits(dof)
            with np.errstate(invalid="ignore"):
                outside = (value < lower - 1e-9) | (value > upper + 1e-9)
            self.doubt(outside, (dof,), f"{{:.3f}} is outside the limits {lower:.3f} to {upper:.3f}", value)

    def _limits(self, dof: str) -> tuple[float, float]:
        d, slack = self._model.dof_index[dof], 0.0 if "Trans" in dof else self._slack_rad
        return float(self._model.lower[d]) - slack, float(self._model.upper[d]) + slack

    def _usual(self, dof: str, value: FloatArray) -> bool:
        """Return whether a DoF's values are all within its limits, none of them NaN."""
        lower, upper = self._limits(dof)
        return bool(value.min() >= lower - 1e-9 and value.max() <= upper + 1e-9)

    def doubt(
        self, where: NDArray[np.bool_], dofs: Sequence[str], reason: str, value: FloatArray | None = None
    ) -> None:
        """Leave DoFs undetermined in the frames `where` (T,); `{...}` in the reason is the frame's `value` (T,)."""
        if not where.any():
            return
        for frame in np.flatnonzero(where):
            for dof in dofs:
                self.reasons[frame].setdefault(dof, reason if value is None else reason.format(value[frame]))
                self.q[frame, self._model.dof_index[dof]] = np.nan


class KinectSkeleton:
    """Converts between skeleton points and postures of P1's 12-DoF human.

    Args:
        model: a model with the 12 DoFs and the links of `LINK_OF_POINT`; P1's if left out.
        slack_rad: angles may exceed the model's limits by this.

    Raises:
        HumanModelError: another set of DoFs, or links that are lacking.
    """

    def __init__(self, model: HumanModel | None = None, slack_rad: float = 0.0) -> None:
        self.model, self._slack_rad = model or HumanModel.kinect12(), slack_rad
        self.model.check_dofs(KINECT12_DOFS)
        lacking = sorted(set(LINK_OF_POINT.values()) - set(self.model.link_names))
        if lacking:
            raise HumanModelError(
                f"Kinect skeleton: model {self.model.name} lacks the links {', '.join(lacking)}; add them to its URDF"
            )
        zero = self.model.forward(np.zeros(len(KINECT12_DOFS)))
        self._pelvis_below_m = zero["kinect_torso"] - zero["pelvis"]
        self._torso_m = zero["torso"] - zero["pelvis"]
        self._neck_m = zero["neck"] - zero["torso"]
        self._left_shoulder_m = zero["kinect_left_shoulder"] - zero["torso"]
        self._right_shoulder_m = zero["right_shoulder"] - zero["torso"]
        self._upper_arm_m = zero["right_elbow"] - zero["right_shoulder"]
        self._forearm_m = zero["right_palm"] - zero["right_elbow"]
        self._hips_m = zero["left_hip"] - zero["right_hip"]

    def points(self, q: ArrayLike) -> FloatArray:
        """Return the points (T, 15, 3) a tracker would see of postures (T, 12); (15, 3) for one posture (12,)."""
        places = self.model.forward(q)
        return np.stack([places[link] for link in LINK_OF_POINT.values()], axis=-2)

    def postures(self, points_m: ArrayLike) -> KinectPostures:
        """Return the postures of points (T, 15, 3) in the tracker's frame, z up.

        A point with a coordinate that is not finite counts as lost. Angles are within +-pi and not unwrapped. Without
        a usable hand rShoulderX and rShoulderZ still follow from the elbow: those of an unrolled upper arm, which put
        the elbow where it was seen (by how much they differ: 0.015 rad / cos(rShoulderZ) at most).

        Raises:
            ArrayError: another shape.
        """
        points = checked("points_m", points_m, ("T", len(LINK_OF_POINT), 3), finite=False)
        points = np.where(np.isfinite(points).all(axis=-1, keepdims=True), points, np.nan)
        seen = {name: points[:, i] for i, name in enumerate(LINK_OF_POINT)}
        found = KinectPostures(len(points), self.model, self._slack_rad)
        # NaN stands for lost all the way down, and zero lengths are reported as such: no warnings wanted.
        with np.errstate(invalid="ignore", divide="ignore"):
            pelvis = self._pelvis(seen, found)
            R_torso, torso = self._torso(seen, pelvis, found)
            self._right_arm(seen, R_torso, torso, found)
        return found

    def _pelvis(self, seen: Mapping[str, FloatArray], found: KinectPostures) -> FloatArray:
        """Find the pelvis; return its position (T, 3)."""
        pelvis = seen["torso"] - self._pelvis_below_m  # straight below, so that no yaw is needed
        place = {f"PelvisTrans{axis}": pelvis[:, i] for i, axis in enumerate("XYZ")}
        found.put(place, _only(seen, "torso"))
        to_left = seen["left_hip"] - seen["right_hip"]
        yaw = _wrapped(np.arctan2(to_left[:, 1], to_left[:, 0]) - np.pi / 2)
        found.put({"PelvisRotZ": yaw}, _only(seen, "left_hip", "right_hip"))
        self._check_bone(found, "between the hips", to_left, self._hips_m, ("PelvisRotZ",))
        across = seen["left_shoulder"] - seen["neck"]
        found.doubt(
            (to_left[:, :2] * across[:, :2]).sum(axis=1) < 0,
            ("PelvisRotZ",),
            "hips and shoulders face opposite ways: left and right are swapped in one of them",
        )
        return pelvis

    def _torso(
        self, seen: Mapping[str, FloatArray], pelvis: FloatArray, found: KinectPostures
    ) -> tuple[FloatArray, FloatArray]:
        """Find the torso's angles; return its rotation (T, 3, 3) and origin (T, 3)."""
        R_pelvis = rotation("z", found.column("PelvisRotZ"))
        torso = pelvis + R_pelvis @ self._torso_m
        n = rotate_back(R_pelvis, seen["neck"] - torso)
        lean = {
            "TorsoX": np.arctan2(-n[:, 1], n[:, 2]),
            "TorsoY": np.arctan2(n[:, 0], np.hypot(n[:, 1], n[:, 2])),
        }
        found.put(lean, _only(seen, "neck"), after=("PelvisTransX", "PelvisRotZ"))
        self._check_bone(found, "from torso to neck", n, self._neck_m, tuple(lean))

        R_lean = R_pelvis @ rotation("x", found.column("TorsoX")) @ rotation("y", found.column("TorsoY"))
        left = rotate_back(R_lean, seen["left_shoulder"] - torso)
        twist = {"TorsoZ": np.arctan2(-left[:, 0], left[:, 1])}
        found.put(twist, _only(seen, "left_shoulder"), after=("TorsoX", "TorsoY"))
        self._check_bone(found, "from torso to left shoulder", left, self._left_shoulder_m, tuple(twist))
        return R_lean @ rotation("z", found.column("TorsoZ")), torso

    def _right_arm(
        self, seen: Mapping[str, FloatArray], R_torso: FloatArray, torso: FloatArray, found: KinectPostures
    ) -> None:
        """Find the right arm's DoFs from the model's shoulder, the elbow and the direction to the hand."""
        ux, uy, uz = self._upper_arm_m
        e = rotate_back(R_torso, seen["right_elbow"] - torso) - self._right_shoulder_m
        h = rotate_back(R_torso, seen["right_hand"] - seen["right_elbow"])
        # The elbow slides along the upper arm's -y; its offsets along x and z stay.
        length = np.sqrt(np.maximum((e**2).sum(axis=1) - ux**2 - uz**2, 0.0))
        upper = np.stack([np.full_like(length, ux), -length, np.full_like(length, uz)], axis=1)
        bend, straight = self._elbow(upper, e, h)
        fore = rotation("z", bend) @ self._forearm_m
        sX, sZ, sY = _shoulder_angles(_frame_of(e, h) @ np.swapaxes(_frame_of(upper, fore), 1, 2))
        unrolled = straight | np.isnan(sY)
        sX_alone, sZ_alone = _shoulder_angles_of_elbow(upper, e)
        arm = {
            "rShoulderX": np.where(unrolled, sX_alone, sX),
            "rShoulderZ": np.where(unrolled, sZ_alone, sZ),
            "rArmTrans": length + uy,
        }
        hand = {"rShoulderY": sY, "rElbowZ": bend}
        found.doubt(straight, ("rShoulderY",), "the elbow is straight, which leaves the upper arm's roll open")
        aligned = np.hypot(e[:, 1], e[:, 2]) < _ALIGNED_ARM_RAD * np.linalg.norm(e, axis=1)
        found.doubt(aligned, ("rShoulderX", "rShoulderY"), "the upper arm lies along the torso's x axis")
        found.put(arm, _only(seen, "right_elbow"), after=("TorsoZ",))
        found.put(hand, _only(seen, "right_elbow", "right_hand"), after=("TorsoZ",))
        low, high = _ARM_TRANS_M
        wrong = (arm["rArmTrans"] < low) | (arm["rArmTrans"] > high)
        found.doubt(wrong, (*arm, *hand), f"rArmTrans is {{:.3f}} m, plausible are {low} to {high} m", arm["rArmTrans"])
        self._check_bone(found, "from right elbow to hand", h, self._forearm_m, tuple(hand))

    def _elbow(self, upper: FloatArray, e: FloatArray, h: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return rElbowZ (T,) for which the model's arm has the observed angle, and where it is straight."""
        fx, fy, fz = self._forearm_m
        # (upper arm) . Rz(bend) (forearm) = A cos(bend) + B sin(bend) + uz fz must equal the observed scalar product.
        A = upper[:, 0] * fx + upper[:, 1] * fy
        B = upper[:, 1] * fx - upper[:, 0] * fy
        cosine = (e * h).sum(axis=1) / np.linalg.norm(e, axis=1) / np.linalg.norm(h, axis=1)
        wanted = cosine * np.linalg.norm(upper, axis=1) * np.linalg.norm(self._forearm_m) - upper[:, 2] * fz
        opening = np.arccos(np.clip(wanted / np.hypot(A, B), -1.0, 1.0))
        return np.arctan2(B, A) + opening, opening < _STRAIGHT_ELBOW_RAD

    def _check_bone(
        self, found: KinectPostures, bone: str, measured: FloatArray, model: FloatArray, dofs: tuple[str, ...]
    ) -> None:
        length = np.linalg.norm(measured, axis=1)
        low, high = (ratio * float(np.linalg.norm(model)) for ratio in _BONE_RATIO)
        reason = f"{{:.3f}} m {bone}, plausible are {low:.3f} to {high:.3f} m"
        found.doubt((length < low) | (length > high), dofs, reason, length)


def _only(seen: Mapping[str, FloatArray], *names: str) -> dict[str, FloatArray]:
    return {name: seen[name] for name in names}


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return the angles within [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _frame_of(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the orthonormal frames (T, 3, 3) with x along `first` and z normal to both; NaN if parallel."""
    x, z = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (first, _cross(first, second)))
    return np.stack([x, _cross(z, x), z], axis=-1)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector products of a and b (T, 3): np.cross takes five times as long for one frame."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _shoulder_angles(R: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rShoulderX, Z, Y (T,) of R = Rx(sX) Rz(sZ) Ry(-sY) (T, 3, 3), with sZ within 90 degrees."""
    sX = np.arctan2(R[:, 2, 1], R[:, 1, 1])
    sZ = np.arctan2(-R[:, 0, 1], np.hypot(R[:, 1, 1], R[:, 2, 1]))
    return sX, sZ, np.arctan2(-R[:, 0, 2], R[:, 0, 0])


def _shoulder_angles_of_elbow(upper: FloatArray, e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rShoulderX, Z (T,) that put the elbow at `e` (T, 3) for an unrolled upper arm (sY = 0)."""
    inward = -np.sqrt(np.maximum(e[:, 1] ** 2 + e[:, 2] ** 2 - upper[:, 2] ** 2, 0.0))
    sX = np.arctan2(e[:, 2], e[:, 1]) - np.arctan2(upper[:, 2], inward)
    sZ = np.arctan2(inward, e[:, 0]) - np.arctan2(upper[:, 1], upper[:, 0])
    return _wrapped(sX), _wrapped(sZ)


def rotation(axis: str, angle: FloatArray) -> FloatArray:
    """Return the right-handed rotations (T, 3, 3) by `angle` (T,) about the axis "x", "y" or "z"."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.zeros((len(angle), 3, 3))
    R[:, i, i] = 1.0
    R[:, j, j] = R[:, k, k] = np.cos(angle)
    R[:, k, j] = np.sin(angle)
    R[:, j, k] = -R[:, k, j]
    return R


def rotate_back(R: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the vectors (T, 3) in the rotated frames R (T, 3, 3)."""
    return np.asarray(np.einsum("tji,tj->ti", R, vectors))
