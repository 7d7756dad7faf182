"""The body of a person who reaches, as capsules and points: what keeps clear of the table and of the partner.

docs/papers.md, "P2 scene".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.geometry.description import Body
from humanpred_ros.geometry.solids import Box, Capsule, EllipticCylinder, Sphere
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.features import LINK_POINTS

Float32Array = NDArray[np.float32]
#: Bodies that move with a reach: trunk and right arm. P2 leaves out the pelvis, whose joints come first.
MOVING_BODIES = (
    "torso", "shoulders", "right_upper_arm", "right_lower_upper_arm", "right_forearm", "right_lower_forearm",
    "right_hand",
)  # fmt: skip
#: Spheres along a bone are at most this many radii apart.
_SPACING = 1.0


@dataclass(frozen=True, eq=False)
class BodyCapsules:
    """Capsules fixed to the links of one human.

    Attributes:
        links: K names.
        ends_m: (K, 2, 3) both ends of each capsule's bone, in its link's frame.
        radius_m: (K,).
    """

    links: tuple[str, ...]
    ends_m: FloatArray
    radius_m: FloatArray

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


class ReachBody:
    """The points of one human that costs look at: `LINK_POINTS`, and the ends of the capsules of trunk and arm.

    All reaches of the human share it; immutable.

    Attributes:
        model: the human.
        feature_points, all_points: (4,) rows of `LINK_POINTS` among the points without and with the body.
        capsules: (C, 4) rows of both ends among the points, and the first and last + 1 of its spheres.
        spheres: (S, 2) place along the bone, 0 to 1, and radius in metres.
        radius_m: (C,) of the capsules, float32.
    """

    def __init__(self, model: HumanModel) -> None:
        capsules = BodyCapsules.of(model, MOVING_BODIES)
        links = [*LINK_POINTS, *(link for link in capsules.links for _ in range(2))]
        local = np.concatenate([np.zeros((len(LINK_POINTS), 3)), capsules.ends_m.reshape(-1, 3)])
        self.model = model
        self._features, self.feature_points = _in_order(model, links[: len(LINK_POINTS)], local[: len(LINK_POINTS)])
        self._all, number = _in_order(model, links, local)
        self.all_points, ends = number[: len(LINK_POINTS)], number[len(LINK_POINTS) :].reshape(-1, 2)
        rows: list[tuple[int, int, int, int]] = []
        spheres: list[tuple[float, float]] = []
        for (a, b), bone, radius in zip(ends, capsules.ends_m, capsules.radius_m, strict=True):
            count = 1 + int(np.ceil(np.linalg.norm(bone[1] - bone[0]) / (_SPACING * radius) - 1e-9))
            places = np.linspace(0.0, 1.0, count) if count > 1 else np.array([0.5])
            rows.append((a, b, len(spheres), len(spheres) + count))
            spheres += [(place, radius) for place in places]
        self.capsules = np.array(rows, dtype=np.int64)
        self.spheres = np.array(spheres, dtype=np.float32)
        self.radius_m = capsules.radius_m.astype(np.float32)

    def points(self, q: Float32Array, *, with_body: bool) -> Float32Array:
        """Return the points (M, P, 3) of postures (M, J); without the body only those of the features."""
        points: Float32Array = (self._all if with_body else self._features).positions(q)
        return points


def _in_order(model: HumanModel, links: Sequence[str], local_m: FloatArray) -> tuple[ChainPoints, NDArray[np.int64]]:
    """Return points in the order of the chain, which is the fastest, and the row of each of the given ones."""
    order = np.argsort(model.link_joint[[model.link_names.index(link) for link in links]], kind="stable")
    return ChainPoints(model, [links[k] for k in order], local_m[order]), np.argsort(order)


def _capsule(body: Body) -> tuple[FloatArray, float]:
    """Return the ends (2, 3) of the bone in the link's frame, and the radius."""
    match body.shape:
        case Capsule(radius_m, length_m):
            axis, half, radius = 2, length_m / 2.0, radius_m
        case Sphere(radius_m):
            axis, half, radius = 2, 0.0, radius_m
        case Box(x, y, z):
            axis, half, radius = _longest(np.array([x, y, z]) / 2.0)
        case EllipticCylinder(x, y, length_m):
            axis, half, radius = _longest(np.array([x, y, length_m / 2.0]))
        case _:
            raise HumanModelError(f"capsules: wanted a known shape, body {body.name} is a {type(body.shape).__name__}")
    ends = np.zeros((2, 3))
    ends[:, axis] = (-half, half)
    return ends @ body.T_link_body[:3, :3].T + body.T_link_body[:3, 3], radius


def _longest(half_sides: FloatArray) -> tuple[int, float, float]:
    axis = int(np.argmax(half_sides))
    radius = float(np.sqrt(np.prod(np.delete(half_sides, axis))))
    return axis, max(float(half_sides[axis]) - radius, 0.0), radius
