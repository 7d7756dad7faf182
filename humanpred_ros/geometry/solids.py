"""The solids that people, tables, cups and robots are made of: signed distances, points and triangles on their surface.

Every solid is centred on its own frame, its axis along z; distances are negative inside. `sample` covers the surface so
that no point of it is farther than the spacing from a sample (the worst case is spacing / sqrt(2), the half diagonal of
a mesh cell). Nothing is random: the same spacing gives the same points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen

FloatLike = NDArray[np.floating]
# Corners of a box's twelve triangles, as indices into its eight corners (x slowest, z fastest).
_BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_BOX_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_BOX_TRIANGLES = np.array([corners for a, b, c, d in _BOX_SIDES for corners in ((a, b, c), (a, c, d))])
#: Corners of the polygon that stands for a circle, around it: it sticks out by 0.5 % of the radius.
_CORNERS = 32
#: Enough for 1e-9 m from any start inside the bracket of `_distance_to_ellipse`; six or seven are needed in practice.
NEWTON_STEPS = 10


@dataclass(frozen=True)
class Shape(ABC):
    """A solid in its own frame; all fields are lengths in metres.

    Raises:
        ArrayError: a length that is not positive.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            length_m = getattr(self, field.name)
            if not (np.isfinite(length_m) and length_m > 0):
                raise ArrayError(f"{type(self).__name__}: wanted a positive {field.name}, got {length_m}; correct it")

    @property
    @abstractmethod
    def half_m(self) -> tuple[float, float, float]:
        """Half the lengths of the box around it, along its own axes."""

    @abstractmethod
    def local_distance(self, x: FloatLike, y: FloatLike, z: FloatLike) -> FloatLike:
        """Return the signed distances (...) of points given by coordinates (...), in their precision."""

    @abstractmethod
    def sample(self, spacing_m: float) -> FloatArray:
        """Return points (P, 3) on the surface, neighbours at most about `spacing_m` apart."""

    @abstractmethod
    def triangles(self) -> FloatArray:
        """Return the closed surface (F, 3, 3) of a body that holds the solid; at round places it is a little larger."""

    def distance_m(self, points: FloatArray) -> FloatArray:
        """Return the signed distances (...) of points (..., 3)."""
        return np.asarray(self.local_distance(points[..., 0], points[..., 1], points[..., 2]), dtype=np.float64)


@dataclass(frozen=True)
class Sphere(Shape):
    """A ball; distances are exact."""

    radius_m: float

    @property
    def half_m(self) -> tuple[float, float, float]:
        return self.radius_m, self.radius_m, self.radius_m

    def local_distance(self, x: FloatLike, y: FloatLike, z: FloatLike) -> FloatLike:
        return np.sqrt(x * x + y * y + z * z) - x.dtype.type(self.radius_m)

    def sample(self, spacing_m: float) -> FloatArray:
        return _dome(self.radius_m, spacing_m, np.pi)

    def triangles(self) -> FloatArray:
        arc = _outer_arc(self.radius_m)
        return _turned(np.concatenate([arc, arc[::-1] * (1, -1)]), 1.0, 1.0)


@dataclass(frozen=True)
class Box(Shape):
    """A cuboid with edge lengths x, y, z; distances are exact."""

    x_m: float
    y_m: float
    z_m: float

    @property
    def half_m(self) -> tuple[float, float, float]:
        return self.x_m / 2.0, self.y_m / 2.0, self.z_m / 2.0

    def local_distance(self, x: FloatLike, y: FloatLike, z: FloatLike) -> FloatLike:
        half = np.array(self.half_m).astype(x.dtype)
        return _combined(np.abs(x) - half[0], np.abs(y) - half[1], np.abs(z) - half[2])

    def sample(self, spacing_m: float) -> FloatArray:
        ticks = [_ticks(length, spacing_m) for length in (self.x_m, self.y_m, self.z_m)]
        points = np.stack([axis.ravel() for axis in np.meshgrid(*ticks, indexing="ij")], axis=1)
        faces: FloatArray = points[(np.abs(points) == self.half_m).any(axis=1)]
        return faces

    def triangles(self) -> FloatArray:
        exact: FloatArray = (_BOX_CORNERS * self.half_m)[_BOX_TRIANGLES]
        return exact


@dataclass(frozen=True)
class Capsule(Shape):
    """All points within the radius of a segment of the given length on z; distances are exact."""

    radius_m: float
    length_m: float

    @property
    def half_m(self) -> tuple[float, float, float]:
        return self.radius_m, self.radius_m, self.length_m / 2.0 + self.radius_m

    def local_distance(self, x: FloatLike, y: FloatLike, z: FloatLike) -> FloatLike:
        beyond = z - np.clip(z, -self.length_m / 2, self.length_m / 2)
        return np.sqrt(x * x + y * y + beyond * beyond) - x.dtype.type(self.radius_m)

    def sample(self, spacing_m: float) -> FloatArray:
        rim = _ellipse(self.radius_m, self.radius_m, spacing_m)
        dome = _dome(self.radius_m, spacing_m, np.pi / 2)
        end = np.array([0.0, 0.0, self.length_m / 2])
        wall = _stack(rim, _ticks(self.length_m, spacing_m))
        return np.concatenate([wall, dome + end, dome * (1, 1, -1) - end])

    def triangles(self) -> FloatArray:
        arc = _outer_arc(self.radius_m) + np.array([0.0, self.length_m / 2])
        return _turned(np.concatenate([arc, arc[::-1] * (1, -1)]), 1.0, 1.0)


@dataclass(frozen=True)
class EllipticCylinder(Shape):
    """A cylinder whose cross-section is an ellipse with semi-axes along x and y; a plain cylinder has equal ones.

    Distances of a plain one are exact, of others to about 1e-9 m: the nearest point of an ellipse has no closed form
    worth using and is found by Newton's method.
    """

    x_m: float
    y_m: float
    length_m: float

    @property
    def half_m(self) -> tuple[float, float, float]:
        return self.x_m, self.y_m, self.length_m / 2.0

    def local_distance(self, x: FloatLike, y: FloatLike, z: FloatLike) -> FloatLike:
        # In the plane (distance to the ellipse, distance to the end faces) the solid is a corner, like a box's.
        if self.x_m == self.y_m:
            across = np.sqrt(x * x + y * y) - x.dtype.type(self.x_m)
        else:
            across = _distance_to_ellipse(x, y, self.x_m, self.y_m)
        return _combined(across, np.abs(z) - z.dtype.type(self.length_m / 2.0))

    def sample(self, spacing_m: float) -> FloatArray:
        wall = _stack(_ellipse(self.x_m, self.y_m, spacing_m), _ticks(self.length_m, spacing_m))
        rings = int(np.ceil(max(self.x_m, self.y_m) / spacing_m))
        inner = [_ellipse(self.x_m * k / rings, self.y_m * k / rings, spacing_m) for k in range(1, rings)]
        face = np.concatenate([np.zeros((1, 2)), *inner])
        return np.concatenate([wall, _stack(face, np.array([-1.0, 1.0]) * self.length_m / 2)])

    def triangles(self) -> FloatArray:
        return _turned(np.array([[1.0, self.length_m / 2], [1.0, -self.length_m / 2]]), self.x_m, self.y_m)


def cylinder(radius_m: float, height_m: float) -> EllipticCylinder:
    """Return a plain cylinder."""
    return EllipticCylinder(radius_m, radius_m, height_m)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A solid that stands somewhere, with the name that messages call it by.

    Raises:
        ArrayError: for a pose that is not rigid.
    """

    name: str  #: as said
    shape: Shape
    T_world_shape: FloatArray  #: (4, 4) pose of the solid's frame

    def __post_init__(self) -> None:
        T = checked(f"pose of {self.name}", self.T_world_shape, (4, 4))
        if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-6 or np.linalg.det(T[:3, :3]) < 0:
            raise ArrayError(f"pose of {self.name}: wanted a rigid (4, 4) transform, got\n{T}")
        object.__setattr__(self, "T_world_shape", frozen(T))

    @property
    def half_extent_m(self) -> FloatArray:
        """(3,) half the lengths of an upright box around it, world frame."""
        half: FloatArray = np.abs(self.T_world_shape[:3, :3]) @ np.array(self.shape.half_m)
        return half

    def distance_m(self, points_m: FloatLike) -> FloatLike:
        """Return the (...) signed distances of world points (..., 3): metres, negative inside."""
        T = self.T_world_shape
        offset = [points_m[..., i] - T[i, 3] for i in range(3)]
        return self.shape.local_distance(*(sum(T[i, axis] * offset[i] for i in range(3)) for axis in range(3)))


def planar_pose(x_m: float, y_m: float, z_m: float = 0.0, yaw_rad: float = 0.0) -> FloatArray:
    """Return the (4, 4) pose at a place, turned about the vertical."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0, x_m], [s, c, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]])


def _combined(*beyond: FloatLike) -> FloatLike:
    """Distance from how far points lie beyond each pair of faces (negative: between them)."""
    squared, deepest = np.maximum(beyond[0], 0.0) ** 2, beyond[0]
    for part in beyond[1:]:
        squared = squared + np.maximum(part, 0.0) ** 2
        deepest = np.maximum(deepest, part)
    distance: FloatLike = np.sqrt(squared) + np.minimum(deepest, 0.0)
    return distance


def _ticks(length_m: float, spacing_m: float) -> FloatArray:
    """Return positions from -length/2 to length/2, both included exactly, at most `spacing_m` apart."""
    return np.linspace(-length_m / 2, length_m / 2, int(np.ceil(length_m / spacing_m)) + 1)


def _stack(outline: FloatArray, heights: FloatArray) -> FloatArray:
    """Return the outline (K, 2) repeated at every height: (K * H, 3)."""
    flat = np.repeat(outline, len(heights), axis=0)
    return np.column_stack([flat, np.tile(heights, len(outline))])


def _ellipse(x_m: float, y_m: float, spacing_m: float) -> FloatArray:
    """Return points (K, 2) on an ellipse, evenly spaced along its arc."""
    angle = np.linspace(0.0, 2 * np.pi, 721)
    outline = np.stack([x_m * np.cos(angle), y_m * np.sin(angle)], axis=1)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    count = max(3, int(np.ceil(arc[-1] / spacing_m)))
    even = np.interp(np.arange(count) * arc[-1] / count, arc, angle)
    return np.stack([x_m * np.cos(even), y_m * np.sin(even)], axis=1)


def _dome(radius_m: float, spacing_m: float, opening: float) -> FloatArray:
    """Return points on a sphere from its top pole down to the polar angle `opening`, in rings."""
    rings = max(1, int(np.ceil(radius_m * opening / spacing_m)))
    points = [np.array([[0.0, 0.0, radius_m]])]
    for polar in np.linspace(0.0, opening, rings + 1)[1:]:
        across = radius_m * np.sin(polar)
        if across < 1e-9 * radius_m:  # the other pole
            points.append(np.array([[0.0, 0.0, -radius_m]]))
        else:
            points.append(_stack(_ellipse(across, across, spacing_m), np.array([radius_m * np.cos(polar)])))
    return np.concatenate(points)


def _outer_arc(radius_m: float) -> FloatArray:
    """Return corners (K, 2), distance from the axis and height, of a polygon around a circle's upper quarter."""
    step = 2.0 * np.pi / _CORNERS
    polar = np.arange(step / 2.0, np.pi / 2.0, step)
    arc: FloatArray = radius_m / np.cos(step / 2.0) * np.stack([np.sin(polar), np.cos(polar)], axis=1)
    return arc


def _turned(profile: FloatArray, x_m: float, y_m: float) -> FloatArray:
    """Return the triangles (F, 3, 3) of a body of revolution, closed by flat faces, around which its circles lie.

    Args:
        profile: (K, 2) distances from the axis, which `x_m` and `y_m` stretch, and heights, from above.
    """
    angle = 2.0 * np.pi * np.arange(_CORNERS) / _CORNERS
    around = np.stack([x_m * np.cos(angle), y_m * np.sin(angle)], axis=1) / np.cos(np.pi / _CORNERS)
    rings = [np.column_stack([r * around, np.full(_CORNERS, z)]) for r, z in profile]
    faces = []
    for above, below in pairwise(rings):
        a, b = np.roll(above, -1, axis=0), np.roll(below, -1, axis=0)
        faces += [np.stack([above, below, a], axis=1), np.stack([a, below, b], axis=1)]
    for ring, order in ((rings[0], (0, 1, 2)), (rings[-1], (0, 2, 1))):
        middle = np.broadcast_to(ring.mean(axis=0), ring.shape)
        faces.append(np.stack([middle, ring, np.roll(ring, -1, axis=0)], axis=1)[:, order])
    return np.concatenate(faces)


def _distance_to_ellipse(x: FloatLike, y: FloatLike, x_m: float, y_m: float) -> FloatLike:
    """Return the signed distances (...) of points (x, y), each (...), to an ellipse, negative inside.

    For the point (u, v) folded into the first quadrant the nearest one is (x²u / (t + x²), y²v / (t + y²)), where t is
    the largest root of f(t) = (xu / (t + x²))² + (yv / (t + y²))² - 1 (Lagrange). There f falls and is convex, so
    Newton's method started left of the root, where 0 <= f <= 1, approaches it from one side and cannot overshoot.
    """
    u, v = np.abs(x), np.abs(y)
    inside = (u / x_m) ** 2 + (v / y_m) ** 2 < 1.0
    # On an axis near the centre the root merges with a pole of f; a nanometre beside it the distance is the same.
    u, v = np.maximum(u, 1e-9), np.maximum(v, 1e-9)
    t = np.maximum(x_m * u - x_m**2, y_m * v - y_m**2)
    for _ in range(NEWTON_STEPS):
        a, b = t + x_m**2, t + y_m**2
        p, q = (x_m * u / a) ** 2, (y_m * v / b) ** 2
        t = t + (p + q - 1.0) / (2.0 * (p / a + q / b))
    distance = np.hypot(u * t / (t + x_m**2), v * t / (t + y_m**2))
    return np.where(inside, -distance, distance)
