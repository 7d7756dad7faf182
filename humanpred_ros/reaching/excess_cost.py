"""By how much does the reach so far cost more than the best reach to a given place, by kinds of cost?

P2 explains a reach by a cost that it keeps low. Then a place is improbable if the reach would have been much cheaper
with that place as its end, which is what makes a motion legible (Dragan and Srinivasa 2013). The reaches of P2's cost
are smooth and nearly straight, so what a reach spends in excess can be measured on the hand, without planning:

- detour: how much longer the way to the place by here is than the straight one,
- aside: how far the hand is beside the straight way,
- beyond: how far it is past the place,
- heading over 5 and over 15 cm: how far it points elsewhere; less and less so the nearer the place,
- stopping: how far from the place it slows down, or has turned back,
- body: how far palm, elbow, shoulder and neck are, summed, from the whole body's best reach (`best_reach`).

Everything is measured on the tracker's points, relative to the reach's own start and its highest speed so far. The
room, the direction in it and a person's speed have no influence, except through the sampling of the sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.recognition.reach_features import (
    FAR,
    HEADINGS,
    N_FEATURES,
    POINTS,
    REACHED,
    ReachState,
    advance,
    point_links,
)

#: The parts of the excess cost. All are metres but the headings, which have no unit.
PARTS = ("detour", "aside", "beyond", "heading_5cm", "heading_15cm", "stopping", "body")
N_PARTS = len(PARTS)
BODY = PARTS.index("body")
#: Distances count up to this, metres, so that a lost arm does not outweigh all that was seen before.
MOST_M = 0.3

#: Columns of a row about the reach so far: palm, elbow, shoulder and neck now (once the palm has turned back: when it
#: was farthest), the palm at its start, headings, how far it has been from the start, and how far it has arrived,
#: 0 to 1.
HAND, START, SHORT, LONG, REACHED_M, ARRIVED = 0, 12, 15, 18, 21, 22
N_COLUMNS = 23

#: Ropes of `reach_features` whose headings are used: 5 and 15 cm behind the palm.
_SHORT_ROPE, _LONG_ROPE = 1, 2
#: The hand's velocity is averaged over about so long, seconds: three frames of a 60 Hz tracker.
_VELOCITY_S = 0.05
#: Before the hand has gone so far, metres, being slow means that it has not begun.
_BEGUN_M = 0.1
#: A hand that was never faster than this, m/s, has not been seen to slow down.
_LEAST_PEAK_M_S = 0.15
#: So far back from its farthest point, metres, the hand begins to have turned back, and has done so.
_TURNED_M = (0.02, 0.06)
#: Within about so far of a place, metres, a heading says nothing about it.
_NEAR_M = 0.05


#: Postures along a best reach, both ends included: each point stays within 2 mm of the curve they stand for.
N_ALONG = 13
_N_POINTS = len(POINTS)
_SHARES = np.linspace(0.0, 1.0, N_ALONG)[:, None]
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


class LostHand:
    """Finds postures that show the hand where it cannot be, because the tracker lost the arm.

    What is measured along the hand's path (the farthest point, the highest speed, whether it has turned back) never
    forgets, so one false excursion would spoil the rest of the reach. A posture is an outlier if the hand would have to
    be faster than hands are since the last posture that was accepted. Postures are accepted again once they are steady
    and the hand can have got there by then. Because that gets easier with time, nothing wrong is held on to for ever;
    and before the hand has gone anywhere, the reach simply begins anew where the hand is steady. So a hand that is
    shown steadily in a wrong place is accepted if it stays there long enough.
    """

    def __init__(self) -> None:
        self._n_steady = 0
        #: Stamp and hand of the last posture accepted, and of the last posture.
        self._accepted: tuple[float, FloatArray] | None = None
        self._last: tuple[float, FloatArray] | None = None

    def judge(self, hand: FloatArray, t_s: float, begun: bool) -> int:
        """Judge the posture with the hand there (3,), tracker's frame, at a stamp later than the one before.

        Args:
            hand: where it is.
            t_s: stamp.
            begun: whether the hand has gone anywhere since the reach began.

        Returns:
            OUTLIER, PART or RECOVERED; RESTARTED only before the reach has begun.
        """
        conclusion, now = PART, (t_s, np.array(hand))
        if self._accepted is not None and self._last is not None:
            can_be = _can_follow(self._accepted, now)
            if self._n_steady > 0 or not can_be:
                if self._n_steady > 0 and not _can_follow(self._last, now):
                    self._n_steady = 0
                self._n_steady += 1
                conclusion = OUTLIER
                if self._n_steady >= N_STEADY and (can_be or not begun):
                    conclusion = RECOVERED if can_be else RESTARTED
        self._last = now
        if conclusion != OUTLIER:
            self._n_steady, self._accepted = 0, now
        return conclusion


def _can_follow(before: tuple[float, FloatArray], now: tuple[float, FloatArray]) -> bool:
    return math.dist(before[1], now[1]) <= OFF_M + FASTEST_M_S * (now[0] - before[0])


class HandFollower:
    """Follows the hand of the reach under way; what it remembers is a fixed amount, however long the reach lasts.

    Attributes:
        row: (N_COLUMNS,) about the reach so far.
        reach: state of `reach_features`.
    """

    def __init__(self) -> None:
        self.row: FloatArray = np.zeros(N_COLUMNS)
        self.reach = ReachState.fresh()
        self._lost = LostHand()
        self._before = np.zeros_like(self.reach.recent)  # points of the last two postures, outliers or not
        self._features = np.zeros(N_FEATURES)
        self._palm = np.zeros(3)  # in the last posture accepted, a single lost frame ignored
        self._velocity = np.zeros(3)  # averaged, m/s
        self._peak_m_s = 0.0  # the highest speed so far
        self._last_s = 0.0  # stamp of the last posture accepted

    def observe(self, points: FloatArray, t_s: float) -> int:
        """Take the points (P, 3) of one posture and bring `row` up to date; return what `LostHand.judge` concludes.

        An OUTLIER leaves the row as it was; with RESTARTED the reach begins here.

        Args:
            points: where the links of `reach_features.POINTS` are, tracker's frame.
            t_s: stamp, later than the one before.
        """
        conclusion = self._lost.judge(points[0], t_s, bool(self.reach.reached_m[0] > _BEGUN_M))
        if conclusion == RECOVERED:
            # The median of three is then of postures since the loss.
            self.reach.recent[:] = self._before
        self._before[1], self._before[0] = self._before[0], points
        if conclusion == OUTLIER:
            return conclusion
        if conclusion == RESTARTED:
            self.reach.n_seen[0] = 0
            self._velocity[:] = 0.0
            self._peak_m_s = 0.0
        first, features = self.reach.n_seen[0] == 0, self._features
        advance(self.reach, points, features)
        palm = features[:3].copy()
        if not first and conclusion != RECOVERED:
            step_s = t_s - self._last_s
            share = 1.0 - math.exp(-step_s / _VELOCITY_S)
            self._velocity += share * ((palm - self._palm) / step_s - self._velocity)
        self._palm, self._last_s = palm, t_s
        speed = float(np.sqrt((self._velocity**2).sum()))
        self._peak_m_s = max(self._peak_m_s, speed)
        self._describe(speed)
        return conclusion

    def _describe(self, speed: float) -> None:
        """Fill the row."""
        features, row = self._features, self.row
        reached = features[REACHED]
        back = (reached - features[REACHED - 1] - _TURNED_M[0]) / (_TURNED_M[1] - _TURNED_M[0])
        back = min(max(back, 0.0), 1.0)
        slow = max(0.0, 1.0 - speed / max(self._peak_m_s, _LEAST_PEAK_M_S)) if reached > _BEGUN_M else 0.0
        arrived = max(slow, back)
        row[HAND:START] = features[:FAR] + back * (features[FAR : 2 * FAR] - features[:FAR])
        row[START:SHORT] = self.reach.start
        # A hand that has stopped has no heading, and one on its way back heads away from its place.
        headings = features[HEADINGS:][: 3 * (_LONG_ROPE + 1)].reshape(-1, 3)
        row[SHORT:LONG] = (1.0 - arrived) * headings[_SHORT_ROPE]
        row[LONG:REACHED_M] = (1.0 - arrived) * headings[_LONG_ROPE]
        row[REACHED_M], row[ARRIVED] = reached, arrived


def excess_costs(rows: FloatArray, places_m: FloatArray, best: Sequence[FloatArray] | None = None) -> FloatArray:
    """Return by how much reaches so far cost more than the best to each place.

    Args:
        rows: (N, N_COLUMNS) of reaches that start in the same posture.
        places_m: (G, 3), tracker's frame.
        best: the best reach to each (`best_reaches`); None if they are not known, then "body" is 0.

    Returns:
        (N, G, N_PARTS), none negative; all zero before the hand has moved.
    """
    hand, start, short, long = (rows[:, None, first : first + 3] for first in (HAND, START, SHORT, LONG))
    to_place, from_start, whole = places_m - hand, hand - start, places_m - start
    ahead, straight, gone = (_length(way) for way in (to_place, whole, from_start))
    # A place at the start has no way to be beside of.
    along = _dot(from_start, whole) / np.where(straight > 1e-9, straight, np.inf)
    near = 1.0 / (ahead + _NEAR_M)
    costs = np.zeros((len(rows), len(places_m), N_PARTS))
    costs[..., 0] = np.clip(gone + ahead - straight, 0.0, MOST_M)
    costs[..., 1] = np.minimum(np.sqrt(np.maximum(_dot(from_start, from_start) - along * along, 0.0)), MOST_M)
    costs[..., 2] = np.clip(along - straight, 0.0, MOST_M)
    for part, heading in ((3, short), (4, long)):
        costs[..., part] = np.maximum(_length(heading) * ahead - _dot(heading, to_place), 0.0) * near
    costs[..., 5] = np.minimum(ahead, MOST_M) * rows[:, ARRIVED, None]
    if best is not None:
        for g, path in enumerate(best):
            costs[:, g, BODY] = np.minimum(distances_from(path, rows[:, :START]), MOST_M)
    return costs


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = (a * b).sum(axis=-1)
    return product


def _length(a: FloatArray) -> FloatArray:
    return np.sqrt(_dot(a, a))


def best_reach(human: HumanModel, ends: EndPostures, start_q: FloatArray, place_m: FloatArray) -> FloatArray:
    """Return where palm, elbow, shoulder and neck are along the best reach of the whole body to a place.

    The hand alone is much the same for many places at first; shoulder and neck show earlier whether a person leans or
    turns. The best reach leads straight, in posture space, from the start to the posture in which reaches to that place
    end (`end_postures`); how fast it is passed through does not matter here.

    Args:
        human: whose reach it is.
        ends: in which posture reaches end.
        start_q: (D,) the posture it begins in.
        place_m: (3,) where the palm goes, tracker's frame.

    Returns:
        (N_ALONG, 12) the coordinates of the four points, one after the other, metres, tracker's frame.
    """
    end_q = ends.mean(start_q, place_m)
    poses = human.link_poses(start_q + _SHARES * (end_q - start_q))
    points: FloatArray = poses[:, point_links(human)][..., :3, 3].reshape(N_ALONG, -1)
    return points


def distances_from(path: FloatArray, points: FloatArray) -> FloatArray:
    """Return the distances (N,), summed over four points (N, 12), from the nearest moment of a path (K, 12), metres."""
    steps, from_begin = np.diff(path, axis=0), points[:, None] - path[:-1]
    size = (steps**2).sum(axis=1)
    share = np.clip((steps * from_begin).sum(axis=2) / np.where(size > 0.0, size, np.inf), 0.0, 1.0)
    away = (from_begin - share[..., None] * steps).reshape(*share.shape, _N_POINTS, 3)
    squares = (away**2).sum(axis=-1)
    nearest = squares.sum(axis=-1).argmin(axis=1)
    found: FloatArray = np.sqrt(squares[np.arange(len(points)), nearest]).sum(axis=-1)
    return found


def reach_so_far(motion: Motion, human: HumanModel) -> FloatArray:
    """Return the rows (T, N_COLUMNS) about a motion's reach after each of its postures.

    Raises:
        HumanModelError: a motion of another human, or one without the links that are followed.
    """
    return _followed(motion, human)[0]


def farthest_palm(motion: Motion, human: HumanModel) -> FloatArray:
    """Return where (3,) a motion's palm was farthest from its start; raises as `reach_so_far`."""
    farthest: FloatArray = _followed(motion, human)[1].reach.far[0].copy()
    return farthest


def _followed(motion: Motion, human: HumanModel) -> tuple[FloatArray, HandFollower]:
    human.check_dofs(motion.dof_names)
    points = np.ascontiguousarray(human.link_poses(motion.q)[:, point_links(human)][..., :3, 3])
    hand, rows = HandFollower(), np.empty((len(motion), N_COLUMNS))
    for k, t_s in enumerate(motion.t_s.tolist()):
        hand.observe(points[k], t_s)
        rows[k] = hand.row
    return rows, hand


def chosen_postures(n_frames: int, n: int) -> NDArray[np.intp]:
    """Return the numbers of `n` evenly spaced postures of a motion, the last one among them, the first not."""
    chosen: NDArray[np.intp] = np.round(np.linspace(0, n_frames - 1, n + 1)[1:]).astype(np.intp)
    return chosen
