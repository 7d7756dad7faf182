"""Futures of a body, recorded ones or postures, and the probability of a voxel to be touched by them.

A body is a few rigid parts: five poses say where it is, and thirty links need not be moved. How people of a library
went on from each of its postures is prepared once. Of every motion and part of the body, the poses are kept at even
steps of movement, not of time: one pose suffices while a part rests.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry import chain_kernels
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy import future_kernels as kernels
from humanpred_ros.occupancy.future_kernels import MOMENTS, Float32Array, Ways
from humanpred_ros.occupancy.voxeliser import DEFAULT_SPACING_M, BodyVoxeliser, checked_placement
from humanpred_ros.recognition.forest import Exemplars
from humanpred_ros.settings import Settings, setting

#: A voxel remembers in one bit each which of the futures touch it.
MOST_FUTURES = 32
#: Steps of this share of a whole never fall together: points in this order are spread evenly, however many are taken.
_GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)


@dataclass(frozen=True, eq=False)
class BodyParts:
    """The body's surface in P parts, each dealt out to R rounds that cover it thinly."""

    link: NDArray[np.int64]  #: (P,) number of the link in whose frame each part's points are
    #: coordinates x, y, z, each (N,), part after part, and round after round within a part
    points: tuple[Float32Array, Float32Array, Float32Array]
    first: NDArray[np.int64]  #: (P, R + 1) where each part's rounds begin, and where its last one ends
    corners_m: FloatArray  #: (P, 8, 3) of the box around each part's points; the first and the last are opposite

    @classmethod
    def of(cls, human: HumanModel, spacing_m: float, n_rounds: int) -> BodyParts:
        """Return the parts of a human, with points `spacing_m` apart if all rounds are taken together."""
        surface = human.surface(spacing_m)
        part_of, T_part_link = rigid_parts(human)
        heads = np.unique(part_of[surface.link])
        points, first, corners = [], [], []
        n = 0
        for head in heads:
            mine = part_of[surface.link] == head
            T = T_part_link[surface.link[mine]]
            local = np.einsum("nab,nb->na", T[:, :3, :3], surface.local_m[mine]) + T[:, :3, 3]
            low, high = local.min(axis=0), local.max(axis=0)
            corners.append([np.where([i & 4, i & 2, i & 1], high, low) for i in range(8)])
            first.append([n])
            for r in range(n_rounds):
                dealt = local[r::n_rounds]
                # Neighbours on the surface mostly share a voxel; marking one voxel twice in a row is slow.
                points.append(dealt[np.argsort(np.arange(len(dealt)) * _GOLDEN_RATIO % 1.0)])
                n += len(dealt)
                first[-1].append(n)
        x, y, z = np.ascontiguousarray(np.concatenate(points).T.astype(np.float32))
        return cls(heads, (x, y, z), np.array(first, dtype=np.int64), np.array(corners))


def rigid_parts(human: HumanModel) -> tuple[NDArray[np.int64], FloatArray]:
    """Return for each of L links the first link (L,) that it is fixed to, and its pose (L, 4, 4) in that one's frame.

    Links are fixed to each other if their relative pose is the same in two postures that differ in every DoF.
    """
    zero = np.zeros(len(human.dof_names))
    poses = human.link_poses(np.stack([zero, np.linspace(0.1, 0.4, len(zero))]))
    part_of = np.arange(len(human.link_names))
    T_part_link = np.tile(np.eye(4), (len(part_of), 1, 1))
    for link in range(1, len(part_of)):
        relative = np.linalg.inv(poses[:, :link]) @ poses[:, link, None]
        fixed = np.flatnonzero(np.abs(relative[0] - relative[1]).max(axis=(1, 2)) < 1e-9)
        if len(fixed):
            part_of[link], T_part_link[link] = fixed[0], relative[0, fixed[0]]
    return part_of, T_part_link


@dataclass(frozen=True, eq=False)
class RecordedFutures:
    """The ways the body's parts went in every motion of a library."""

    ways: Ways  #: the poses
    label: NDArray[np.int64]  #: (M,) number of each exemplar posture's class
    n_classes: int  #: C

    @classmethod
    def of(cls, exemplars: Exemplars, human: HumanModel, parts: BodyParts, step_m: float) -> RecordedFutures:
        """Prepare the motions of a library.

        Args:
            exemplars: the library's postures.
            human: whose postures they are.
            parts: of this human.
            step_m: a pose is kept as soon as some corner of the part is so far from where it was in the last one kept.
        """
        present, poses, moments, first = [], [], [], []
        n = 0
        for start, end in zip(exemplars.first[:-1], exemplars.first[1:], strict=True):
            on_the_way = human.link_poses(_in_moments(exemplars.q[start:end]))[:, parts.link, :3]
            kept = _steps(np.ascontiguousarray(on_the_way), parts.corners_m, step_m)
            present.append(on_the_way[::MOMENTS])
            first.append([n])
            for part in range(len(parts.link)):
                at = np.flatnonzero(kept[:, part])
                poses.append(on_the_way[at, part])
                moments.append(at)
                n += len(at)
                first[-1].append(n)
        ways = Ways(
            np.concatenate(present).astype(np.float32),
            np.concatenate(poses).astype(np.float32),
            np.concatenate(moments).astype(np.int64),
            np.array(first, dtype=np.int64),
            np.array(exemplars.first, dtype=np.int64),
        )
        label = np.asarray(exemplars.label[exemplars.motion], dtype=np.int64)
        return cls(ways, label, int(exemplars.label.max()) + 1)


def _in_moments(q: FloatArray) -> FloatArray:
    """Return postures (MOMENTS * (T - 1) + 1, D) that lie evenly between postures (T, D)."""
    moment = np.arange(MOMENTS * (len(q) - 1) + 1)
    before = moment // MOMENTS
    after = np.minimum(before + 1, len(q) - 1)
    between: FloatArray = q[before] + (moment % MOMENTS / MOMENTS)[:, None] * (q[after] - q[before])
    return between


@exact
def _steps(poses: FloatArray, corners: FloatArray, step_m: float) -> NDArray[np.bool_]:
    """Return (T, P) which of the poses (T, P, 3, 4) to keep: the first, the last, and where a step is full."""
    n_moments, n_parts = poses.shape[:2]
    kept = np.zeros((n_moments, n_parts), dtype=np.bool_)
    for p in range(n_parts):
        kept[0, p] = kept[n_moments - 1, p] = True
        last = 0
        for t in range(1, n_moments):
            farthest = 0.0
            for c in range(len(corners[p])):
                square = 0.0
                for a in range(3):
                    d = poses[t, p, a, 3] - poses[last, p, a, 3]
                    for b in range(3):
                        d += (poses[t, p, a, b] - poses[last, p, a, b]) * corners[p, c, b]
                    square += d * d
                farthest = max(farthest, square)
            if farthest >= step_m * step_m:
                kept[t, p] = True
                last = t
    return kept


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
