"""An arm flattened to float32 arrays, because compiled kernels want constants and not objects.

Every joint is brought to a coordinate axis: where joint l turns about another axis, its frame is re-based by
a fixed rotation B_l that carries z onto it, which the next joint's origin and the attached points absorb.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.chain import KinematicChain
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.stomp import cost_kernels

Float32Array = NDArray[np.float32]


@dataclass(frozen=True)
class FlatChain:
    """A chain and the points on it, ready for `cost_kernels`.

    Positions come out in cells of a lattice: `(world - lattice origin) / resolution`.

    Attributes:
        root: (12,) rotation (row by row) and translation of the root, in cells.
        joints: (J, 20) one row per joint, columns as named in `cost_kernels`; lengths in metres.
        points: (P, 4) position in the joint's frame and radius (zero for plain points), metres, by joint.
    """

    root: Float32Array
    joints: Float32Array
    points: Float32Array


def flatten(
    chain: KinematicChain,
    link: NDArray[np.int64],
    local_m: FloatArray,
    radius_m: FloatArray,
    lattice_origin_m: FloatArray,
    resolution_m: float,
) -> FlatChain:
    """Return `chain` with spheres or points (P, 3) attached to its joints, in cells of a lattice.

    Args:
        chain: the arm.
        link: (P,) joint each point moves with.
        local_m, radius_m: (P, 3) and (P,) centres in the joints' frames and radii; 0 for plain points.
        lattice_origin_m, resolution_m: where the lattice's coordinates are zero, and its unit.

    Raises:
        ArrayError: if there are no points or one is attached to a joint the chain does not have.
    """
    n = chain.n_joints
    if len(link) == 0 or link.max() >= n:
        raise ArrayError(f"flat chain: wanted points on joints 0 to {n - 1}, got joints {sorted(set(link.tolist()))}")
    bases = np.stack([_basis(axis) for axis in chain.joint_axis])
    before = np.concatenate([np.eye(3)[None], bases[:-1]])
    origin = np.einsum("jba,jb->ja", before, chain.joint_origin_m)
    rotation = np.swapaxes(before, 1, 2) @ chain.joint_rotation @ bases
    turned = np.abs(rotation - np.eye(3)).max(axis=(1, 2)) > 0.0
    based = np.abs(bases - np.eye(3)).max(axis=(1, 2)) > 0.0
    axis = np.where(based, 2, np.argmax(chain.joint_axis, axis=1))

    order = np.argsort(link, kind="stable")
    local = np.einsum("pba,pb->pa", bases[link], local_m)[order]
    offset = np.searchsorted(link[order], np.arange(n + 1))
    root_rotation = chain.T_world_root[:3, :3] / resolution_m
    root_position = (chain.T_world_root[:3, 3] - lattice_origin_m) / resolution_m
    joints = np.zeros((n, cost_kernels.COLUMNS))
    joints[:, : cost_kernels.ROTATION] = origin
    joints[:, cost_kernels.ROTATION : cost_kernels.TURNED] = rotation.reshape(n, 9)
    joints[:, cost_kernels.TURNED] = turned
    joints[:, cost_kernels.AXIS] = axis
    joints[:, cost_kernels.FIRST], joints[:, cost_kernels.LAST] = offset[:-1], offset[1:]
    joints[:, cost_kernels.BOUND :] = _bounds(local, radius_m[order], offset)
    return FlatChain(
        root=_f32(np.concatenate([root_rotation.ravel(), root_position])),
        joints=_f32(joints),
        points=_f32(np.column_stack([local, radius_m[order]])),
    )


def _bounds(local: FloatArray, radius: FloatArray, offset: NDArray[np.int64]) -> FloatArray:
    """Return a ball around each link's spheres (J, 4); links without spheres get an empty one."""
    bound = np.zeros((len(offset) - 1, 4))
    for j, (first, last) in enumerate(pairwise(offset)):
        if last > first:
            p, r = local[first:last], radius[first:last]
            centre = ((p - r[:, None]).min(axis=0) + (p + r[:, None]).max(axis=0)) / 2.0
            bound[j, :3] = centre
            bound[j, 3] = (np.linalg.norm(p - centre, axis=1) + r).max()
    return bound


def _basis(axis: FloatArray) -> FloatArray:
    """Return the identity for +x, +y, +z, and otherwise a rotation whose third column is `axis`."""
    if np.abs(axis - np.eye(3)[int(np.argmax(axis))]).max() == 0.0:
        return np.eye(3)
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    u = np.cross(helper, axis)
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(axis, u), axis], axis=1)


def _f32(array: FloatArray) -> Float32Array:
    return frozen(np.ascontiguousarray(array, dtype=np.float32))  # type: ignore[return-value]
