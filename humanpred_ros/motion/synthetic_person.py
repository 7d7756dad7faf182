"""Draws how a person's hand and body move in a reach and return, for the synthetic library.

Each movement of the hand is a stroke with the bell-shaped speed of least jerk, bowed and skewed a little; overlapping
strokes add up, as corrections do in recordings of people.

A hand alone leaves nine of the twelve DoFs open. People share a reach out over the body in a regular way: further
forward means more lean, further left more turning. That regularity, with its spread, is a prior; the posture is the
most probable one that has the palm where it should be (damped least squares, weighted by the spreads).
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.model import HumanModel
from humanpred_ros.settings import Settings, setting

#: Smallest value of what must be above 0.
_LEAST = 1e-9
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


class HandPathConfig(Settings):
    """How a person moves the hand: medians and spreads.

    Times: library_a's recorded stamps say that the middle half of a reach takes 0.46 s, library_b's phases how that
    compares with resting and returning (its motions then last 2.5 to 4 s). Shapes are library_b's. After the wait, the
    hand's first 5 cm take another 0.2 s; people stop a recording before the hand lies still.
    """

    wait_s: tuple[float, float] = setting((0.42, 0.18), "rest before moving, mean and deviation", unit="s", low=0.0)
    wait_least_s: float = setting(0.08, "shortest rest", unit="s", low=_LEAST)
    reach_s: float = setting(1.15, "length of the stroke out", unit="s", low=_LEAST)
    return_s: float = setting(1.70, "length of the stroke back", unit="s", low=_LEAST)
    dwell_s: float = setting(0.15, "mean of the exponentially distributed rest at the place", unit="s", low=0.0)
    tail_s: float = setting(0.15, "longest recording after the return, uniform from 0", unit="s", low=0.0)
    spread: float = setting(0.10, "standard deviation of the logarithm of each of these lengths", low=0.0)
    tempo_spread: float = setting(0.08, "the same for a factor common to all parts of one motion", low=0.0)
    tail_of_return: float = setting(0.75, "share of the return that is always recorded", low=_LEAST, high=1.0)
    correction_share: float = setting(0.5, "share of the reaches that are corrected", low=0.0, high=1.0)
    correction_miss: float = setting(0.06, "deviation of the first stroke's miss per axis, of the distance", low=0.0)
    correction_s: float = setting(0.40, "length of a correcting stroke", unit="s", low=_LEAST)
    rise_out: float = setting(0.06, "mean rise above the straight line on the way out, of the distance", low=0.0)
    rise_back: float = setting(0.17, "the same on the way back", low=0.0)
    bow_spread: float = setting(0.05, "deviation of the rise, and of the bow in the other directions", low=0.0)
    skew_spread: float = setting(0.08, "deviation of the exponent that skews a stroke in time", low=0.0)


class BodyConfig(Settings):
    """How regular a body is.

    The lag is library_b's (4 to 5 of 100 phases). PARTICIPATION's spreads contain library_b's tracking errors: with a
    habit of 0.4 of them a classifier recognises reaches as early as library_b's. Pelvis and torso give way less than
    the arm, so that the arm compensates for the body's lag.
    """

    lag_s: float = setting(0.12, "pelvis and torso follow the hand this much later", unit="s", low=0.0)
    habit: float = setting(0.4, "how far motions differ from the regular one, of PARTICIPATION's spreads", low=0.0)
    give: float = setting(0.5, "how easily pelvis and torso give way to the palm, of the spreads; the arm: 1", low=0.0)
    sway: float = setting(0.05, "the same share for the slow swaying within a motion", low=0.0)
    sway_s: float = setting(0.7, "time constant of the swaying", unit="s", low=_LEAST)
    palm_tolerance_m: float = setting(0.002, "how exactly the palm follows the hand's path", unit="m", low=_LEAST)
    iterations: int = setting(20, "most damped least-squares steps per posture", low=1)


@dataclass(frozen=True)
class Stroke:
    """One movement that adds `step_m` to where the hand is."""

    start_s: float  #: when
    duration_s: float
    step_m: FloatArray  #: (3,) from where to where
    bow_m: FloatArray  #: (3,) deviation from the straight line, reached half way
    skew: float = 1.0  #: exponent on the elapsed share of the stroke; below 1 it starts faster

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return what the stroke has added at times (T,), as (T, 3)."""
        u = np.clip((t_s - self.start_s) / self.duration_s, 0.0, 1.0) ** self.skew
        share = (u**3 * (10.0 - 15.0 * u + 6.0 * u**2))[:, None]  # least jerk
        added: FloatArray = share * self.step_m + 4.0 * share * (1.0 - share) * self.bow_m
        return added


@dataclass(frozen=True)
class HandPath:
    """A hand's path over time."""

    start_m: FloatArray  #: (3,) where the hand rests
    strokes: tuple[Stroke, ...]  #: what moves it; times before the first and after the last are rest
    arrival_s: float  #: when it is at the goal for the first time (corrections included)
    duration_s: float  #: length of the recording; it may end just before the last stroke does

    def at(self, t_s: ArrayLike) -> FloatArray:
        """Return the hand's positions (T, 3) at times (T,), seconds from the start of the recording."""
        times = checked("t_s", t_s, ("T",))
        place = np.tile(self.start_m, (len(times), 1))
        for stroke in self.strokes:
            place += stroke.at(times)
        return place


def draw_hand_path(
    start_m: ArrayLike, goal_m: ArrayLike, rest_m: ArrayLike, config: HandPathConfig, rng: np.random.Generator
) -> HandPath:
    """Return a path from `start_m` (3,) to `goal_m` (3,) and back to `rest_m` (3,); z is up."""
    start, goal = checked("start_m", start_m, (3,)), checked("goal_m", goal_m, (3,))
    rest = checked("rest_m", rest_m, (3,))
    tempo = rng.lognormal(0.0, config.tempo_spread)
    reach_s, correction_s, return_s = (
        tempo * median * rng.lognormal(0.0, config.spread)
        for median in (config.reach_s, config.correction_s, config.return_s)
    )
    leave_s = max(config.wait_least_s, tempo * rng.normal(*config.wait_s))
    distance = float(np.linalg.norm(goal - start))

    miss = np.zeros(3)
    if rng.random() < config.correction_share:
        miss = config.correction_miss * distance * rng.normal(size=3)
    strokes = [_stroke(leave_s, reach_s, goal + miss - start, config.rise_out, config, rng)]
    arrival_s = leave_s + reach_s
    if miss.any():
        # A correction starts before the reach has ended: eyes and arm do not wait for each other.
        correct_s = leave_s + rng.uniform(0.65, 0.9) * reach_s
        strokes.append(Stroke(correct_s, correction_s, -miss, np.zeros(3)))
        arrival_s = max(arrival_s, correct_s + correction_s)
    return_at_s = arrival_s + rng.exponential(config.dwell_s)
    strokes.append(_stroke(return_at_s, return_s, rest - goal, config.rise_back, config, rng))
    end_s = return_at_s + return_s * rng.uniform(config.tail_of_return, 1.0) + rng.uniform(0.0, config.tail_s)
    return HandPath(start, tuple(strokes), arrival_s, end_s)


def _stroke(
    start_s: float, duration_s: float, step_m: FloatArray, rise: float, config: HandPathConfig, rng: np.random.Generator
) -> Stroke:
    """Draw a stroke that is bowed upwards by `rise` on average, and somewhat in every direction."""
    bow = np.linalg.norm(step_m) * (np.array([0.0, 0.0, rise]) + config.bow_spread * rng.normal(size=3))
    skew = float(np.clip(rng.normal(1.0, config.skew_spread), 0.7, 1.4))
    return Stroke(start_s, duration_s, step_m, bow, skew)


class ReachingBody:
    """Finds postures of P1's 12-DoF human for a path of its right palm.

    Raises:
        HumanModelError: a model with other DoFs.
    """

    def __init__(self, model: HumanModel | None = None, config: BodyConfig | None = None) -> None:
        self.human = model or HumanModel.kinect12()
        self.human.check_dofs(KINECT12_DOFS)
        self.config = config or BodyConfig()
        self._palm = ChainPoints(self.human, ["right_palm"])
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
        # A habit grows with the reach: where the hand will go does not change how a person rests.
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
            place, J = self._palm.positions(q)[:, 0], self._palm.jacobian(q)[:, 0]
            short = preferred - q
            gain = weight[:, None] * np.swapaxes(J, 1, 2)
            error = palm_m - place - np.einsum("tij,tj->ti", J, short)
            step = short + np.einsum("tij,tj->ti", gain, np.linalg.solve(J @ gain + damping, error[..., None])[..., 0])
            # Far from the solution the linear model overshoots; steps of at most a third of a radian do not.
            step /= np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 0.33)
            moved = np.clip(q + step, self.human.lower, self.human.upper)
            done, q = np.abs(moved - q).max() < 1e-5, moved
            if done:
                break
        return q


def slow_noise(t_s: FloatArray, time_constant_s: float, n: int, rng: np.random.Generator) -> FloatArray:
    """Return (T, n) noise of unit variance that forgets with `time_constant_s` (a stationary Markov process)."""
    noise: FloatArray = rng.normal(size=(len(t_s), n))
    keep = np.exp(-np.diff(t_s) / time_constant_s)
    for k, share in enumerate(keep, start=1):
        noise[k] = share * noise[k - 1] + np.sqrt(1.0 - share**2) * noise[k]
    return noise
