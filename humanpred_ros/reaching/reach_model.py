"""What is learned about reaches from motions to some places, to predict reaches to others.

Between its ends a reach is a straight line in posture space, plus a bow, plus what people vary. The posture when the
hand has gone a share a of its way is start + a (end - start) + bow(a), and deviates from that by an amount that is zero
at both ends and largest in the middle. All of it is Gaussian, so the part of a reach that was seen says how it goes on:
a person who leans more than usual at half the way will lean more than usual at its end. How far a reach under way has
got is what `ReachProgress` follows.
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
    N_START,
    EndPosture,
    EndPostures,
    continuous,
    shrunk_covariance,
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

    Raises:
        MotionError: arrays that do not fit each other.
    """

    #: (N_SHARES, D) what a reach whose hand goes one metre has beyond the straight line, by share of the way
    bow: FloatArray
    variation: FloatArray  #: (D, D) covariance of what it has beyond that in the middle

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
        return cls(bow, shrunk_covariance(left[:, N_SHARES // 2], _SHAPE_NOISE_VARIANCE))

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

    Raises:
        MotionError: arrays or numbers that do not fit.
    """

    ends: EndPostures  #: the posture in which a reach to a place ends
    shape: ReachShape  #: what a reach looks like between its ends
    rest_deviation: FloatArray  #: (D,) by how much the posture after a return differs from the one before the reach
    returning: float  #: share of the motions that come back
    pace_s_m: float  #: duration of a reach for each metre of the hand's way
    trained_on: tuple[str, ...] = ()  #: names of the motions learned from

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
    def learn(cls, motions: Sequence[Motion], human: HumanModel) -> ReachModel:
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
            EndPostures.learn(postures, human),
            ReachShape.learn(postures, human),
            np.sqrt(variance),
            float(np.mean(back)),
            float(np.clip(np.median(paces), 0.1, 10.0)),
            tuple(motion.name for motion in motions),
        )


#: A hand this much closer to its start than it was at most has turned back; trackers are off by half as much.
TURNED_M = 0.04
#: A hand that came back to less than this share of its way, and goes out again by this much, begins another reach.
_BACK_SHARE, _SET_OUT_M = 0.5, 0.1
_N_MEDIAN = 3


class ReachProgress:
    """Follows one reach, posture by posture, in constant memory.

    Leave out postures in which the hand cannot be (`excess_cost.LostHand`): the farthest posture is never forgotten.

    Attributes:
        human: whose reach it is.
        seen: whether a posture was seen since `start`; what follows is defined only then.
        posture: (D,) the posture seen last, its angles following from the first without whole turns.
        start_posture: (D,) where the reach started.
        start_hand_m, hand_m: (3,) where the hand was then, and is now, tracker's frame; one wild posture is ignored.
        reached_m: how far the hand has been from its start.
        apex: (D,) the posture in which it was farthest.
        turned: whether the hand is on its way back.
        sets_out_again: whether the hand, most of the way back, goes out anew.
    """

    posture: FloatArray
    start_posture: FloatArray
    start_hand_m: FloatArray
    hand_m: FloatArray
    apex: FloatArray

    def __init__(self, human: HumanModel) -> None:
        self.human = human
        self._hand = human.link_names.index(HAND)
        self._angles = ~human.joints.slides
        self.start()

    def start(self) -> None:
        """Forget the reach: the next posture is the first of another."""
        self.seen = False
        self.reached_m = 0.0
        self.turned = False
        self.sets_out_again = False
        self._first: list[FloatArray] = []
        self._recent: list[FloatArray] = []
        self._nearest_m = np.inf

    def update(self, q: FloatArray) -> None:
        """Take one posture (D,); a single wild one, of a tracker that lost the arm for a frame, changes nothing."""
        now = self.posture = self._following(q)
        self._recent = [*self._recent[-2:], now]
        if len(self._first) < N_START:
            self._first.append(now)
            self.start_posture = np.asarray(np.median(self._first, axis=0))
            self.start_hand_m = self._hand_of(self.start_posture)
        calm = np.median(self._recent, axis=0) if len(self._recent) == _N_MEDIAN else now
        self.hand_m = self._hand_of(calm)
        away = float(np.linalg.norm(self.hand_m - self.start_hand_m))
        if not self.seen or away >= self.reached_m:
            self.reached_m, self.apex, self.turned = away, calm, False
        elif away < self.reached_m - TURNED_M:
            self.turned = True
        self.seen = True
        self._nearest_m = min(self._nearest_m, away) if self.turned else np.inf
        came_back = self._nearest_m < _BACK_SHARE * self.reached_m
        self.sets_out_again = came_back and away > self._nearest_m + _SET_OUT_M

    @property
    def way_back(self) -> float:
        """Share of the way back that is done, 0 to 1; 0 while the hand goes out."""
        if not self.turned:
            return 0.0
        away = float(np.linalg.norm(self.hand_m - self.start_hand_m))
        return min(max(1.0 - away / self.reached_m, 0.0), 1.0)

    def way_to(self, place_m: FloatArray) -> float:
        """Return the share of the way to a place (3,) that the hand has done, 0 to 1, if that is where it goes."""
        way = place_m - self.start_hand_m
        length = float(np.linalg.norm(way))
        if length < 1e-6:
            return 1.0
        left = float(np.linalg.norm(place_m - self.hand_m))
        done = float((self.hand_m - self.start_hand_m) @ way) / length**2
        return min(max(0.5 * (done + 1.0 - left / length), 0.0), 1.0)

    def _following(self, q: FloatArray) -> FloatArray:
        """Return the posture (D,) with angles that follow from those before."""
        if not self._recent:
            return np.array(q, dtype=np.float64)
        before = np.median(self._recent, axis=0)
        turns = np.where(self._angles, np.round((q - before) / (2.0 * np.pi)), 0.0)
        following: FloatArray = q - 2.0 * np.pi * turns
        return following

    def _hand_of(self, q: FloatArray) -> FloatArray:
        return np.asarray(self.human.link_poses(q)[self._hand, :3, 3])
