"""How fast an arm may move near a body: the protective separation distance of ISO/TS 15066 (now in ISO 10218-2:2025).

S_p = S_h + S_r + S_s + C + Z_d + Z_r: what the person travels until the arm stands, what the arm travels until it
begins to brake and while it brakes, how far a body reaches in before it is seen, and how wrong the positions of person
and arm may be. Here this is asked of every pair of a solid of the body and a sphere of the arm, and turned round: which
factor of its speed may the arm have so that no pair comes closer than its S_p. Not safety-rated: a formula of a
standard does not make a safety function.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.geometry.chain import inverse_pose
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.settings import Settings, setting

if TYPE_CHECKING:  # whoever watches needs no planner
    from humanpred_ros.planning.problem import Arm

#: Speeds are differences of distances over this time, s.
_STEP_S = 1e-3
#: Halvings of the factor's interval: exact to 1e-3.
_HALVINGS = 10
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
        8.0, "people become faster by so much; a large one gives no credit for a body that rests or moves away",
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
    rise_per_s: float = setting(0.5, "the factor rises no faster", unit="1/s", low=0.01, high=100.0)
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
        self._human, self._chain, self._spheres = human, arm.chain, arm.spheres()
        self._T_world_human = checked("pose of the postures' frame", T_world_human, (4, 4))

    def separation(
        self, bodies: Sequence[SeenBody], q: ArrayLike, v: ArrayLike, factor: float, age_s: float = 0.0
    ) -> Separation:
        """Return what decides how fast the arm may be.

        Args:
            bodies: all of them, one or more.
            q, v: (J,) measured configuration and velocity of the arm.
            factor: of the arm's speed at present: the speed at factor 1 follows from it.
            age_s: of the older of postures and joint states.

        Raises:
            ArrayError, HumanModelError: for a state or a posture of another shape, or not finite.
        """
        q = checked("configuration", q, (self._chain.n_joints,))
        v = checked("velocity", v, (self._chain.n_joints,))
        centres = self._spheres.world_m(self._chain, np.stack([q, q + _STEP_S * v]))
        found = [self._decisive(k, body, centres, v, factor, age_s) for k, body in enumerate(bodies)]
        least_m = min(found, key=lambda one: one.least_m).least_m
        decisive = min(found, key=lambda one: (one.factor, one.distance_m - one.protective_m))
        return Separation(**(vars(decisive) | {"least_m": least_m}))

    def _decisive(
        self, number: int, body: SeenBody, centres: FloatArray, v: FloatArray, factor: float, age_s: float
    ) -> Separation:
        """Return what decides of one body; sphere centres (2, P, 3) now and a moment later."""
        settings, dq = self.settings, body.velocity
        later = body.q if dq is None else body.q + _STEP_S * dq
        poses = self._T_world_human @ self._human.body_poses(np.stack([body.q, later]))  # (2, B, 4, 4)
        # Distances (B, P) of the solids to the spheres: now; had the arm moved alone; had the person.
        now, arm_moved = (self._distances(poses[0], centres[k]) for k in (0, 1))
        person_moved = self._distances(poses[1], centres[0])
        arm_speed = (now - arm_moved) / _STEP_S
        person_speed = np.full_like(now, settings.person_speed_m_s) if dq is None else (now - person_moved) / _STEP_S
        stopping_s = float(np.abs(v).max()) / settings.braking_rad_s2
        told = factor >= _LEAST_TOLD and stopping_s > 0.0
        # At factor 1: of an arm that stands nobody knows where it will go, nor how long it will take to stop.
        full_speed = np.maximum(arm_speed, 0.0) / factor if told else np.full_like(now, settings.arm_speed_m_s)
        full_stopping_s = stopping_s / factor if told else settings.arm_speed_m_s / settings.braking_rad_s2
        reaction_s = settings.reaction_s + age_s
        fixed_m = settings.intrusion_m + settings.person_uncertainty_m + settings.arm_uncertainty_m

        def protective_m(factors: FloatArray | float, pairs: NDArray[np.bool_] | slice = slice(None)) -> FloatArray:
            travel = self._travel_m(person_speed[pairs], reaction_s + factors * full_stopping_s)
            arm = factors * full_speed[pairs] * (reaction_s + 0.5 * factors * full_stopping_s)
            total: FloatArray = travel + arm + fixed_m
            return total

        low = (protective_m(1.0) <= now).astype(np.float64)
        between = (low == 0.0) & (protective_m(0.0) <= now)
        if between.any():
            least, most = np.zeros(between.sum()), np.ones(between.sum())
            for _ in range(_HALVINGS):
                middle = 0.5 * (least + most)
                fine = protective_m(middle, between) <= now[between]
                least, most = np.where(fine, middle, least), np.where(fine, most, middle)
            low[between] = least
        present_m = protective_m(factor if told else 0.0)
        at = np.lexsort(((now - present_m).ravel(), low.ravel()))[0]
        b, p = divmod(int(at), now.shape[1])
        speed = float(max(arm_speed[b, p], 0.0))
        return Separation(
            factor=float(low[b, p]),
            distance_m=float(now[b, p]),
            least_m=float(now.min()),
            protective_m=float(present_m[b, p]),
            person_m=float(self._travel_m(person_speed, reaction_s + stopping_s)[b, p]),
            person_speed_m_s=float("nan") if dq is None else float(person_speed[b, p]),
            arm_m=speed * reaction_s,
            arm_speed_m_s=speed,
            stopping_m=0.5 * speed * stopping_s,
            stopping_s=stopping_s,
            reaction_s=reaction_s,
            intrusion_m=settings.intrusion_m,
            person_uncertainty_m=settings.person_uncertainty_m,
            arm_uncertainty_m=settings.arm_uncertainty_m,
            body=number,
            body_link=self._human.bodies[b].link,
            arm_link=int(self._spheres.link[p]),
            body_point_m=self._nearest_m(poses[0, b], b, centres[0, p]),
            arm_point_m=centres[0, p],
        )

    def _travel_m(self, speed: FloatArray, for_s: FloatArray | float) -> FloatArray:
        """Return S_h: how far people come in a time who now move towards the arm at `speed`.

        They become faster at once, up to `person_speed_m_s`. One who moves away is taken to stand: nobody knows when
        they turn round.
        """
        now = np.maximum(speed, 0.0)
        most = np.maximum(now, self.settings.person_speed_m_s)
        faster_s = np.minimum((most - now) / self.settings.person_acceleration_m_s2, for_s)
        reached = now + self.settings.person_acceleration_m_s2 * faster_s
        travel: FloatArray = 0.5 * (now + reached) * faster_s + reached * (for_s - faster_s)
        return travel

    def _distances(self, poses: FloatArray, centres: FloatArray) -> FloatArray:
        """Return the distances (B, P) of the solids at poses (B, 4, 4) from the spheres around centres (P, 3)."""
        found = np.empty((len(poses), len(centres)))
        for b, (T, body) in enumerate(zip(poses, self._human.bodies, strict=True)):
            found[b] = body.shape.distance_m((centres - T[:3, 3]) @ T[:3, :3])
        return found - self._spheres.radius_m

    def _nearest_m(self, pose: FloatArray, b: int, point: FloatArray) -> FloatArray:
        """Return the point (3,) of a solid nearest to a point, by the slope of its distance."""
        inverse, shape, step = inverse_pose(pose), self._human.bodies[b].shape, 1e-5
        around = np.vstack([point, point + step * np.eye(3)])
        d = shape.distance_m(around @ inverse[:3, :3].T + inverse[:3, 3])
        nearest: FloatArray = point - d[0] * (d[1:] - d[0]) / step
        return nearest


class SpeedFactor:
    """The factor over time: it falls at once, rises smoothly, and after a stop only once it is worth it.

    Attributes:
        factor: of the speed at present, 0 to 1, in whole percents, rounded down.
    """

    def __init__(self, settings: ProtectiveDistanceSettings | None = None) -> None:
        """Begin with a stop."""
        self._settings = settings or ProtectiveDistanceSettings()
        self._exact, self._t_s = 0.0, -np.inf

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
        return self.factor
