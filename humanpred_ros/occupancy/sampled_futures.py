"""From sampled futures of a body, sequences of postures, to the probability that a voxel is going to be touched."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry import posture_kernels as human_kernels
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy import sampled_kernels as kernels
from humanpred_ros.occupancy.body_parts import BodyParts, Float32Array
from humanpred_ros.occupancy.forecast_config import MOST_FUTURES
from humanpred_ros.occupancy.point_kernels import spread_out
from humanpred_ros.occupancy.voxeliser import DEFAULT_SPACING_M, BodyVoxeliser, checked_placement


@dataclass(frozen=True)
class SweepConfig:
    """How futures are turned into voxels; the meaning is as in `ForecastConfig`."""

    step_voxels: float = 0.8
    thinning: int = 3
    spread: float = 0.3
    spacing_m: float = DEFAULT_SPACING_M

    def __post_init__(self) -> None:
        if self.thinning < 1 or not 0.0 < self.step_voxels < np.inf or not 0.0 < self.spacing_m < np.inf:
            raise UsageError(f"sweep: wanted a thinning of 1 or more, positive steps and spacing, got {self}")
        if not 0.0 <= self.spread <= 1.0:
            raise UsageError(f"sweep: wanted a spread within [0, 1], got {self.spread}")


class SampledFutures:
    """Counts which voxels futures touch: p(voxel) = sum over futures of P(future) [it touches the voxel].

    Where the body is now has probability 1, and nothing else has. Holds room to work in: one object per thread.

    Args:
        human: whose body it is.
        grid: the lattice, world frame.
        T_world_human: (4, 4) rigid transform from the tracker's frame to the world.
        config: settings.

    Raises:
        ArrayError: a placement that is not a rigid transform.
    """

    def __init__(
        self, human: HumanModel, grid: VoxelGrid, T_world_human: ArrayLike, config: SweepConfig | None = None
    ) -> None:
        self.human, self.grid = human, grid
        self.config = config or SweepConfig()
        self._voxeliser = BodyVoxeliser(human, grid, T_world_human, self.config.spacing_m)
        self._T_grid_human = checked_placement(T_world_human).copy()
        self._T_grid_human[:3, 3] -= grid.origin_m
        self._T_grid_human[:3] /= grid.resolution_m
        self._parts = BodyParts.of(human, self.config.spacing_m, self.config.thinning)
        self._part_joint = human.link_joint[self._parts.link]
        self._T_joint_part = human.T_joint_link[self._parts.link]
        low, high = self._parts.corners_m[:, 0], self._parts.corners_m[:, -1]
        self._balls = np.column_stack([(low + high) / 2, np.linalg.norm(high - low, axis=1) / 2])
        self._touched = np.zeros(grid.size + 1, dtype=np.uint32)
        self._share = np.zeros([n + 2 for n in grid.shape], dtype=np.float32)
        self._busy = np.zeros([n + 2 for n in grid.shape[:2]], dtype=np.bool_)

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
        now = self._voxeliser.mask(q)
        n_dofs = len(self.human.dof_names)
        for weights, paths in futures:
            postures = checked("futures", paths, ("S", "N", n_dofs))
            probability = checked("probability of futures", weights, (len(postures),))
            if len(postures) > MOST_FUTURES or (probability < 0.0).any():
                raise ArrayError(
                    f"futures: wanted at most {MOST_FUTURES} in a group, of probability 0 or more, got {len(postures)}"
                )
            if postures.size:
                self._add(postures, probability)
        kernels.add_body(now, self._share, self._busy)
        p = np.zeros(self.grid.shape, dtype=np.float32)
        spread_out(self._share, self._busy, now, self.config.spread, p)
        self._busy[:] = False
        return p

    def _add(self, postures: FloatArray, probability: FloatArray) -> None:
        S, N, D = postures.shape
        poses = human_kernels.link_poses(
            np.ascontiguousarray(postures.reshape(S * N, D)),
            *self.human.joints,
            self._part_joint,
            self._T_joint_part,
        )
        kernels.sweep(
            poses.reshape(S, N, len(self._part_joint), 4, 4),
            self._T_grid_human,
            self._parts.points,
            self._parts.first,
            self._balls,
            self.config.step_voxels * self.grid.resolution_m,
            self.grid.shape,
            self._touched,
        )
        kernels.add_share(self._touched, probability, self._share, self._busy)
