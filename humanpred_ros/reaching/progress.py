"""How far a reach under way has got: where it started, how far the hand went, and whether it is on its way back."""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import HAND, N_START

#: A hand this much closer to its start than it was at most has turned back; trackers are off by half as much.
TURNED_M = 0.04
#: A hand that came back to less than this share of its way, and goes out again by this much, begins another reach.
_BACK_SHARE, _SET_OUT_M = 0.5, 0.1
_N_MEDIAN = 3


class ReachProgress:
    """Follows one reach, posture by posture, in constant memory.

    Leave out postures in which the hand cannot be (`hand_outliers`): the farthest posture is never forgotten.

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
