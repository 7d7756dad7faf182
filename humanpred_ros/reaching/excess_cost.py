"""By how much does the reach so far cost more than the best reach to a given place, by kinds of cost?

P2 explains a reach by a cost that it keeps low. Then a place is improbable if the reach would have been much cheaper
with that place as its end, which is what makes a motion legible (Dragan and Srinivasa 2013). The reaches of P2's cost
are
smooth and nearly straight, so what a reach spends in excess can be measured on the hand, without planning:

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

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.reaching.end_postures import EndPostures
from humanpred_ros.reaching.hand_outliers import OUTLIER, RECOVERED, RESTARTED, HandHistory, judge
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


class HandState(NamedTuple):
    """What is remembered of the reach under way: a fixed amount, however long it lasts."""

    history: HandHistory
    before: FloatArray  # (2, P, 3) points of the last two postures, outliers or not
    reach: ReachState
    features: FloatArray  # (N_FEATURES,) of `reach_features`
    palm: FloatArray  # (3,) in the last posture accepted, a single lost frame ignored
    velocity: FloatArray  # (3,) averaged, m/s
    peak_m_s: FloatArray  # (1,) the highest speed so far
    last_s: FloatArray  # (1,) stamp of the last posture accepted

    @classmethod
    def fresh(cls) -> HandState:
        """Return the state before the first posture."""
        reach, features = ReachState.fresh(), np.zeros(N_FEATURES)
        before = np.zeros_like(reach.recent)
        return cls(HandHistory.fresh(), before, reach, features, np.zeros(3), np.zeros(3), np.zeros(1), np.zeros(1))


@exact
def observe(state: HandState, points: FloatArray, t_s: float, row: FloatArray) -> int:
    """Take the points (P, 3) of one posture: changes `state` in place and fills `row` (N_COLUMNS,).

    Returns what `hand_outliers.judge` concludes: an OUTLIER leaves the row as it was; with RESTARTED the reach begins
    here.

    Args:
        state: of the reach so far.
        points: where the links of `reach_features.POINTS` are, tracker's frame.
        t_s: stamp, later than the one before.
        row: about the reach so far; the same array with every posture of a reach.
    """
    conclusion = judge(state.history, points[0], t_s, state.reach.reached_m[0] > _BEGUN_M)
    if conclusion == RECOVERED:
        # The median of three is then of postures since the loss.
        for i in range(len(points)):
            for a in range(3):
                state.reach.recent[0, i, a], state.reach.recent[1, i, a] = state.before[0, i, a], state.before[1, i, a]
    for i in range(len(points)):
        for a in range(3):
            state.before[1, i, a], state.before[0, i, a] = state.before[0, i, a], points[i, a]
    if conclusion == OUTLIER:
        return conclusion
    if conclusion == RESTARTED:
        state.reach.n_seen[0] = 0
        for a in range(3):
            state.velocity[a] = 0.0
        state.peak_m_s[0] = 0.0
    first = state.reach.n_seen[0] == 0
    features = state.features
    advance(state.reach, points, features)
    if not first and conclusion != RECOVERED:
        step_s = t_s - state.last_s[0]
        share = 1.0 - np.exp(-step_s / _VELOCITY_S)
        for a in range(3):
            state.velocity[a] += share * ((features[a] - state.palm[a]) / step_s - state.velocity[a])
    for a in range(3):
        state.palm[a] = features[a]
    state.last_s[0] = t_s
    vx, vy, vz = state.velocity[0], state.velocity[1], state.velocity[2]
    speed = np.sqrt(vx * vx + vy * vy + vz * vz)
    state.peak_m_s[0] = max(state.peak_m_s[0], speed)

    reached = features[REACHED]
    back = (reached - features[REACHED - 1] - _TURNED_M[0]) / (_TURNED_M[1] - _TURNED_M[0])
    back = min(max(back, 0.0), 1.0)
    slow = 0.0
    if reached > _BEGUN_M:
        slow = max(0.0, 1.0 - speed / max(state.peak_m_s[0], _LEAST_PEAK_M_S))
    arrived = max(slow, back)
    for i in range(START):
        row[HAND + i] = features[i] + back * (features[FAR + i] - features[i])
    for a in range(3):
        row[START + a] = state.reach.start[a]
        # A hand that has stopped has no heading, and one on its way back heads away from its place.
        row[SHORT + a] = (1.0 - arrived) * features[HEADINGS + 3 * _SHORT_ROPE + a]
        row[LONG + a] = (1.0 - arrived) * features[HEADINGS + 3 * _LONG_ROPE + a]
    row[REACHED_M] = reached
    row[ARRIVED] = arrived
    return conclusion


@exact
def _excess(rows: FloatArray, places: FloatArray) -> FloatArray:
    out = np.zeros((len(rows), len(places), N_PARTS))
    for n in range(len(rows)):
        row = rows[n]
        for g in range(len(places)):
            way = straight = ahead = gone = along = short = long = short_size = long_size = 0.0
            for a in range(3):
                to_place = places[g, a] - row[HAND + a]
                from_start = row[HAND + a] - row[START + a]
                whole = places[g, a] - row[START + a]
                ahead += to_place * to_place
                gone += from_start * from_start
                straight += whole * whole
                along += from_start * whole
                short += row[SHORT + a] * to_place
                long += row[LONG + a] * to_place
                short_size += row[SHORT + a] ** 2
                long_size += row[LONG + a] ** 2
            ahead, straight = np.sqrt(ahead), np.sqrt(straight)
            way = np.sqrt(gone) + ahead - straight
            # A place at the start has no way to be beside of.
            along = along / straight if straight > 1e-9 else 0.0
            near = 1.0 / (ahead + _NEAR_M)
            out[n, g, 0] = min(max(way, 0.0), MOST_M)
            out[n, g, 1] = min(np.sqrt(max(gone - along * along, 0.0)), MOST_M)
            out[n, g, 2] = min(max(along - straight, 0.0), MOST_M)
            out[n, g, 3] = max(np.sqrt(short_size) * ahead - short, 0.0) * near
            out[n, g, 4] = max(np.sqrt(long_size) * ahead - long, 0.0) * near
            out[n, g, 5] = min(ahead, MOST_M) * row[ARRIVED]
    return out


def excess_costs(rows: FloatArray, places_m: FloatArray, best: Sequence[FloatArray] | None = None) -> FloatArray:
    """Return by how much reaches so far cost more than the best to each place.

    Args:
        rows: (N, N_COLUMNS) of reaches that start in the same posture.
        places_m: (G, 3), tracker's frame.
        best: the best reach to each (`best_reaches`); None if they are not known, then "body" is 0.

    Returns:
        (N, G, N_PARTS), none negative; all zero before the hand has moved.
    """
    rows = np.ascontiguousarray(rows)
    costs = _excess(rows, np.ascontiguousarray(places_m))
    if best is not None:
        points = np.ascontiguousarray(rows[:, :START])
        for g, path in enumerate(best):
            costs[:, g, BODY] = np.minimum(distances_from(path, points), MOST_M)
    return costs


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


@exact
def distances_from(path: FloatArray, points: FloatArray) -> FloatArray:
    """Return the distances (N,), summed over four points (N, 12), from the nearest moment of a path (K, 12), metres."""
    out = np.empty(len(points))
    for n in range(len(points)):
        nearest, found = np.inf, 0.0
        for k in range(len(path) - 1):
            size = ahead = 0.0
            for i in range(3 * _N_POINTS):
                step = path[k + 1, i] - path[k, i]
                size += step * step
                ahead += step * (points[n, i] - path[k, i])
            share = min(max(ahead / size, 0.0), 1.0) if size > 0.0 else 0.0
            squares = total = 0.0
            for p in range(_N_POINTS):
                square = 0.0
                for i in range(3 * p, 3 * p + 3):
                    away = points[n, i] - path[k, i] - share * (path[k + 1, i] - path[k, i])
                    square += away * away
                squares += square
                total += np.sqrt(square)
            if squares < nearest:
                nearest, found = squares, total
        out[n] = found
    return out


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


def _followed(motion: Motion, human: HumanModel) -> tuple[FloatArray, HandState]:
    human.check_dofs(motion.dof_names)
    points = np.ascontiguousarray(human.link_poses(motion.q)[:, point_links(human)][..., :3, 3])
    state, rows, row = HandState.fresh(), np.empty((len(motion), N_COLUMNS)), np.zeros(N_COLUMNS)
    for k, (posture, t_s) in enumerate(zip(points, motion.t_s.tolist(), strict=True)):
        observe(state, posture, t_s, row)
        rows[k] = row
    return rows, state


def chosen_postures(n_frames: int, n: int) -> NDArray[np.intp]:
    """Return the numbers of `n` evenly spaced postures of a motion, the last one among them, the first not."""
    chosen: NDArray[np.intp] = np.round(np.linspace(0, n_frames - 1, n + 1)[1:]).astype(np.intp)
    return chosen
