"""The posture in which a reach to a given place ends: learned from reaches to other places, corrected to touch it.

A place says where the hand ends, not how the body gets it there: how far people lean and step, and where the elbow is.
That is a smooth function of where the place is seen from the body, so it carries over to places nobody reached for: how
far pelvis and torso move, and which angles the arm has at the end. What the learned function misses is corrected by
moving those DoFs that vary most: inverse kinematics in the metric of what people do, which as a whole is the Gaussian
of postures given that the hand is at the place.

Not in P2, where the end posture is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import HumanModelError, MotionError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel

HAND, BODY, TRUNK_END = "right_palm", "pelvis", "neck"
#: The start is the median of so many first postures.
N_START = 5
#: Least standard deviations, for when few reaches were seen: people never end twice in the same posture.
_LEAST_M, _LEAST_RAD = 0.02, 0.1
_STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
#: In units of a squared standard deviation.
_CONVERGED = 1e-3
#: Half or double of any of the following changes the error on either of P1's libraries by less than 10 %, except twice
#: the bend, which makes the function nearly linear: then the error on library_a, where people lean for far places only,
#: grows by 39 %. Distances of two places at which the linear part of the function differs by its unit, and over which
#: the part that bends is alike:
_SLOPE_M, _BEND_M = 0.3, 0.5
#: Variance of what people do, relative to that of the function.
_NOISE = 0.2
#: Standard deviation of the hand about its place in each direction.
_PLACE_M = 0.03
#: Iterations of the correction at most; most converge in three to five.
_ITERATIONS = 20


@dataclass(frozen=True, eq=False)
class EndPosture:
    """The Gaussian of postures in which a reach to a place ends."""

    mean: FloatArray  #: (D,) the most probable one; angles follow from the start posture without a jump
    covariance: FloatArray  #: (D, D)
    miss_m: float  #: how far its hand is from the place


class EndPostures:
    """Maps start posture and place to the end posture: a Gaussian process, the sum of a linear and a bending part.

    Attributes:
        human: whose postures they are.
        seen: (N, 6) of each reach learned from, as seen from the body: the place, and where the hand was at the start.
    """

    def __init__(self, human: HumanModel, seen: ArrayLike, outcome: ArrayLike) -> None:
        """Learn from what was seen of reaches, and their outcome.

        Args:
            human: whose postures they are.
            seen: (N, 6), see above.
            outcome: (N, D) end minus start of the trunk's DoFs, the pelvis as seen from the body; the end of the arm's.

        Raises:
            MotionError: arrays that do not fit each other, or nothing learned from.
            HumanModelError: a human that lacks a hand or a neck, or whose first DoFs do not shift the pelvis.
        """
        D = len(human.dof_names)
        self.human = human
        self.seen: FloatArray = frozen(checked("end postures: seen", seen, ("N", 6), error=MotionError))  # type: ignore[assignment]
        known = checked("end postures: outcome", outcome, (len(self.seen), D), error=MotionError)
        if not len(self.seen):
            raise MotionError("end postures: wanted at least one reach to learn from, got none")
        missing = {HAND, BODY, TRUNK_END} - set(human.link_names)
        moves = human.joints.axis[:3] * human.joints.slides[:3, None]
        if missing or not np.array_equal(moves, np.eye(3)):
            raise HumanModelError(
                f"end postures of {human.name}: wanted links {HAND}, {BODY} and {TRUNK_END}, and first DoFs "
                f"that shift the pelvis along x, y, z; got a model without {', '.join(sorted(missing)) or 'such DoFs'}"
            )
        self._hand = ChainPoints(human, [HAND])
        self._centre = self.seen.mean(axis=0)
        self._mean_outcome = known.mean(axis=0)
        K = self._kernel(self.seen, self.seen)
        self._inverse = np.asarray(np.linalg.inv(K + _NOISE * np.eye(len(K))), dtype=np.float64)
        self._weights = self._inverse @ (known - self._mean_outcome)
        #: Mean variance with which a reach is predicted that was left out, in units of the bend's.
        self._mean_variance = float((1.0 / np.diag(self._inverse)).mean())
        left_out = self._weights / np.diag(self._inverse)[:, None]
        #: (D, D) covariance of the leave-one-out errors.
        self._covariance = shrunk_covariance(left_out)
        least = np.where(human.joints.slides, _LEAST_M, _LEAST_RAD) ** 2
        self._covariance += np.diag(np.maximum(least - np.diag(self._covariance), 0.0))

    @classmethod
    def learn(cls, postures: Sequence[ArrayLike], human: HumanModel) -> EndPostures:
        """Learn from reaches (T, D) each, whose ends are taken to be where the hand is farthest from its start.

        Raises:
            MotionError: no reaches, or postures of another human.
        """
        seen: list[FloatArray] = []
        outcome: list[FloatArray] = []
        arm = _arm(human)
        for number, reach in enumerate(postures):
            q = checked(f"reach {number}", reach, ("T", len(human.dof_names)), error=MotionError)
            if not len(q):
                raise MotionError(f"reach {number}: wanted at least one posture, got none")
            start, end = start_and_end(continuous(q, human), human)
            T = standing(human, start)
            hand = human.forward(np.stack([start, end]))[HAND]
            seen.append(np.concatenate([_from_body(T, hand[1]), _from_body(T, hand[0])]))
            row = end - start
            row[:3] = row[:3] @ T[:3, :3]
            row[arm] = _near(human, end, outcome[0] if outcome else end)[arm]
            outcome.append(row)
        return cls(human, np.reshape(seen, (-1, 6)), np.reshape(outcome, (-1, len(human.dof_names))))

    def at(self, start: ArrayLike, place_m: ArrayLike) -> EndPosture:
        """Return the end posture of a reach from a posture (D,) to a place (3,) in the tracker's frame.

        Raises:
            MotionError: arrays of other shapes or not finite.
        """
        q = checked("start posture", start, (len(self.human.dof_names),), error=MotionError)
        place = checked("place", place_m, (3,), error=MotionError)
        T = standing(self.human, q)
        hand = self.human.forward(q)[HAND]
        x = np.concatenate([_from_body(T, place), _from_body(T, hand)])[None]
        k = self._kernel(x, self.seen)
        end = self._mean_outcome + (k @ self._weights)[0]
        end[:3] = T[:3, :3] @ end[:3]
        trunk = slice(None, _arm(self.human).start)
        end[trunk] += q[trunk]
        end = _near(self.human, end, q)
        # Farther from the reaches seen the process is less certain: its variance, relative to the mean one.
        unsure = float((self._kernel(x, x) - k @ self._inverse @ k.T)[0, 0]) + _NOISE
        turned = np.eye(len(self.human.dof_names))
        turned[:3, :3] = T[:3, :3]
        prior = turned @ self._covariance @ turned.T * (unsure / self._mean_variance)
        return self._touching(end, prior, place, *_limits(self.human, q))

    def mean(self, start: ArrayLike, place_m: ArrayLike) -> FloatArray:
        """Return the most probable end posture (D,); see `at`."""
        return self.at(start, place_m).mean

    def _touching(
        self, mean: FloatArray, covariance: FloatArray, place: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> EndPosture:
        """Return the Gaussian given that the hand is at the place: Gauss-Newton, as an iterated Kalman filter."""
        noise = _PLACE_M**2 * np.eye(3)
        inverse = np.linalg.inv(covariance)

        def cost(q: FloatArray) -> float:
            away, miss = q - mean, place - self._hand_at(q)
            return float(away @ inverse @ away + miss @ miss / _PLACE_M**2)

        q = np.clip(mean, lower, upper)
        before = cost(q)
        for _ in range(_ITERATIONS):
            J = self._jacobian(q)
            gain = covariance @ J.T @ np.linalg.inv(J @ covariance @ J.T + noise)
            aim = mean + gain @ (place - self._hand_at(q) - J @ (mean - q))
            # Far from the place a whole step may overshoot; then a half or a quarter is tried.
            for share in _STEP_SHARES:
                tried = np.clip(q + share * (aim - q), lower, upper)
                after = cost(tried)
                if after < before:
                    break
            else:
                break
            q, gained, before = tried, before - after, after
            if gained < _CONVERGED:
                break
        J = self._jacobian(q)
        gain = covariance @ J.T @ np.linalg.inv(J @ covariance @ J.T + noise)
        given = covariance - gain @ J @ covariance
        miss_m = float(np.linalg.norm(place - self._hand_at(q)))
        return EndPosture(q, 0.5 * (given + given.T), miss_m)

    def _hand_at(self, q: FloatArray) -> FloatArray:
        return np.asarray(self._hand.positions(q), dtype=np.float64)[0]  # type: ignore[no-any-return]

    def _jacobian(self, q: FloatArray) -> FloatArray:
        return np.asarray(self._hand.jacobian(q), dtype=np.float64)[0]  # type: ignore[no-any-return]

    def _kernel(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return the covariance (A, B) of the function at a (A, 6) and b (B, 6), in units of the bend's."""
        x, y = a - self._centre, b - self._centre
        square = ((x[:, None] - y) ** 2).sum(axis=2)
        k: FloatArray = 1.0 + x @ y.T / _SLOPE_M**2 + np.exp(-0.5 * square / _BEND_M**2)
        return k


def shrunk_covariance(deviations: FloatArray, noise: float = 0.0) -> FloatArray:
    """Return the covariance (D, D) of deviations (n, D) from zero, shrunk towards its diagonal, as reaches are few.

    `noise` is one more variance of each.
    """
    n, D = deviations.shape
    S = deviations.T @ deviations / n
    share = D / (D + n)
    shrunk: FloatArray = (1.0 - share) * S + np.diag(share * np.diag(S) + noise)
    return shrunk


def start_and_end(q: FloatArray, human: HumanModel) -> tuple[FloatArray, FloatArray]:
    """Return first and last posture (D,) of a reach (T, D) with continuous angles.

    The start is the median of the first postures, the end is where the hand is farthest from it.
    """
    start = np.median(q[:N_START], axis=0)
    hand = human.forward(np.concatenate([start[None], q]))[HAND]
    return start, q[int(np.argmax(np.linalg.norm(hand[1:] - hand[0], axis=1)))].copy()


def continuous(q: FloatArray, human: HumanModel) -> FloatArray:
    """Return postures (T, D) whose angles follow from the first on without whole turns."""
    turns = ~human.joints.slides
    out = q.copy()
    out[:, turns] = np.unwrap(q[:, turns], axis=0)
    return out


def _arm(human: HumanModel) -> slice:
    """Return the DoFs of the arm, which follow those of the trunk."""
    return slice(int(human.link_joint[human.link_names.index(TRUNK_END)]), None)


def _limits(human: HumanModel, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the limits (D,) of reaches from a posture (D,), in the turn that its angles are in.

    An angle that may be anything has no limits; a tracker may report an angle a whole turn off.
    """
    turns = ~human.joints.slides
    free = turns & (human.upper - human.lower > 2.0 * np.pi - 1e-3)
    shift = np.where(
        turns & ~free, 2.0 * np.pi * np.round((start - 0.5 * (human.lower + human.upper)) / (2 * np.pi)), 0
    )
    return np.where(free, -np.inf, human.lower + shift), np.where(free, np.inf, human.upper + shift)


def _near(human: HumanModel, q: FloatArray, reference: FloatArray) -> FloatArray:
    """Return the posture (D,) with each angle within half a turn of a reference (D,)."""
    turns = ~human.joints.slides
    near: FloatArray = q - np.where(turns, 2.0 * np.pi * np.round((q - reference) / (2.0 * np.pi)), 0.0)
    return near


def standing(human: HumanModel, q: FloatArray) -> FloatArray:
    """Return the pose (4, 4) of an upright body that looks where the pelvis does."""
    pelvis = human.link_poses(q)[human.link_names.index(BODY)]
    yaw = np.arctan2(pelvis[1, 0], pelvis[0, 0])
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = pelvis[:3, 3]
    return T


def _from_body(T: FloatArray, point_m: FloatArray) -> FloatArray:
    seen: FloatArray = (point_m - T[:3, 3]) @ T[:3, :3]
    return seen
