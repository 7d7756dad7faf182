"""Finds postures that show the hand where it cannot be, because the tracker lost the arm.

What is measured along the hand's path (the farthest point, the highest speed, whether it has turned back) never
forgets, so one false excursion would spoil the rest of the reach. A posture is an outlier if the hand would have to be
faster than hands are since the last posture that was accepted. Postures are accepted again once they are steady and the
hand can have got there by then. Because that gets easier with time, nothing wrong is held on to for ever; and before
the hand has gone anywhere, the reach simply begins anew where the hand is steady. So a hand that is shown steadily in a
wrong place is accepted if it stays there long enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact_part

#: No reaching hand is faster, m/s: ISO 13855 counts with 2 m/s at most when hands approach a machine, and 0.6 m in
#: 0.3 s, as fast as people can, has a peak of 3.75 m/s (minimum jerk: 1.875 times the mean).
FASTEST_M_S = 4.0
#: A tracked hand may be off by this much more from one frame to the next, metres: a palm's width.
OFF_M = 0.1
#: A lost hand is steady when this many postures in a row can each follow the one before. Three of a hand that jumps
#: about at random often can.
N_STEADY = 5

#: What a posture is: left out, a part of the reach, the first accepted after a loss, the first of a new reach.
OUTLIER, PART, RECOVERED, RESTARTED = 0, 1, 2, 3


class HandHistory(NamedTuple):
    """What is remembered of the hand, metres and seconds."""

    seen: NDArray[np.bool_]  # (1,) whether it was at all
    n_steady: NDArray[np.int64]  # (1,) postures in a row since it was lost; 0 while it is not
    hand: FloatArray  # (2, 3) in the last posture accepted, and in the last posture
    stamp_s: FloatArray  # (2,) of those

    @classmethod
    def fresh(cls) -> HandHistory:
        """Return the state before the first posture."""
        return cls(np.zeros(1, dtype=np.bool_), np.zeros(1, dtype=np.int64), np.zeros((2, 3)), np.zeros(2))


@exact_part
def judge(history: HandHistory, hand: FloatArray, t_s: float, begun: bool) -> int:
    """Judge the posture with the hand there (3,) at that time; changes `history` in place.

    Args:
        history: left by the postures before.
        hand: tracker's frame.
        t_s: stamp, later than the one before.
        begun: whether the hand has gone anywhere since the reach began.

    Returns:
        OUTLIER, PART or RECOVERED; RESTARTED only before the reach has begun.
    """
    conclusion = PART
    if history.seen[0]:
        can_be = _can_follow(history, 0, hand, t_s)
        if history.n_steady[0] > 0 or not can_be:
            if history.n_steady[0] > 0 and not _can_follow(history, 1, hand, t_s):
                history.n_steady[0] = 0
            history.n_steady[0] += 1
            conclusion = OUTLIER
            if history.n_steady[0] >= N_STEADY and (can_be or not begun):
                conclusion = RECOVERED if can_be else RESTARTED
    history.seen[0] = True
    for a in range(3):
        history.hand[1, a] = hand[a]
    history.stamp_s[1] = t_s
    if conclusion != OUTLIER:
        history.n_steady[0] = 0
        for a in range(3):
            history.hand[0, a] = hand[a]
        history.stamp_s[0] = t_s
    return conclusion


@exact_part
def _can_follow(history: HandHistory, k: int, hand: FloatArray, t_s: float) -> bool:
    away = 0.0
    for a in range(3):
        away += (hand[a] - history.hand[k, a]) ** 2
    return bool(np.sqrt(away) <= OFF_M + FASTEST_M_S * (t_s - history.stamp_s[k]))
