"""Voxel grids and the probability that a human occupies each voxel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked

#: A lattice of more voxels would take more memory and time than any prediction has; places are within this (m).
MOST_VOXELS, _FARTHEST_M = 1 << 24, 1e4


@dataclass(frozen=True)
class VoxelGrid:
    """An axis-aligned lattice of cubic voxels in the world frame."""

    origin_m: tuple[float, float, float]  #: lower corner of the first voxel, world frame
    resolution_m: float  #: edge length of a voxel
    shape: tuple[int, int, int]  #: number of voxels along x, y, z; flat indices run z fastest (C order)

    def __post_init__(self) -> None:
        origin = checked("grid origin", self.origin_m, (3,))
        object.__setattr__(self, "origin_m", tuple(float(x) for x in origin))
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        if not self.resolution_m > 0 or not np.isfinite(self.resolution_m):
            raise ArrayError(f"grid resolution: wanted a positive length in metres, got {self.resolution_m}")
        if len(self.shape) != 3 or min(self.shape) < 1 or math.prod(self.shape) > MOST_VOXELS:
            raise ArrayError(
                f"grid shape: wanted three positive voxel counts, at most {MOST_VOXELS} voxels in all, got {self.shape}"
            )
        if max(map(abs, self.origin_m)) + self.resolution_m * max(self.shape) > _FARTHEST_M:
            raise ArrayError(f"grid: wanted a lattice within {_FARTHEST_M:g} m of the world's origin, got one beyond")

    @property
    def size(self) -> int:
        """Number of voxels."""
        return math.prod(self.shape)

    def flat_index(self, points_m: FloatArray) -> NDArray[np.int64]:
        """Return the flat voxel index of each point (..., 3), world frame; -1 outside the grid."""
        cell = np.floor((np.asarray(points_m, dtype=np.float64) - self.origin_m) / self.resolution_m)
        with np.errstate(invalid="ignore"):
            inside = np.asarray(np.logical_and(cell >= 0, cell < self.shape).all(axis=-1))
        ijk = np.where(inside[..., None], cell, 0.0).astype(np.int64)
        flat = (ijk[..., 0] * self.shape[1] + ijk[..., 1]) * self.shape[2] + ijk[..., 2]
        return np.where(inside, flat, -1)

    def centres_m(self, flat: NDArray[np.int64]) -> FloatArray:
        """Return the (..., 3) centres of voxels given by flat index, world frame."""
        ijk = np.stack(np.unravel_index(flat, self.shape), axis=-1)
        centres: FloatArray = np.asarray(self.origin_m) + (ijk + 0.5) * self.resolution_m
        return centres

    def mask_of(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return the boolean grid of voxels that hold at least one of the points."""
        mask = np.zeros(self.size, dtype=np.bool_)
        flat = self.flat_index(points_m).ravel()
        mask[flat[flat >= 0]] = True
        return mask.reshape(self.shape)


_ONE_STEP = 1.0 / 255.0


@lru_cache
def probability_of_code() -> NDArray[np.float32]:
    """Return the (256,) probabilities that travel, ascending: 0, 1/255, 3/255, 4/255 ... and next to 1, and 1."""
    steps = np.append(0.0, np.arange(1, 256) + 1.0) * _ONE_STEP
    steps[[1, 255]] = _ONE_STEP, 1.0
    table: NDArray[np.float32] = steps.astype(np.float32)
    table[254] = np.nextafter(np.float32(1.0), np.float32(0.0))
    table.setflags(write=False)
    return table


@lru_cache
def _largest_of_code() -> NDArray[np.float32]:
    """Return the largest probability (256,) that each code stands for: its own, but for the first."""
    largest = probability_of_code().copy()
    largest[1] = 2.0 * _ONE_STEP
    return largest


def codes_of(probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the 8-bit codes of probabilities above 0, of any shape: at most 1/255 off (`probability_of_code`).

    Above 2/255 none is rounded down, so that a voxel that reaches a threshold still does; none becomes 0, and 1 stays
    1 and is the only one. Probabilities that were rounded once stay as they are.
    """
    codes: NDArray[np.uint8] = np.clip(
        np.ceil(probability * np.float32(255.0) - np.float32(1.0001)), 1.0, 254.0
    ).astype(np.uint8)
    codes += _largest_of_code()[codes] < probability
    return codes


_BITS_OF_ONE = np.float32(1.0).view(np.uint32)


@dataclass(frozen=True)
class Occupancy:
    """Probability that the human occupies each voxel.

    Attributes:
        grid: the lattice.
        probability: float32 array of the grid's shape, each value in [0, 1].
        t_s: stamp of the observed posture it follows from, in seconds.
    """

    grid: VoxelGrid
    probability: NDArray[np.float32]
    t_s: float = 0.0

    def __post_init__(self) -> None:
        p = np.asarray(self.probability, dtype=np.float32)
        if p.shape != self.grid.shape:
            raise ArrayError(f"occupancy: wanted probabilities of shape {self.grid.shape}, got {p.shape}")
        # Numbers from 0 to 1 are ordered as their bits are; all others, NaN too, have larger ones, but so has -0.
        if p.view(np.uint32).max() > _BITS_OF_ONE and not (p.min() >= 0.0 and p.max() <= 1.0):
            raise ArrayError(f"occupancy: wanted probabilities within [0, 1], got {p.min()} to {p.max()}")
        object.__setattr__(self, "probability", p)

    def voxels_above(self, threshold: float) -> NDArray[np.int64]:
        """Return the flat indices of voxels whose probability exceeds `threshold`, ascending."""
        return np.flatnonzero(self.probability.ravel() > threshold).astype(np.int64)

    def sparse(self, threshold: float) -> Occupancy:
        """Return the occupancy as it survives publication: 0 up to `threshold`, else in steps of 1/255 (`codes_of`)."""
        flat = self.voxels_above(threshold)
        kept = np.zeros(self.grid.size, dtype=np.float32)
        kept[flat] = probability_of_code()[codes_of(self.probability.ravel()[flat])]
        return Occupancy(self.grid, kept.reshape(self.grid.shape), self.t_s)


@dataclass(frozen=True, eq=False)
class OccupancyInTime:
    """Probability that the human is in a voxel at some time of a slice, for slices that follow each other.

    Attributes:
        grid: the lattice.
        edges_s: (S + 1,) where slices begin and end, seconds after `t_s`, ascending from 0; the last may be infinite.
        voxels: (N,) flat indices, ascending, of the voxels that may be occupied; all others have probability 0.
        probability: (N, S) float32 of these voxels, each value in [0, 1].
        t_s: stamp of the observed posture it follows from, in seconds.
    """

    grid: VoxelGrid
    edges_s: NDArray[np.float64]
    voxels: NDArray[np.int64]
    probability: NDArray[np.float32]
    t_s: float = 0.0

    def __post_init__(self) -> None:
        if self.probability.shape != (len(self.voxels), len(self.edges_s) - 1):
            raise ArrayError(
                f"occupancy in time: wanted probabilities of shape {(len(self.voxels), len(self.edges_s) - 1)}, "
                f"got {self.probability.shape}"
            )

    def slice_at(self, ahead_s: float) -> int:
        """Return the number of the slice that holds a time so long after `t_s`; the last one beyond all."""
        found = int(np.searchsorted(self.edges_s, ahead_s, side="right")) - 1
        return min(max(found, 0), len(self.edges_s) - 2)

    def during(self, k: int) -> Occupancy:
        """Return slice `k` as an occupancy of the whole lattice."""
        p = np.zeros(self.grid.size, dtype=np.float32)
        p[self.voxels] = self.probability[:, k]
        return Occupancy(self.grid, p.reshape(self.grid.shape), self.t_s)
