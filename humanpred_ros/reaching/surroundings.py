"""What a reach has to keep clear of: table and boxes, and the partner as capsules (docs/papers.md, "P2 scene")."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import HumanModelError, SceneError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.geometry.compiled import fast
from humanpred_ros.geometry.description import Body
from humanpred_ros.geometry.distance_field import SignedDistanceField, build_distance_field
from humanpred_ros.geometry.solids import Box, Obstacle, planar_pose
from humanpred_ros.human.model import HumanModel

#: Larger distances are not told apart: the clearance, the radius of the thickest body, and the interpolation's error.
CAP_M = 0.35
#: Cells of P2's distance field.
RESOLUTION_M = 0.03

#: P2's table: pose of its frame, and its boxes there as name, full size, centre; metres.
_TABLE_PLACE = (1.84, 1.41, 0.70, np.deg2rad(166.572))
_TABLE_BOXES = (
    ("table_top", (1.21, 0.50, 0.02), (0.0, 0.0, 0.0)),
    ("central_box", (0.50, 0.30, 0.18), (0.0, -0.10, 0.09)),
    ("left_box", (0.15, 0.22, 0.29), (0.325, -0.14, 0.15)),
    ("right_box", (0.15, 0.22, 0.29), (-0.325, -0.14, 0.15)),
    ("front_left", (0.23, 0.17, 0.02), (0.12, 0.16, 0.02)),
    ("front_right", (0.23, 0.17, 0.02), (-0.12, 0.16, 0.02)),
)
#: The region of the reaches at that table; outside, the distance at the border is used.
_REGION_M = ((0.9, 0.3, 0.6), (2.6, 2.0, 1.9))
#: The region reaches this far beyond other obstacles.
_AROUND_M = 0.6


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Fixed obstacles in the frame of the recordings, with the distances to them: immutable.

    Raises:
        SceneError: an empty region.
    """

    obstacles: tuple[Obstacle, ...]  #: with a name each; may be none
    lower_m: FloatArray  #: (3,) corners of the region in which distances are known
    upper_m: FloatArray
    resolution_m: float = RESOLUTION_M  #: of the lattice of distances

    def __post_init__(self) -> None:
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        for name in ("lower_m", "upper_m"):
            value = checked(f"surroundings: {name}", getattr(self, name), (3,), error=SceneError)
            object.__setattr__(self, name, frozen(value))
        if not (self.upper_m > self.lower_m).all() or not 0.0 < self.resolution_m < np.inf:
            raise SceneError(
                f"surroundings: wanted a region with lower < upper and a positive resolution, got {self.lower_m}, "
                f"{self.upper_m} and {self.resolution_m}"
            )
        # Without obstacles one far below keeps the lattice's size; all distances are then the cap.
        far = Obstacle("none", Box(1.0, 1.0, 1.0), planar_pose(*(self.lower_m - [0.0, 0.0, 10.0])))
        field = build_distance_field(
            self.obstacles or (far,), self.lower_m, self.upper_m, self.resolution_m, cap_m=CAP_M
        )
        object.__setattr__(self, "_field", field)

    @classmethod
    def of_p2(cls) -> Surroundings:
        """Return the table of P2's recordings."""
        return _of_p2()

    @classmethod
    def of_obstacles(cls, obstacles: Sequence[Obstacle], T: ArrayLike) -> Surroundings:
        """Return obstacles moved by a rigid transform (4, 4), as from the world to the tracker's frame.

        Raises:
            ArrayError: a transform that is not rigid.
        """
        move = checked("surroundings: transform", T, (4, 4))
        moved = tuple(replace(obstacle, T_world_shape=move @ obstacle.T_world_shape) for obstacle in obstacles)
        if not moved:
            return cls.empty()
        centre = np.array([obstacle.T_world_shape[:3, 3] for obstacle in moved])
        half = np.array([obstacle.half_extent_m for obstacle in moved])
        return cls(moved, (centre - half).min(axis=0) - _AROUND_M, (centre + half).max(axis=0) + _AROUND_M)

    @classmethod
    def around_hands(cls, hands_m: ArrayLike) -> Surroundings:
        """Return P2's table if some of the hands (M, 3) are in its region, else the hands' region without a table.

        Raises:
            SceneError: no hands, or positions that are not finite.
        """
        hands = checked("surroundings: hands", hands_m, ("M", 3), error=SceneError)
        if not len(hands):
            raise SceneError("surroundings: wanted positions of hands, got none")
        lower, upper = np.array(_REGION_M)
        if ((hands > lower) & (hands < upper)).all(axis=1).any():
            return cls.of_p2()
        return cls((), hands.min(axis=0) - _AROUND_M, hands.max(axis=0) + _AROUND_M)

    @classmethod
    def empty(cls) -> Surroundings:
        """Return the region of P2's recordings without a table."""
        return cls((), np.array(_REGION_M[0]), np.array(_REGION_M[1]))

    @property
    def field(self) -> SignedDistanceField:
        """Distances to the fixed obstacles, up to `CAP_M`."""
        return self._field  # type: ignore[attr-defined, no-any-return]

    def field_with(self, ends_m: ArrayLike, radius_m: ArrayLike) -> SignedDistanceField:
        """Return distances to the fixed obstacles and to capsules with ends (K, 2, 3) and radii (K,).

        Raises:
            SceneError: arrays of other shapes.
        """
        radius = checked("capsules' radii", radius_m, ("K",), error=SceneError)
        ends = checked("capsules' ends", ends_m, (len(radius), 2, 3), error=SceneError)
        values = self.field.values.copy()
        lower_to_capsules(
            values, self.field.origin_m.astype(np.float32), np.float32(self.field.resolution_m),
            ends.astype(np.float32), radius.astype(np.float32), np.float32(CAP_M),
        )  # fmt: skip
        return SignedDistanceField(self.field.origin_m, self.field.resolution_m, values)


@lru_cache(maxsize=1)
def _of_p2() -> Surroundings:
    T = planar_pose(*_TABLE_PLACE)
    table = (Obstacle(name, Box(*size), T @ planar_pose(*centre)) for name, size, centre in _TABLE_BOXES)
    return Surroundings(tuple(table), np.array(_REGION_M[0]), np.array(_REGION_M[1]))


@fast
def lower_to_capsules(
    values: NDArray[Any],
    origin: NDArray[Any],
    resolution: Any,
    ends: NDArray[Any],
    radius: NDArray[Any],
    cap: Any,
) -> None:
    """Lower the distances at the nodes of a lattice (nx, ny, nz) to those from capsules, up to `cap`."""
    for k in range(len(radius)):
        reach = radius[k] + cap
        low, high = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
        for a in range(3):
            near, far = min(ends[k, 0, a], ends[k, 1, a]), max(ends[k, 0, a], ends[k, 1, a])
            low[a] = max(0, int(np.floor((near - reach - origin[a]) / resolution)))
            high[a] = min(values.shape[a], int(np.ceil((far + reach - origin[a]) / resolution)) + 1)
        bx, by, bz = ends[k, 1, 0] - ends[k, 0, 0], ends[k, 1, 1] - ends[k, 0, 1], ends[k, 1, 2] - ends[k, 0, 2]
        length2 = max(bx * bx + by * by + bz * bz, np.float32(1e-12))
        for i in range(low[0], high[0]):
            x = origin[0] + np.float32(i) * resolution - ends[k, 0, 0]
            for j in range(low[1], high[1]):
                y = origin[1] + np.float32(j) * resolution - ends[k, 0, 1]
                row = values[i, j]
                for m in range(low[2], high[2]):
                    z = origin[2] + np.float32(m) * resolution - ends[k, 0, 2]
                    s = min(max((x * bx + y * by + z * bz) / length2, np.float32(0.0)), np.float32(1.0))
                    u, v, w = x - s * bx, y - s * by, z - s * bz
                    row[m] = min(row[m], np.sqrt(u * u + v * v + w * w) - radius[k])


@dataclass(frozen=True, eq=False)
class BodyCapsules:
    """Capsules fixed to the links of one human."""

    links: tuple[str, ...]  #: K names
    ends_m: FloatArray  #: (K, 2, 3) both ends of each capsule's bone, in its link's frame
    radius_m: FloatArray  #: (K,)

    @classmethod
    def of(cls, model: HumanModel, names: Iterable[str] | None = None) -> BodyCapsules:
        """Return a capsule for each body of a human, or for those of `names` that it has.

        Capsules and spheres are exact. A box or a cylinder becomes a capsule along its longest side, with the geometric
        mean of the other sides as radius: P2's torso is right to 0.02 m except at rims and corners.

        Raises:
            HumanModelError: a human without any of the bodies.
        """
        wanted = None if names is None else set(names)
        bodies = [body for body in model.bodies if wanted is None or body.name in wanted]
        if not bodies:
            raise HumanModelError(
                f"capsules of {model.name}: wanted some of {', '.join(wanted or ('its bodies',))}, it has "
                f"{', '.join(body.name for body in model.bodies) or 'none'}"
            )
        ends, radii = zip(*(_capsule(body) for body in bodies), strict=True)
        return cls(tuple(body.link for body in bodies), frozen(np.stack(ends)), frozen(np.array(radii)))  # type: ignore[arg-type]

    def placed(self, model: HumanModel, q: FloatArray) -> FloatArray:
        """Return the ends (K, 2, 3) of the capsules of a human in posture (J,), in the tracker's frame."""
        poses = model.link_poses(q)[[model.link_names.index(link) for link in self.links]]
        ends: FloatArray = np.einsum("kij,kej->kei", poses[:, :3, :3], self.ends_m) + poses[:, None, :3, 3]
        return ends


def _capsule(body: Body) -> tuple[FloatArray, float]:
    """Return the ends (2, 3) of the bone in the link's frame, and the radius."""
    half = np.array(body.shape.half_m)
    axis = int(np.argmax(half))
    radius = float(np.sqrt(np.prod(np.delete(half, axis))))
    ends = np.zeros((2, 3))
    ends[:, axis] = np.array([-1.0, 1.0]) * max(float(half[axis]) - radius, 0.0)
    return ends @ body.T_link_body[:3, :3].T + body.T_link_body[:3, 3], radius
