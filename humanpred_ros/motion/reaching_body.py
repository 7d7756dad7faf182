"""How a whole body follows its hand, so that synthetic reaches turn and lean as people's do.

A hand alone leaves nine of the twelve DoFs open. People share a reach out over the body in a regular way: further
forward means more lean, further left more turning. That regularity, with its spread, is a prior; the posture is the
most probable one that has the palm where it should be (damped least squares, weighted by the spreads).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.hand_path import HandPath

#: DoF -> change per metre of the palm forwards and to the left (seen by the resting person), and spread about that.
#: Pelvis forwards and left for PelvisTransX and Y. Regression at the turning point of library_b's 180 good motions,
#: and its residuals; the spreads of rShoulderY, rArmTrans and rElbowZ are smaller, by what a tracker's noise explains.
#: The elbow straightens half as much as in library_b: a straighter one would not show rShoulderY (`human.kinect`).
PARTICIPATION = MappingProxyType(
    {
        "PelvisTransX": (0.11, 0.00, 0.026), "PelvisTransY": (-0.03, 0.20, 0.026), "PelvisTransZ": (-0.10, 0.00, 0.022),
        "PelvisRotZ": (1.13, 0.95, 0.18),
        "TorsoX": (0.49, -0.16, 0.074), "TorsoY": (0.53, -0.02, 0.068), "TorsoZ": (-0.02, -0.03, 0.012),
        "rShoulderX": (-1.74, 0.45, 0.30), "rShoulderZ": (1.13, 0.20, 0.15), "rShoulderY": (0.08, -0.61, 0.35),
        "rArmTrans": (0.01, 0.02, 0.008), "rElbowZ": (-0.20, 0.05, 0.08),
    }
)  # fmt: skip
_BODY = tuple(not name.startswith("r") for name in KINECT12_DOFS)


@dataclass(frozen=True)
class BodyConfig:
    """How regular a body is.

    Attributes:
        lag_s: pelvis and torso follow the hand this much later (library_b: 4 to 5 of 100 phases).
        habit: how far motions differ from the regular one, as a share of the spreads in `PARTICIPATION` (which contain
            library_b's tracking errors); with 0.4 a classifier recognises reaches as early as library_b's.
        give: how easily pelvis and torso give way for the palm to be where it should, as a share of the spreads (the
            arm: all of them). Below 1, so that the arm makes up for the body's lag.
        sway: the same share for the slow swaying within a motion.
        sway_s: time constant of the swaying.
        palm_tolerance_m: how exactly the palm follows the hand's path.
        iterations: most damped least-squares steps per posture.
    """

    lag_s: float = 0.12
    habit: float = 0.4
    give: float = 0.5
    sway: float = 0.05
    sway_s: float = 0.7
    palm_tolerance_m: float = 0.002
    iterations: int = 20

    def __post_init__(self) -> None:
        for name in ("lag_s", "habit", "give", "sway", "sway_s", "palm_tolerance_m", "iterations"):
            value, least = getattr(self, name), 1 if name == "iterations" else 0
            if not (np.isfinite(value) and value >= least):
                raise UsageError(f"body: wanted {name} finite and at least {least}, got {value}")
        for name in ("sway_s", "palm_tolerance_m"):
            if getattr(self, name) == 0:
                raise UsageError(f"body: wanted {name} above 0, got 0")


class ReachingBody:
    """Finds postures of P1's 12-DoF human for a path of its right palm.

    Raises:
        HumanModelError: a model with other DoFs.
    """

    def __init__(self, model: HumanModel | None = None, config: BodyConfig = BodyConfig()) -> None:
        self.human = model or HumanModel.kinect12()
        self.human.check_dofs(KINECT12_DOFS)
        self.config = config
        # One posture at a time with derivatives: here pinocchio is faster than the batch of HumanModel.
        self._pin = pin.buildModelFromXML(self.human.urdf)
        self._data = self._pin.createData()
        self._palm = self._pin.getFrameId("right_palm")
        table = np.array([PARTICIPATION[name] for name in KINECT12_DOFS])
        self._per_metre, self._spread = table[:, :2], table[:, 2]

    def palm_m(self, q: FloatArray) -> FloatArray:
        """Return the right palm (3,) of a posture (12,), in the tracker's frame."""
        return self.human.forward(q)["right_palm"]

    def follow(self, path: HandPath, t_s: FloatArray, rest_q: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the postures (T, 12) at times (T,) of a person who rests in `rest_q` (12,) and moves the hand so.

        Each call draws how this motion differs from the regular one. A path that cannot be reached leaves the palm
        as close as joint limits allow; `miss_m` tells.
        """
        rest = checked("rest_q", rest_q, (len(KINECT12_DOFS),))
        hand, late = path.at(t_s), path.at(t_s - self.config.lag_s)
        preferred = rest + self._participation(hand - path.start_m, late - path.start_m, rest)
        # A habit shows as the reach unfolds: nobody rests differently because of where the hand will go.
        away = np.linalg.norm(hand - path.start_m, axis=1, keepdims=True)
        farthest = float(away.max())
        habit = self.config.habit * self._spread * rng.normal(size=len(KINECT12_DOFS))
        preferred += habit * (away / farthest if farthest > 0 else 0.0)
        preferred += self.config.sway * self._spread * slow_noise(t_s, self.config.sway_s, len(KINECT12_DOFS), rng)
        return self._solve(preferred, hand)

    def miss_m(self, goal_m: FloatArray, rest_q: FloatArray) -> float:
        """Return by how much the regular posture for a palm at `goal_m` (3,) misses it."""
        change = (goal_m - self.palm_m(rest_q))[None]
        reached = self._solve(rest_q + self._participation(change, change, rest_q), goal_m[None])
        return float(np.linalg.norm(self.palm_m(reached[0]) - goal_m))

    def _participation(self, hand_m: FloatArray, late_m: FloatArray, rest: FloatArray) -> FloatArray:
        """Return the regular change (T, 12) of posture for displacements of the hand, now and a lag ago (T, 3)."""
        c, s = np.cos(rest[3]), np.sin(rest[3])
        to_tracker = np.array([[c, -s], [s, c]])  # from forwards and left of the resting person to x and y
        now, late = ((moved[:, :2] @ to_tracker) @ self._per_metre.T for moved in (hand_m, late_m))
        change = np.where(_BODY, late, now)
        change[:, :2] = change[:, :2] @ to_tracker.T
        return np.asarray(change, dtype=np.float64)

    def _solve(self, preferred: FloatArray, palm_m: FloatArray) -> FloatArray:
        """Minimise |(q - preferred) / spread|^2 + |palm(q) - palm_m|^2 / tolerance^2 by Gauss-Newton, within limits."""
        q = np.clip(preferred, self.human.lower, self.human.upper)
        weight = np.where(_BODY, self.config.give, 1.0) ** 2 * self._spread**2
        damping = self.config.palm_tolerance_m**2 * np.eye(3)
        for _ in range(self.config.iterations):
            place, J = self._palm_and_jacobian(q)
            short = preferred - q
            gain = weight[:, None] * np.swapaxes(J, 1, 2)
            error = palm_m - place - np.einsum("tij,tj->ti", J, short)
            step = short + np.einsum("tij,tj->ti", gain, np.linalg.solve(J @ gain + damping, error[..., None])[..., 0])
            # Far from the solution the linear model overshoots; a third of a radian keeps it honest.
            step /= np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.33)
            moved = np.clip(q + step, self.human.lower, self.human.upper)
            done, q = np.abs(moved - q).max() < 1e-5, moved
            if done:
                break
        return q

    def _palm_and_jacobian(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the palm (T, 3) and its derivatives (T, 3, 12) by the DoFs."""
        place, J = np.empty((len(q), 3)), np.empty((len(q), 3, q.shape[1]))
        for k, posture in enumerate(q):
            jacobian = pin.computeFrameJacobian(self._pin, self._data, posture, self._palm, pin.LOCAL_WORLD_ALIGNED)
            J[k] = jacobian[:3]
            place[k] = self._data.oMf[self._palm].translation
        return place, J


def slow_noise(t_s: FloatArray, time_constant_s: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Return (T, n) noise of unit variance that forgets with `time_constant_s` (a stationary Markov process)."""
    noise: FloatArray = rng.normal(size=(len(t_s), n))
    keep = np.exp(-np.diff(t_s) / time_constant_s)
    for k, share in enumerate(keep, start=1):
        noise[k] = share * noise[k - 1] + np.sqrt(1.0 - share**2) * noise[k]
    return noise
