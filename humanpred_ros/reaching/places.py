"""Places a hand may go to, each known by a label, and where the motions of a library ended.

A place is a point in the tracker's frame. It comes from a parameter, from a scene, or from a library: where the motions
of a class have their farthest palm. People hit a place within a few centimetres, and trackers lose arms, so a class's
place is a median, and motions that are mistracked or mislabelled are not counted.

A person also reaches for what no list has. Such a reach goes somewhere, most likely to where people's hands go at all
as seen from the body, which the library shows. A set of unlisted places stands for all of these. What speaks for a
listed place, that the motion so far is a good way to it, speaks for them in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import ArrayError, HumanPredError, LibraryFormatError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.cleaning import DROP_REASONS, flag_library
from humanpred_ros.motion.labels import checked_label, label_order
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.reaching.end_postures import EndPostures, standing
from humanpred_ros.reaching.excess_cost import farthest_palm
from humanpred_ros.recognition.reach_features import POINTS, point_links

#: How much farther than the length of the arm people get by leaning, turning and stepping, metres. In both of P1's
#: libraries no place is more than 0.63 m farther from the shoulder at the start than the arm is long.
LEAN_M = 0.7
_RIGID_TOLERANCE = 1e-6
#: No room is larger.
_FARTHEST_M = 1000.0
#: Number of unlisted places of each kind, drawn evenly: where people reach most they are less than 0.1 m apart.
N_PLACES = 512
#: Factor on the variance of the reaches seen: people also reach beyond the places that a library shows.
_WIDER = 2.0
#: Least standard deviation, metres: reaches to one place only, or all at one height, say little about others.
_LEAST_M = 0.05
#: Standard deviation in each direction about the shoulder before anything is learned, metres.
_UNLEARNED_M = 0.5
#: After that, one in this many reaches still goes anywhere: to a shelf above the only table seen, or to a fallen tool.
_ANYWHERE = 8
#: The R3 sequence, a golden ratio in three dimensions: its multiples, less whole numbers, fill the unit cube evenly.
_RATIO = 1.0 / 1.22074408460575947536 ** np.arange(1, 4)


@dataclass(frozen=True, eq=False)
class Places:
    """Places of the palm that a person may reach for: immutable.

    Raises:
        UsageError: no place, a label given twice, or numbers that no room has.
        ArrayError: wrong shape, or places that are not finite.
    """

    labels: tuple[str, ...]  #: G different labels, as those of a library's classes
    places_m: FloatArray  #: (G, 3) where the palm goes, tracker's frame

    def __post_init__(self) -> None:
        labels = tuple(checked_label(label, UsageError) for label in self.labels)
        if not labels:
            raise UsageError("places: wanted at least one, got none; give places, or do not infer them")
        twice = sorted({label for label in labels if labels.count(label) > 1})
        if twice:
            raise UsageError(
                f"places: wanted every label once, got {', '.join(map(str, twice))} more often; "
                "name each place differently"
            )
        places = checked("places", self.places_m, (len(labels), 3))
        for label, place in zip(labels, places, strict=True):
            if np.abs(place).max() > _FARTHEST_M:
                raise UsageError(
                    f"places: wanted places within {_FARTHEST_M:g} m, got {label} at {place.tolist()}; check the units"
                )
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "places_m", frozen(places))

    @classmethod
    def of(cls, places: Mapping[str, ArrayLike]) -> Places:
        """Return places given as (3,) by label."""
        return cls(tuple(places), np.array(list(places.values()), dtype=np.float64))

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def by_label(self) -> dict[str, FloatArray]:
        """(3,) places by label."""
        return dict(zip(self.labels, self.places_m, strict=True))

    def moved(self, T: ArrayLike) -> Places:
        """Return them moved by a rigid transform (4, 4), as into another frame (ArrayError if it is not rigid)."""
        T = checked("transform of places", T, (4, 4))
        R = T[:3, :3]
        rigid = np.abs(R @ R.T - np.eye(3)).max() < _RIGID_TOLERANCE and np.linalg.det(R) > 0
        if not rigid or (T[3] != (0.0, 0.0, 0.0, 1.0)).any():
            raise ArrayError(f"transform of places: wanted a rotation and a translation, got {T.tolist()}")
        return Places(self.labels, self.places_m @ R.T + T[:3, 3])

    def out_of_reach(self, human: HumanModel, q: ArrayLike) -> dict[str, str]:
        """Return the places that a person in posture (D,) cannot get to, by label, with a sentence about each.

        People get farther than the length of the arm by `LEAN_M`.

        Raises:
            HumanModelError: a posture of another human, or one without a right arm.
        """
        palm, elbow, shoulder = human.link_poses(q)[point_links(human)[:3]][..., :3, 3]
        limit_m = float(np.linalg.norm(palm - elbow) + np.linalg.norm(elbow - shoulder)) + LEAN_M
        distances = np.linalg.norm(self.places_m - shoulder, axis=1).tolist()
        return {
            label: f"place {label} is {distance:.2f} m from the right shoulder, out of reach: this person gets "
            f"{limit_m:.2f} m far; check the place and the frame it is in"
            for label, distance in zip(self.labels, distances, strict=True)
            if distance > limit_m
        }

    @classmethod
    def of_ends(cls, ends: Sequence[ReachEnd], *, without_motion: str | None = None) -> Places:
        """Return one place for each label among ends of reaches: the typical one.

        Args:
            ends: of a library's motions (`reach_ends`); those without a label are not counted.
            without_motion: a motion (`class/index`) that is not counted, as one that is to be tested.

        Raises:
            LibraryFormatError: no labelled motions, or a class whose only motion is left out.
        """
        labels = sorted({end.label for end in ends if end.label is not None}, key=label_order)
        if not labels:
            raise LibraryFormatError("places: wanted motions with a label, got none; label them or give places")
        by_label = {c: [end for end in ends if end.label == c and end.name != without_motion] for c in labels}
        for label, found in by_label.items():
            if not found:
                raise LibraryFormatError(
                    f"places: wanted a motion that shows where place {label} is, got only {without_motion}, which "
                    "is left out; record more or give the place"
                )
        return cls(tuple(labels), np.array([typical_end(found) for found in by_label.values()]))


def places_from_text(entries: Sequence[str], T_world_human: FloatArray) -> Places | None:
    """Return the places of entries `label x y z` (metres in the world frame); None if there are none.

    Empty entries are ignored: ROS has no empty list of texts.

    Args:
        entries: any number.
        T_world_human: (4, 4) from the tracker's frame to the world; the result is in the tracker's.

    Raises:
        UsageError: an entry that is something else, or a label used twice.
    """
    found = [_read(entry) for entry in entries if entry.strip()]
    labels = tuple(label for label, _ in found)
    return (
        Places(labels, np.array([place for _, place in found])).moved(np.linalg.inv(T_world_human)) if found else None
    )


def places_in_world(places: Mapping[str, ArrayLike], T_world_human: FloatArray) -> Places | None:
    """Return places (3,) by label in the world frame, as a scene gives them, in the tracker's; None if there are none.

    Raises:
        UsageError: places that cannot be.
    """
    if not places:
        return None
    try:
        return Places.of(places).moved(np.linalg.inv(T_world_human))
    except HumanPredError as trouble:
        raise UsageError(str(trouble)) from trouble


def _read(entry: str) -> tuple[str, FloatArray]:
    try:
        label, *place = entry.strip().rsplit(maxsplit=3)
        x, y, z = (float(number) for number in place)
        # Python reads 1_0 as 10, which is more likely a typing error.
        if any("_" in number for number in place) or not all(map(math.isfinite, (x, y, z))):
            raise ValueError
        return label, np.array([x, y, z])
    except ValueError:
        raise UsageError(
            f"place: wanted 'label x y z', a name and the palm's place in metres in the world frame, as in "
            f"'screws -0.22 -0.67 0.80', got {entry!r:.80}"
        ) from None


@dataclass(frozen=True, eq=False)
class ReachEnd:
    """Where one motion's palm was farthest from its start."""

    name: str  #: of the motion, `class/index`
    label: str | None  #: its class, None if it has none
    place_m: FloatArray  #: (3,) tracker's frame
    tracked: bool  #: False if the motion is mistracked or mislabelled (`motion.cleaning`)


def reach_ends(library: MotionLibrary, human: HumanModel) -> tuple[ReachEnd, ...]:
    """Return where each motion's palm was farthest from its start, outliers left out, in the library's order.

    Raises:
        HumanModelError: a library of another human.
    """
    wrong = {flag.motion for flag in flag_library(library, model=human) if flag.reason in DROP_REASONS}
    return tuple(
        ReachEnd(motion.name, motion.label, farthest_palm(motion, human), motion.name not in wrong)
        for motion in library
    )


def reaching_for(ends: Sequence[ReachEnd], labels: Collection[str]) -> frozenset[str]:
    """Return the names of motions of these labels, and of those that end nearer to their places than to their own.

    A predictor that must know nothing of a class must not learn from these, since labels may be wrong.
    """
    by_label: dict[str, list[ReachEnd]] = {}
    for end in ends:
        if end.label is not None:
            by_label.setdefault(end.label, []).append(end)
    places = {label: typical_end(group) for label, group in by_label.items()}
    found = set()
    for end in ends:
        distance = {label: float(np.linalg.norm(end.place_m - place)) for label, place in places.items()}
        own = distance.get(end.label, np.inf) if end.label is not None else np.inf
        if end.label in labels or any(label in labels and distance[label] < own for label in distance):
            found.add(end.name)
    return frozenset(found)


def typical_end(ends: Sequence[ReachEnd]) -> FloatArray:
    """Return the median (3,) of the ends (at least one) that were tracked, of all if none was."""
    counted = [end.place_m for end in ends if end.tracked] or [end.place_m for end in ends]
    place: FloatArray = np.median(counted, axis=0)
    return place


@dataclass(frozen=True, eq=False)
class UnlistedPlaces:
    """Places as seen from a body, spread over where hands may go: what "none of the places" means.

    Raises:
        ArrayError: arrays of another shape, or shares that are not such.
    """

    human: HumanModel  #: whose body
    #: (M, 3) from the pelvis, x where it looks, z up; ordered from one side of the body to the other
    seen_m: FloatArray
    #: (M,) how probable each is before a reach begins, given that it is one of them; positive, with sum 1
    share: FloatArray

    def __post_init__(self) -> None:
        seen = checked("unlisted places", self.seen_m, ("M", 3))
        share = checked("shares of unlisted places", self.share, (len(seen),))
        if not (share > 0.0).all() or abs(float(share.sum()) - 1.0) > 1e-9:
            raise ArrayError(f"unlisted places: wanted positive shares with sum 1, got a sum of {share.sum()}")
        object.__setattr__(self, "seen_m", frozen(seen))
        object.__setattr__(self, "share", frozen(share))

    @classmethod
    def around_ends(cls, ends: EndPostures) -> UnlistedPlaces:
        """Return places spread about where reaches were seen to end, and farther."""
        reached = ends.seen[:, :3]
        centre = reached.mean(axis=0)
        away = reached - centre
        variance, axes = np.linalg.eigh(_WIDER * away.T @ away / len(away))
        deviation = np.sqrt(np.maximum(variance, _LEAST_M**2))
        # The symmetric root: the signs of the axes, which are arbitrary, do not matter.
        near = _drawn() @ (axes * deviation) @ axes.T
        anywhere = _UNLEARNED_M * _drawn()
        share = np.repeat([1.0 - 1.0 / _ANYWHERE, 1.0 / _ANYWHERE], N_PLACES) / N_PLACES
        return cls._from_side_to_side(ends.human, centre + np.vstack([near, anywhere]), share)

    @classmethod
    def around_shoulder(cls, human: HumanModel) -> UnlistedPlaces:
        """Return places all around the right shoulder, for when no reach was learned from."""
        q = np.clip(np.zeros(len(human.dof_names)), human.lower, human.upper)
        T = standing(human, q)
        shoulder = human.link_poses(q)[point_links(human)[POINTS.index("right_shoulder")], :3, 3]
        places = (shoulder - T[:3, 3]) @ T[:3, :3] + _UNLEARNED_M * _drawn()
        return cls._from_side_to_side(human, places, np.full(N_PLACES, 1.0 / N_PLACES))

    @classmethod
    def _from_side_to_side(cls, human: HumanModel, seen_m: FloatArray, share: FloatArray) -> UnlistedPlaces:
        order = np.argsort(np.arctan2(seen_m[:, 1], seen_m[:, 0]))
        return cls(human, seen_m[order], share[order])

    def around(self, posture: FloatArray) -> FloatArray:
        """Return them (M, 3) in the tracker's frame for a reach that begins in a posture (D,)."""
        T = standing(self.human, posture)
        places: FloatArray = self.seen_m @ T[:3, :3].T + T[:3, 3]
        return places


def evenly_picked(places_m: FloatArray, log_probability: FloatArray, n: int) -> FloatArray:
    """Return n of places (M, 3), each as often as it is probable, as nearly as n allows.

    Nothing is random (systematic resampling), so predictions do not flicker; neighbours in the array should be
    neighbours in space.

    Args:
        places_m: at least one.
        log_probability: (M,) up to a constant.
        n: how many.
    """
    reached = np.cumsum(np.exp(log_probability - log_probability.max()))
    picked: FloatArray = places_m[np.searchsorted(reached, (np.arange(n) + 0.5) / n * reached[-1])]
    return picked


def _drawn() -> FloatArray:
    """Return (N_PLACES, 3) evenly spread standard normal numbers."""
    even = (0.5 + np.arange(1, N_PLACES + 1)[:, None] * _RATIO) % 1.0
    normal = NormalDist()
    return np.array([[normal.inv_cdf(share) for share in row] for row in even.tolist()])
