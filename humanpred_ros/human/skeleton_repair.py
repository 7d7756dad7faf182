"""Mends the points of one person, frame by frame: exchanged sides, limbs that change their length, missing points.

Points are (18, 3) in the order of `skeletons.POINTS`, in metres, z up, NaN where lost. What is bridged follows from the
points that were seen and from proportions: the person's own where they were learned, else those of P1's human. Elbows
and hands are never bridged, except a hand from the wrist beside it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.kinect import LINK_OF_POINT
from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.skeletons import POINTS

AT = {name: i for i, name in enumerate(POINTS)}
#: Points that a tracker exchanges together.
_PAIRS = (("shoulder",), ("elbow", "wrist", "hand"), ("hip",), ("knee", "foot"))
#: Limbs whose lengths are learned, outwards: each ends where the next one begins.
_LIMBS = (("shoulder", "elbow"), ("elbow", "hand"))
_SIDES = ("left", "right")
#: Sides are exchanged where that brings points nearer to where they were by this share, and by so much on average, m.
_NEARER, _NEARER_M = 0.5, 0.06
#: Points that were seen so long ago say nothing of sides, s.
_RECENT_S = 0.3
#: From so many frames on a limb has a length; one that differs from it by more than this share ends at a wrong point.
_FRAMES, _STRANGE = 10, 0.4


def _sides(parts: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Return the places of points on both sides, and those of the same points on the other side."""
    left, right = ([AT[f"{side}_{part}"] for part in parts if f"{side}_{part}" in AT] for side in _SIDES)
    return left + right, right + left


class SkeletonRepair:
    """What is known of one person, and what follows from it for the next frame.

    Attributes:
        lengths_m: learned so far, by side and limb.
    """

    def __init__(self, model: HumanModel, learn_s: float, swap_s: float) -> None:
        """Take P1's human, for how long lengths are learned, and how long exchanged sides are mended."""
        zero = model.forward(np.zeros(len(model.dof_names)))
        at = {point: zero[link] for point, link in LINK_OF_POINT.items()}
        hips, shoulders = 0.5 * (at["left_hip"] + at["right_hip"]), 0.5 * (at["left_shoulder"] + at["right_shoulder"])
        self._trunk_m = float(at["neck"][2] - hips[2])
        self._shoulders_below_neck = float(at["neck"][2] - shoulders[2]) / self._trunk_m
        self._torso_share = float(at["torso"][2] - hips[2]) / self._trunk_m
        self._pelvis_share = float(zero["pelvis"][2] - hips[2]) / self._trunk_m
        self._hip_m = 0.5 * float(np.linalg.norm(at["left_hip"] - at["right_hip"]))
        forearm = float(np.linalg.norm(zero["right_palm"] - zero["right_elbow"]))
        self._palm_share = forearm / float(np.linalg.norm(zero["right_wrist"] - zero["right_elbow"]))
        self._learn_s, self._swap_s = learn_s, swap_s
        self.forget()

    def forget(self) -> None:
        """Begin with another person."""
        self.lengths_m: dict[tuple[str, str], float] = {}
        self._measured: dict[tuple[str, str], list[float]] = {}
        self._first_s: float | None = None
        #: Where each point was seen last, and when.
        self._last, self._last_s = np.full((len(POINTS), 3), np.nan), np.full(len(POINTS), -np.inf)
        self._swapped_since_s = np.inf

    def unswapped(self, points: FloatArray, t_s: float) -> tuple[FloatArray, tuple[str, ...]]:
        """Return points with left and right as they were before, and the parts that were exchanged.

        After `swap_s` of exchanging, the tracker is believed.
        """
        recent = self._last_s >= t_s - _RECENT_S
        swapped = []
        step = points - self._last
        if (np.nan_to_num((step * step).sum(axis=1)) > _NEARER_M**2).any():  # else no exchange brings them that nearer
            swapped = [parts for parts in _PAIRS if self._is_swapped(points, parts, recent)]
        self._swapped_since_s = min(self._swapped_since_s, t_s) if swapped else np.inf
        if t_s - self._swapped_since_s > self._swap_s:
            swapped, self._swapped_since_s = [], np.inf
        points = points.copy()
        for parts in swapped:
            own, other = _sides(parts)
            points[own] = points[other]
        seen = ~np.isnan(points[:, 0])
        self._last[seen], self._last_s[seen] = points[seen], t_s
        return points, tuple(parts[0] for parts in swapped)

    def _is_swapped(self, points: FloatArray, parts: tuple[str, ...], recent: NDArray[np.bool_]) -> bool:
        own, other = _sides(parts)
        known = ~np.isnan(points[own, 0]) & recent[own] & recent[other]
        if not known.any():
            return False
        keep, swap = (np.linalg.norm(points[own] - self._last[which], axis=1)[known].mean() for which in (own, other))
        return bool(swap < _NEARER * keep and keep - swap > _NEARER_M)

    def held_lengths(self, points: FloatArray, t_s: float) -> FloatArray:
        """Return points with arms of the learned lengths; the end of one that is far off counts as lost."""
        points = points.copy()
        self._first_s = t_s if self._first_s is None else self._first_s
        learning = t_s - self._first_s <= self._learn_s
        for side in _SIDES:
            shift = np.zeros(3)
            for begin, end in _LIMBS:
                a, b = AT[f"{side}_{begin}"], AT[f"{side}_{end}"]
                limb = points[b] + shift - points[a]
                length = float(np.sqrt(limb @ limb))
                points[b] += shift
                if not length > 0.0:  # lost
                    shift = np.zeros(3)
                    continue
                usual = self._usual((side, begin), length, learning)
                if abs(length / usual - 1.0) > _STRANGE:
                    points[b], shift = np.nan, np.zeros(3)
                    continue
                change = limb * (usual / length - 1.0)
                points[b] += change
                shift = shift + change
        return points

    def _usual(self, limb: tuple[str, str], length: float, learning: bool) -> float:
        measured = self._measured.setdefault(limb, [])
        if learning or len(measured) < _FRAMES:
            measured.append(length)
            if len(measured) < _FRAMES:
                return length
            self.lengths_m[limb] = float(np.median(measured))
        return self.lengths_m[limb]

    def bridged(self, points: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """Return points with those added that follow from others, and the names of these."""
        before = np.isnan(points[:, 0])
        points = points.copy()

        def at(name: str) -> FloatArray:
            place: FloatArray = points[AT[name]]
            return place

        def middle(part: str) -> FloatArray:
            return 0.5 * (at(f"left_{part}") + at(f"right_{part}"))

        def put(name: str, place: FloatArray) -> None:
            if np.isnan(points[AT[name], 0]):
                points[AT[name]] = place

        for side in _SIDES:
            elbow = at(f"{side}_elbow")
            put(f"{side}_hand", elbow + self._palm_share * (at(f"{side}_wrist") - elbow))
        across = at("left_shoulder") - at("right_shoulder")
        across = across * (1.0, 1.0, 0.0)
        across = across / max(float(np.sqrt(across @ across)), 1e-9)
        hips = self._hips(at, middle("hip"), middle("shoulder"), across)
        below = self._shoulders_below_neck
        if np.isnan(at("neck")[0]):
            put("neck", hips + (middle("shoulder") - hips) / (1.0 - below))
        neck = at("neck")
        between = neck + below * (hips - neck)
        put("left_shoulder", 2.0 * between - at("right_shoulder"))
        put("right_shoulder", 2.0 * between - at("left_shoulder"))
        if np.isnan(across[0]):
            across = (at("left_shoulder") - at("right_shoulder")) * (1.0, 1.0, 0.0)
            across = across / max(float(np.sqrt(across @ across)), 1e-9)
        put("left_hip", hips + self._hip_m * across)
        put("right_hip", 2.0 * hips - at("left_hip"))
        put("torso", hips + self._torso_share * (neck - hips))
        new = before & ~np.isnan(points[:, 0])
        return points, tuple(name for name in LINK_OF_POINT if new[AT[name]])

    def _hips(
        self, at: Callable[[str], FloatArray], hips: FloatArray, shoulders: FloatArray, across: FloatArray
    ) -> FloatArray:
        """Return the middle of the hips: seen, or from one of them, pelvis, torso, or last the shoulders above."""
        top, share_of_top = (at("neck"), 1.0) if not np.isnan(at("neck")[0]) else (
            shoulders, 1.0 - self._shoulders_below_neck)  # fmt: skip

        def along(low: FloatArray, share: float) -> FloatArray:
            """Return the foot of a line on which `low` is this share of the way up to the neck."""
            found: FloatArray = low - share / (share_of_top - share) * (top - low)
            return found

        # Behind a table the trunk hangs below the shoulders.
        upright: FloatArray = top - np.array([0.0, 0.0, self._trunk_m * share_of_top])
        for found in (
            hips,
            at("left_hip") - self._hip_m * across,
            at("right_hip") + self._hip_m * across,
            along(at("pelvis"), self._pelvis_share),
            along(at("torso"), self._torso_share),
        ):
            if not np.isnan(found[0]):
                return found
        return upright
