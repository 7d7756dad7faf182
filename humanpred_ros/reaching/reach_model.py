"""What is learned about reaches from motions to some places, to predict reaches to others.

Between its ends a reach is a straight line in posture space, plus a bow, plus what people vary. The posture when the
hand has gone a share a of its way is start + a (end - start) + bow(a), and deviates from that by an amount that is zero
at both ends and largest in the middle. All of it is Gaussian, so the part of a reach that was seen says how it goes on:
a person who leans more than usual at half the way will lean more than usual at its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.reaching.end_postures import (
    HAND,
    EndPosture,
    EndPostures,
    EndPosturesSettings,
    continuous,
    standing,
    start_and_end,
)

#: Shares of the way at which the bow is kept.
N_SHARES = 21
_SHAPE_NOISE_VARIANCE = 1e-4
_LEAST_WAY_M = 0.05
#: A motion whose hand ends at less than this share of its farthest distance from the start is a reach and its return.
_BACK_SHARE = 0.5
_REST_NOISE_VARIANCE = 1e-5
#: The median of the square of a standard normal; a median, because more arms are lost than a Gaussian has outliers.
_MEDIAN_SQUARE = 0.4549


@dataclass(frozen=True, eq=False)
class ReachShape:
    """Bow and variation of reaches between their ends; the pelvis' way is relative to where the body looks.

    Attributes:
        bow: (N_SHARES, D) what a reach whose hand goes one metre has beyond the straight line, by share of the way.
        variation: (D, D) covariance of what it has beyond that in the middle.

    Raises:
        MotionError: arrays that do not fit each other.
    """

    bow: FloatArray
    variation: FloatArray

    def __post_init__(self) -> None:
        bow = checked("reach shape: bow", self.bow, (N_SHARES, "D"), error=MotionError)
        variation = checked("reach shape: variation", self.variation, (bow.shape[1],) * 2, error=MotionError)
        object.__setattr__(self, "bow", frozen(bow))
        object.__setattr__(self, "variation", frozen(variation))

    @classmethod
    def learn(cls, postures: Sequence[ArrayLike], human: HumanModel) -> ReachShape:
        """Learn from reaches (T, D) each, up to where their hand is farthest from its start.

        Raises:
            MotionError: no reach in which the hand goes anywhere, or postures of another human.
        """
        shares = np.linspace(0.0, 1.0, N_SHARES)
        beyond, ways = [], []
        for number, reach in enumerate(postures):
            q = continuous(checked(f"reach {number}", reach, ("T", len(human.dof_names)), error=MotionError), human)
            start, end = start_and_end(q, human)
            hand = human.forward(np.concatenate([[start], q]))[HAND]
            away = np.linalg.norm(hand[1:] - hand[0], axis=1)
            last = int(np.argmax(away))
            if away[last] < _LEAST_WAY_M or last < 2:
                continue
            done = np.maximum.accumulate(away[: last + 1]) / away[last]
            # Where the hand rests the share does not grow; the last posture at a share counts.
            keep = np.concatenate([np.diff(done) > 0.0, [True]])
            line = start + done[keep, None] * (end - start)
            rest = q[: last + 1][keep] - line
            rest[:, :3] = rest[:, :3] @ standing(human, start)[:3, :3]
            beyond.append(np.stack([np.interp(shares, done[keep], column) for column in rest.T], axis=1))
            beyond[-1][[0, -1]] = 0.0
            ways.append(away[last])
        if not beyond:
            raise MotionError("reach shape: wanted at least one reach whose hand goes somewhere, got none")
        way = np.array(ways)
        bow = np.tensordot(way, np.array(beyond), axes=1) / (way**2).sum()
        left = np.array(beyond) - way[:, None, None] * bow
        middle = left[:, N_SHARES // 2]
        n, D = middle.shape
        S = middle.T @ middle / n
        share = D / (D + n)
        return cls(bow, (1.0 - share) * S + np.diag(share * np.diag(S) + _SHAPE_NOISE_VARIANCE))

    def turned(self, R: FloatArray) -> ReachShape:
        """Return the shape of reaches of a body turned by a rotation (3, 3) about the vertical."""
        turn = np.eye(len(self.variation))
        turn[:3, :3] = R
        return ReachShape(self.bow @ turn.T, turn @ self.variation @ turn.T)

    def bow_at(self, share: FloatArray, way_m: float) -> FloatArray:
        """Return the bow (..., N, D) at shares (..., N) of a way of the hand."""
        known = np.linspace(0.0, 1.0, N_SHARES)
        bow: FloatArray = way_m * np.stack([np.interp(share, known, column) for column in self.bow.T], axis=-1)
        return bow

    def given(self, end: EndPosture, start: FloatArray, now: FloatArray, done: float, way_m: float) -> EndPosture:
        """Return the end posture given that the reach is in posture `now` (D,) after a share of its way.

        One step of a Kalman filter: now - start - bow = done (end - start) + variation.
        """
        if done <= 0.0:
            return end
        noise = 4.0 * done * (1.0 - done) * self.variation + _SHAPE_NOISE_VARIANCE * np.eye(len(now))
        expected = start + done * (end.mean - start) + self.bow_at(np.array([done]), way_m)[0]
        gain = done * np.linalg.solve(done**2 * end.covariance + noise, end.covariance).T
        mean = end.mean + gain @ (now - expected)
        left = end.covariance - done * gain @ end.covariance
        return EndPosture(mean, 0.5 * (left + left.T), end.miss_m)


@dataclass(frozen=True, eq=False)
class ReachModel:
    """How people reach, to whatever place: immutable.

    Attributes:
        ends: the posture in which a reach to a place ends.
        shape: what a reach looks like between its ends.
        rest_deviation: (D,) by how much the posture after a return differs from the one before the reach.
        returning: share of the motions that come back.
        pace_s_m: duration of a reach for each metre of the hand's way.
        trained_on: names of the motions learned from.

    Raises:
        MotionError: arrays or numbers that do not fit.
    """

    ends: EndPostures
    shape: ReachShape
    rest_deviation: FloatArray
    returning: float
    pace_s_m: float
    trained_on: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        D = len(self.human.dof_names)
        deviation = checked("rest deviation", self.rest_deviation, (D,), error=MotionError)
        object.__setattr__(self, "rest_deviation", frozen(deviation))
        if not 0.0 <= self.returning <= 1.0 or not 0.0 < self.pace_s_m < np.inf:
            raise MotionError(
                f"reach model: wanted a share that returns within [0, 1] and a positive pace, got {self.returning} "
                f"and {self.pace_s_m} s/m"
            )

    @property
    def human(self) -> HumanModel:
        """Whose reaches they are."""
        return self.ends.human

    @classmethod
    def learn(
        cls, motions: Sequence[Motion], human: HumanModel, settings: EndPosturesSettings | None = None
    ) -> ReachModel:
        """Learn from motions, a reach each, with or without the return; labels are not used.

        Leave out mistracked motions (`motion.cleaning`): they would teach reaches that nobody made.

        Raises:
            MotionError: no motions, or none whose hand goes anywhere.
            HumanModelError: motions of another human.
        """
        if not motions:
            raise MotionError("reach model: wanted at least one motion, got none")
        back, paces, rests = [], [], []
        for motion in motions:
            human.check_dofs(motion.dof_names)
            q = continuous(motion.q, human)
            hand = human.forward(q)[HAND]
            away = np.linalg.norm(hand - hand[0], axis=1)
            apex = int(np.argmax(away))
            paces.append((motion.t_s[apex] - motion.t_s[0]) / max(float(away[apex]), 1e-3))
            back.append(away[-1] < _BACK_SHARE * away[apex])
            if back[-1]:
                rests.append(q[-1] - q[0])
        variance = np.full(len(human.dof_names), _REST_NOISE_VARIANCE)
        if rests:
            variance += np.median(np.square(rests), axis=0) / _MEDIAN_SQUARE
            # The directions of a room's axes mean nothing for people.
            variance[:2] = variance[:2].mean()
        postures = [motion.q for motion in motions]
        return cls(
            EndPostures.learn(postures, human, settings),
            ReachShape.learn(postures, human),
            np.sqrt(variance),
            float(np.mean(back)),
            float(np.clip(np.median(paces), 0.1, 10.0)),
            tuple(motion.name for motion in motions),
        )
