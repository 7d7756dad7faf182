"""How fast an arm may move near a body: the protective separation distance of ISO/TS 15066 (now in ISO 10218-2:2025).

S_p = S_h + S_r + S_s + C + Z_d + Z_r: what the person travels until the arm stands, what the arm travels until it
begins to brake and while it brakes, how far a body reaches in before it is seen, and how wrong the positions of person
and arm may be. Here this is asked of every pair of a solid of the body and a sphere of the arm, and turned round: which
factor of its speed may the arm have so that no pair comes closer than its S_p. Not safety-rated: a formula of a
standard does not make a safety function.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.chain import inverse_pose
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.solids import Box, Capsule, EllipticCylinder, Sphere
from humanpred_ros.human.model import HumanModel
from humanpred_ros.planning.protective_kernels import (
    BOX,
    CAPSULE,
    ELLIPTIC_CYLINDER,
    SPHERE,
    STEP_S,
    Solids,
    Spheres,
    Terms,
    decisive_pair,
)
from humanpred_ros.settings import Settings, setting

if TYPE_CHECKING:  # whoever watches needs no planner
    from humanpred_ros.planning.problem import Arm

#: Changes of the factor that are remembered: enough for the last second; and moments at which they are looked at.
_REMEMBERED, _MOMENTS = 64, 11
#: Below this factor the measured speed says nothing of the speed at factor 1.
_LEAST_TOLD = 0.1


class ProtectiveDistanceSettings(Settings):
    """Terms of the protective distance."""

    reaction_s: float = setting(
        0.1, "T_r: from a posture's arrival until the arm begins to brake; its age is added", unit="s",
        low=0.0, high=2.0,
    )  # fmt: skip
    braking_rad_s2: float = setting(
        4.0, "every joint of the arm brakes at least so hard", unit="rad/s^2", low=0.1, high=100.0
    )
    person_speed_m_s: float = setting(
        1.6, "v_h: a person whose speed is not known moves so fast, one whose speed is, no faster unless seen faster",
        unit="m/s", low=0.1, high=10.0,
    )  # fmt: skip
    person_acceleration_m_s2: float = setting(
        8.0, "a person whose speed is measured becomes faster by so much, up to v_h, and one who moves away counts as "
        "standing: credit for 0.2 s at most; at 1000 there is none, and v_h counts at once",
        unit="m/s^2", low=0.1, high=1000.0,
    )  # fmt: skip
    intrusion_m: float = setting(0.0, "C: a body reaches in so far before it is seen", unit="m", low=0.0, high=2.0)
    person_uncertainty_m: float = setting(
        0.03, "Z_d: a body may be so far from where it is seen", unit="m", low=0.0, high=1.0
    )
    arm_uncertainty_m: float = setting(
        0.01, "Z_r: the arm may be so far from where it is measured", unit="m", low=0.0, high=1.0
    )
    arm_speed_m_s: float = setting(
        1.0, "an arm that stands is taken to set out towards the person so fast, at factor 1", unit="m/s",
        low=0.01, high=10.0,
    )  # fmt: skip
    rise_per_s: float = setting(1.0, "the factor rises no faster", unit="1/s", low=0.01, high=100.0)
    resume_factor: float = setting(
        0.1, "after a stop the arm sets out once it may have this factor", low=0.01, high=1.0
    )


class SeenBody:
    """A body's newest posture, and how fast its DoFs change."""

    #: The velocity is the mean over at least this time, s: noise of a single step would be taken for speed.
    _OVER_S = 0.06
    #: Postures farther apart say nothing of a velocity, s.
    _LONGEST_S = 0.3

    def __init__(self) -> None:
        self._seen: deque[tuple[float, FloatArray]] = deque(maxlen=64)

    def see(self, q: ArrayLike, t_s: float) -> None:
        """Remember a posture (D,) at `t_s`; a time that does not increase begins anew."""
        if self._seen and t_s <= self._seen[-1][0]:
            self._seen.clear()
        self._seen.append((t_s, np.asarray(q, dtype=np.float64)))
        while len(self._seen) > 2 and self._seen[-1][0] - self._seen[1][0] >= self._OVER_S:
            self._seen.popleft()

    @property
    def q(self) -> FloatArray:
        """(D,) newest posture."""
        return self._seen[-1][1]

    @property
    def t_s(self) -> float:
        """When that was."""
        return self._seen[-1][0]

    @property
    def velocity(self) -> FloatArray | None:
        """(D,) mean velocity of the last moment, rad/s and m/s; None if it is not known."""
        (before_s, before), (now_s, now) = self._seen[0], self._seen[-1]
        if not 0.0 < now_s - before_s <= self._LONGEST_S:
            return None
        velocity: FloatArray = (now - before) / (now_s - before_s)
        return velocity


@dataclass(frozen=True)
class Separation:
    """What decides how fast the arm may be: the terms of one pair, metres and seconds, and the factor that follows."""

    factor: float  #: largest factor of the speed, 0 to 1
    distance_m: float  #: of the pair: a solid of the body and a sphere of the arm
    least_m: float  #: of all pairs
    protective_m: float  #: S_p of the pair at the present speed
    person_m: float  #: S_h, of which
    person_speed_m_s: float  #: is the measured speed towards the arm; NaN if it is not known
    arm_m: float  #: S_r
    arm_speed_m_s: float  #: the present speed towards the person
    stopping_m: float  #: S_s
    stopping_s: float  #: T_s
    reaction_s: float  #: T_r
    intrusion_m: float  #: C
    person_uncertainty_m: float  #: Z_d
    arm_uncertainty_m: float  #: Z_r
    body: int  #: number of the body
    body_link: str  #: link of the human model
    arm_link: int  #: number of the joint that the sphere moves with
    body_point_m: FloatArray  #: (3,) where the solid is nearest, world frame
    arm_point_m: FloatArray  #: (3,) centre of the sphere


class ProtectiveDistance:
    """Compares bodies with an arm."""

    def __init__(
        self, human: HumanModel, arm: Arm, T_world_human: ArrayLike, settings: ProtectiveDistanceSettings | None = None
    ) -> None:
        """Take the model of all bodies, the arm, and the pose (4, 4) of the frame of the postures."""
        self.settings = settings or ProtectiveDistanceSettings()
        self._human, self._chain, spheres = human, arm.chain, arm.spheres()
        # Copies: compiled functions are compiled once more for what is read-only.
        self._spheres = Spheres(spheres.link + 1, np.array(spheres.local_m), np.array(spheres.radius_m))
        self._solids = _solids_of(human)
        self._T_world_human = checked("pose of the postures' frame", T_world_human, (4, 4))
        self._T_human_world = inverse_pose(self._T_world_human)

    def separation(
        self, bodies: Sequence[SeenBody], q: ArrayLike, v: ArrayLike, factor: float, age_s: float = 0.0
    ) -> Separation:
        """Return what decides how fast the arm may be.

        Args:
            bodies: all of them, one or more.
            q, v: (J,) measured configuration and velocity of the arm.
            factor: of the arm's speed when it had that velocity: the speed at factor 1 follows from both.
            age_s: of the older of postures and joint states.

        Raises:
            ArrayError, HumanModelError: for a state or a posture of another shape, or not finite.
        """
        settings = self.settings
        q = checked("configuration", q, (self._chain.n_joints,))
        v = checked("velocity", v, (self._chain.n_joints,))
        postures = np.empty((len(bodies), 2, len(self._human.dof_names)))
        known = np.empty(len(bodies), dtype=np.bool_)
        for k, body in enumerate(bodies):
            posture, dq = checked("posture", body.q, postures.shape[2:], error=HumanModelError), body.velocity
            known[k] = dq is not None
            postures[k] = posture, posture if dq is None else posture + STEP_S * dq
        stopping_s = float(np.abs(v).max()) / settings.braking_rad_s2
        told = factor >= _LEAST_TOLD and stopping_s > 0.0
        terms = Terms(
            reaction_s=settings.reaction_s + age_s,
            factor=float(factor) if told else 0.0,
            # Of an arm that stands nobody knows where it will go, nor how long it will take to stop.
            full_stopping_s=stopping_s / factor if told else settings.arm_speed_m_s / settings.braking_rad_s2,
            full_speed_m_s=math.nan if told else settings.arm_speed_m_s,
            fixed_m=settings.intrusion_m + settings.person_uncertainty_m + settings.arm_uncertainty_m,
            person_speed_m_s=settings.person_speed_m_s,
            person_acceleration_m_s2=settings.person_acceleration_m_s2,
        )
        found = decisive_pair(
            postures, known, self._human.joints, self._solids, self._T_human_world, np.stack([q, q + STEP_S * v]),
            self._chain.joints, self._spheres, terms,
        )  # fmt: skip
        speed = max(found.arm_speed_m_s, 0.0)
        return Separation(
            factor=found.factor,
            distance_m=found.distance_m,
            least_m=found.least_m,
            protective_m=found.protective_m,
            person_m=found.person_m,
            person_speed_m_s=found.person_speed_m_s if known[found.body] else math.nan,
            arm_m=speed * terms.reaction_s,
            arm_speed_m_s=speed,
            stopping_m=0.5 * speed * stopping_s,
            stopping_s=stopping_s,
            reaction_s=terms.reaction_s,
            intrusion_m=settings.intrusion_m,
            person_uncertainty_m=settings.person_uncertainty_m,
            arm_uncertainty_m=settings.arm_uncertainty_m,
            body=found.body,
            body_link=self._human.bodies[found.solid].link,
            arm_link=int(self._spheres.joint[found.sphere]) - 1,
            body_point_m=self._in_world(found.body_point_m),
            arm_point_m=self._in_world(found.arm_point_m),
        )

    def _in_world(self, point_m: ArrayLike) -> FloatArray:
        point: FloatArray = self._T_world_human[:3, :3] @ np.asarray(point_m) + self._T_world_human[:3, 3]
        return point


def _solids_of(human: HumanModel) -> Solids:
    """Return the solids of a human as the search wants them.

    Raises:
        HumanModelError: for a solid of a kind that it does not know.
    """
    kind, size = [], []
    for body in human.bodies:
        shape = body.shape
        if isinstance(shape, Sphere):
            kind.append(SPHERE)
            size.append((shape.radius_m, 0.0, 0.0))
        elif isinstance(shape, Box):
            kind.append(BOX)
            size.append(shape.half_m)
        elif isinstance(shape, Capsule):
            kind.append(CAPSULE)
            size.append((shape.radius_m, 0.5 * shape.length_m, 0.0))
        elif isinstance(shape, EllipticCylinder):
            kind.append(ELLIPTIC_CYLINDER)
            size.append((shape.x_m, shape.y_m, 0.5 * shape.length_m))
        else:
            raise HumanModelError(f"protective distance: wanted {body.name} as one of the known solids, got {shape}")
    links = [human.link_names.index(body.link) for body in human.bodies]
    T_link_body = np.array([body.T_link_body for body in human.bodies])
    return Solids(np.array(kind), np.array(size), human.link_joint[links], human.T_joint_link[links] @ T_link_body)


class SpeedFactor:
    """The factor over time: it falls at once, rises smoothly, and after a stop only once it is worth it.

    Attributes:
        factor: of the speed at present, 0 to 1, in whole percents, rounded down.
    """

    def __init__(self, settings: ProtectiveDistanceSettings | None = None) -> None:
        """Begin with a stop."""
        self._settings = settings or ProtectiveDistanceSettings()
        self._exact, self._t_s = 0.0, -np.inf
        #: Since when which factor was in force.
        self._were: deque[tuple[float, float]] = deque([(-np.inf, 0.0)], maxlen=_REMEMBERED)

    @property
    def factor(self) -> float:
        return int(self._exact * 100.0 + 1e-9) / 100.0

    def follow(self, wanted: float, t_s: float) -> float:
        """Return the factor at `t_s`, given the largest one there may be."""
        since_s = max(t_s - self._t_s, 0.0) if np.isfinite(self._t_s) else 0.0
        self._t_s = t_s
        stands = self.factor == 0.0
        if wanted < 0.01 or (stands and wanted < self._settings.resume_factor):
            self._exact = 0.0
        else:
            # The first step out of a stop is one that can be told.
            self._exact = min(wanted, max(self._exact + since_s * self._settings.rise_per_s, 0.01))
        if self.factor != self._were[-1][1]:
            self._were.append((t_s, self.factor))
        return self.factor

    def between(self, from_s: float, to_s: float) -> FloatArray:
        """Return the factors (N,) at equal intervals of a time that is over: first its beginning, last its end."""
        t_s, factor = np.array(self._were).T
        found: FloatArray = factor[np.maximum(np.searchsorted(t_s, np.linspace(from_s, to_s, _MOMENTS)) - 1, 0)]
        return found
