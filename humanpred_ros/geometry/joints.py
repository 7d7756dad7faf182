"""Joints of an arm or a person as one table of numbers, which is what compiled kernels take.

Nothing here is compiled, so that what only reads descriptions does not load a compiler.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, frozen

if TYPE_CHECKING:
    from humanpred_ros.geometry.chain import KinematicChain

Float32Array = NDArray[np.float32]

# Compiled functions use these constants.
#: Columns of a table of joints: origin (3) and fixed rotation (9, row by row) from the joint before, whether that
#: rotation is another than none, kind (0, 1, 2: turns about x, y, z; 3, 4, 5: slides along them; 6, 7: turns about and
#: slides along another axis), -1 if the axis points the other way, unit axis (3); and, of a `FlatChain`, first and
#: last + 1 of the points that move with the joint, centre and radius of a ball around them.
ROTATION, TURNED, KIND, SIGN, AXIS, FIRST, LAST, BOUND, COLUMNS = 3, 12, 13, 14, 15, 18, 19, 20, 24


class Joints(NamedTuple):
    """J joints as kernels want them; a parent comes before its children."""

    parent: NDArray[np.int64]  #: (J,) number of the joint before: 0 for the root, j + 1 for joint j
    table: FloatArray  #: (J, COLUMNS) float64, a row per joint; lengths in metres

    @classmethod
    def of(cls, parent: ArrayLike, T_parent_joint: FloatArray, axis: FloatArray, slides: ArrayLike) -> Joints:
        """Return the joints of a tree.

        Args:
            parent: (J,) as above.
            T_parent_joint: (J, 4, 4) pose of each joint at zero in the joint before.
            axis: (J, 3) unit axes in the joints' own frames.
            slides: (J,) whether a joint slides along its axis instead of turning about it.
        """
        table = np.zeros((len(axis), COLUMNS))
        table[:, :ROTATION] = T_parent_joint[:, :3, 3]
        table[:, ROTATION:TURNED] = T_parent_joint[:, :3, :3].reshape(-1, 9)
        table[:, TURNED] = np.abs(T_parent_joint[:, :3, :3] - np.eye(3)).max(axis=(1, 2)) > 0.0
        along = np.argmax(np.abs(axis), axis=1)
        table[:, SIGN] = np.sign(axis[np.arange(len(axis)), along])
        straight = np.abs(np.abs(axis).sum(axis=1) - 1.0) < 1e-12
        slides = np.asarray(slides, dtype=np.bool_)
        table[:, KIND] = np.where(straight, along + 3 * slides, 6 + slides)
        table[:, AXIS:FIRST] = axis
        return cls(np.array(parent, dtype=np.int64), table)

    @property
    def axis(self) -> FloatArray:
        """(J, 3) unit axes in the joints' own frames."""
        return self.table[:, AXIS:FIRST]

    @property
    def slides(self) -> NDArray[np.bool_]:
        """(J,) whether a joint slides along its axis instead of turning about it."""
        return np.isin(self.table[:, KIND], (3, 4, 5, 7))


class FlatChain(NamedTuple):
    """A chain and points fixed to it in single precision, for kernels that plan.

    Positions come out in cells of a lattice: `(world - lattice origin) / resolution`.
    """

    root: Float32Array  #: (12,) rotation (row by row) and translation of the root, in cells
    joints: Float32Array  #: (J, COLUMNS) a row per joint, columns as named in `chain_kernels`; lengths in metres
    points: Float32Array  #: (P, 4) position in the joint's frame and radius (zero for plain points), metres, by joint


def flatten(
    chain: KinematicChain,
    link: NDArray[np.int64],
    local_m: FloatArray,
    radius_m: FloatArray,
    lattice_origin_m: FloatArray,
    resolution_m: float,
) -> FlatChain:
    """Return `chain` with spheres or points (P, 3) attached to its joints, in cells of a lattice.

    Every joint is brought to a coordinate axis: where one turns about another axis, its frame is turned so that z lies
    along it, which the next joint's origin and the attached points take up.

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
    based = np.abs(bases - np.eye(3)).max(axis=(1, 2)) > 0.0
    axis = np.where(based, 2, np.argmax(chain.joint_axis, axis=1))

    order = np.argsort(link, kind="stable")
    local = np.einsum("pba,pb->pa", bases[link], local_m)[order]
    offset = np.searchsorted(link[order], np.arange(n + 1))
    root_rotation = chain.T_world_root[:3, :3] / resolution_m
    root_position = (chain.T_world_root[:3, 3] - lattice_origin_m) / resolution_m
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotation, origin
    joints = Joints.of(np.arange(n), T, np.eye(3)[axis], np.zeros(n, dtype=np.bool_)).table
    joints[:, FIRST], joints[:, LAST] = offset[:-1], offset[1:]
    joints[:, BOUND:] = _bounds(local, radius_m[order], offset)
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
