"""From futures of a body to the probability that a voxel is going to be touched."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry import chain_kernels
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy import future_kernels as kernels
from humanpred_ros.occupancy.recorded_futures import BodyParts, Float32Array
from humanpred_ros.occupancy.voxeliser import DEFAULT_SPACING_M, BodyVoxeliser, checked_placement
from humanpred_ros.settings import Settings, setting

#: A voxel remembers in one bit each which of the futures touch it.
MOST_FUTURES = 32


class SweepSettings(Settings):
    """How futures are turned into voxels.

    None is critical: half or twice any of these makes the leave-one-out Brier score on library_b 4 % worse at most, and
    thinning or steps halved, at twice the time, 1 % better.
    """

    step_voxels: float = setting(
        0.8, "successive postures of a future are so many voxels apart, at the part that moves most", low=1e-6, high=1e3
    )
    thinning: int = setting(
        3,
        "each posture of a future takes every this many-th point of the surface, the next one others",
        low=1,
        high=100,
    )
    spread: float = setting(
        0.3,
        "share of its probability that a voxel gives to its six neighbours: samples are few, trackers noisy",
        low=0.0,
        high=1.0,
    )
    spacing_m: float = setting(
        DEFAULT_SPACING_M, "distance between points on the body's surface", unit="m", low=1e-3, high=10.0
    )


class FutureVoxels:
    """Counts which voxels futures touch. Holds room to work in: one object per thread.

    Attributes:
        human: whose body it is.
        grid: the lattice, world frame.
        settings: how futures are turned into voxels.
        parts: of the body.
        balls: (P, 4) centre and radius of a ball around each part, metres, part's frame.
        T_grid_human: (4, 4) from the tracker's frame to the grid in units of voxels.
        touched: (V + 1,) bits, for the kernels (`future_kernels`).
    """

    def __init__(self, human: HumanModel, grid: VoxelGrid, T_world_human: ArrayLike, settings: SweepSettings) -> None:
        """Prepare for a placement (4, 4). Raises ArrayError for one that is not a rigid transform."""
        self.human, self.grid, self.settings = human, grid, settings
        self._voxeliser = BodyVoxeliser(human, grid, T_world_human, settings.spacing_m)
        self.T_grid_human = checked_placement(T_world_human).copy()
        self.T_grid_human[:3, 3] -= grid.origin_m
        self.T_grid_human[:3] /= grid.resolution_m
        self.parts = BodyParts.of(human, settings.spacing_m, settings.thinning)
        low, high = self.parts.corners_m[:, 0], self.parts.corners_m[:, -1]
        self.balls = np.column_stack([(low + high) / 2, np.linalg.norm(high - low, axis=1) / 2])
        self.touched = np.zeros(grid.size + 1, dtype=np.uint32)
        self._share = np.zeros([n + 2 for n in grid.shape], dtype=np.float32)
        self._busy = np.zeros([n + 2 for n in grid.shape[:2]], dtype=np.bool_)

    def add(self, probability: FloatArray) -> None:
        """Count the futures that `touched` says, with their probabilities (S,)."""
        kernels.add_share(self.touched, probability, self._share, self._busy)

    def body(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Return the boolean grid of where the body is in posture (D,); raises as `BodyVoxeliser.mask`."""
        return self._voxeliser.mask(q)

    def collected(self, now: NDArray[np.bool_]) -> Float32Array:
        """Return the grid of probabilities of all futures added since the last call, with the body in voxels `now`.

        Where the body is now has probability 1, and nothing else has.
        """
        kernels.add_body(now, self._share, self._busy)
        p = np.zeros(self.grid.shape, dtype=np.float32)
        kernels.spread_out(self._share, self._busy, now, self.settings.spread, p)
        return p


class SampledFutures(FutureVoxels):
    """p(voxel) = sum over futures of P(future) [it touches the voxel], for futures given as sequences of postures."""

    def __init__(
        self, human: HumanModel, grid: VoxelGrid, T_world_human: ArrayLike, settings: SweepSettings | None = None
    ) -> None:
        super().__init__(human, grid, T_world_human, settings or SweepSettings())
        self._part_joint = human.link_joint[self.parts.link]
        self._T_joint_part = human.T_joint_link[self.parts.link]

    def probability(self, q: FloatArray, futures: Iterable[tuple[ArrayLike, ArrayLike]]) -> Float32Array:
        """Return the grid of probabilities (float32) for a body in posture `q` (D,) with given futures.

        Args:
            q: the present posture.
            futures: groups of at most 32 futures each: probabilities (S,) and postures (S, N, D). Probabilities of
                all groups sum to at most 1.

        Raises:
            HumanModelError: a posture of another human.
            ArrayError: arrays that do not fit each other.
        """
        now = self.body(q)
        n_dofs = len(self.human.dof_names)
        groups = []
        for weights, paths in futures:
            postures = checked("futures", paths, ("S", "N", n_dofs))
            probability = checked("probability of futures", weights, (len(postures),))
            if len(postures) > MOST_FUTURES or (probability < 0.0).any():
                raise ArrayError(
                    f"futures: wanted at most {MOST_FUTURES} in a group, of probability 0 or more, got {len(postures)}"
                )
            groups.append((postures, probability))
        for postures, probability in groups:
            if postures.size:
                self._sweep(postures)
                self.add(probability)
        return self.collected(now)

    def _sweep(self, postures: FloatArray) -> None:
        S, N, D = postures.shape
        poses = chain_kernels.link_poses(
            np.ascontiguousarray(postures.reshape(S * N, D)), self.human.joints, self._part_joint, self._T_joint_part
        )
        kernels.sweep(
            poses.reshape(S, N, len(self._part_joint), 4, 4),
            self.T_grid_human,
            self.parts.points,
            self.parts.first,
            self.balls,
            self.settings.step_voxels * self.grid.resolution_m,
            self.grid.shape,
            self.touched,
        )
