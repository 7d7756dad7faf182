"""Phase: P1's frame numbers for P1's motions, time for everything else."""

from __future__ import annotations

import numpy as np
from small_library import DOF_NAMES, small_library

from humanpred_ros.motion.motion import Motion
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.recognition.phase import phase_frames, resampled_postures, training_samples


def test_a_motion_of_100_frames_is_taken_as_it_is() -> None:
    for seed, duration_s in enumerate((1.0, 1.65, 2.371)):
        motion = small_library(1, 1, 100, duration_s=duration_s, seed=seed).motions[0]
        np.testing.assert_array_equal(resampled_postures(motion, 100), motion.q)
        samples = training_samples(motion, GmmSettings())
        np.testing.assert_array_equal(samples[:, 0], np.arange(100))
        np.testing.assert_allclose(phase_frames(motion.t_s, motion.duration_s, 100), np.arange(100), atol=1e-6)


def test_each_sample_is_the_last_posture_recorded_by_then() -> None:
    q = np.arange(4.0)[:, None]
    motion = Motion(np.array([5.0, 5.1, 5.2, 6.0]), q, ("TorsoX",))
    np.testing.assert_array_equal(resampled_postures(motion, 6)[:, 0], [0, 2, 2, 2, 2, 3])


def test_phase_is_clipped_where_a_motion_outlasts_what_is_expected() -> None:
    np.testing.assert_allclose(phase_frames(np.array([0.0, 1.0, 2.0, 9.0]), 2.0, 100), [0.0, 49.5, 99.0, 99.0])


def test_angles_are_unwrapped_on_request() -> None:
    motion = small_library(1, 1, 100).motions[0]
    wrapped = motion.q.copy()
    wrapped[60:, DOF_NAMES.index("rShoulderY")] -= 2 * np.pi
    jumping = motion.with_postures(wrapped)
    np.testing.assert_allclose(training_samples(jumping, GmmSettings(unwrap_angles=True))[:, 1:], motion.q, atol=1e-12)
    np.testing.assert_array_equal(training_samples(jumping, GmmSettings(phase_feature=False)), wrapped)
