"""What is learned about reaches from motions to some places, to predict reaches to others: one immutable object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.reaching.end_postures import HAND, EndPostures, EndPosturesConfig, continuous
from humanpred_ros.reaching.shape import ReachShape

#: A motion whose hand ends this much nearer to where it started than it was at most is one of a reach and its return.
_BACK_SHARE = 0.5
_NOISE_VARIANCE = 1e-5
#: The median of the square of a standard normal: times more are lost arms than a Gaussian has.
_MEDIAN_SQUARE = 0.4549


@dataclass(frozen=True, eq=False)
class ReachModel:
    """How people reach, wherever to.

    Attributes:
        ends: the posture in which a reach to a place ends.
        shape: what a reach looks like between its ends.
        rest_deviation: (D,) by how much the posture after a return differs from the one before the reach.
        returning: share of the motions that come back.
        pace_s_m: a reach takes so long for each metre of the hand's way.
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
    def learn(cls, motions: Sequence[Motion], human: HumanModel, config: EndPosturesConfig | None = None) -> ReachModel:
        """Learn from motions, a reach each, with or without the return; labels play no part.

        Leave out what is mistracked (`motion.cleaning`): a lost arm reaches for nothing.

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
        variance = np.full(len(human.dof_names), _NOISE_VARIANCE)
        if rests:
            variance += np.median(np.square(rests), axis=0) / _MEDIAN_SQUARE
            # Which way a room's axes point says nothing about people.
            variance[:2] = variance[:2].mean()
        postures = [motion.q for motion in motions]
        return cls(
            EndPostures.learn(postures, human, config),
            ReachShape.learn(postures, human),
            np.sqrt(variance),
            float(np.mean(back)),
            float(np.clip(np.median(paces), 0.1, 10.0)),
            tuple(motion.name for motion in motions),
        )
