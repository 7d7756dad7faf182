"""Which reaches are impossible because they run into table or partner: samples in collision are discarded (P2 III-C).

Trunk and right arm of the reaching person are capsules; what they must not touch are the fixed obstacles of the scene
and the partner's body, in the posture in which the partner is when the reach begins (P2 III-A). The person's own legs,
left arm and head are left out, as in planning. Distances are exact, not those of the planner's lattice, which is too
coarse for boards of 2 cm.

Recorded people touch each other, and markers, bodies and boxes are measured to a centimetre or two: two of P2's seven
reaches pass through something by up to 3 cm. What a person did cannot be impossible. Therefore a sample collides where
it goes deeper than the demonstration itself goes, pair by pair of body and obstacle; `Touch` says where that is so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.shapes import Cylinder, Obstacle
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching import collision_kernels as kernels
from humanpred_ros.reaching.body import MOVING_BODIES, BodyCapsules
from humanpred_ros.reaching.cost_terms import ReachBody
from humanpred_ros.reaching.demonstrations import Demonstration
from humanpred_ros.reaching.surroundings import ReachScene

_FAR_M = 1e3


@dataclass(frozen=True)
class CollisionConfig:
    """What counts as a collision of a sample.

    Attributes:
        partner: whether the partner is in the way; the authors' code looks at the table only (facts section 3).
        slack_m: a sample may go deeper than its demonstration by so much, half of what motion capture is right to.
        doubtful_m: a demonstration that goes deeper than this makes one doubt that the scene stands right.

    Raises:
        UsageError: negative numbers.
    """

    partner: bool = True
    slack_m: float = 0.005
    doubtful_m: float = 0.05

    def __post_init__(self) -> None:
        if not (self.slack_m >= 0.0 and self.doubtful_m >= 0.0):
            raise UsageError(
                f"collisions: wanted slack and doubt of 0 m or more, got {self.slack_m} and {self.doubtful_m}"
            )


@dataclass(frozen=True)
class Touch:
    """Where a demonstration itself is in something.

    Attributes:
        body: of the reaching person.
        obstacle: in the scene, or `partner's <body>`.
        depth_m: how deep at most.
    """

    body: str
    obstacle: str
    depth_m: float

    def __str__(self) -> str:
        return f"{self.body.replace('_', ' ')} {100.0 * self.depth_m:.1f} cm in {self.obstacle.replace('_', ' ')}"


class ReachCollisions:
    """Finds collisions of one human's reaches in one scene; immutable.

    Args:
        model: the human, also the partner.
        scene: fixed obstacles; P2's table if None.
        config: settings.

    Raises:
        HumanModelError: a human without trunk and right arm.
    """

    def __init__(
        self, model: HumanModel, scene: ReachScene | None = None, config: CollisionConfig | None = None
    ) -> None:
        self.model, self.config = model, config or CollisionConfig()
        self.scene = scene or ReachScene.of_p2()
        self._body = ReachBody(model)
        moving = BodyCapsules.of(model, MOVING_BODIES)
        self._moving_names = tuple(body.name for body in model.bodies if body.name in MOVING_BODIES)
        # The kernel's capsules: rows of both ends among the body's points, and radii.
        self._moving = (np.ascontiguousarray(self._body.capsules[:, :2]), moving.radius_m.astype(np.float32))
        self._fixed = _packed(self.scene.obstacles)
        self._partner = BodyCapsules.of(model)
        self._partner_names = tuple(f"partner's {body.name}" for body in model.bodies)

    def beside(self, demo: Demonstration) -> DemonstrationCollisions:
        """Return what decides about samples of a demonstration."""
        names = [obstacle.name for obstacle in self.scene.obstacles]
        ends, radius = np.zeros((0, 2, 3)), np.zeros(0)
        if self.config.partner and demo.partner is not None:
            ends, radius = self._partner.placed(self.model, demo.partner), self._partner.radius_m
            names += self._partner_names
        partner = (np.ascontiguousarray(ends, dtype=np.float32), radius.astype(np.float32))
        field = self.scene.field_with(ends, radius)
        lattice = (field.values, field.origin_m.astype(np.float32), np.float32(field.resolution_m))
        least = np.full((len(self._moving_names), len(names)), np.float32(_FAR_M))
        kernels.clearances(self._points(demo.q[None])[0], self._moving, self._fixed, partner, least)
        return DemonstrationCollisions(self, _Obstacles(partner, lattice, tuple(names)), least)

    def touching(self, q: FloatArray, obstacles: _Obstacles, allowed_m: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the number of a pair that touches in each of reaches (R, N, J), (R,), -1 for none."""
        found = np.empty(len(q), dtype=np.int64)
        kernels.touches(
            self._points(q), self._moving, self._fixed, obstacles.partner, obstacles.lattice, allowed_m, found
        )
        return found

    @property
    def moving_names(self) -> tuple[str, ...]:
        """Bodies that must not touch anything."""
        return self._moving_names

    def _points(self, q: FloatArray) -> NDArray[np.float32]:
        postures = np.asarray(q, dtype=np.float32)
        points = self._body.points(postures.reshape(-1, postures.shape[-1]), with_body=True)
        return points.reshape(*postures.shape[:2], *points.shape[1:])


class _Obstacles(NamedTuple):
    """What is in the way of one demonstration, as the kernels want it, and the names of it all."""

    partner: tuple[NDArray[np.float32], NDArray[np.float32]]
    lattice: tuple[NDArray[np.float32], NDArray[np.float32], np.float32]
    names: tuple[str, ...]


class DemonstrationCollisions:
    """Decides which variations of one demonstration collide; made by `ReachCollisions.beside`.

    Attributes:
        touches: where the demonstration itself is in something, the deepest first.
    """

    def __init__(
        self,
        collisions: ReachCollisions,
        obstacles: _Obstacles,
        clearance_m: NDArray[np.float32],
    ) -> None:
        self._collisions, self._obstacles = collisions, obstacles
        slack = np.float32(collisions.config.slack_m)
        self._allowed_m = np.minimum(clearance_m - slack, np.float32(0.0))
        pairs = np.argwhere(clearance_m < 0.0)
        touches = [Touch(*self._names(int(c), int(o)), float(-clearance_m[c, o])) for c, o in pairs]
        self.touches = tuple(sorted(touches, key=lambda touch: -touch.depth_m))

    def __call__(self, q: FloatArray) -> NDArray[np.bool_]:
        """Return which of reaches (R, N, J) collide, (R,)."""
        return np.asarray(self._collisions.touching(q, self._obstacles, self._allowed_m) >= 0, dtype=np.bool_)

    def usual_touch(self, q: FloatArray) -> str:
        """Return what reaches (R, N, J) run into most often, in words; empty if none collides."""
        found = self._collisions.touching(q, self._obstacles, self._allowed_m)
        found = found[found >= 0]
        if not len(found):
            return ""
        body, obstacle = self._names(*divmod(int(np.bincount(found).argmax()), len(self._obstacles.names)))
        return f"{body.replace('_', ' ')} into {obstacle.replace('_', ' ')}"

    def _names(self, body: int, obstacle: int) -> tuple[str, str]:
        return self._collisions.moving_names[body], self._obstacles.names[obstacle]


def _packed(obstacles: Sequence[Obstacle]) -> tuple[NDArray[Any], ...]:
    """Return kinds, rotations from the world, centres and half sizes, as the kernels want them."""
    shapes = [obstacle.shape for obstacle in obstacles]
    kind = np.array([kernels.CYLINDER if isinstance(s, Cylinder) else kernels.BOX for s in shapes], dtype=np.int64)
    T = np.array([shape.T_world_shape for shape in shapes]).reshape(-1, 4, 4)
    half = [(s.radius_m, 0.0, s.height_m / 2.0) if isinstance(s, Cylinder) else tuple(s.size_m / 2.0) for s in shapes]
    return (
        kind,
        np.ascontiguousarray(T[:, :3, :3].transpose(0, 2, 1), dtype=np.float32),
        np.ascontiguousarray(T[:, :3, 3], dtype=np.float32),
        np.array(half, dtype=np.float32).reshape(-1, 3),
    )
