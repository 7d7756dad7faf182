"""P1's classifier looks at (phase, posture); this says what the phase of a posture is, offline and online."""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion, unwrap_angles
from humanpred_ros.recognition.gmm_config import GmmSettings


def phase_frames(elapsed_s: FloatArray | float, duration_s: float, n_phase_frames: int) -> FloatArray:
    """Return the phase of postures seen `elapsed_s` after the start: 0 to n_phase_frames - 1, clipped.

    P1's phase is the frame number 0 to 99 of a motion resampled to 100 postures (facts 3). Online, the end is
    not known; the duration then is the one expected of a motion of this library.
    """
    last = n_phase_frames - 1
    return np.clip(np.asarray(elapsed_s) * (last / duration_s), 0.0, float(last))


def resampled_postures(motion: Motion, n_phase_frames: int) -> FloatArray:
    """Return (n_phase_frames, D) postures evenly spaced in time, each the last one recorded by then.

    Nothing is interpolated (facts 1): the mean of two angles on both sides of a wrap is a posture nobody had.
    """
    wanted_s = np.linspace(0.0, motion.duration_s, n_phase_frames)
    # Stamps are whole nanoseconds; half of one keeps a posture that lies exactly on a wanted time.
    index = np.searchsorted(motion.t_s - motion.t_s[0], wanted_s + 0.5e-9, side="right") - 1
    return motion.q[index]


def training_samples(motion: Motion, config: GmmSettings) -> FloatArray:
    """Return the (n_phase_frames, F) samples a motion contributes to its class; F = D, or 1 + D with phase first."""
    postures = resampled_postures(unwrap_angles(motion) if config.unwrap_angles else motion, config.n_phase_frames)
    if not config.phase_feature:
        return postures
    return np.column_stack([np.arange(config.n_phase_frames, dtype=np.float64), postures])
