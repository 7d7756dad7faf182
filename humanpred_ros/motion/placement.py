"""Moves a motion to another place, to show whether a prediction follows the person.

Only turns about the vertical are possible: a body's frame, like a tracker's world, has z up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.motion.motion import Motion, MotionLibrary

#: DoFs that say where the body stands, x, y, z in metres and then the turn about z in radians.
PELVIS_DOFS = ("PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotZ")
#: A transform's rotation may be off by this much, as text with six digits is.
_TOLERANCE = 1e-6


def pelvis_columns(dof_names: Sequence[str]) -> tuple[int, int, int, int]:
    """Return the columns of a posture that hold `PELVIS_DOFS`.

    Raises:
        MotionError: some are missing, so the body cannot be placed.
    """
    missing = [name for name in PELVIS_DOFS if name not in dof_names]
    if missing:
        raise MotionError(
            f"placing a motion: wanted the DoFs {', '.join(PELVIS_DOFS)}, {', '.join(missing)} missing among "
            f"{', '.join(dof_names)}; only bodies that are free to stand anywhere can be moved"
        )
    x, y, z, yaw = (list(dof_names).index(name) for name in PELVIS_DOFS)
    return x, y, z, yaw


def turn_and_shift(
    yaw_rad: float, shift_m: ArrayLike = (0.0, 0.0, 0.0), about_m: ArrayLike = (0.0, 0.0, 0.0)
) -> FloatArray:
    """Return the (4, 4) transform that turns by `yaw_rad` about the vertical through `about_m` and then shifts."""
    about = checked("about_m", about_m, (3,), error=MotionError)
    turn = float(checked("yaw_rad", yaw_rad, (), error=MotionError))
    T = np.eye(4)
    T[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    T[:3, 3] = about - T[:3, :3] @ about + checked("shift_m", shift_m, (3,), error=MotionError)
    return T


def placed(motion: Motion, T: ArrayLike) -> Motion:
    """Return the motion as made by a person moved by the rigid transform `T`, in the same frame.

    Every point of the body, and every skeleton point, is where `T` takes it.

    Args:
        motion: any whose body can stand anywhere.
        T: (4, 4), a turn about z and a translation.

    Raises:
        MotionError: no such DoFs, or a transform that is not of this kind.
    """
    columns = pelvis_columns(motion.dof_names)
    T = checked("placement", T, (4, 4), error=MotionError)
    yaw = math.atan2(T[1, 0], T[0, 0])
    if np.abs(T[:3, :3] - turn_and_shift(yaw)[:3, :3]).max() > _TOLERANCE or (T[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise MotionError(
            f"placing {motion.name}: wanted a turn about z and a translation, got {T.tolist()}; a person stays upright"
        )
    q = np.array(motion.q)
    q[:, columns[:3]] = q[:, columns[:3]] @ T[:3, :3].T + T[:3, 3]
    q[:, columns[3]] += yaw
    points = motion.points_m
    if points is not None:
        points = points @ T[:3, :3].T + T[:3, 3]
    return replace(motion, q=q, points_m=points)


def start_pelvis_m(library: MotionLibrary) -> FloatArray:
    """Return where the pelvis (3,) is at the start of a motion: per axis the median, as recordings may be wild.

    Raises:
        MotionError: a library whose bodies cannot stand anywhere.
    """
    columns = pelvis_columns(library.dof_names)
    start: FloatArray = np.median([motion.q[0, columns[:3]] for motion in library], axis=0)
    return start
