"""A library small enough to learn in a test: smooth, noisy reaches of the 12-DoF human, drawn from a seed."""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion, MotionLibrary

DOF_NAMES = (
    "PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotZ", "TorsoX", "TorsoY", "TorsoZ",
    "rShoulderX", "rShoulderZ", "rShoulderY", "rArmTrans", "rElbowZ",
)  # fmt: skip
#: Somebody standing at (0, 0) who faces +x and lets the right arm hang.
REST = np.array([0.0, 0.0, 0.76, 0.0, 0.1, 0.02, 0.0, 1.35, -0.15, -0.2, 0.1, 0.4])
#: How far each class moves each DoF away from rest.
REACHES = np.array(
    [
        [0.02, 0.03, -0.02, 0.25, 0.10, 0.08, 0.02, -0.45, 0.55, 0.30, 0.02, 0.35],
        [0.04, -0.02, -0.02, -0.15, 0.05, 0.10, -0.02, -0.25, 0.90, -0.25, 0.01, 0.20],
        [0.06, 0.00, -0.05, 0.05, 0.18, 0.15, 0.00, -0.60, 0.75, 0.05, 0.03, -0.25],
        [0.01, 0.05, -0.01, 0.40, 0.02, 0.02, 0.01, -0.30, 0.35, 0.45, 0.00, 0.55],
    ]
)


def small_library(
    n_classes: int = 3,
    n_motions: int = 6,
    n_frames: int = 40,
    *,
    duration_s: float = 1.5,
    there_and_back: bool = False,
    seed: int = 0,
) -> MotionLibrary:
    """Return `n_motions` reaches of each of up to four classes, labelled 0, 10, 20, 30."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, n_frames)
    profile = phase**3 * (10 - 15 * phase + 6 * phase**2)  # least jerk
    if there_and_back:
        profile = np.sin(np.pi * phase) ** 2
    motions = [
        Motion(
            phase * duration_s,
            REST + profile[:, None] * reach * rng.normal(1.0, 0.05) + _sway(rng, n_frames),
            DOF_NAMES,
            10 * label,
            index,
            "lab",
        )
        for label, reach in enumerate(REACHES[:n_classes])
        for index in range(n_motions)
    ]
    return MotionLibrary("small", tuple(motions), {"source": "drawn by a test"})


def _sway(rng: np.random.Generator, n_frames: int) -> FloatArray:
    """Return (T, 12) where this person happens to stand, plus the tracker's noise."""
    sway: FloatArray = rng.normal(0.0, 0.01, 12) + rng.normal(0.0, 0.003, (n_frames, 12))
    return sway
