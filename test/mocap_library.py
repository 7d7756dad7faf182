"""Reaches of the 23-DoF human, drawn from a seed: what motion capture would see of somebody at a table."""

from __future__ import annotations

import numpy as np

from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.reach_recordings import FRAME_ID

HUMAN = HumanModel.mocap23()
#: Somebody who stands at (0, 0), looks along y, and holds the right hand before the belly.
STAND = dict(zip(HUMAN.dof_names, np.zeros(23).tolist(), strict=True)) | {
    "PelvisTransZ": 0.95, "PelvisRotZ": 1.9, "rShoulderTransX": 0.08, "rShoulderTransY": 0.21, "rShoulderTransZ": 0.14,
    "rShoulderY1": -0.7, "rShoulderX": -0.4, "rShoulderY2": 2.4, "rArmTrans": 0.4, "rElbowZ": -1.9, "rElbowX": -1.4,
    "rElbowY": -1.0, "rForeArmTrans": 0.245, "rWristZ": 0.2, "rWristX": 0.3,
}  # fmt: skip
#: By how much a reach changes some DoFs, for each class: across to the left, straight ahead, to the right, and up.
REACHES = (
    {"PelvisTransY": 0.10, "PelvisRotZ": 0.4, "TorsoZ": -0.3, "TorsoY": 0.15, "rShoulderY1": 1.6, "rShoulderX": -0.8,
     "rShoulderY2": -1.2, "rElbowZ": 1.5, "rElbowX": 0.7, "rElbowY": 2.1, "rWristX": -0.7},
    {"PelvisTransY": 0.12, "TorsoX": -0.1, "rShoulderY1": 0.9, "rShoulderX": -0.8, "rShoulderY2": -1.0,
     "rElbowZ": 1.4, "rElbowX": 0.8, "rElbowY": 1.8, "rWristX": -0.5},
    {"PelvisTransX": 0.08, "PelvisRotZ": -0.3, "TorsoZ": 0.2, "rShoulderY1": 0.3, "rShoulderX": -0.9,
     "rShoulderY2": -0.6, "rElbowZ": 1.3, "rElbowX": 0.9, "rElbowY": 1.6, "rWristX": -0.4},
    {"PelvisTransY": 0.05, "TorsoX": 0.1, "rShoulderY1": 0.9, "rShoulderX": -1.6, "rShoulderY2": -1.0,
     "rElbowZ": 1.4, "rElbowX": 0.6, "rElbowY": 1.8, "rWristX": -0.4},
)  # fmt: skip


def mocap_library(
    n_classes: int = 4, n_motions: int = 4, n_frames: int = 80, *, duration_s: float = 1.3, seed: int = 0
) -> MotionLibrary:
    """Return `n_motions` reaches of each of up to four classes, labelled 0, 1, 2 and 3."""
    rng = np.random.default_rng(seed)
    stand = np.array(list(STAND.values()))
    phase = np.linspace(0.0, 1.0, n_frames)
    profile = (phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2))[:, None]  # least jerk
    motions = []
    for label, changes in enumerate(REACHES[:n_classes]):
        change = np.array([changes.get(name, 0.0) for name in HUMAN.dof_names])
        for index in range(n_motions):
            here = stand + rng.normal(0.0, 0.01, 23)
            q = here + profile * change * rng.normal(1.0, 0.04, 23) + rng.normal(0.0, 0.001, (n_frames, 23))
            motions.append(Motion(phase * duration_s, q, HUMAN.dof_names, label, index, FRAME_ID))
    return MotionLibrary("captured", tuple(motions), {"source": "drawn by a test"})
