"""Boxes and cylinders with exact signed distances: what tables, cups and the robot's fixed bodies are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen

FloatLike = NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Box:
    """A box centred in its frame.

    Attributes:
        T_world_shape: (4, 4) pose of its centre.
        size_m: (3,) full lengths along its own axes.
    """

    T_world_shape: FloatArray
    size_m: FloatArray

    def __post_init__(self) -> None:
        size = checked("box size", self.size_m, (3,))
        if not (size > 0).all():
            raise ArrayError(f"box size: wanted three positive lengths in metres, got {size}")
        object.__setattr__(self, "T_world_shape", _pose("box", self.T_world_shape))
        object.__setattr__(self, "size_m", frozen(size))

    @property
    def half_extent_m(self) -> FloatArray:
        """(3,) half the lengths of the upright box around it, world frame."""
        half: FloatArray = np.abs(self.T_world_shape[:3, :3]) @ (self.size_m / 2.0)
        return half

    def distance(self, points_m: FloatLike) -> FloatLike:
        """Return the (...) signed distances of world points (..., 3): metres, negative inside."""
        return self.local_distance(*_local(self.T_world_shape, points_m))

    def local_distance(self, x: FloatLike, y: FloatLike, z: FloatLike) -> FloatLike:
        """Return the signed distances of points given by coordinates (...) in the box's own frame."""
        half = (self.size_m / 2.0).astype(x.dtype)
        return _combined(np.abs(x) - half[0], np.abs(y) - half[1], np.abs(z) - half[2])


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A cylinder about the z axis of its frame, centred in it.

    Attributes:
        T_world_shape: (4, 4) pose of its centre.
        radius_m, height_m: metres.
    """

    T_world_shape: FloatArray
    radius_m: float
    height_m: float

    def __post_init__(self) -> None:
        if not (self.radius_m > 0 and self.height_m > 0 and np.isfinite([self.radius_m, self.height_m]).all()):
            raise ArrayError(
                f"cylinder: wanted a positive radius and height in metres, got {self.radius_m} and {self.height_m}"
            )
        object.__setattr__(self, "T_world_shape", _pose("cylinder", self.T_world_shape))

    @property
    def half_extent_m(self) -> FloatArray:
        """(3,) half the lengths of an upright box around it, world frame."""
        size = np.array([self.radius_m, self.radius_m, self.height_m / 2.0])
        half: FloatArray = np.abs(self.T_world_shape[:3, :3]) @ size
        return half

    def distance(self, points_m: FloatLike) -> FloatLike:
        """Return the (...) signed distances of world points (..., 3): metres, negative inside."""
        return self.local_distance(*_local(self.T_world_shape, points_m))

    def local_distance(self, x: FloatLike, y: FloatLike, z: FloatLike) -> FloatLike:
        """Return the signed distances of points given by coordinates (...) in the cylinder's own frame."""
        radial = np.sqrt(x * x + y * y) - x.dtype.type(self.radius_m)
        axial = np.abs(z) - z.dtype.type(self.height_m / 2.0)
        return _combined(radial, axial)


Shape = Box | Cylinder


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A shape with the name that messages call it by."""

    name: str
    shape: Shape


def planar_pose(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> FloatArray:
    """Return the (4, 4) pose at a place, turned about the vertical."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0, x_m], [s, c, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]])


def _pose(what: str, T: FloatArray) -> NDArray[np.generic]:
    T = checked(f"{what} pose", T, (4, 4))
    if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-6 or np.linalg.det(T[:3, :3]) < 0:
        raise ArrayError(f"{what} pose: wanted a rigid (4, 4) transform, got\n{T}")
    return frozen(T)


def _local(T_world_shape: FloatArray, points_m: FloatLike) -> list[FloatLike]:
    """Return x, y and z of world points (..., 3) in a shape's frame."""
    offset = [points_m[..., i] - T_world_shape[i, 3] for i in range(3)]
    return [sum(T_world_shape[i, axis] * offset[i] for i in range(3)) for axis in range(3)]


def _combined(*beyond: FloatLike) -> FloatLike:
    """Distance from how far points lie beyond each pair of faces (negative: between them)."""
    squared, deepest = np.maximum(beyond[0], 0.0) ** 2, beyond[0]
    for part in beyond[1:]:
        squared += np.maximum(part, 0.0) ** 2
        deepest = np.maximum(deepest, part)
    distance: FloatLike = np.sqrt(squared) + np.minimum(deepest, 0.0)
    return distance
