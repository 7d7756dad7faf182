"""What stands around the arm beside the scene's own obstacles: solids that come and go, and a cloud of points."""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.distance_field import SignedDistanceField
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.geometry.solids import Obstacle
from humanpred_ros.planning.person import distance_to_voxels
from humanpred_ros.robot.scene_file import LARGEST_M

#: Points farther than this outside of what the arm can reach do not matter, nodes of the field's lattice.
_BEYOND = 8
#: Distances beyond this need not be told apart while something is live, m: three times the clearance that costs.
CAP_M = 0.3


class LiveObstacles:
    """Solids by key and a cloud of points, on top of a scene's distance field.

    What could not be read is a doubt under its key, until something that can be read takes its place: what was there
    before stays, and whoever plans must not go on as if that were all.

    Attributes:
        doubts: why something is not known, by key.
        changed: whether `field` has not been asked for since the last change.
    """

    def __init__(self, field: SignedDistanceField) -> None:
        """Take the distance to what never changes."""
        self._still = field
        self._solids: dict[Hashable, tuple[Obstacle, float]] = {}  # until when
        h, origin = field.resolution_m, field.origin_m - (_BEYOND + 0.5) * field.resolution_m
        nx, ny, nz = (n + 2 * _BEYOND for n in field.values.shape)
        self.grid = VoxelGrid((float(origin[0]), float(origin[1]), float(origin[2])), h, (nx, ny, nz))
        self._cells = np.zeros(0, dtype=np.int64)
        #: What was computed last, and for what.
        self._cloud: tuple[NDArray[np.int64], NDArray[np.float32] | None] = self._cells, None
        self._with_solids = tuple[Obstacle, ...](), field.lowered((), CAP_M)
        self.doubts: dict[Hashable, str] = {}
        self.changed = False

    @property
    def solids(self) -> tuple[Obstacle, ...]:
        """The solids there are."""
        return tuple(solid for solid, _ in tuple(self._solids.values()))

    @property
    def cells_m(self) -> FloatArray:
        """(M, 3) middles of the cubes that stand for the cloud."""
        return self.grid.centres_m(self._cells)

    @property
    def doubt(self) -> str:
        """Why not all that is there is known; empty if it is."""
        return next(iter(self.doubts.values()), "")

    def put(self, key: Hashable, obstacle: Obstacle, until_s: float = math.inf) -> None:
        """Let a solid be there until a time, in the place of what had its key."""
        self._solids[key] = obstacle, until_s
        self.doubts.pop(key, None)
        self.changed = True

    def remove(self, key: Hashable) -> None:
        """Let the solid of a key be gone, if there is one."""
        self.changed |= self._solids.pop(key, None) is not None
        self.doubts.pop(key, None)

    def clear(self) -> None:
        """Let all solids be gone, and doubts about them; the cloud stays."""
        self.changed |= bool(self._solids)
        self._solids.clear()
        self.doubts = {key: reason for key, reason in self.doubts.items() if key is None}

    def expire(self, now_s: float) -> None:
        """Let the solids be gone whose time is over."""
        for key in [key for key, (_, until_s) in self._solids.items() if until_s <= now_s]:
            self.remove(key)

    def set_points(self, points_m: FloatArray) -> None:
        """Let a cloud (N, 3) in the world take the place of the last one; its key among the doubts is None.

        Each point fills the cube of the field's lattice that it lies in.

        Raises:
            ArrayError: points that are not finite, or farther away than any workplace is large.
        """
        points = checked("point cloud", points_m, ("N", 3))
        if len(points) and (far := float(np.abs(points).max())) > LARGEST_M:
            raise ArrayError(f"point cloud: wanted metres, got a point {far:.0f} m away; divide millimetres by 1000")
        found = np.flatnonzero(self.grid.mask_of(points))
        self.doubts.pop(None, None)
        if not np.array_equal(found, self._cells):
            self._cells, self.changed = found, True

    def field(self) -> SignedDistanceField:
        """Return the distance to everything; made anew when asked for, in some 10 ms for 20 solids.

        One thread may ask while another changes what is there.
        """
        self.changed = False
        cells, solids = self._cells, self.solids
        if not solids and not len(cells):
            return self._still
        if cells is not self._cloud[0]:
            self._cloud = cells, self._distance_to(cells)
        if solids != self._with_solids[0]:
            self._with_solids = solids, self._still.lowered(solids, CAP_M)
        around, (_, cloud) = self._with_solids[1], self._cloud
        return around if cloud is None else around.no_farther(cloud)

    def _distance_to(self, cells: NDArray[np.int64]) -> NDArray[np.float32] | None:
        """Return the distance of every node of the field to cubes of the lattice; None without any."""
        if not len(cells):
            return None
        still = self._still
        near = distance_to_voxels(self.grid, cells, still.origin_m, still.upper_m, CAP_M)
        first = np.rint((still.origin_m - near.origin_m) / still.resolution_m).astype(np.int64)
        i, j, k = (slice(a, a + n) for a, n in zip(first, still.values.shape, strict=True))
        return near.values[i, j, k]
