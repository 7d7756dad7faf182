"""Distance to the nearest obstacle on a grid, because a planner asks for it millions of times a second.

Points outside the grid get the value at the nearest point of the grid. Projection onto a box brings a point
no farther from anything inside that box, so this never overstates the clearance from obstacles in the grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.solids import Obstacle

DEFAULT_RESOLUTION_M = 0.025
"""Half the voxel edge of the paper's distance transform (docs/papers.md, P1 occupancy: 0.05 m)."""


@dataclass(frozen=True, eq=False)
class SignedDistanceField:
    """Signed distances at the nodes of an axis-aligned lattice."""

    origin_m: FloatArray  #: (3,) position of node (0, 0, 0), world frame
    resolution_m: float  #: distance between neighbouring nodes
    values: NDArray[np.float32]  #: (nx, ny, nz) float32, contiguous, metres, negative inside an obstacle

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_m", frozen(checked("distance field origin", self.origin_m, (3,))))
        if not (self.resolution_m > 0 and np.isfinite(self.resolution_m)):
            raise ArrayError(f"distance field: wanted a positive resolution in metres, got {self.resolution_m}")
        values = np.array(self.values, dtype=np.float32, order="C")
        if values.ndim != 3 or min(values.shape) < 2 or not np.isfinite(values).all():
            raise ArrayError(
                f"distance field: wanted finite values on at least 2 x 2 x 2 nodes, got shape {values.shape}"
            )
        values.setflags(write=False)
        object.__setattr__(self, "values", values)

    @property
    def upper_m(self) -> FloatArray:
        """(3,) position of the last node."""
        upper: FloatArray = self.origin_m + self.resolution_m * (np.array(self.values.shape) - 1)
        return upper

    def lowered(self, obstacles: Sequence[Obstacle], cap_m: float) -> SignedDistanceField:
        """Return the distance to more obstacles, too; larger distances than `cap_m` are not told apart any more."""
        values = np.minimum(self.values, np.float32(cap_m))
        _lower(values, self.origin_m, self.resolution_m, obstacles, cap_m)
        return SignedDistanceField(self.origin_m, self.resolution_m, values)

    def no_farther(self, distance_m: NDArray[np.float32]) -> SignedDistanceField:
        """Return the field with every value lowered to a distance from something else (nx, ny, nz)."""
        return SignedDistanceField(self.origin_m, self.resolution_m, np.minimum(self.values, distance_m))

    def distance(self, points_m: FloatArray) -> FloatArray:
        """Return trilinearly interpolated distances (...) of world points (..., 3).

        Off by at most the lattice's resolution times sqrt(3) / 2; inside a plate thinner than the
        resolution that can hide its sign, so compare with a robot's radius, not with zero.
        """
        points = _points(points_m)
        from humanpred_ros.geometry.lattice_kernels import Lattice, values_at  # numba, which not every node needs

        lattice = Lattice(self.values, self.origin_m, 1.0 / self.resolution_m)
        return values_at(np.ascontiguousarray(points.reshape(-1, 3)), lattice).reshape(points.shape[:-1])

    def nearest(self, points_m: FloatArray) -> FloatArray:
        """Return the distances (...) stored at the nodes nearest to world points (..., 3)."""
        cell = (_points(points_m) - self.origin_m) / self.resolution_m
        node = np.clip(np.floor(cell + 0.5), 0, np.array(self.values.shape) - 1).astype(np.int64)
        return self.values[node[..., 0], node[..., 1], node[..., 2]].astype(np.float64)


def _points(points_m: FloatArray) -> FloatArray:
    points = np.asarray(points_m, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 3 or not np.isfinite(points).all():
        raise ArrayError(f"distance field: wanted finite points (..., 3), got shape {points.shape}")
    return points


def build_distance_field(
    obstacles: Sequence[Obstacle],
    lower_m: FloatArray,
    upper_m: FloatArray,
    resolution_m: float = DEFAULT_RESOLUTION_M,
    cap_m: float = np.inf,
) -> SignedDistanceField:
    """Evaluate the exact distance to the nearest obstacle on a lattice that encloses a region.

    Args:
        obstacles: at least one, if there is no cap; where two overlap, the inside depth is that of the deeper one.
        lower_m, upper_m: (3,) corners of the region; one node of border is added around it.
        resolution_m: distance between neighbouring nodes.
        cap_m: larger distances are stored as this, which saves most of the work where obstacles are small.

    Raises:
        ArrayError: for no obstacles and no cap, an empty region, or a resolution or cap that is not positive.
    """
    lower = checked("distance field lower corner", lower_m, (3,))
    upper = checked("distance field upper corner", upper_m, (3,))
    if not obstacles and not np.isfinite(cap_m):
        raise ArrayError("distance field: wanted at least one obstacle, got none; the distance would be infinite")
    if not (upper > lower).all():
        raise ArrayError(f"distance field: wanted lower < upper, got {lower} and {upper}")
    if not (resolution_m > 0 and np.isfinite(resolution_m)):
        raise ArrayError(f"distance field: wanted a positive resolution in metres, got {resolution_m}")
    if not cap_m > 0:
        raise ArrayError(f"distance field: wanted a positive cap in metres, got {cap_m}")
    origin = lower - resolution_m
    shape = np.ceil((upper - origin) / resolution_m).astype(int) + 2
    values = np.full(shape, cap_m, dtype=np.float32)
    _lower(values, origin, resolution_m, obstacles, cap_m)
    return SignedDistanceField(origin, resolution_m, values)


def _lower(
    values: NDArray[np.float32], origin: FloatArray, resolution_m: float, obstacles: Sequence[Obstacle], cap_m: float
) -> None:
    """Lower the nodes' values to their distance from obstacles, as far as that is less than the cap."""
    nodes = [origin[axis] + resolution_m * np.arange(values.shape[axis]) for axis in range(3)]
    for obstacle in obstacles:
        centre, half = obstacle.T_world_shape[:3, 3], obstacle.half_extent_m
        near = [
            slice(*np.searchsorted(nodes[axis], (centre[axis] - half[axis] - cap_m, centre[axis] + half[axis] + cap_m)))
            for axis in range(3)
        ]
        _lower_to(values[near[0], near[1], near[2]], [n[part] for n, part in zip(nodes, near, strict=True)], obstacle)


def _lower_to(values: NDArray[np.float32], nodes: Sequence[FloatArray], obstacle: Obstacle) -> None:
    """Lower the nodes' values to their distance from one more obstacle.

    On a lattice a shape's own coordinates are sums of one term per axis, which saves most of the
    arithmetic; and one plane of nodes at a time keeps the temporaries in the cache.
    """
    T = obstacle.T_world_shape
    along_x, along_y, along_z = (
        (T[axis, :3, None] * (nodes[axis] - T[axis, 3])).astype(np.float32) for axis in range(3)
    )
    planes = along_y[:, :, None] + along_z[:, None, :]
    for i in range(len(values)):
        distance = obstacle.shape.local_distance(*(along_x[:, i, None, None] + planes))
        np.minimum(values[i], distance, out=values[i])
