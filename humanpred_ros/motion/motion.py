"""Motions (timed sequences of postures), libraries of labelled motions, and motions at other stamps or places."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import LibraryFormatError, MotionError, UsageError
from humanpred_ros.files import name_trouble
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.human.kinect import LINK_OF_POINT
from humanpred_ros.motion.labels import checked_label, label_order

#: DoFs that say where the body stands, x, y, z in metres and then the turn about z in radians.
PELVIS_DOFS = ("PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotZ")
#: DoFs of bodies whose pelvis tilts, about x and then y, before it turns about z.
_TILTS = ("PelvisRotX", "PelvisRotY")
#: A transform's rotation may be off by this much, as text with six digits is.
_TOLERANCE = 1e-6
#: No motion holds more: stamps are nanoseconds in 64 bits, and compiled loops count voxels in them.
_LONGEST_S, _FARTHEST, _MOST = 1e9, 1e6, 2**31 - 1
#: The 15 skeleton points an OpenNI tracker delivers, in the order of `Motion.points_m`.
SKELETON_POINTS = tuple(LINK_OF_POINT)


@dataclass(frozen=True)
class Motion:
    """One recorded motion: immutable.

    Attributes:
        t_s: (T,) seconds since the motion's start, strictly increasing, whole nanoseconds.
        q: (T, D) postures, metres and radians, in the order of `dof_names`.
        dof_names: D names.
        label: class of the motion, as `screws` or `3`, or None when unlabelled; a whole number becomes its text.
        index: number of the motion within its class.
        frame_id: frame in which pelvis and points are expressed.
        points_m: (T, 15, 3) skeleton points in `frame_id`, NaN where the sensor lost one; None if not recorded.

    Raises:
        MotionError: wrong shapes, fewer than two frames, values not finite, stamps not increasing.
    """

    t_s: FloatArray
    q: FloatArray
    dof_names: tuple[str, ...]
    label: str | None = None
    index: int = 0
    frame_id: str = "kinect"
    points_m: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.label is not None:
            object.__setattr__(self, "label", checked_label(self.label))
        name = self.name
        t_s = checked(f"{name}: t_s", self.t_s, ("T",), error=MotionError)
        q = checked(f"{name}: q", self.q, ("T", len(self.dof_names)), error=MotionError)
        if len(t_s) < 2 or len(t_s) != len(q):
            raise MotionError(
                f"{name}: wanted 2 frames or more, as many stamps as postures, got {len(t_s)} and {len(q)}"
            )
        largest = float(np.abs(t_s).max()) / _LONGEST_S, float(np.abs(q).max(initial=0.0)) / _FARTHEST
        if max(largest) > 1.0 or not 0 <= self.index <= _MOST:
            raise MotionError(
                f"{name:.80}: wanted stamps up to {_LONGEST_S:g} s, postures up to {_FARTHEST:g} m or rad, and "
                f"index up to {_MOST}, got more; correct it"
            )
        t_s = np.round(t_s * 1e9) * 1e-9  # stamps live as integer nanoseconds in bags; keep both sides equal
        step = np.diff(t_s)
        if (step <= 0).any():
            k = int(np.argmax(step <= 0))
            raise MotionError(
                f"{name}: wanted increasing stamps, got {t_s[k]:.6f} s and then {t_s[k + 1]:.6f} s at frame {k + 1}"
            )
        object.__setattr__(self, "t_s", frozen(t_s))
        object.__setattr__(self, "q", frozen(q))
        object.__setattr__(self, "dof_names", tuple(self.dof_names))
        if self.points_m is not None:
            points = checked(
                f"{name}: points_m", self.points_m, (len(t_s), len(SKELETON_POINTS), 3), finite=False, error=MotionError
            )
            object.__setattr__(self, "points_m", frozen(points))

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def name(self) -> str:
        """`class/index`, the way motions are named on the command line."""
        return f"{'-' if self.label is None else self.label}/{self.index}"

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last frame."""
        return float(self.t_s[-1] - self.t_s[0])

    def timeline(self, n_held: int = 0) -> tuple[list[int], FloatArray]:
        """Return offsets from the first frame in whole ns and the postures (T + n_held, D).

        The last posture is repeated `n_held` times at the median period: a person who stays where the
        recording ended.
        """
        offsets = [round((t - self.t_s[0]) * 1e9) for t in self.t_s]
        period_ns = max(1, round(self.period_s * 1e9))
        held = [offsets[-1] + period_ns * (k + 1) for k in range(n_held)]
        return offsets + held, np.vstack([self.q, np.repeat(self.q[-1:], n_held, axis=0)])

    @property
    def period_s(self) -> float:
        """Median time between frames."""
        return float(np.median(np.diff(self.t_s)))

    def with_postures(self, q: FloatArray) -> Motion:
        """Return the same motion with other postures at the same stamps (points, if any, are dropped)."""
        return replace(self, q=q, points_m=None)


@dataclass(frozen=True)
class MotionLibrary:
    """Labelled motions of one recording: immutable, in recording order.

    Attributes:
        name: short name, shown in tables and stored in trained models.
        motions: at least one; all with the same DoF names and frame.
        provenance: where the data come from, as text.

    Raises:
        LibraryFormatError: no motions, mixed DoFs or frames, or two motions with one name.
    """

    name: str
    motions: tuple[Motion, ...]
    provenance: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "motions", tuple(self.motions))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))
        if not self.motions:
            raise LibraryFormatError(f"library {self.name}: wanted at least one motion, got none")
        first, seen = self.motions[0], set()
        for motion in self.motions:
            if motion.dof_names != first.dof_names:
                raise LibraryFormatError(
                    f"library {self.name}: motion {motion.name} has DoFs {motion.dof_names}, "
                    f"{first.name} has {first.dof_names}; one library needs one set"
                )
            if motion.frame_id != first.frame_id:
                raise LibraryFormatError(
                    f"library {self.name}: motion {motion.name} is in frame {motion.frame_id!r}, "
                    f"{first.name} in {first.frame_id!r}; transform them into one frame first"
                )
            if motion.name in seen:
                raise LibraryFormatError(f"library {self.name}: two motions are named {motion.name}")
            seen.add(motion.name)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickles the library: provenance is a read-only view, which cannot be pickled itself."""
        return MotionLibrary, (self.name, self.motions, dict(self.provenance))

    def __deepcopy__(self, memo: dict[int, Any]) -> MotionLibrary:
        return self  # immutable

    def __len__(self) -> int:
        return len(self.motions)

    def __iter__(self) -> Iterator[Motion]:
        return iter(self.motions)

    @property
    def dof_names(self) -> tuple[str, ...]:
        return self.motions[0].dof_names

    @property
    def frame_id(self) -> str:
        return self.motions[0].frame_id

    @property
    def labels(self) -> tuple[str, ...]:
        """Class labels in `label_order`; unlabelled motions have none."""
        return tuple(sorted({motion.label for motion in self.motions if motion.label is not None}, key=label_order))

    def of_class(self, label: str) -> tuple[Motion, ...]:
        """Return the motions of one class, by index; a whole number will do for its text."""
        return tuple(sorted((m for m in self.motions if m.label == str(label)), key=lambda m: m.index))

    @property
    def by_class(self) -> list[Motion]:
        """The motions by class and index, those without a class first."""
        return sorted(self.motions, key=lambda motion: (*label_order(motion.label), motion.index))

    def select(self, keep: Callable[[Motion], bool]) -> MotionLibrary:
        """Return the library of the motions for which `keep` is true (LibraryFormatError if none)."""
        return replace(self, motions=tuple(motion for motion in self.motions if keep(motion)))

    def find(self, trajectory: str) -> Motion:
        """Return one motion by `class/index` or by its running number over the sorted classes.

        The running number is the papers' global id: in a library of 25 motions a class, 77 is 3/2.

        Raises:
            UsageError: no such motion, with what exists.
        """
        ordered = self.by_class
        for number, motion in enumerate(ordered):
            if trajectory in (motion.name, str(number)):
                return motion
        raise UsageError(
            f"no trajectory {trajectory!r} in library {self.name}; "
            f"valid: 0 to {len(ordered) - 1}, or {ordered[0].name} to {ordered[-1].name}"
        )


def require_plain_name(where: str, name: str) -> str:
    """Return a name that a file of data gives to a library, if it can be the name of a folder.

    Raises:
        LibraryFormatError: names such as `..`, `a/b` or an absolute path, which would leave the folder meant for it.
    """
    if trouble := name_trouble(name):
        raise LibraryFormatError(
            f"{where}: wanted a library name that can be a folder's, got {name!r:.120}: {trouble}; rename it"
        )
    return name


def is_angle(dof_name: str) -> bool:
    """Return whether a DoF turns; those of the papers' humans that slide have `Trans` in their name."""
    return "Trans" not in dof_name


def unwrap_angles(motion: Motion) -> Motion:
    """Return the same motion with each angle continuous from its first frame on; itself if it is already.

    The first frame stays, so a stream unwrapped frame by frame gives the same numbers.
    """
    angles = [d for d, name in enumerate(motion.dof_names) if is_angle(name)]
    turns = np.zeros_like(motion.q)
    # A step is shortened by the whole turns in it; summed up as integers, so that no rounding piles up.
    turns[1:, angles] = np.cumsum(np.round(np.diff(motion.q[:, angles], axis=0) / (2 * np.pi)), axis=0)
    if not turns.any():
        return motion
    return replace(motion, q=motion.q - 2 * np.pi * turns)


def resample(motion: Motion, *, t_s: ArrayLike) -> Motion:
    """Return the motion at the stamps `t_s` (N,), by linear interpolation of unwrapped postures.

    At a stamp of the original the posture is the original one (angles up to whole turns). Skeleton points
    are interpolated too, and lost where a neighbouring frame has lost them.

    Raises:
        MotionError: stamps that do not increase, or outside the motion.
    """
    stamps = np.round(checked("t_s", t_s, ("N",), error=MotionError) * 1e9) * 1e-9
    if len(stamps) < 2 or stamps[0] < motion.t_s[0] or stamps[-1] > motion.t_s[-1]:
        span = f"{motion.t_s[0]:.6f} to {motion.t_s[-1]:.6f} s"
        came = f"{len(stamps)} from {stamps[0]:.6f} to {stamps[-1]:.6f} s" if len(stamps) else "none"
        raise MotionError(f"{motion.name}: wanted at least 2 stamps within {span}, got {came}; ask for fewer")
    points = motion.points_m
    if points is not None:
        points = _interpolated(motion.t_s, points.reshape(len(motion), -1), stamps).reshape(len(stamps), -1, 3)
    return replace(motion, t_s=stamps, q=_interpolated(motion.t_s, unwrap_angles(motion).q, stamps), points_m=points)


def resample_phase(motion: Motion, n: int) -> Motion:
    """Return the motion at `n` evenly spaced phases of its duration; first and last frame are the original ones.

    Raises:
        MotionError: fewer than 2 phases, or more than there are nanoseconds.
    """
    if n < 2:
        raise MotionError(f"{motion.name}: wanted at least 2 phases, got {n}")
    return resample(motion, t_s=np.linspace(motion.t_s[0], motion.t_s[-1], n))


def _interpolated(t_s: FloatArray, values: FloatArray, stamps: FloatArray) -> FloatArray:
    """Interpolate (T, K) values at `stamps` within `t_s`; exact at the frames, NaN only next to NaN."""
    left = np.clip(np.searchsorted(t_s, stamps, side="right") - 1, 0, len(t_s) - 2)
    share = ((stamps - t_s[left]) / (t_s[left + 1] - t_s[left]))[:, None]
    # Written as a sum of shares, not as start plus difference: so the right end comes out exactly, too.
    between = (1.0 - share) * values[left] + share * values[left + 1]
    return np.where(share <= 0.0, values[left], np.where(share >= 1.0, values[left + 1], between))


def pelvis_columns(dof_names: Sequence[str]) -> tuple[int, int, int, int]:
    """Return the columns of a posture that hold `PELVIS_DOFS`.

    Raises:
        MotionError: some are missing, so the body cannot be placed.
    """
    missing = [name for name in PELVIS_DOFS if name not in dof_names]
    if missing:
        raise MotionError(
            f"placing a motion: wanted the DoFs {', '.join(PELVIS_DOFS)}, {', '.join(missing)} missing among "
            f"{', '.join(dof_names)}; only bodies that are free to stand anywhere can be moved"
        )
    x, y, z, yaw = (list(dof_names).index(name) for name in PELVIS_DOFS)
    return x, y, z, yaw


def turn_and_shift(
    yaw_rad: float, shift_m: ArrayLike = (0.0, 0.0, 0.0), about_m: ArrayLike = (0.0, 0.0, 0.0)
) -> FloatArray:
    """Return the (4, 4) transform that turns by `yaw_rad` about the vertical through `about_m` and then shifts."""
    about = checked("about_m", about_m, (3,), error=MotionError)
    turn = float(checked("yaw_rad", yaw_rad, (), error=MotionError))
    T = np.eye(4)
    T[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    T[:3, 3] = about - T[:3, :3] @ about + checked("shift_m", shift_m, (3,), error=MotionError)
    return T


def placed(motion: Motion, T: ArrayLike) -> Motion:
    """Return the motion as made by a person moved by the rigid transform `T`, in the same frame.

    Every point of the body, and every skeleton point, is where `T` takes it. Only turns about the vertical are done:
    a body's frame, like a tracker's world, has z up.

    Args:
        motion: any whose body can stand anywhere.
        T: (4, 4), a turn about z and a translation.

    Raises:
        MotionError: no such DoFs, or a transform that is not of this kind.
    """
    T = checked("placement", T, (4, 4), error=MotionError)
    q = placed_postures(motion.q, motion.dof_names, T)
    points = None if motion.points_m is None else motion.points_m @ T[:3, :3].T + T[:3, 3]
    return replace(motion, q=q, points_m=points)


def placed_postures(q: ArrayLike, dof_names: Sequence[str], T: ArrayLike) -> FloatArray:
    """Return postures (..., D) moved by the rigid transform `T` (4, 4).

    Raises:
        MotionError: no DoFs that place the body, or a transform other than a turn about z and a translation: a body's
            frame, like a tracker's world, has z up.
    """
    x, y, z, yaw = pelvis_columns(dof_names)
    T = checked("placement", T, (4, 4), error=MotionError)
    turn = math.atan2(T[1, 0], T[0, 0])
    if np.abs(T[:3, :3] - turn_and_shift(turn)[:3, :3]).max() > _TOLERANCE or (T[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise MotionError(
            f"placing a body: wanted a turn about z and a translation, got {T.tolist()}; a person stays upright"
        )
    q = np.array(q, dtype=np.float64)
    q[..., [x, y, z]] = q[..., [x, y, z]] @ T[:3, :3].T + T[:3, 3]
    if not set(_TILTS) <= set(dof_names):
        q[..., yaw] += turn
        return q
    # The turn about the vertical comes before the tilts, which come before the body's own turn.
    tilts = [list(dof_names).index(name) for name in _TILTS]
    angles = np.stack([q[..., tilts[0]], q[..., tilts[1]], q[..., yaw]])
    (sa, sb, sc), (ca, cb, cc) = np.sin(angles), np.cos(angles)
    # Rotation about x, then y, then z: of its first two rows what the turn mixes, of the third what it leaves.
    x_of = np.stack([cb * cc, ca * sc + sa * sb * cc], axis=-1) @ T[:2, :2].T
    y_of = np.stack([-cb * sc, ca * cc - sa * sb * sc], axis=-1) @ T[:2, :2].T
    z_of = np.stack([sb, -sa * cb], axis=-1) @ T[:2, :2].T
    q[..., tilts[0]] = np.arctan2(-z_of[..., 1], ca * cb)
    q[..., tilts[1]] = np.arcsin(np.clip(z_of[..., 0], -1.0, 1.0))
    q[..., yaw] = np.arctan2(-y_of[..., 0], x_of[..., 0])
    return q


def start_pelvis_m(library: MotionLibrary) -> FloatArray:
    """Return where the pelvis (3,) is at the start of a motion: per axis the median, as recordings may be wild.

    Raises:
        MotionError: a library whose bodies cannot stand anywhere.
    """
    columns = pelvis_columns(library.dof_names)
    start: FloatArray = np.median([motion.q[0, columns[:3]] for motion in library], axis=0)
    return start
