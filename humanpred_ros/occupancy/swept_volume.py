"""The space a body sweeps during a motion, as voxels: what P1 takes a class of motions to occupy (P1 IV).

P1 marks the voxels that the body touches in each posture of the motion (facts 3). All bodies count: legs and the
resting arm are in the way like the reaching one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import UsageError
from humanpred_ros.occupancy.voxeliser import DEFAULT_SPACING_M, BodyVoxeliser, checked_placement

__all__ = ["BodyVoxeliser", "SweptVolumeConfig", "checked_placement", "swept_volume"]


@dataclass(frozen=True)
class SweptVolumeConfig:
    """How finely bodies and motions are sampled.

    Attributes:
        spacing_m: distance between points on the surface (P1: 0.02 m).
        n_postures: postures a motion is thinned to; 100 is P1's normal case, and as good as it gets for motions of
            100 frames (10, used when P1 was submitted, loses 6 to 10 % of the voxels, facts 3).
    """

    spacing_m: float = DEFAULT_SPACING_M
    n_postures: int = 100

    def __post_init__(self) -> None:
        if not 0 < self.spacing_m < np.inf or self.n_postures < 1:
            raise UsageError(
                "swept volume: wanted a positive spacing and at least one posture, "
                f"got spacing_m={self.spacing_m}, n_postures={self.n_postures}"
            )


def swept_volume(voxeliser: BodyVoxeliser, q: ArrayLike, config: SweptVolumeConfig | None = None) -> NDArray[np.bool_]:
    """Return the boolean grid of voxels the body touches during a motion (P1 IV).

    Args:
        voxeliser: human, grid and placement.
        q: (T, D) postures in order.
        config: how many of them count.

    Raises:
        HumanModelError: wrong shape or values that are not finite.
    """
    config = SweptVolumeConfig() if config is None else config
    postures = np.atleast_2d(np.asarray(q, dtype=np.float64))
    if len(postures) > config.n_postures:
        postures = postures[np.round(np.linspace(0, len(postures) - 1, config.n_postures)).astype(np.intp)]
    return voxeliser.mask(postures)
