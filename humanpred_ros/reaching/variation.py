"""How much people vary the way they move each DoF: what noise a planner should try for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.trivial import minimum_jerk


def posture_variation(recordings: Sequence[ReachRecording]) -> FloatArray:
    """Return how far each DoF (J,) is from a minimum-jerk line between its ends: root mean square, m and rad.

    The median over recordings, so that a lost marker in one of them does not count.

    Raises:
        MotionError: no recordings.
    """
    if not recordings:
        raise MotionError("variation: wanted at least one recording, got none")
    found = []
    for recording in recordings:
        active = recording.active
        phase = (active.t_s - active.t_s[0]) / active.duration_s
        done = minimum_jerk(phase)[:, None]
        away = active.q - ((1.0 - done) * active.q[0] + done * active.q[-1])
        found.append(np.sqrt((away**2).mean(axis=0)))
    variation: FloatArray = np.median(found, axis=0)
    return variation
