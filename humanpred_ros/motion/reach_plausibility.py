"""Tells recordings of people from recordings in wrong units or of swapped people, which would be learned in silence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.resampling import is_angle

#: Joints turn by less than this, whole turns of an unwrapped recording included: degrees go beyond.
_MOST_RAD = 20.0
#: No room for motion capture is larger: centimetres and millimetres go beyond.
_MOST_M = 20.0
#: Frames of motion capture are 2 to 10 ms apart, of a depth camera 33 ms: milliseconds and nanoseconds go beyond.
_PERIOD_S = (0.0005, 0.2)
#: Upper arms and forearms of children and giants, markers badly placed.
_BONE_M = (0.05, 1.0)
#: A hand that goes less than this does not reach.
_LEAST_WAY_M = 0.05
#: A hand that ends nearer to where it began than this share of the farthest it was has come back.
_BACK_SHARE = 0.25


def check_units(where: str, t_s: FloatArray, q: FloatArray, dof_names: Sequence[str]) -> None:
    """Refuse stamps (T,) and postures (T, D) that are not in seconds, metres and radians.

    Raises:
        MotionError: with the first DoF that cannot be so.
    """
    period = float(np.median(np.diff(t_s)))
    if not _PERIOD_S[0] <= abs(period) <= _PERIOD_S[1] and period != 0.0:
        raise MotionError(
            f"{where}: wanted stamps in seconds, {_PERIOD_S[0]} to {_PERIOD_S[1]} s apart, got {period:g} as the "
            "median step; convert them, they look like another unit"
        )
    most = np.abs(q).max(axis=0)
    for name, value, column in zip(dof_names, most, q.T, strict=True):
        if is_angle(name):
            if value > _MOST_RAD:
                raise MotionError(
                    f"{where}: wanted angles in radians, got {value:g} for {name}; convert them, they look like degrees"
                )
            continue
        if value > _MOST_M:
            raise MotionError(
                f"{where}: wanted lengths in metres, got {value:g} for {name}; convert them, they look like "
                f"{'millimetres' if value > 500.0 else 'centimetres'}"
            )
        length = float(np.median(column))
        if name.endswith("Trans") and not _BONE_M[0] <= length <= _BONE_M[1]:
            raise MotionError(
                f"{where}: wanted the bone {name} between {_BONE_M[0]} and {_BONE_M[1]} m, got {length:g} as the "
                "median; check its unit and sign"
            )


def check_two_people(where: str, active: Motion, passive: Motion) -> None:
    """Refuse one person recorded as two.

    Raises:
        MotionError: both have the same postures.
    """
    if np.array_equal(active.q, passive.q):
        raise MotionError(
            f"{where}: wanted two people, got the same postures for both; one file is a copy of the other, replace it"
        )


def doubts(active: Motion, passive: Motion, model: HumanModel, hand: str = "right_palm") -> list[str]:
    """Return sentences on what makes one doubt who reaches, or whether anybody does."""
    (mine, end_m), (theirs, _) = (_way_m(motion, model, hand) for motion in (active, passive))
    if theirs > max(mine, _LEAST_WAY_M):
        return [
            f"the partner's hand goes farther ({theirs:.2f} m) than that of who reaches ({mine:.2f} m); check that the "
            "files are not swapped"
        ]
    if mine < _LEAST_WAY_M:
        return [f"the hand of who reaches goes only {mine:.2f} m; check that this is a reach"]
    if end_m < _BACK_SHARE * mine:
        return [
            f"the hand ends {end_m:.2f} m from where it began, after {mine:.2f} m: a reach and the way back? cut it at "
            "the turn"
        ]
    return []


def _way_m(motion: Motion, model: HumanModel, hand: str) -> tuple[float, float]:
    """Return how far the hand is from where it began: at the farthest, and in the end.

    But for the tenth of the frames where it is farthest: a lost marker throws the hand about for a frame or two.
    """
    place = model.forward(motion.q)[hand]
    far = np.linalg.norm(place - place[0], axis=1)
    return float(np.quantile(far, 0.9)), float(far[-1])
