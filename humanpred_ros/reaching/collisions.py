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
from humanpred_ros.geometry.solids import EllipticCylinder, Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching import collision_kernels as kernels
from humanpred_ros.reaching.body import MOVING_BODIES, BodyCapsules, ReachBody
from humanpred_ros.reaching.surroundings import Surroundings
from humanpred_ros.settings import Settings, setting

_FAR_M = 1e3


class CollisionSettings(Settings):
    """What counts as a collision of a sample."""

    partner: bool = setting(True, "Whether the partner is an obstacle; the authors' code looks at the table only")
    slack_m: float = setting(
        0.005, "A sample may go deeper than its demonstration by this, half the accuracy of motion capture", unit="m",
        low=0.0,
    )  # fmt: skip
    doubtful_m: float = setting(
        0.05, "A demonstration that goes deeper than this questions where the obstacles stand", unit="m", low=0.0
    )


@dataclass(frozen=True)
class Touch:
    """A body of the reaching person that is inside something in a demonstration.

    Attributes:
        body: of the reaching person.
        obstacle: its name, or `partner's <body>`.
        depth_m: how deep at most.
    """

    body: str
    obstacle: str
    depth_m: float

    def __str__(self) -> str:
        return f"{self.body.replace('_', ' ')} {100.0 * self.depth_m:.1f} cm in {self.obstacle.replace('_', ' ')}"


class ReachCollisions:
    """Prepares what all demonstrations of one human in one place share; immutable.

    Args:
        model: the human, also the partner.
        surroundings: fixed obstacles; P2's table if None.
        settings: what counts as a collision.

    Raises:
        HumanModelError: a human without trunk and right arm.
    """

    def __init__(
        self,
        model: HumanModel,
        surroundings: Surroundings | None = None,
        settings: CollisionSettings | None = None,
    ) -> None:
        self.model, self.settings = model, settings or CollisionSettings()
        self.surroundings = surroundings or Surroundings.of_p2()
        self.moving_names = tuple(body.name for body in model.bodies if body.name in MOVING_BODIES)
        self._body = ReachBody(model)
        # The kernel's capsules: rows of both ends among the body's points, and radii.
        self.moving = (np.ascontiguousarray(self._body.capsules[:, :2]), self._body.radius_m)
        self.fixed = _packed(self.surroundings.obstacles)
        self._partner = BodyCapsules.of(model)

    def beside(self, q: FloatArray, partner: FloatArray | None) -> SampleCollisions:
        """Return what decides about samples of the demonstration q (N, J), beside a partner in posture (J,) or none."""
        names = [obstacle.name for obstacle in self.surroundings.obstacles]
        ends, radius = np.zeros((0, 2, 3)), np.zeros(0)
        if self.settings.partner and partner is not None:
            ends, radius = self._partner.placed(self.model, partner), self._partner.radius_m
            names += [f"partner's {body.name}" for body in self.model.bodies]
        return SampleCollisions(self, q, ends, radius, tuple(names))

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

    def __init__(
        self,
        shared: ReachCollisions,
        q: FloatArray,
        partner_ends_m: FloatArray,
        partner_radius_m: FloatArray,
        obstacle_names: tuple[str, ...],
    ) -> None:
        self._shared, self._obstacle_names = shared, obstacle_names
        partner = (np.ascontiguousarray(partner_ends_m, dtype=np.float32), partner_radius_m.astype(np.float32))
        field = shared.surroundings.field_with(partner_ends_m, partner_radius_m)
        lattice = (field.values, field.origin_m.astype(np.float32), np.float32(field.resolution_m))
        least = np.full((len(shared.moving_names), len(obstacle_names)), np.float32(_FAR_M))
        kernels.clearances(shared.points(q[None])[0], shared.moving, shared.fixed, partner, least)
        allowed = np.minimum(least - np.float32(shared.settings.slack_m), np.float32(0.0))
        self._obstacles = (shared.moving, shared.fixed, partner, lattice, allowed)
        touches = [Touch(*self._names(int(c), int(o)), float(-least[c, o])) for c, o in np.argwhere(least < 0.0)]
        self.touches = tuple(sorted(touches, key=lambda touch: -touch.depth_m))

    def of(self, q: FloatArray) -> NDArray[np.bool_]:
        """Return which of reaches (R, N, J) collide, (R,)."""
        return np.asarray(self._found(q) >= 0, dtype=np.bool_)

    def most_frequent(self, q: FloatArray) -> str:
        """Return in words what reaches (R, N, J) collide with most often; empty if none collides."""
        found = self._found(q)
        found = found[found >= 0]
        if not len(found):
            return ""
        body, obstacle = self._names(*divmod(int(np.bincount(found).argmax()), len(self._obstacle_names)))
        return f"{body.replace('_', ' ')} into {obstacle.replace('_', ' ')}"

    def _found(self, q: FloatArray) -> NDArray[np.int64]:
        """Return the number of a pair that touches in each of reaches (R, N, J), (R,), -1 for none."""
        found = np.empty(len(q), dtype=np.int64)
        kernels.touches(self._shared.points(q), *self._obstacles, found)
        return found

    def _names(self, body: int, obstacle: int) -> tuple[str, str]:
        return self._shared.moving_names[body], self._obstacle_names[obstacle]


def _packed(obstacles: Sequence[Obstacle]) -> tuple[NDArray[Any], ...]:
    """Return kinds, rotations from the world, centres and half sizes, as the kernels want them."""
    round_ = [isinstance(obstacle.shape, EllipticCylinder) for obstacle in obstacles]
    kind = np.where(round_, kernels.CYLINDER, kernels.BOX).astype(np.int64)
    T = np.array([obstacle.T_world_shape for obstacle in obstacles]).reshape(-1, 4, 4)
    half = [obstacle.shape.half_m for obstacle in obstacles]
    return (
        kind,
        np.ascontiguousarray(T[:, :3, :3].transpose(0, 2, 1), dtype=np.float32),
        np.ascontiguousarray(T[:, :3, 3], dtype=np.float32),
        np.array(half, dtype=np.float32).reshape(-1, 3),
    )
