"""How much more costly is the reach so far than the best one to a given place? Told apart by kinds of cost.

P2 explains a reach by a cost that it keeps low. Then a place is improbable as far as the reach would have been cheaper
had it been the goal, which is what makes a motion tell its goal (Dragan and Srinivasa 2013 call it legible). The
reaches of P2's cost are smooth and nearly straight, so what a reach wastes on the way to a place can be read off the
hand without planning a single one:

- detour: how much longer the way by here is than the straight one,
- aside: how far the hand is beside the straight way,
- beyond: how far it is past the place,
- heading over 5 and over 15 cm: how far it points elsewhere; less and less so the nearer the place,
- stopping: how far from the place it slows down, or has turned back,
- body: how far palm, elbow, shoulder and neck are, all in all, from the whole body's best reach (`best_reaches`).

Everything is measured on the tracker's points, relative to the reach's own start and its fastest moment so far; where
the room is, how it is turned and how fast a person moves leaves no trace, up to how a sensor samples it.
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
from humanpred_ros.reaching.best_reaches import distances_from
from humanpred_ros.reaching.hand_outliers import ANEW, FOUND, LEFT_OUT, Belief, judged
from humanpred_ros.recognition.reach_features import (
    FAR,
    HEADINGS,
    N_FEATURES,
    REACHED,
    ReachState,
    advance,
    point_links,
)

#: The parts of the excess cost. All are metres but the headings, which have no unit.
PARTS = ("detour", "aside", "beyond", "heading_5cm", "heading_15cm", "stopping", "body")
N_PARTS = len(PARTS)
BODY = PARTS.index("body")
#: Beyond this, far off is far off, metres: a lost arm must not outvote all that was seen before.
MOST_M = 0.3

#: Columns of what is known of the reach so far: palm, elbow, shoulder and neck now (once the palm has turned back: when
#: it was farthest), the palm at its start, headings, how far it has been from the start, and how far it has arrived,
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


class HandState(NamedTuple):
    """What is remembered of the reach under way: a fixed amount, however long it lasts."""

    belief: Belief
    before: FloatArray  # (2, P, 3) points of the last two postures, believed or not
    reach: ReachState
    features: FloatArray  # (N_FEATURES,) of `reach_features`
    palm: FloatArray  # (3,) in the last posture believed, a lost frame forgiven
    velocity: FloatArray  # (3,) averaged, m/s
    peak_m_s: FloatArray  # (1,) the highest speed so far
    last_s: FloatArray  # (1,) stamp of the last posture believed

    @classmethod
    def fresh(cls) -> HandState:
        """Return the state before the first posture."""
        reach, features = ReachState.fresh(), np.zeros(N_FEATURES)
        before = np.zeros_like(reach.recent)
        return cls(Belief.fresh(), before, reach, features, np.zeros(3), np.zeros(3), np.zeros(1), np.zeros(1))


@exact
def observe(state: HandState, points: FloatArray, t_s: float, row: FloatArray) -> int:
    """Take the points (P, 3) of one posture: changes `state` in place and fills `row` (N_COLUMNS,).

    Returns what `believing` concludes: a posture LEFT_OUT leaves the row as it was; with ANEW the reach begins here.

    Args:
        state: of the reach so far.
        points: where the links of `reach_features.POINTS` are, tracker's frame.
        t_s: stamp, later than the one before.
        row: what is known of the reach so far; the same array with every posture of a reach.
    """
    conclusion = judged(state.belief, points[0], t_s, state.reach.reached_m[0] > _BEGUN_M)
    if conclusion == FOUND:
        # The median of three is then of postures since the loss.
        for i in range(len(points)):
            for a in range(3):
                state.reach.recent[0, i, a], state.reach.recent[1, i, a] = state.before[0, i, a], state.before[1, i, a]
    for i in range(len(points)):
        for a in range(3):
            state.before[1, i, a], state.before[0, i, a] = state.before[0, i, a], points[i, a]
    if conclusion == LEFT_OUT:
        return conclusion
    if conclusion == ANEW:
        state.reach.n_seen[0] = 0
        for a in range(3):
            state.velocity[a] = 0.0
        state.peak_m_s[0] = 0.0
    first = state.reach.n_seen[0] == 0
    features = state.features
    advance(state.reach, points, features)
    if not first and conclusion != FOUND:
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
        # A hand that has stopped heads nowhere, and one on its way back away from its goal.
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
                to_goal = places[g, a] - row[HAND + a]
                from_start = row[HAND + a] - row[START + a]
                whole = places[g, a] - row[START + a]
                ahead += to_goal * to_goal
                gone += from_start * from_start
                straight += whole * whole
                along += from_start * whole
                short += row[SHORT + a] * to_goal
                long += row[LONG + a] * to_goal
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


def reach_so_far(motion: Motion, human: HumanModel) -> FloatArray:
    """Return (T, N_COLUMNS) what is known of a motion's reach after each of its postures.

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
