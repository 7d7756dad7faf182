"""Cuts single reaches out of a person's stream of postures, to make a library of them, and labels them by their end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from humanpred_ros.errors import HumanPredError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.cleaning import DROP_REASONS, flag_library
from humanpred_ros.motion.motion import Motion, MotionLibrary, unwrap_angles
from humanpred_ros.recognition.onset import BodyPoints, OnsetDetector
from humanpred_ros.recognition.training import farthest_palm_m

#: A cut begins and ends this much outside the motion, s.
_MARGIN_S = 0.1
#: What is shorter, longer, or goes less far is no reach; own judgement, after P1's and P2's libraries.
_SHORTEST_S, _LONGEST_S, _LEAST_WAY_M, _LEAST_FRAMES = 0.3, 20.0, 0.1, 8
#: Ends of the hand closer than this are one place, where nobody says how many there are; and a told place is meant
#: within this.
_ONE_PLACE_M, _NEAR_M = 0.2, 0.3
#: Begins what is said of movements that are none: people shift and scratch between reaches.
NO_REACH = "no reach"
#: A place is reached for at least this often, as a share of the place reached for most.
_LEAST_SHARE = 0.25


class Cut(NamedTuple):
    """A movement that is over: a reach without a label, or why it is none."""

    motion: Motion | None
    refusal: str = ""


class ReachCutter:
    """Finds reaches in a stream of one person, from onset to rest; what the tracker lost or mistook is refused.

    Args:
        human: whose postures come.
    """

    def __init__(self, human: HumanModel) -> None:
        self.human = human
        self._points, self._detector = BodyPoints(human), OnsetDetector()
        self._frames: list[tuple[float, FloatArray]] = []

    @property
    def moving(self) -> bool:
        """Whether a movement is under way."""
        return self._detector.state is not None and self._detector.state.moving

    def update(self, q: FloatArray, t_s: float) -> Cut | None:
        """Take a posture (D,) stamped `t_s` and return the movement that is over with it, if one is.

        Raises:
            HumanPredError: a posture or a stamp that cannot be used; it is left out.
        """
        before, lost_s = self._detector.state, t_s - self._frames[-1][0] if self._frames else 0.0
        after = self._detector.update(self._points(q), t_s)
        self._frames.append((t_s, q))
        if after.moving:
            return None
        if before is None or not before.moving:
            keep_s = t_s - self._detector.settings.lookback_s - _MARGIN_S
            while self._frames[0][0] < keep_s:
                self._frames.pop(0)
            return None
        if lost_s > self._detector.settings.gap_s:
            self._frames = self._frames[-1:]
            return Cut(None, f"no frames for {lost_s:.1f} s on the way")
        begin, end = before.since_s - _MARGIN_S, after.since_s + _MARGIN_S
        mine = [frame for frame in self._frames if begin <= frame[0] <= end]
        return self._judged(mine, after.since_s - before.since_s)

    def _judged(self, frames: Sequence[tuple[float, FloatArray]], lasted_s: float) -> Cut:
        if not _SHORTEST_S <= lasted_s <= _LONGEST_S or len(frames) < _LEAST_FRAMES:
            return Cut(None, f"{NO_REACH}: moved for less than {_SHORTEST_S} or more than {_LONGEST_S:.0f} s")
        t_s = np.array([stamp for stamp, _ in frames])
        q = np.array([posture for _, posture in frames])
        try:
            motion = unwrap_angles(Motion(t_s - t_s[0], q, self.human.dof_names))
        except HumanPredError as error:
            return Cut(None, str(error))
        away_m = float(np.linalg.norm(farthest_palm_m(self.human, q) - farthest_palm_m(self.human, q[:1])))
        if away_m < _LEAST_WAY_M:
            return Cut(None, f"{NO_REACH}: the hand went less than {_LEAST_WAY_M} m")
        for flag in flag_library(MotionLibrary("cut", (motion,)), model=self.human):
            if flag.reason in ("jump", "wild", "gap"):
                return Cut(None, str(flag).partition(": ")[2])
        return Cut(motion)


def misplaced(reaches: Sequence[Motion], human: HumanModel) -> str:
    """Return why the last of labelled reaches is not like the others of its class; empty if it is."""
    if len(reaches) < 2:
        return ""
    found = flag_library(MotionLibrary("reaches", tuple(reaches)), model=human)
    mine = [flag for flag in found if flag.motion == reaches[-1].name and flag.reason in DROP_REASONS]
    return str(mine[0]).partition(": ")[2] if mine else ""


def ends_m(reaches: Sequence[Motion], human: HumanModel) -> FloatArray:
    """Return where the palm was farthest from its start, (N, 3)."""
    return np.array([farthest_palm_m(human, motion.q) for motion in reaches]).reshape(-1, 3)


def labels_by_place(ends: FloatArray, places: Mapping[str, FloatArray]) -> list[str | None]:
    """Return the label of the place nearest to each end (N, 3); None where none is within 0.3 m."""
    names, where = list(places), np.array(list(places.values()))
    distance = np.linalg.norm(ends[:, None] - where, axis=-1)
    return [names[k] if row[k] <= _NEAR_M else None for k, row in zip(distance.argmin(axis=1), distance, strict=True)]


def labels_by_cluster(ends: FloatArray, labels: Sequence[str]) -> list[str | None]:
    """Return labels of ends (N, 3) that lie together, in the order in which they are first reached for.

    With labels, as many places are looked for as there are labels: single ends elsewhere count as none (None).

    Args:
        ends: at least one.
        labels: of the places; where there are none, ends within 0.2 m are one place, and called `place 1` and on.
    """
    if len(ends) < 2:
        return [labels[0] if labels else "place 1"] * len(ends)
    tree, n = linkage(ends, "average"), len(labels)
    found = fcluster(tree, _ONE_PLACE_M, "distance")
    for parts in range(n, len(ends) + 1) if labels else ():
        found = fcluster(tree, parts, "maxclust")
        sizes = np.sort(np.bincount(found))[::-1]
        if sizes[n - 1] >= _LEAST_SHARE * sizes[0]:
            break
    else:
        found = fcluster(tree, n, "maxclust") if labels else found
    counts = np.bincount(found)
    kept = set(np.argsort(-counts, kind="stable")[: n or len(counts)].tolist())
    order = [cluster for cluster in dict.fromkeys(found.tolist()) if cluster in kept]
    names = [*labels] or [f"place {k + 1}" for k in range(len(order))]
    return [names[order.index(cluster)] if cluster in kept else None for cluster in found.tolist()]
