"""What every learned prediction of a reach has to beat: postures on the straight line between start and goal.

They differ in the time profile only, the share of the way that is done at each share of the duration. P2 does not
show them; its own predictions do not beat minimum jerk in joint centres (facts section 8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.reach_task import ReachTask

#: Phases at which time profiles are compared and averaged.
_N_PHASES = 100
#: A motion that ends nearer to where it began than this share of the farthest it was is no reach, but there and back.
_LEAST_WAY_SHARE = 0.25


@dataclass(frozen=True)
class TimedLine:
    """Moves on the straight line in posture space, `profile` (n,) of the way at phases (n,) from 0 to 1."""

    profile: Callable[[FloatArray], FloatArray]

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J); chance plays no part."""
        done = self.profile(task.phase)[:, None]
        postures: FloatArray = (1.0 - done) * task.start + done * task.goal
        return postures


def constant_speed(phase: FloatArray) -> FloatArray:
    """Return the profile of a straight line in posture space over time."""
    return phase


def minimum_jerk(phase: FloatArray) -> FloatArray:
    """Return the profile with the least integral of squared jerk, at rest at both ends."""
    profile: FloatArray = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    return profile


def cubic(phase: FloatArray) -> FloatArray:
    """Return the profile with the least integral of squared acceleration, at rest at both ends."""
    profile: FloatArray = phase**2 * (3.0 - 2.0 * phase)
    return profile


def hold(phase: FloatArray) -> FloatArray:
    """Return the profile of somebody who never leaves the start."""
    return np.zeros_like(phase)


def time_profile(motion: Motion) -> FloatArray:
    """Return how far a motion is along the line from its first to its last posture, (100,) at even phases.

    The projection onto that line, 0 at the start and 1 at the end; in between it may leave that range.

    Raises:
        MotionError: a motion that ends where it began.
    """
    way = motion.q[-1] - motion.q[0]
    length2 = float(way @ way)
    if length2 == 0.0:
        raise MotionError(f"time profile of {motion.name}: wanted a reach, it ends in the posture it began with")
    done = (motion.q - motion.q[0]) @ way / length2
    phase = (motion.t_s - motion.t_s[0]) / motion.duration_s
    profile: FloatArray = np.interp(np.linspace(0.0, 1.0, _N_PHASES), phase, done)
    return profile


def mean_profile(recordings: Sequence[ReachRecording]) -> TimedLine:
    """Return the predictor with the mean time profile of recorded reaches (leave the tested one out).

    Recordings of people who came back to where they began have no profile; without any other it is minimum jerk.

    Raises:
        MotionError: no recordings.
    """
    if not recordings:
        raise MotionError("time profile: wanted at least one recording to learn from, got none")
    profiles = [time_profile(recording.active) for recording in recordings if _gets_somewhere(recording.active)]
    if not profiles:
        return TimedLine(minimum_jerk)
    mean = np.mean(profiles, axis=0)
    phases = np.linspace(0.0, 1.0, _N_PHASES)
    return TimedLine(lambda phase: np.interp(phase, phases, mean))


def _gets_somewhere(motion: Motion) -> bool:
    way = np.linalg.norm(motion.q - motion.q[0], axis=1)
    return bool(way[-1] > _LEAST_WAY_SHARE * way.max())
