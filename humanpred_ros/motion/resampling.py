"""Motions at other stamps: learning and comparison want equal lengths, sensors do not deliver them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.motion.motion import Motion


def is_angle(dof_name: str) -> bool:
    """Return whether a DoF turns; those of the papers' humans that slide have `Trans` in their name."""
    return "Trans" not in dof_name


def unwrap_angles(motion: Motion) -> Motion:
    """Return the same motion with each angle continuous from its first frame on; itself if it is already.

    The first frame stays, so a stream unwrapped frame by frame gives the same numbers.
    """
    angles = [d for d, name in enumerate(motion.dof_names) if is_angle(name)]
    turns = np.zeros_like(motion.q)
    # A step is shortened by the whole turns in it; summed up as integers, so that no rounding piles up.
    turns[1:, angles] = np.cumsum(np.round(np.diff(motion.q[:, angles], axis=0) / (2 * np.pi)), axis=0)
    if not turns.any():
        return motion
    return replace(motion, q=motion.q - 2 * np.pi * turns)


def resample(motion: Motion, *, t_s: ArrayLike) -> Motion:
    """Return the motion at the stamps `t_s` (N,), by linear interpolation of unwrapped postures.

    At a stamp of the original the posture is the original one (angles up to whole turns). Skeleton points
    are interpolated too, and lost where a neighbouring frame has lost them.

    Raises:
        MotionError: stamps that do not increase, or outside the motion.
    """
    stamps = np.round(checked("t_s", t_s, ("N",), error=MotionError) * 1e9) * 1e-9
    if len(stamps) < 2 or stamps[0] < motion.t_s[0] or stamps[-1] > motion.t_s[-1]:
        span = f"{motion.t_s[0]:.6f} to {motion.t_s[-1]:.6f} s"
        came = f"{len(stamps)} from {stamps[0]:.6f} to {stamps[-1]:.6f} s" if len(stamps) else "none"
        raise MotionError(f"{motion.name}: wanted at least 2 stamps within {span}, got {came}; ask for fewer")
    points = motion.points_m
    if points is not None:
        points = _interpolated(motion.t_s, points.reshape(len(motion), -1), stamps).reshape(len(stamps), -1, 3)
    return replace(motion, t_s=stamps, q=_interpolated(motion.t_s, unwrap_angles(motion).q, stamps), points_m=points)


def resample_phase(motion: Motion, n: int) -> Motion:
    """Return the motion at `n` evenly spaced phases of its duration; first and last frame are the original ones.

    Raises:
        MotionError: fewer than 2 phases, or more than there are nanoseconds.
    """
    if n < 2:
        raise MotionError(f"{motion.name}: wanted at least 2 phases, got {n}")
    return resample(motion, t_s=np.linspace(motion.t_s[0], motion.t_s[-1], n))


def _interpolated(t_s: FloatArray, values: FloatArray, stamps: FloatArray) -> FloatArray:
    """Interpolate (T, K) values at `stamps` within `t_s`; exact at the frames, NaN only next to NaN."""
    left = np.clip(np.searchsorted(t_s, stamps, side="right") - 1, 0, len(t_s) - 2)
    share = ((stamps - t_s[left]) / (t_s[left + 1] - t_s[left]))[:, None]
    # Written as a sum of shares, not as start plus difference: so the right end comes out exactly, too.
    between = (1.0 - share) * values[left] + share * values[left + 1]
    return np.where(share <= 0.0, values[left], np.where(share >= 1.0, values[left + 1], between))
