"""A library stands in no scene; to score occupancy with it, a grid like P1's is put around where its people are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.motion.placement import pelvis_columns
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.training import REACHING_LINK

#: P1's environment box along x, y, z (facts 3); in voxels of 0.05 m it is 80 x 80 x 48.
BOX_M = (4.0, 4.0, 2.4)
P1_RESOLUTION_M = 0.05
#: Shares of the library's places outside of which a place may be a tracker's mistake.
_OUTER_PERCENT = (1.0, 99.0)


def grid_around(library: MotionLibrary, human: HumanModel, resolution_m: float = P1_RESOLUTION_M) -> VoxelGrid:
    """Return a grid of P1's size in the library's own frame, centred where its people stand and reach.

    Horizontally the centre is the middle of all start pelvises and palms (but for the outermost hundredths), vertically
    the middle of the body at the median start. The corner lies on a multiple of the resolution.

    Raises:
        UsageError: people or palms that do not fit into the box, or a resolution that is not a length within it.
        MotionError, HumanModelError: a library whose bodies cannot stand anywhere, or of another human.
    """
    if not 0.0 < resolution_m <= min(BOX_M):
        raise UsageError(f"grid: wanted voxels of a positive size up to {min(BOX_M)} m, got {resolution_m}")
    human.check_dofs(library.dof_names)
    columns = pelvis_columns(library.dof_names)
    starts = np.array([motion.q[0] for motion in library])
    palms = human.forward(np.concatenate([motion.q for motion in library]))[REACHING_LINK]
    boxes = [np.percentile(places, _OUTER_PERCENT, axis=0) for places in (starts[:, columns[:3]], palms)]
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    body_z = human.surface_points(np.median(starts, axis=0))[:, 2]
    low[2], high[2] = min(low[2], body_z.min()), max(high[2], body_z.max())
    middle = (low + high) / 2
    middle[2] = (body_z.min() + body_z.max()) / 2
    box = np.array(BOX_M)
    if (low < middle - box / 2).any() or (high > middle + box / 2).any():
        raise UsageError(
            f"grid: wanted a library whose people fit into {BOX_M} m, {library.name} extends over "
            f"{np.round(high - low, 2).tolist()} m; name a scene with a larger grid"
        )
    # Rounded again, so that -0.6 is -0.6 in a file, too.
    origin = np.round(np.round((middle - box / 2) / resolution_m) * resolution_m, 9)
    x, y, z = (round(length / resolution_m) for length in BOX_M)
    return VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), resolution_m, (x, y, z))


def swept_region(library: MotionLibrary, voxeliser: BodyVoxeliser, margin_voxels: int) -> NDArray[np.bool_]:
    """Return the boolean grid of voxels that some motion sweeps, widened by a margin: where scores are taken.

    Raises:
        UsageError: no motion touches the grid.
    """
    region = np.zeros(voxeliser.grid.shape, dtype=np.bool_)
    for motion in library:
        region |= voxeliser.mask(motion.q)
    if not region.any():
        raise UsageError(
            f"grid: wanted people within it, those of {library.name} are all outside; "
            "check the scene's human placement and the shift"
        )
    if margin_voxels:
        region = binary_dilation(region, iterations=margin_voxels)
    return region
