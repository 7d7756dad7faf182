"""P2's joint centres of trunk and right arm, for tests that compare postures by where the body is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from humanpred_ros.human.model import HumanModel

#: P2's name of each joint centre (docs/papers.md, P2 human), and the link whose origin it is.
JOINT_CENTRES: Mapping[str, str] = {
    "Pelvis": "pelvis", "TorsoX": "torso", "rShoulderX": "right_shoulder", "rElbowZ": "right_elbow",
    "rWristX": "right_wrist", "rPalm": "right_palm",
}  # fmt: skip


def joint_centres(model: HumanModel, q: np.ndarray) -> dict[str, np.ndarray]:
    """Return name -> (T, 3) for postures (T, D), (3,) for one posture (D,)."""
    places = model.forward(q)
    return {name: places[link] for name, link in JOINT_CENTRES.items()}
