"""The solids a body is made of, because occupancy needs points on their surface and clearance needs distances to them.

Every shape is centred on its own frame, its axis along z. `distance_m` is signed, negative inside; `sample` covers
the surface so that no point of it is farther than the spacing from a sample (the worst case is spacing / sqrt(2), the
half diagonal of a mesh cell). Nothing is random: the same spacing gives the same points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray

#: Enough for 1e-9 m from any start inside the bracket above; six or seven are needed in practice.
NEWTON_STEPS = 10


@dataclass(frozen=True)
class Shape(ABC):
    """A solid in its own frame; all fields are lengths in metres.

    Raises:
        HumanModelError: a length that is not positive.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            length_m = getattr(self, field.name)
            if not (np.isfinite(length_m) and length_m > 0):
                raise HumanModelError(
                    f"{type(self).__name__}: wanted a positive {field.name}, got {length_m}; correct the URDF"
                )

    @abstractmethod
    def distance_m(self, points: FloatArray) -> FloatArray:
        """Return the signed distance (N,) from each point (N, 3) to the surface, negative inside."""

    @abstractmethod
    def sample(self, spacing_m: float) -> FloatArray:
        """Return points (P, 3) on the surface, neighbours at most about `spacing_m` apart."""


@dataclass(frozen=True)
class Sphere(Shape):
    """A ball; distances are exact."""

    radius_m: float

    def distance_m(self, points: FloatArray) -> FloatArray:
        return _float(np.linalg.norm(points, axis=1) - self.radius_m)

    def sample(self, spacing_m: float) -> FloatArray:
        return _dome(self.radius_m, spacing_m, np.pi)


@dataclass(frozen=True)
class Box(Shape):
    """A cuboid with edge lengths x, y, z; distances are exact."""

    x_m: float
    y_m: float
    z_m: float

    def distance_m(self, points: FloatArray) -> FloatArray:
        beyond = np.abs(points) - np.array([self.x_m, self.y_m, self.z_m]) / 2
        return _float(np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0))

    def sample(self, spacing_m: float) -> FloatArray:
        ticks = [_ticks(length, spacing_m) for length in (self.x_m, self.y_m, self.z_m)]
        x, y, z = (axis.ravel() for axis in np.meshgrid(*ticks, indexing="ij"))
        faces = (np.abs(x) == self.x_m / 2) | (np.abs(y) == self.y_m / 2) | (np.abs(z) == self.z_m / 2)
        return _float(np.stack([x, y, z], axis=1)[faces])


@dataclass(frozen=True)
class Capsule(Shape):
    """All points within the radius of a segment of the given length on z; distances are exact."""

    radius_m: float
    length_m: float

    def distance_m(self, points: FloatArray) -> FloatArray:
        nearest = np.zeros_like(points)
        nearest[:, 2] = np.clip(points[:, 2], -self.length_m / 2, self.length_m / 2)
        return _float(np.linalg.norm(points - nearest, axis=1) - self.radius_m)

    def sample(self, spacing_m: float) -> FloatArray:
        rim = _ellipse(self.radius_m, self.radius_m, spacing_m)
        dome = _dome(self.radius_m, spacing_m, np.pi / 2)
        end = np.array([0.0, 0.0, self.length_m / 2])
        wall = _stack(rim, _ticks(self.length_m, spacing_m))
        return np.concatenate([wall, dome + end, dome * (1, 1, -1) - end])


@dataclass(frozen=True)
class EllipticCylinder(Shape):
    """A cylinder whose cross-section is an ellipse with semi-axes along x and y; a plain cylinder has equal ones.

    Distances are exact to about 1e-9 m: the nearest point of an ellipse has no closed form worth using and is found by
    Newton's method.
    """

    x_m: float
    y_m: float
    length_m: float

    def distance_m(self, points: FloatArray) -> FloatArray:
        # In the plane (distance to the ellipse, distance to the end faces) the solid is a corner, like a box's.
        across = _distance_to_ellipse(points[:, :2], self.x_m, self.y_m)
        beyond = np.stack([across, np.abs(points[:, 2]) - self.length_m / 2], axis=1)
        return _float(np.linalg.norm(np.maximum(beyond, 0.0), axis=1) + np.minimum(beyond.max(axis=1), 0.0))

    def sample(self, spacing_m: float) -> FloatArray:
        wall = _stack(_ellipse(self.x_m, self.y_m, spacing_m), _ticks(self.length_m, spacing_m))
        rings = int(np.ceil(max(self.x_m, self.y_m) / spacing_m))
        inner = [_ellipse(self.x_m * k / rings, self.y_m * k / rings, spacing_m) for k in range(1, rings)]
        face = np.concatenate([np.zeros((1, 2)), *inner])
        return np.concatenate([wall, _stack(face, np.array([-1.0, 1.0]) * self.length_m / 2)])


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


def _distance_to_ellipse(points: FloatArray, x_m: float, y_m: float) -> FloatArray:
    """Return the signed distance (N,) from points (N, 2) to an ellipse, negative inside.

    For the point (u, v) folded into the first quadrant the nearest one is (x²u / (t + x²), y²v / (t + y²)), where t is
    the largest root of f(t) = (xu / (t + x²))² + (yv / (t + y²))² - 1 (Lagrange). There f falls and is convex, so
    Newton's method started left of the root, where 0 <= f <= 1, approaches it from one side and cannot overshoot.
    """
    u, v = np.abs(points).T
    if x_m == y_m:
        return _float(np.hypot(u, v) - x_m)
    inside = (u / x_m) ** 2 + (v / y_m) ** 2 < 1.0
    # On an axis near the centre the root merges with a pole of f; a nanometre beside it the distance is the same.
    u, v = np.maximum(u, 1e-9), np.maximum(v, 1e-9)
    t = np.maximum(x_m * u - x_m**2, y_m * v - y_m**2)
    for _ in range(NEWTON_STEPS):
        a, b = t + x_m**2, t + y_m**2
        p, q = (x_m * u / a) ** 2, (y_m * v / b) ** 2
        t = t + (p + q - 1.0) / (2.0 * (p / a + q / b))
    distance = np.hypot(u * t / (t + x_m**2), v * t / (t + y_m**2))
    return _float(np.where(inside, -distance, distance))


def _float(array: NDArray[np.generic]) -> FloatArray:
    return np.asarray(array, dtype=np.float64)
