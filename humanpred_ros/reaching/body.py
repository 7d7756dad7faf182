"""The body of a human as capsules: what keeps clear of table and partner when a reach is planned (facts section 3)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.capsules import Box, Capsule, EllipticCylinder, Sphere
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.human.bodies import Body
from humanpred_ros.human.model import HumanModel

#: Bodies that move with a reach: trunk and right arm. P2 leaves the pelvis out, whose joints come first.
MOVING_BODIES = (
    "torso", "shoulders", "right_upper_arm", "right_lower_upper_arm", "right_forearm", "right_lower_forearm",
    "right_hand",
)  # fmt: skip


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

        Capsules and spheres are exact. Of a box or a cylinder that is none, the longest side becomes the axis and the
        geometric mean of the others the radius: P2's torso is right to 0.02 m but for rims and corners.

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
        parts = [_capsule(body) for body in bodies]
        return cls(
            tuple(body.link for body in bodies),
            frozen(np.stack([ends for ends, _ in parts])),  # type: ignore[arg-type]
            frozen(np.array([radius for _, radius in parts])),  # type: ignore[arg-type]
        )

    def placed(self, model: HumanModel, q: FloatArray) -> FloatArray:
        """Return the ends (K, 2, 3) of the capsules of a human in posture (J,), in the tracker's frame."""
        poses = model.link_poses(q)[[model.link_names.index(link) for link in self.links]]
        ends: FloatArray = np.einsum("kij,kej->kei", poses[:, :3, :3], self.ends_m) + poses[:, None, :3, 3]
        return ends


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
