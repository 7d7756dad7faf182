"""How far a reach under way has got: where it started, how far the hand went, and whether it is on its way back."""

from __future__ import annotations

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.reaching.end_postures import HAND, N_START

#: A hand this much closer to its start than it was at most has turned back; trackers are off by half as much.
TURNED_M = 0.04
#: Somebody who came back to less than this share of the way, and goes out again by so much, reaches anew.
_BACK_SHARE, _SET_OUT_M = 0.5, 0.1
_N_CALM = 3


class ReachProgress:
    """Follows one reach, posture by posture; a fixed amount is remembered.

    What nobody would believe (`goals.believing`) is best not shown to it: the farthest posture is never forgotten.

    Attributes:
        human: whose reach it is.
    """

    def __init__(self, human: HumanModel) -> None:
        self.human = human
        self._hand = human.link_names.index(HAND)
        self._angles = ~human.joints.slides
        self.start()

    def start(self) -> None:
        """Forget the reach: the next posture is the first of another."""
        self._first: list[FloatArray] = []
        self._recent: list[FloatArray] = []
        self._apex: FloatArray | None = None
        self._reached_m = 0.0
        self._turned = False
        self._nearest_m = np.inf
        self._sets_out_again = False

    def update(self, q: FloatArray) -> None:
        """Take one posture (D,). One wild posture, of a tracker that lost the arm for a frame, changes nothing."""
        now = self._following(q)
        self._recent = [*self._recent[-2:], now]
        if len(self._first) < N_START:
            self._first.append(now)
            self._start = np.median(self._first, axis=0)
            self._start_hand = self._hand_of(self._start)
        # The median of three forgives a tracker one wild posture.
        calm = np.median(self._recent, axis=0) if len(self._recent) == _N_CALM else now
        self._hand_m = self._hand_of(calm)
        away = float(np.linalg.norm(self._hand_m - self._start_hand))
        if self._apex is None or away >= self._reached_m:
            self._reached_m, self._apex, self._turned = away, calm, False
        elif away < self._reached_m - TURNED_M:
            self._turned = True
        self._nearest_m = min(self._nearest_m, away) if self._turned else np.inf
        came_back = self._nearest_m < _BACK_SHARE * self._reached_m
        self._sets_out_again = came_back and away > self._nearest_m + _SET_OUT_M

    @property
    def seen(self) -> bool:
        """Whether a posture was seen since `start`."""
        return bool(self._recent)

    @property
    def sets_out_again(self) -> bool:
        """Whether the hand, most of the way back, goes out anew: somebody who does one reach after another."""
        return self._sets_out_again

    @property
    def posture(self) -> FloatArray:
        """(D,) the posture seen last, its angles following from the first without whole turns."""
        return self._recent[-1]

    @property
    def start_posture(self) -> FloatArray:
        """(D,) where the reach started."""
        return np.asarray(self._start)

    @property
    def start_hand_m(self) -> FloatArray:
        """(3,) where the hand was then, tracker's frame."""
        return np.asarray(self._start_hand)

    @property
    def hand_m(self) -> FloatArray:
        """(3,) where the hand is, tracker's frame; one wild posture forgiven."""
        return np.asarray(self._hand_m)

    @property
    def reached_m(self) -> float:
        """How far the hand has been from there."""
        return self._reached_m

    @property
    def apex(self) -> FloatArray:
        """(D,) the posture in which the hand was farthest from where it started."""
        assert self._apex is not None
        return self._apex

    @property
    def turned(self) -> bool:
        """Whether the hand is on its way back."""
        return self._turned

    @property
    def way_back(self) -> float:
        """Share of the way back that is done, 0 to 1; 0 while the hand goes out."""
        if not self._turned:
            return 0.0
        away = float(np.linalg.norm(self._hand_m - self._start_hand))
        return min(max(1.0 - away / self._reached_m, 0.0), 1.0)

    def way_to(self, place_m: FloatArray) -> float:
        """Return the share of the way to a place (3,) that the hand has done, 0 to 1, if that is where it goes."""
        way = place_m - self._start_hand
        length = float(np.linalg.norm(way))
        if length < 1e-6:
            return 1.0
        left = float(np.linalg.norm(place_m - self._hand_m))
        done = float((self._hand_m - self._start_hand) @ way) / length**2
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
        return self.human.link_poses(q)[self._hand, :3, 3]
