"""Finds the samples of a demonstration that collide with table or partner; learning discards them (P2 III-C).

Trunk and right arm of the reaching person are capsules. They must not touch the fixed obstacles or the partner's body,
in the posture the partner has when the reach begins (P2 III-A). The person's own legs, left arm and head are left out,
as in planning. Distances are exact; the planner's lattice is too coarse for boards of 2 cm.

Recorded people touch each other, and markers, bodies and boxes are measured to a centimetre or two: two of P2's seven
reaches pass through something by up to 3 cm. What a person did cannot be impossible. Therefore a sample collides only
where it goes deeper than the demonstration itself, for each pair of body and obstacle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import fast, fast_part
from humanpred_ros.geometry.solids import EllipticCylinder, Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.cost_terms import MOVING_BODIES, ReachBody
from humanpred_ros.reaching.surroundings import BodyCapsules, Surroundings

_FAR_M = 1e3
#: Kinds of fixed obstacles: half sizes are (x, y, z) of a box; (radius, -, half the height) of a cylinder.
BOX, CYLINDER = 0, 1
_0, _1, _HALF = np.float32(0.0), np.float32(1.0), np.float32(0.5)
#: Sections of a bone: the golden ratio, and so many that 0.3 m of bone are searched to 0.0001 m.
_GOLDEN = np.float32(0.61803399)
_SECTIONS = 17
_FAR = np.float32(1e6)
_STRIDE = 8
#: How far a place may be from the nearest node, in cells.
_NODE = np.float32(0.87)
#: A sample may go deeper than its demonstration by this: half the accuracy of motion capture.
SLACK_M = 0.005
#: A demonstration that goes deeper than this questions where the obstacles stand.
DOUBTFUL_M = 0.05


@dataclass(frozen=True)
class Touch:
    """A body of the reaching person that is inside something in a demonstration."""

    body: str  #: of the reaching person
    obstacle: str  #: its name, or `partner's <body>`
    depth_m: float  #: how deep at most

    def __str__(self) -> str:
        return f"{self.body.replace('_', ' ')} {100.0 * self.depth_m:.1f} cm in {self.obstacle.replace('_', ' ')}"


class ReachCollisions:
    """Prepares what all demonstrations of one human in one place share; immutable.

    Args:
        model: the human, also the partner.
        surroundings: fixed obstacles; P2's table if None.

    Raises:
        HumanModelError: a human without trunk and right arm.
    """

    def __init__(self, model: HumanModel, surroundings: Surroundings | None = None) -> None:
        self.model = model
        self.surroundings = surroundings or Surroundings.of_p2()
        self.moving_names = tuple(body.name for body in model.bodies if body.name in MOVING_BODIES)
        self._body = ReachBody(model)
        # The kernel's capsules: rows of both ends among the body's points, and radii.
        self.moving = (np.ascontiguousarray(self._body.capsules[:, :2]), self._body.radius_m)
        self.fixed = packed(self.surroundings.obstacles)
        self.partner = BodyCapsules.of(model)

    def beside(self, q: FloatArray, partner: FloatArray | None) -> SampleCollisions:
        """Return what decides about samples of the demonstration q (N, J), beside a partner in posture (J,) or none."""
        return SampleCollisions(self, q, partner)

    def points(self, q: FloatArray) -> NDArray[np.float32]:
        """Return the points (R, N, P, 3) of the body in reaches (R, N, J)."""
        postures = np.asarray(q, dtype=np.float32)
        points = self._body.points(postures.reshape(-1, postures.shape[-1]), with_body=True)
        return points.reshape(*postures.shape[:2], *points.shape[1:])


class SampleCollisions:
    """Decides which variations of one demonstration collide; made by `ReachCollisions.beside`.

    Attributes:
        touches: where the demonstration itself is inside something, the deepest first.
    """

    def __init__(self, shared: ReachCollisions, q: FloatArray, partner: FloatArray | None) -> None:
        self._shared = shared
        self._obstacle_names = [obstacle.name for obstacle in shared.surroundings.obstacles]
        ends, radius = np.zeros((0, 2, 3)), np.zeros(0)
        if partner is not None:
            ends, radius = shared.partner.placed(shared.model, partner), shared.partner.radius_m
            self._obstacle_names += [f"partner's {body.name}" for body in shared.model.bodies]
        capsules = (np.ascontiguousarray(ends, dtype=np.float32), radius.astype(np.float32))
        field = shared.surroundings.field_with(ends, radius)
        lattice = (field.values, field.origin_m.astype(np.float32), np.float32(field.resolution_m))
        least = np.full((len(shared.moving_names), len(self._obstacle_names)), np.float32(_FAR_M))
        clearances(shared.points(q[None])[0], shared.moving, shared.fixed, capsules, least)
        allowed = np.minimum(least - np.float32(SLACK_M), np.float32(0.0))
        self._obstacles = (shared.moving, shared.fixed, capsules, lattice, allowed)
        found = [Touch(*self._names(int(c), int(o)), float(-least[c, o])) for c, o in np.argwhere(least < 0.0)]
        self.touches = tuple(sorted(found, key=lambda touch: -touch.depth_m))

    def of(self, q: FloatArray) -> NDArray[np.bool_]:
        """Return which of reaches (R, N, J) collide, (R,)."""
        return np.asarray(self._pairs(q) >= 0, dtype=np.bool_)

    def most_frequent(self, q: FloatArray) -> str:
        """Return in words what reaches (R, N, J) collide with most often; empty if none collides."""
        pairs = self._pairs(q)
        pairs = pairs[pairs >= 0]
        if not len(pairs):
            return ""
        body, obstacle = self._names(*divmod(int(np.bincount(pairs).argmax()), len(self._obstacle_names)))
        return f"{body.replace('_', ' ')} into {obstacle.replace('_', ' ')}"

    def _pairs(self, q: FloatArray) -> NDArray[np.int64]:
        """Return the number of a pair that touches in each of reaches (R, N, J), (R,), -1 for none."""
        pairs = np.empty(len(q), dtype=np.int64)
        touches(self._shared.points(q), *self._obstacles, pairs)
        return pairs

    def _names(self, body: int, obstacle: int) -> tuple[str, str]:
        return self._shared.moving_names[body], self._obstacle_names[obstacle]


def packed(obstacles: Sequence[Obstacle]) -> tuple[NDArray[Any], ...]:
    """Return kinds, rotations from the world, centres and half sizes, as the compiled functions want them."""
    round_ = [isinstance(obstacle.shape, EllipticCylinder) for obstacle in obstacles]
    kind = np.where(round_, CYLINDER, BOX).astype(np.int64)
    T = np.array([obstacle.T_world_shape for obstacle in obstacles]).reshape(-1, 4, 4)
    half = [obstacle.shape.half_m for obstacle in obstacles]
    return (
        kind,
        np.ascontiguousarray(T[:, :3, :3].transpose(0, 2, 1), dtype=np.float32),
        np.ascontiguousarray(T[:, :3, 3], dtype=np.float32),
        np.array(half, dtype=np.float32).reshape(-1, 3),
    )


# The compiled search: learning looks at two million postures. A body or a partner's body is a capsule: a bone (2, 3)
# and a radius. Fixed obstacles are convex, so the distance from a point of a bone to one of them is a convex function
# of its place along the bone, and a search by sections finds the least. All arrays are float32.


@fast
def clearances(points: NDArray[Any], capsules: Any, fixed: Any, partner: Any, out: NDArray[Any]) -> None:
    """Lower `out` (C, B + K) to the least distances over postures (N) from capsules to obstacles and partner.

    points (N, P, 3); capsules (rows (C, 2) of both ends among the points, radius (C,)); fixed obstacles (kind (B,),
    rotation world to shape (B, 3, 3), centre (B, 3), half size (B, 3)); partner (ends (K, 2, 3), radius (K,)).
    """
    rows, radius = capsules
    n_fixed = len(fixed[0])
    for t in range(len(points)):
        for c in range(len(rows)):
            a, b = points[t, rows[c, 0]], points[t, rows[c, 1]]
            for o in range(out.shape[1]):
                if o < n_fixed:
                    d = _to_fixed(a, b, radius[c], fixed, o, _FAR)
                else:
                    d = _to_capsule(a, b, radius[c], partner, o - n_fixed, _FAR)
                out[c, o] = min(out[c, o], d)


@fast
def touches(
    points: NDArray[Any],
    capsules: Any,
    fixed: Any,
    partner: Any,
    lattice: Any,
    allowed: NDArray[Any],
    out: NDArray[Any],
) -> None:
    """Write a pair that touches in each reach (R,), as capsule * (B + K) + obstacle; -1 if none does.

    points (R, N, P, 3); lattice (distances (nx, ny, nz) to all obstacles and partner's bodies, origin (3,), resolution)
    saves looking at what is far away; allowed (C, B + K), 0 or less: a pair touches when it comes closer. Others as in
    `clearances`.
    """
    for r in range(points.shape[0]):
        out[r] = -1
        # Touches last some waypoints: with long strides first, most are found early.
        for first in range(_STRIDE):
            for t in range(first, points.shape[1], _STRIDE):
                out[r] = _touch(points[r, t], capsules, fixed, partner, lattice, allowed)
                if out[r] >= 0:
                    break
            if out[r] >= 0:
                break


@fast_part
def _touch(points: NDArray[Any], capsules: Any, fixed: Any, partner: Any, lattice: Any, allowed: NDArray[Any]) -> int:
    rows, radius = capsules
    n_fixed, n_all = len(fixed[0]), allowed.shape[1]
    for c in range(len(rows)):
        a, b = points[rows[c, 0]], points[rows[c, 1]]
        if _far_from_all(a, b, radius[c], lattice):
            continue
        for o in range(n_all):
            least = allowed[c, o]
            if o < n_fixed:
                d = _to_fixed(a, b, radius[c], fixed, o, least)
            else:
                d = _to_capsule(a, b, radius[c], partner, o - n_fixed, least)
            if d < least:
                return int(c * n_all + o)
    return -1


@fast_part
def _far_from_all(a: NDArray[Any], b: NDArray[Any], radius: Any, lattice: Any) -> bool:
    """Return whether the lattice says that nothing is within the capsule about a to b; false where it does not know."""
    values, origin, resolution = lattice
    x, y, z = _HALF * (a[0] + b[0]), _HALF * (a[1] + b[1]), _HALF * (a[2] + b[2])
    i = int(np.floor((x - origin[0]) / resolution + _HALF))
    j = int(np.floor((y - origin[1]) / resolution + _HALF))
    k = int(np.floor((z - origin[2]) / resolution + _HALF))
    if i < 0 or j < 0 or k < 0 or i >= values.shape[0] or j >= values.shape[1] or k >= values.shape[2]:
        return False
    u, v, w = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    # Half the bone on each side of its middle, and the nearest node is at most 0.87 cells away.
    return bool(values[i, j, k] > _HALF * np.sqrt(u * u + v * v + w * w) + radius + _NODE * resolution)


@fast_part
def _to_fixed(a: NDArray[Any], b: NDArray[Any], radius: Any, fixed: Any, o: int, least: Any) -> Any:
    """Return the distance of the capsule about a to b from obstacle o, or anything not below `least` if it is not."""
    kind, rotation, centre, half = fixed
    ux, uy, uz = a[0] - centre[o, 0], a[1] - centre[o, 1], a[2] - centre[o, 2]
    vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    R = rotation[o]
    x, y, z = _turned(R, ux, uy, uz)
    dx, dy, dz = _turned(R, vx, vy, vz)
    hx, hy, hz, is_box = half[o, 0], half[o, 1], half[o, 2], kind[o] == BOX
    middle = _inside(x + _HALF * dx, y + _HALF * dy, z + _HALF * dz, hx, hy, hz, is_box) - radius
    # No point of the bone is farther from its middle than half the bone.
    if middle - _HALF * np.sqrt(vx * vx + vy * vy + vz * vz) >= least:
        return least
    low, high = _0, _1
    s, t = _1 - _GOLDEN, _GOLDEN
    at_s = _inside(x + s * dx, y + s * dy, z + s * dz, hx, hy, hz, is_box)
    at_t = _inside(x + t * dx, y + t * dy, z + t * dz, hx, hy, hz, is_box)
    for _ in range(_SECTIONS):
        if at_s < at_t:
            high, t, at_t = t, s, at_s
            s = high - _GOLDEN * (high - low)
            at_s = _inside(x + s * dx, y + s * dy, z + s * dz, hx, hy, hz, is_box)
        else:
            low, s, at_s = s, t, at_t
            t = low + _GOLDEN * (high - low)
            at_t = _inside(x + t * dx, y + t * dy, z + t * dz, hx, hy, hz, is_box)
    ends = min(_inside(x, y, z, hx, hy, hz, is_box), _inside(x + dx, y + dy, z + dz, hx, hy, hz, is_box))
    return min(min(at_s, at_t), ends) - radius


@fast
def _turned(R: NDArray[Any], x: Any, y: Any, z: Any) -> Any:
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@fast_part
def _inside(x: Any, y: Any, z: Any, hx: Any, hy: Any, hz: Any, is_box: bool) -> Any:
    """Return the signed distance of a point in the obstacle's frame, negative inside."""
    if is_box:
        p, q = abs(x) - hx, abs(y) - hy
    else:
        p, q = np.sqrt(x * x + y * y) - hx, -_FAR
    r = abs(z) - hz
    u, v, w = max(p, _0), max(q, _0), max(r, _0)
    return np.sqrt(u * u + v * v + w * w) + min(max(max(p, q), r), _0)


@fast_part
def _to_capsule(a: NDArray[Any], b: NDArray[Any], radius: Any, partner: Any, k: int, least: Any) -> Any:
    """Return the distance between the capsule about a to b and the partner's k-th, or `least` if it is not below."""
    ends, radii = partner
    p, q = ends[k, 0], ends[k, 1]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    wx, wy, wz = a[0] - p[0], a[1] - p[1], a[2] - p[2]
    both = radius + radii[k]
    uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    mx, my, mz = wx + _HALF * (ux - vx), wy + _HALF * (uy - vy), wz + _HALF * (uz - vz)
    if np.sqrt(mx * mx + my * my + mz * mz) - _HALF * (np.sqrt(uu) + np.sqrt(vv)) - both >= least:
        return least
    uv = ux * vx + uy * vy + uz * vz
    uw, vw = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    # The closest points of two segments: of the lines, then drawn back to the segments one after the other.
    tiny = np.float32(1e-12)
    det = uu * vv - uv * uv
    s = min(max((uv * vw - vv * uw) / det, _0), _1) if det > np.float32(1e-6) * uu * vv + tiny else _0
    t = (uv * s + vw) / vv if vv > tiny else _0
    t = min(max(t, _0), _1)
    s = min(max((uv * t - uw) / uu, _0), _1) if uu > tiny else _0
    x, y, z = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return np.sqrt(x * x + y * y + z * z) - both
