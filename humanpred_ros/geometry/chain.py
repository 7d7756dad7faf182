"""A serial arm, and points, spheres and boxes fixed to its links, as plain arrays.

Everything here is in radians and metres. A configuration `q` holds one angle per joint, in joint order; a link carries
the index of the joint it moves with. What is computed is computed by `chain_kernels`; pinocchio is the reference (tests
agree to 1e-9).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.joints import Joints

_ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class KinematicChain:
    """Revolute joints in series, from a root fixed in the world to a tool.

    The frame after joint j is `frame before . translation(origin j) . rotation j . rot(axis j, q j)`.

    Raises:
        ArrayError: for shapes that disagree, axes that are not unit, rotations that are not rotations.
    """

    joint_names: tuple[str, ...]  #: J names, from the root outwards
    joint_origin_m: FloatArray  #: (J, 3) translation from the previous joint's frame (the root for the first)
    #: (J, 3, 3) fixed rotation from the previous joint's frame at zero (identity on many robots)
    joint_rotation: FloatArray
    joint_axis: FloatArray  #: (J, 3) unit rotation axes in the joints' own frames
    T_world_root: FloatArray  #: (4, 4) frame in which the first origin is expressed
    T_last_tool: FloatArray  #: (4, 4) tool frame in the last joint's frame
    lower: FloatArray  #: (J,) limits in rad, -inf and inf where the joint turns without end
    upper: FloatArray
    continuous: NDArray[np.bool_]  #: (J,) true where the joint turns without end
    velocity_limit: FloatArray  #: (J,) rad/s
    #: (J,) rad/s^2, inf where none is known; one number for all
    acceleration_limit: FloatArray = field(default_factory=lambda: np.array(np.inf))

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        n = len(self.joint_names)
        if n == 0:
            raise ArrayError("chain: wanted at least one joint, got none; name the joints from root to tool")
        shapes: dict[str, tuple[int, ...]] = {
            "joint_origin_m": (n, 3),
            "joint_rotation": (n, 3, 3),
            "joint_axis": (n, 3),
            "T_world_root": (4, 4),
            "T_last_tool": (4, 4),
            "lower": (n,),
            "upper": (n,),
            "velocity_limit": (n,),
            "acceleration_limit": (n,),
        }
        if np.ndim(self.acceleration_limit) == 0:
            object.__setattr__(self, "acceleration_limit", np.full(n, self.acceleration_limit))
        for name, shape in shapes.items():
            finite = name not in ("lower", "upper", "velocity_limit", "acceleration_limit")
            array = checked(f"chain {name}", getattr(self, name), shape, finite=finite)
            object.__setattr__(self, name, frozen(array))
        continuous = np.asarray(self.continuous, dtype=np.bool_)
        if continuous.shape != (n,):
            raise ArrayError(f"chain continuous: wanted shape ({n},), got {continuous.shape}")
        object.__setattr__(self, "continuous", frozen(continuous))
        self._check_values()

    def _check_values(self) -> None:
        length = np.linalg.norm(self.joint_axis, axis=1)
        if np.abs(length - 1.0).max() > _ROTATION_TOLERANCE:
            raise ArrayError(f"chain joint_axis: wanted unit vectors, got lengths {length}; normalise them")
        for name, rotation in (
            ("joint_rotation", self.joint_rotation),
            ("T_world_root", self.T_world_root[:3, :3]),
            ("T_last_tool", self.T_last_tool[:3, :3]),
        ):
            error = np.abs(rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)).max()
            if error > _ROTATION_TOLERANCE or np.linalg.det(rotation).min() < 0:
                raise ArrayError(f"chain {name}: wanted a rotation, got a matrix that is off by {error:.2g}")
        if not (self.lower < self.upper).all():
            raise ArrayError(f"chain limits: wanted lower < upper, got {self.lower} and {self.upper}")
        if not (np.isinf(self.lower) & np.isinf(self.upper))[self.continuous].all():
            raise ArrayError("chain limits: wanted -inf and inf for continuous joints, got finite values")
        for name in ("velocity_limit", "acceleration_limit"):
            if not (getattr(self, name) > 0).all():
                raise ArrayError(f"chain {name}: wanted positive numbers, got {getattr(self, name)}")

    @property
    def n_joints(self) -> int:
        """Number of joints J."""
        return len(self.joint_names)

    @cached_property
    def joints(self) -> Joints:
        """The joints as kernels want them, with the world for a root."""
        T = np.tile(np.eye(4), (self.n_joints, 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.joint_rotation, self.joint_origin_m
        T[0] = self.T_world_root @ T[0]
        return Joints.of(np.arange(self.n_joints), T, self.joint_axis, np.zeros(self.n_joints, dtype=np.bool_))

    def link_poses(self, q: ArrayLike) -> FloatArray:
        """Return the world pose of the frame after each joint.

        Args:
            q: (..., J) configurations in rad.

        Returns:
            (..., J, 4, 4).

        Raises:
            ArrayError: if the last axis of `q` is not J long.
        """
        q = np.asarray(q, dtype=np.float64)
        if q.ndim == 0 or q.shape[-1] != self.n_joints:
            raise ArrayError(f"configuration: wanted {self.n_joints} angles on the last axis, got shape {q.shape}")
        from humanpred_ros.geometry.chain_kernels import link_poses  # numba, which not every node needs

        n = self.n_joints
        flat = np.ascontiguousarray(q.reshape(-1, n))
        poses = link_poses(flat, self.joints, np.arange(1, n + 1), np.tile(np.eye(4), (n, 1, 1)))
        return poses.reshape(*q.shape[:-1], n, 4, 4)

    def tool_pose(self, q: ArrayLike) -> FloatArray:
        """Return the (..., 4, 4) world pose of the tool at configurations `q` (..., J)."""
        pose: FloatArray = self.link_poses(q)[..., -1, :, :] @ self.T_last_tool
        return pose


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points on the surface of the moving bodies.

    Raises:
        ArrayError: for arrays that do not fit each other, or a negative index.
    """

    link: NDArray[np.int64]  #: (P,) index of the joint the point moves with
    local_m: FloatArray  #: (P, 3) position in that joint's frame

    def __post_init__(self) -> None:
        link = np.asarray(self.link, dtype=np.int64)
        if link.ndim != 1 or (link < 0).any():
            raise ArrayError(f"{type(self).__name__}: wanted one joint index >= 0 per entry, got {self.link!r:.80}")
        object.__setattr__(self, "link", frozen(link))
        self._freeze("local_m", (len(link), 3))

    def _freeze(self, name: str, shape: tuple[int, ...], *, positive: bool = False) -> None:
        array = checked(f"{type(self).__name__} {name}", getattr(self, name), shape)
        if positive and (array <= 0).any():
            raise ArrayError(f"{type(self).__name__} {name}: wanted positive metres, got {array.min()}")
        object.__setattr__(self, name, frozen(array))

    def __len__(self) -> int:
        return len(self.link)

    def world_m(self, chain: KinematicChain, q: ArrayLike) -> FloatArray:
        """Return the (..., P, 3) world positions at configurations `q` (..., J)."""
        poses = chain.link_poses(q)[..., self.link, :, :]
        world: FloatArray = np.einsum("...pij,pj->...pi", poses[..., :3, :3], self.local_m) + poses[..., :3, 3]
        return world


@dataclass(frozen=True, eq=False)
class BodySpheres(BodyPoints):
    """Spheres that together cover the moving bodies, for collision: centres as `BodyPoints`, and radii (P,)."""

    radius_m: FloatArray

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze("radius_m", (len(self),), positive=True)


@dataclass(frozen=True, eq=False)
class BodyBoxes(BodyPoints):
    """Boxes that fill the moving bodies, inside included, for what must not enter them.

    Centres as `BodyPoints`, half lengths (P, 3) along the axes of the joint's frame, and how far (P,) each box reaches
    beyond them all around: a sphere is a box of hardly any length.
    """

    half_m: FloatArray
    round_m: FloatArray = field(default_factory=lambda: np.array(0.0))  #: one number for all

    def __post_init__(self) -> None:
        super().__post_init__()
        self._freeze("half_m", (len(self), 3), positive=True)
        if np.ndim(self.round_m) == 0:
            object.__setattr__(self, "round_m", np.full(len(self), self.round_m))
        self._freeze("round_m", (len(self),))


def reach_m(chain: KinematicChain, spheres: BodySpheres) -> tuple[FloatArray, float]:
    """Return centre (3,) and radius of a ball that the spheres on a chain never leave, world frame, metres."""
    lengths = np.linalg.norm(chain.joint_origin_m, axis=1)
    to_joint = np.concatenate([[0.0], np.cumsum(lengths[1:])])
    beyond = np.linalg.norm(spheres.local_m, axis=1) + spheres.radius_m
    root = chain.T_world_root
    centre: FloatArray = root[:3, :3] @ chain.joint_origin_m[0] + root[:3, 3]
    return centre, float((to_joint[spheres.link] + beyond).max())


def inverse_pose(T: FloatArray) -> FloatArray:
    """Return the inverse of a rigid transform (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse
