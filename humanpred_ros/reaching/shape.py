"""What a reach looks like between its ends: a straight line in posture space, a bow, and what people vary of both.

The posture when the hand has done a share a of its way is start + a (end - start) + bow(a), and differs from that by
something that is nothing at both ends and most in the middle. Everything is Gaussian, so what is seen of a reach says
how it goes on: somebody who leans more than usual at half the way is going to lean more than usual at its end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import HAND, EndPosture, continuous, standing, start_and_end

#: Shares of the way at which the bow is kept.
N_SHARES = 21
_NOISE_VARIANCE = 1e-4
_LEAST_WAY_M = 0.05


@dataclass(frozen=True, eq=False)
class ReachShape:
    """Bow and variation of reaches between their ends; the pelvis' way is as seen from where the body looks.

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
        return cls(bow, (1.0 - share) * S + np.diag(share * np.diag(S) + _NOISE_VARIANCE))

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
        noise = 4.0 * done * (1.0 - done) * self.variation + _NOISE_VARIANCE * np.eye(len(now))
        expected = start + done * (end.mean - start) + self.bow_at(np.array([done]), way_m)[0]
        gain = done * np.linalg.solve(done**2 * end.covariance + noise, end.covariance).T
        mean = end.mean + gain @ (now - expected)
        left = end.covariance - done * gain @ end.covariance
        return EndPosture(mean, 0.5 * (left + left.T), end.miss_m)
