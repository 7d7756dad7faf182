"""Which postures are to be believed? A tracker that loses the arm shows the hand where it cannot have got.

What is measured along the hand's path (the farthest point, the highest speed, whether it has turned back) never
forgets, so an excursion that never was would spoil the rest of the reach. A posture is not believed if the hand had to
be faster than hands are since it was believed last; it is believed again once it is steady where it can have got by
then. Nothing wrong is held on to for ever: in time a hand can get anywhere, and one that has gone nowhere yet begins
its reach where it is steady. So a hand shown steadily in a wrong place is believed, if it stays there long enough.
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
#: A tracked hand may be off by so much more from one frame to the next, metres: a palm's width.
OFF_M = 0.1
#: A hand that was lost is steady when so many postures in a row can each follow the one before. Three of a hand thrown
#: about at random often can.
N_STEADY = 5

#: What is concluded of a posture: to be left out, a part of the reach, one that ends a loss, the first of a reach.
LEFT_OUT, PART, FOUND, ANEW = 0, 1, 2, 3


class Belief(NamedTuple):
    """What is remembered of the hand, metres and seconds."""

    seen: NDArray[np.bool_]  # (1,) whether it was at all
    n_steady: NDArray[np.int64]  # (1,) postures in a row since it was lost; 0 while it is not
    hand: FloatArray  # (2, 3) when it was believed last, and in the posture before this one
    stamp_s: FloatArray  # (2,) of those

    @classmethod
    def fresh(cls) -> Belief:
        """Return the state before the first posture."""
        return cls(
            np.zeros(1, dtype=np.bool_),
            np.zeros(1, dtype=np.int64),
            np.zeros((2, 3)),
            np.zeros(2),
        )


@exact_part
def judged(belief: Belief, hand: FloatArray, t_s: float, begun: bool) -> int:
    """Judge the posture with the hand there (3,) at that time; changes `belief` in place.

    Args:
        belief: what the postures before have left.
        hand: tracker's frame.
        t_s: stamp, later than the one before.
        begun: whether the hand has gone anywhere since the reach began.

    Returns:
        LEFT_OUT, PART or FOUND; ANEW only before the reach has begun.
    """
    conclusion = PART
    if belief.seen[0]:
        can_be = _can_follow(belief, 0, hand, t_s)
        if belief.n_steady[0] > 0 or not can_be:
            if belief.n_steady[0] > 0 and not _can_follow(belief, 1, hand, t_s):
                belief.n_steady[0] = 0
            belief.n_steady[0] += 1
            conclusion = LEFT_OUT
            if belief.n_steady[0] >= N_STEADY and (can_be or not begun):
                conclusion = FOUND if can_be else ANEW
    belief.seen[0] = True
    for a in range(3):
        belief.hand[1, a] = hand[a]
    belief.stamp_s[1] = t_s
    if conclusion != LEFT_OUT:
        belief.n_steady[0] = 0
        for a in range(3):
            belief.hand[0, a] = hand[a]
        belief.stamp_s[0] = t_s
    return conclusion


@exact_part
def _can_follow(belief: Belief, k: int, hand: FloatArray, t_s: float) -> bool:
    away = 0.0
    for a in range(3):
        away += (hand[a] - belief.hand[k, a]) ** 2
    return bool(np.sqrt(away) <= OFF_M + FASTEST_M_S * (t_s - belief.stamp_s[k]))
