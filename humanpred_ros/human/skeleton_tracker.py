"""From the points of any tracker to postures of P1's human, frame by frame, without ROS.

    tracker = SkeletonTracker("azure_kinect")
    posture = tracker.update(points, t_s)      # points (32, 3) as the tracker gives them
    if posture.refusal: ...                    # no person, or not enough of one: says why
    else: posture.q                            # (12,)

Several people are `TrackedPeople`: ids of trackers come and go; who stands where somebody stood is that person.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.kinect import LINK_OF_POINT, KinectSkeleton
from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.plausible import PlausibilityCheck, PlausibilitySettings
from humanpred_ros.human.skeleton_repair import AT, SkeletonRepair
from humanpred_ros.human.skeletons import PER_METRE, Skeleton, load_skeleton, person_points
from humanpred_ros.settings import setting

#: A longer silence begins anew, s.
_GAP_S = 1.0
#: A trunk that leans farther from the vertical than this (cosine) is a frame whose z is not up.
_UPRIGHT = 0.5
#: Bones of people, as shares of P1's human; and what else lengths may be in, by how many make a metre.
_PERSON = (0.5, 1.7)
_UNITS = {**PER_METRE, "inches": 39.37, "feet": 3.281, "dm": 10.0}
#: What tells a person's size, whatever the posture.
_BONES = (
    ("left_shoulder", "right_shoulder"), ("left_shoulder", "left_elbow"), ("right_shoulder", "right_elbow"),
    ("left_shoulder", "left_hip"), ("right_shoulder", "right_hip"), ("left_hip", "left_knee"),
    ("right_hip", "right_knee"),
)  # fmt: skip
#: rArmTrans of most people (P1's recordings).
_ARM_TRANS_M = 0.1
_ARM = "rShoulder", "rArm", "rElbow"
#: People are tracked in a room so large, m; whoever predicts has a smaller one.
_ROOM = VoxelGrid((-50.0, -50.0, -20.0), 1.0, (100, 100, 40))
#: A person who is back under another id was last seen so near, m, walks so fast, m/s, and was away so long at most, s.
_NEAR_M, _WALK_M_S, _AWAY_S = 0.6, 1.5, 5.0
#: Begins the ids of bodies that a tracker only lists: they are told by where they stand.
NO_ID = "#"
#: A body that nobody has had for so long may become another person, s.
_FREE_S = 1.0


class TrackingSettings(PlausibilitySettings):
    """How points become postures."""

    learn_s: float = setting(2.0, "first seconds of a person in which limb lengths are learned", unit="s", low=0.0)
    hold_s: float = setting(
        0.25, "an arm of which elbow or hand is lost keeps its angles for so long, then there is no posture",
        unit="s", low=0.0, high=2.0,
    )  # fmt: skip
    swap_s: float = setting(
        1.0, "exchanged left and right are mended for so long, then the tracker is believed", unit="s", low=0.0
    )


@dataclass(frozen=True)
class TrackedPosture:
    """What one frame says of a person."""

    t_s: float  #: stamp
    q: FloatArray | None  #: (12,) posture; None where the frame is refused
    refusal: str  #: why there is no posture, its kind before a colon; empty if there is
    points_m: FloatArray  #: (15, 3) skeleton points in metres, z up, NaN where lost
    lost: tuple[str, ...] = ()  #: points that were not seen and follow from nothing
    bridged: tuple[str, ...] = ()  #: points that were not seen and follow from others
    held: tuple[str, ...] = ()  #: DoFs that no point shows: they are as they were last
    swapped: tuple[str, ...] = ()  #: parts whose left and right were exchanged


class SkeletonTracker:
    """Turns the points of one person into postures, one frame after the other.

    Neck, shoulders, torso and hips are bridged from each other where they are missing. A lost elbow or hand is not
    guessed: the DoFs that it shows are named in `held`, and after `hold_s` there is no posture. Left and right are
    exchanged back where a tracker swaps them for some frames. Limbs keep the lengths they had in the first seconds.

    Attributes:
        skeleton: which point is which.
        model: the human whose postures come.
        lengths_m: learned lengths of upper arm ("shoulder") and forearm ("elbow"), by side and where they begin.
    """

    def __init__(
        self,
        skeleton: str | Path | Skeleton,
        T_room_tracker: ArrayLike | None = None,
        settings: TrackingSettings | None = None,
    ) -> None:
        """Take the tracker.

        Args:
            skeleton: its name, as `azure_kinect`, a YAML file, or what was read from one.
            T_room_tracker: (4, 4) pose of a tracker with x forward, y left, z up in the frame postures are wanted in
                (z up); for a skeleton that is `centred`, where the person's hips are. At the origin if None.
            settings: limits.

        Raises:
            UsageError: no such skeleton, or one that needs a pose and got none.
        """
        self.skeleton = skeleton if isinstance(skeleton, Skeleton) else load_skeleton(skeleton)
        if self.skeleton.centred and T_room_tracker is None:
            raise UsageError(
                "skeleton: its points are about the body's own middle; say where the person stands (T_room_tracker)"
            )
        self.settings = settings or TrackingSettings()
        self.model = HumanModel.kinect12()
        self._convert = KinectSkeleton(self.model, self.settings.limit_slack_rad)
        self._repair = SkeletonRepair(self.model, self.settings.learn_s, self.settings.swap_s)
        self.lengths_m = self._repair.lengths_m
        self._check = PlausibilityCheck(self.model, _ROOM, np.eye(4), self.settings.part(PlausibilitySettings))
        usual = np.zeros(len(self.model.dof_names))
        usual[self.model.dof_index["rArmTrans"]] = _ARM_TRANS_M
        self._bones_m = _bones(person_points(self.model, usual))
        self.place(np.eye(4) if T_room_tracker is None else T_room_tracker)
        self.forget()

    def place(self, T_room_tracker: ArrayLike, frame_axes: bool = False) -> None:
        """Say where the tracker stands from now on.

        Args:
            T_room_tracker: (4, 4) pose, as above.
            frame_axes: it is the pose of the frame that the points' own axes span, as TF has it.
        """
        T = checked("T_room_tracker", T_room_tracker, (4, 4))
        own = np.eye(3) / PER_METRE[self.skeleton.unit] if frame_axes else self.skeleton.to_room
        self._A, self._shift = T[:3, :3] @ own, T[:3, 3]

    def forget(self) -> None:
        """Begin with another person."""
        self._repair.forget()
        self.lengths_m = self._repair.lengths_m
        self._begin()

    def _begin(self) -> None:
        self._check.start()
        self._t_s, self._seen_s = -np.inf, -np.inf
        self._q: FloatArray | None = None

    def update(
        self,
        points: ArrayLike | Mapping[str, ArrayLike],
        t_s: float,
        confidence: ArrayLike | Mapping[str, float] | None = None,
    ) -> TrackedPosture:
        """Return the posture of the next frame, or why there is none.

        Args:
            points: (N, 3) in the tracker's order, unit and axes, NaN where lost; or those seen, by the tracker's names.
            t_s: stamp in seconds.
            confidence: (N,), or by name; whatever the tracker calls so.

        Raises:
            ArrayError: points that are not this tracker's.
        """
        return self.update_placed(self.placed(points, confidence), t_s)

    def placed(
        self,
        points: ArrayLike | Mapping[str, ArrayLike],
        confidence: ArrayLike | Mapping[str, float] | None = None,
    ) -> FloatArray:
        """Return a person's points (18, 3) as `update_placed` takes them; arguments and errors as those of `update`."""
        placed: FloatArray = self.skeleton.read(points, confidence) @ self._A.T + self._shift
        return placed

    def update_placed(self, points: FloatArray, t_s: float) -> TrackedPosture:
        """Return the posture of points (18, 3) in the order of `POINTS`, in metres, z up, NaN where lost."""
        if not t_s > self._t_s:
            return _refused(t_s, points, f"stamp back: wanted one later than {self._t_s:.6g} s, got {t_s:.6g} s")
        if t_s - self._t_s > _GAP_S:
            self._begin()
        self._t_s = t_s
        refusal = self._no_person(points)
        if refusal:
            return _refused(t_s, points, refusal)
        points, swapped = self._repair.unswapped(points, t_s)
        points = self._repair.held_lengths(points, t_s)
        points, bridged = self._repair.bridged(points)
        found = self._convert.postures(points[None, : len(LINK_OF_POINT)])
        q, held, refusal = self._filled(found.q[0], found.reasons[0], points, t_s)
        if not refusal:
            refusal = str(self._check.refusal(q, t_s) or "")
        lost = tuple(name for name in LINK_OF_POINT if np.isnan(points[AT[name], 0]))
        shown = points[: len(LINK_OF_POINT)]
        return TrackedPosture(t_s, None if refusal else q, refusal, shown, lost, bridged, held, swapped)

    def _filled(
        self, q: FloatArray, reasons: Mapping[str, str], points: FloatArray, t_s: float
    ) -> tuple[FloatArray, tuple[str, ...], str]:
        """Return the posture without gaps, the DoFs that were held, and why there is none."""
        names = self.model.dof_names
        held = tuple(name for name, value in zip(names, q, strict=True) if np.isnan(value))
        trunk = [name for name in held if not name.startswith(_ARM)]
        if trunk:
            return q, (), f"no posture: {trunk[0]}: {reasons[trunk[0]]}"
        before = self._q
        arm_lost = [part for part in ("elbow", "hand") if np.isnan(points[AT[f"right_{part}"], 0])]
        if not arm_lost:
            # What geometry hides stays as it was: a straight elbow shows no roll. What no arm can do is none.
            strange = [name for name in held if not reasons[name].startswith(("the elbow is", "the upper arm lies"))]
            if strange:
                return q, (), f"no posture: {strange[0]}: {reasons[strange[0]]}"
            self._seen_s = t_s
        elif before is None or t_s - self._seen_s > self.settings.hold_s:
            return q, (), f"lost hand: wanted the right {' and '.join(arm_lost)}, not seen for {self._unseen(t_s)}"
        if before is None:
            before = np.zeros(len(names))
        q = np.where(np.isnan(q), before, q)
        turning = np.array(["Trans" not in name for name in names])
        q = np.where(turning, q - 2.0 * np.pi * np.round((q - before) / (2.0 * np.pi)), q)
        self._q = q
        return q, held, ""

    def _unseen(self, t_s: float) -> str:
        return f"{t_s - self._seen_s:.2g} s" if np.isfinite(self._seen_s) else "as long as the person is"

    def _no_person(self, points: FloatArray) -> str:
        """Return why points cannot be a person's: their size, or a trunk that is not upright."""
        seen = ~np.isnan(points[:, 0])
        if not seen.any():
            return "no points: wanted those of a person, all are lost"
        ratios = _bones(points) / self._bones_m
        ratios = ratios[~np.isnan(ratios)]
        if len(ratios):
            ratio = float(np.sort(ratios)[len(ratios) // 2])
            if not _PERSON[0] <= ratio <= _PERSON[1]:
                return self._other_unit(ratio)
        top = next((p for p in (points[AT["neck"]], 0.5 * (points[AT["left_shoulder"]] + points[AT["right_shoulder"]]))
                    if not np.isnan(p[0])), None)  # fmt: skip
        low = next((p for p in (points[AT["pelvis"]], 0.5 * (points[AT["left_hip"]] + points[AT["right_hip"]]),
                                points[AT["torso"]]) if not np.isnan(p[0])), None)  # fmt: skip
        if low is None and seen[AT["head"]]:
            low, top = top, points[AT["head"]]
        if top is None or low is None:
            return ""
        trunk = top - low
        length = float(np.sqrt(trunk @ trunk))
        if not length > 0.0 or trunk[2] >= _UPRIGHT * length:
            return ""
        k = int(np.argmax(np.abs(trunk)))
        along = f"{'-' if trunk[k] < 0.0 else '+'}{'xyz'[k]}"
        advice = {"-y": ", as in an optical frame: axes right, down, forward", "+y": ": axes left, up, forward",
                  "-z": ": is the camera upside down?"}.get(along, "")  # fmt: skip
        return f"not upright: wanted a trunk along z, which is up, got one along {along}{advice}; or let TF say it"

    def _other_unit(self, ratio: float) -> str:
        unit = self.skeleton.unit
        for other, per_metre in _UNITS.items():
            factor = per_metre / PER_METRE[unit]
            if other != unit and _PERSON[0] * 1.1 < ratio / factor < _PERSON[1] / 1.1:
                return (
                    f"units: wanted lengths in {unit}, got bones {ratio:.3g} times a person's; in {other}, perhaps: a "
                    f"factor of {1.0 / factor:.4g} would mend it"
                )
        return f"units: wanted lengths in {unit}, got bones {ratio:.3g} times a person's"


def _bones(points: FloatArray) -> FloatArray:
    """Return lengths of bones (7,) of points (18, 3), NaN where one is not seen."""
    a, b = ([AT[pair[k]] for pair in _BONES] for k in (0, 1))
    lengths: FloatArray = np.sqrt(np.square(points[a] - points[b]).sum(axis=1))
    return lengths


def _refused(t_s: float, points: FloatArray, refusal: str) -> TrackedPosture:
    return TrackedPosture(t_s, None, refusal, points[: len(LINK_OF_POINT)])


@dataclass
class _Person:
    tracker: SkeletonTracker
    theirs: str  #: the tracker's id
    where_m: FloatArray
    seen_s: float


class TrackedPeople:
    """Turns the bodies that a tracker tells apart into people with names that stay: `body_0`, `body_1` and so on.

    A tracker's new id is the person who stood there; else somebody new, who gets the first name that is free.

    Attributes:
        people: by name, those included that have left.
    """

    def __init__(
        self,
        skeleton: str | Path | Skeleton,
        T_room_tracker: ArrayLike | None = None,
        settings: TrackingSettings | None = None,
        most: int = 4,
    ) -> None:
        """Take what `SkeletonTracker` takes, and how many people are followed at most."""
        self.skeleton = skeleton if isinstance(skeleton, Skeleton) else load_skeleton(skeleton)
        self._trackers = [SkeletonTracker(self.skeleton, T_room_tracker, settings) for _ in range(most)]
        self.start()

    def start(self) -> None:
        """Begin with nobody: what comes next is another recording, or another time."""
        self.people: dict[str, _Person] = {}

    def place(self, T_room_tracker: ArrayLike, frame_axes: bool = False) -> None:
        """Say where the tracker stands from now on, as `SkeletonTracker.place`."""
        self._trackers[0].place(T_room_tracker, frame_axes)

    def update(
        self, bodies: Mapping[str, tuple[FloatArray, FloatArray | None]], t_s: float, others: Iterable[str] = ()
    ) -> Iterator[tuple[str, TrackedPosture]]:
        """Yield the name and posture of each body in a frame; an empty name where there are too many.

        Args:
            bodies: points and confidence, as `SkeletonTracker.update` takes them, by the tracker's ids.
            t_s: stamp in seconds.
            others: ids that are there, too, and come in frames of their own.
        """
        present = {*bodies, *others}
        for theirs, (points, confidence) in bodies.items():
            placed = self._trackers[0].placed(points, confidence)
            seen = placed[~np.isnan(placed[:, 0])]
            if not len(seen):
                continue  # an id without points is nobody
            where = np.median(seen, axis=0)
            name = self._name(theirs, where, t_s, present)
            if not name:
                yield "", _refused(t_s, placed, f"too many people: at most {len(self._trackers)} are followed")
                continue
            person = self.people[name]
            person.theirs, person.where_m, person.seen_s = theirs, where, t_s
            yield name, person.tracker.update_placed(placed, t_s)

    def _name(self, theirs: str, where: FloatArray, t_s: float, present: set[str]) -> str:
        for name, person in self.people.items():
            if person.theirs == theirs and t_s - person.seen_s <= _AWAY_S and not theirs.startswith(NO_ID):
                return name
        best, best_m = "", np.inf
        for name, person in self.people.items():
            away_s = t_s - person.seen_s
            told = person.theirs in present and not person.theirs.startswith(NO_ID)
            if told or not 0.0 < away_s <= _AWAY_S:
                continue
            off_m = float(np.linalg.norm(where[:2] - person.where_m[:2]))
            if off_m < min(best_m, _NEAR_M + _WALK_M_S * max(away_s, 0.0)):
                best, best_m = name, off_m
        if best:
            return best
        for k, tracker in enumerate(self._trackers):
            name = f"body_{k}"
            had = self.people.get(name)
            if had is None or t_s - had.seen_s > _FREE_S:
                tracker.forget()
                self.people[name] = _Person(tracker, theirs, where, t_s)
                return name
        return ""
