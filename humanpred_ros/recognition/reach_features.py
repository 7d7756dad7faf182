"""What a reach looks like while it is under way, in numbers that know neither its duration nor its speed.

People slow down, speed up and hesitate, so nothing here is measured in seconds or frames. Each posture gives

- where palm, elbow, shoulder and neck are,
- where they were when the palm was farthest from where it started (on the way back, the goal is behind),
- which way palm, elbow and neck are heading, each over a few lengths of travel: a point dragged on a rope of that
  length says from where it comes, whatever time that took, and does not move while noise is shorter than the rope,
- how far the palm is, and was at most, from its start.

Shoulder and neck are there because people lean towards their goal, also when the tracker has lost the arm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.compiled import exact, exact_part
from humanpred_ros.human.model import HumanModel

Float32Array = NDArray[np.float32]

#: Links followed, in the order of the features; the palm first.
POINTS = ("right_palm", "right_elbow", "right_shoulder", "neck")
#: (number of the point, length in metres) of each rope. From where noise ends to half a reach.
ROPES = ((0, 0.02), (0, 0.05), (0, 0.15), (0, 0.30), (1, 0.02), (1, 0.06), (3, 0.02))
#: The start is the median of so many first postures; fewer while there are fewer.
N_START = 5

_N_POINTS = len(POINTS)
#: Columns: positions now, positions at the farthest point, headings, and three distances.
FAR, HEADINGS, DISTANCES = 3 * _N_POINTS, 6 * _N_POINTS, 6 * _N_POINTS + 3 * len(ROPES)
N_FEATURES = DISTANCES + 3
#: The column that says how far the palm has been from its start, metres.
REACHED = DISTANCES + 1

_ROPE_POINT = np.array([point for point, _ in ROPES])
_ROPE_LENGTH_M = np.array([length for _, length in ROPES])


class ReachState(NamedTuple):
    """What is remembered of the reach under way: a fixed amount, however long it lasts. Metres, tracker's frame."""

    n_seen: NDArray[np.int64]  # (1,)
    recent: FloatArray  # (2, P, 3) the last two postures' points
    first: FloatArray  # (N_START, P, 3)
    start: FloatArray  # (3,) palm
    far: FloatArray  # (P, 3) points when the palm was farthest from its start
    reached_m: FloatArray  # (1,) how far that was
    anchors: FloatArray  # (R, 3) loose ends of the ropes

    @classmethod
    def fresh(cls) -> ReachState:
        """Return the state before the first posture."""
        return cls(
            np.zeros(1, dtype=np.int64),
            np.zeros((2, _N_POINTS, 3)),
            np.zeros((N_START, _N_POINTS, 3)),
            np.zeros(3),
            np.zeros((_N_POINTS, 3)),
            np.zeros(1),
            np.zeros((len(ROPES), 3)),
        )


def point_links(human: HumanModel) -> NDArray[np.int64]:
    """Return the link numbers of `POINTS` (HumanModelError if the human lacks one)."""
    missing = [name for name in POINTS if name not in human.link_names]
    if missing:
        raise HumanModelError(
            f"human model {human.name}: wanted links named {', '.join(POINTS)}, "
            f"{', '.join(missing)} missing; name them so"
        )
    return np.array([human.link_names.index(name) for name in POINTS])


def motion_features(points_m: FloatArray) -> FloatArray:
    """Return (T, N_FEATURES) after each of a motion's postures, from the points (T, P, 3) on it.

    The same numbers as posture by posture: it is the same code.
    """
    state = ReachState.fresh()
    features = np.empty((len(points_m), N_FEATURES))
    for points, row in zip(np.ascontiguousarray(points_m), features, strict=True):
        advance(state, points, row)
    return features


@exact
def in_library_frame(features: FloatArray, R: FloatArray, p: FloatArray) -> Float32Array:
    """Return features (M, N_FEATURES) moved rigidly: positions by rotation and translation, headings by rotation."""
    moved = np.empty(features.shape, dtype=np.float32)
    for m in range(len(features)):
        for i in range(0, DISTANCES, 3):
            for a in range(3):
                value = R[a, 0] * features[m, i] + R[a, 1] * features[m, i + 1] + R[a, 2] * features[m, i + 2]
                moved[m, i + a] = value + p[a] if i < HEADINGS else value
        for i in range(DISTANCES, features.shape[1]):
            moved[m, i] = features[m, i]
    return moved


@exact
def advance(state: ReachState, points: FloatArray, features: FloatArray) -> None:
    """Take the points (P, 3) of one posture: changes `state` in place and fills `features` (N_FEATURES,)."""
    n = state.n_seen[0]
    if n == 0:
        for i in range(_N_POINTS):
            for a in range(3):
                state.recent[0, i, a] = state.recent[1, i, a] = points[i, a]
        for r in range(len(_ROPE_POINT)):
            for a in range(3):
                state.anchors[r, a] = points[_ROPE_POINT[r], a]
    # The median of three forgives a tracker one wild posture.
    now = np.empty((_N_POINTS, 3))
    for i in range(_N_POINTS):
        for a in range(3):
            x, y, z = points[i, a], state.recent[0, i, a], state.recent[1, i, a]
            now[i, a] = max(min(x, y), min(max(x, y), z))
            state.recent[1, i, a], state.recent[0, i, a] = y, x
            if n < N_START:
                state.first[n, i, a] = x
    if n < N_START:
        for a in range(3):
            state.start[a] = _median(state.first, n + 1, a)
    state.n_seen[0] = n + 1

    x, y, z = now[0, 0] - state.start[0], now[0, 1] - state.start[1], now[0, 2] - state.start[2]
    d = np.sqrt(x * x + y * y + z * z)
    farther = n == 0 or d >= state.reached_m[0]
    if farther:
        state.reached_m[0] = d
    for i in range(_N_POINTS):
        for a in range(3):
            if farther:
                state.far[i, a] = now[i, a]
            features[3 * i + a] = now[i, a]
            features[FAR + 3 * i + a] = state.far[i, a]
    for r in range(len(_ROPE_POINT)):
        k = _ROPE_POINT[r]
        x, y, z = now[k, 0] - state.anchors[r, 0], now[k, 1] - state.anchors[r, 1], now[k, 2] - state.anchors[r, 2]
        length = np.sqrt(x * x + y * y + z * z)
        if length > _ROPE_LENGTH_M[r]:
            share = 1.0 - _ROPE_LENGTH_M[r] / length
            state.anchors[r, 0] += x * share
            state.anchors[r, 1] += y * share
            state.anchors[r, 2] += z * share
        for a in range(3):
            features[HEADINGS + 3 * r + a] = (now[k, a] - state.anchors[r, a]) / _ROPE_LENGTH_M[r]
    features[DISTANCES] = d
    features[DISTANCES + 1] = state.reached_m[0]
    # Two centimetres: before the reach has begun, the share of the way back means nothing.
    features[DISTANCES + 2] = d / (state.reached_m[0] + 0.02)


@exact_part
def _median(first: FloatArray, n: int, a: int) -> float:
    """Return the median of coordinate `a` of the palm in the first `n` postures."""
    ordered = np.empty(N_START)
    for k in range(n):
        value, place = first[k, 0, a], k
        while place > 0 and ordered[place - 1] > value:
            ordered[place] = ordered[place - 1]
            place -= 1
        ordered[place] = value
    middle: float = ordered[n // 2] if n % 2 else (ordered[n // 2 - 1] + ordered[n // 2]) / 2
    return middle
