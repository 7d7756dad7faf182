"""Recordings of two people at one table, one reaching beside the other, as P2 learns from and predicts (P2 IV).

A folder holds two CSV files for each recording, `<name>_active.csv` of the person who reaches and `<name>_passive.csv`
of the partner: a header, the column `t` in seconds, and one column for each DoF of the 23-DoF human. Motion capture
loses markers now and then. Angles that wrap are unwrapped, with a note; jumps, which a program cannot judge, are marked
and kept; what cannot be used at all (wrong units, one person recorded as two) is refused with the recording's name.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from humanpred_ros.errors import LibraryFormatError, MotionError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.csv_files import read_table
from humanpred_ros.motion.motion import Motion, is_angle, unwrap_angles

ACTIVE, PASSIVE = "active", "passive"
#: Title of the column of stamps.
TIME = "t"
#: Frame of the motion-capture system, z up, the floor at zero.
FRAME_ID = "mocap"
#: Links at which a jump shows.
WATCHED_LINKS = ("right_elbow", "right_wrist", "right_palm")
#: Joints turn by less than this, whole turns of an unwrapped recording included: degrees go beyond.
_MOST_RAD = 20.0
#: No room for motion capture is larger: centimetres and millimetres go beyond.
_MOST_M = 20.0
#: Frames of motion capture are 2 to 10 ms apart, of a depth camera 33 ms: milliseconds and nanoseconds go beyond.
_PERIOD_S = (0.0005, 0.5)
#: Upper arms and forearms of children and giants, also with badly placed markers.
_BONE_M = (0.05, 1.0)
#: A hand that goes less than this does not reach.
_LEAST_WAY_M = 0.05
#: A hand that ends nearer to where it began than this share of the farthest it was has come back.
_BACK_SHARE = 0.25


# What is refused and what is marked in a recording of two people. Frames at 100 Hz differ by three times the
# synchrony. The limits of jumps are own judgement: P2's reaches stay below 2.1 m/s, its jumps begin at 3.6 m/s, and
# its people stay below 29 rad/s. Angles can jump though no link does: a hand turned about itself, or three angles
# that flip to others of the same posture. The jerk's difference spans 7 frames (docs/papers.md, P2 features).
_SYNCHRONY_S = 0.003  #: stamps of the two people may differ by so much
_GAP_FACTOR = 3.0  #: a longer step of time than this many medians is noted as a gap
_JUMP_SPEED_M_S = 3.0  #: faster steps of elbow, wrist or palm are jumps
_JUMP_SPEED_RAD_S = 50.0  #: faster steps of an angle are jumps
_JUMP_ISOLATION = 3.0  #: a jump is also this many times the median speed around it
LEAST_FRAMES = 7  #: a shorter motion is not learned from


@dataclass(frozen=True)
class Jump:
    """A step that no person makes: a marker was lost or mistaken."""

    role: str  #: ACTIVE or PASSIVE
    frame: int  #: the first frame after the step; what lies beyond it, up to the next jump, may be displaced
    what: str  #: the watched link that moved fastest, or the angle that turned fastest if no link jumped
    speed: float  #: of that
    unit: str = "m/s"  #: of the speed, m/s or rad/s

    def __str__(self) -> str:
        return f"{self.what.replace('_', ' ')} jumps at frame {self.frame} ({self.speed:.1f} {self.unit})"


@dataclass(frozen=True)
class ReachRecording:
    """One reach and the partner beside it: immutable, as many frames for both, at the same stamps."""

    name: str  #: of the recording, usually its first and last frame in the session
    #: the person who reaches; angles are unwrapped and begin within half a turn of zero, stamps begin at 0
    active: Motion
    passive: Motion  #: the partner
    jumps: tuple[Jump, ...] = ()  #: marked steps of both, by frame
    notes: tuple[str, ...] = ()  #: sentences about what was mended or looks doubtful

    def __post_init__(self) -> None:
        if len(self.active) != len(self.passive) or self.active.dof_names != self.passive.dof_names:
            raise MotionError(
                f"recording {self.name}: wanted two people with the same DoFs and frames, got {len(self.active)} and "
                f"{len(self.passive)} frames of {len(self.active.dof_names)} and {len(self.passive.dof_names)} DoFs"
            )

    @property
    def unfit(self) -> str | None:
        """Why the reach should not be learned from, None if it may; it can be predicted all the same.

        Jumps of the partner do not count: learning sees the partner at the reach's first frame only.
        """
        if len(self.active) < LEAST_FRAMES:
            return f"{self.name}: {len(self.active)} frames, the jerk's difference needs {LEAST_FRAMES}"
        if mine := [jump for jump in self.jumps if jump.role == ACTIVE]:
            more = f", {len(mine) - 1} more" if len(mine) > 1 else ""
            return f"{self.name}: the reaching person's {mine[0]}{more}"
        return None


def load_reach_recordings(folder: str | Path, model: HumanModel | None = None) -> tuple[ReachRecording, ...]:
    """Return the recordings of a folder by name; other files are not looked at.

    Args:
        folder: holds `<name>_active.csv` and `<name>_passive.csv`.
        model: the human whose DoFs are the columns; P2's 23-DoF human if None.

    Raises:
        LibraryFormatError: no recordings, a file without its counterpart, or one that cannot be used, by name.
        MotionError: stamps or postures that cannot be used, by name.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise LibraryFormatError(f"{folder}: wanted a folder of <name>_{ACTIVE}.csv files, there is no such folder")
    files = {role: {path.name.removesuffix(f"_{role}.csv"): path for path in folder.glob(f"*_{role}.csv")}
             for role in (ACTIVE, PASSIVE)}  # fmt: skip
    if not files[ACTIVE] and not files[PASSIVE]:
        raise LibraryFormatError(f"{folder}: wanted files <name>_{ACTIVE}.csv and <name>_{PASSIVE}.csv, found none")
    for role, other in ((ACTIVE, PASSIVE), (PASSIVE, ACTIVE)):
        if lonely := sorted(files[role].keys() - files[other].keys()):
            raise LibraryFormatError(
                f"{folder}: wanted both people of {', '.join(lonely)}, got {role} without {other}; add or remove a file"
            )
    if "" in files[ACTIVE]:
        raise LibraryFormatError(
            f"{folder}: wanted <name>_{ACTIVE}.csv, got a recording without a name; name its files"
        )
    model = model or HumanModel.mocap23()
    return tuple(
        read_reach_recording(name, files[ACTIVE][name], files[PASSIVE][name], model) for name in sorted(files[ACTIVE])
    )


def read_reach_recording(name: str, active: Path, passive: Path, model: HumanModel) -> ReachRecording:
    """Return one recording; errors as `load_reach_recordings` has them."""
    stamps: dict[str, FloatArray] = {}
    raw: dict[str, Motion] = {}
    for role, path in ((ACTIVE, active), (PASSIVE, passive)):
        stamps[role], raw[role] = _read_person(f"recording {name}, {role}", path, model.dof_names)
    if len(raw[ACTIVE]) != len(raw[PASSIVE]):
        raise MotionError(
            f"recording {name}: wanted as many frames of both people, got {len(raw[ACTIVE])} {ACTIVE} and "
            f"{len(raw[PASSIVE])} {PASSIVE}; cut both to the frames they share"
        )
    apart = np.abs(stamps[ACTIVE] - stamps[PASSIVE])
    allowed = _SYNCHRONY_S + 1e-9  # stamps are rounded
    if apart.max() > allowed:
        k = int(np.argmax(apart > allowed))
        raise MotionError(
            f"recording {name}: wanted both people at the same times, at frame {k} they are {1e3 * apart[k]:.1f} ms "
            f"apart ({1e3 * _SYNCHRONY_S:.1f} ms are allowed); resample one of them to the other's stamps"
        )
    motions: dict[str, Motion] = {}
    notes: list[str] = []
    jumps: list[Jump] = []
    for role in (ACTIVE, PASSIVE):
        # Both get the active person's stamps: what differs is less than the clock's accuracy.
        motion = replace(raw[role], t_s=raw[ACTIVE].t_s)
        smooth = unwrap_angles(motion)
        motions[role], turned = _first_turn(smooth)
        notes += [f"{role}: {text}" for text in (*_wraps(motion, smooth), *turned, *_gaps(motion))]
        jumps += find_jumps(motions[role], role, model)
    notes += [f"{jump.role}: {jump}" for jump in jumps]
    if np.array_equal(motions[ACTIVE].q, motions[PASSIVE].q):
        raise MotionError(
            f"recording {name}: wanted two people, got the same postures for both; one file is a copy of the other, "
            "replace it"
        )
    notes += doubts(motions[ACTIVE], motions[PASSIVE], model)
    return ReachRecording(name, motions[ACTIVE], motions[PASSIVE], tuple(jumps), tuple(notes))


def write_reach_recording(folder: Path, name: str, active: Motion, passive: Motion) -> tuple[Path, Path]:
    """Write `<name>_active.csv` and `<name>_passive.csv` and return them; reading them gives the same numbers."""
    files = folder / f"{name}_{ACTIVE}.csv", folder / f"{name}_{PASSIVE}.csv"
    for path, motion in zip(files, (active, passive), strict=True):
        # repr of a float is the shortest text that reads back as the same number.
        lines = [",".join(repr(float(x)) for x in (t, *q)) for t, q in zip(motion.t_s, motion.q, strict=True)]
        path.write_text("\n".join([",".join((TIME, *motion.dof_names)), *lines]) + "\n", encoding="utf-8")
    return files


def find_jumps(motion: Motion, role: str, model: HumanModel) -> tuple[Jump, ...]:
    """Return the isolated steps that are faster than a person, at most one for each frame.

    Those of elbow, wrist or palm come first; where none of them jumps, an angle may.
    """
    places = model.forward(motion.q)
    path = np.stack([places[link] for link in WATCHED_LINKS], axis=1)
    step_s = np.diff(motion.t_s)[:, None]
    found = _isolated(np.linalg.norm(np.diff(path, axis=0), axis=-1) / step_s, _JUMP_SPEED_M_S)
    jumps = {k + 1: Jump(role, k + 1, WATCHED_LINKS[which], speed) for k, which, speed in found}
    angles = [d for d, name in enumerate(motion.dof_names) if is_angle(name)]
    turning = np.abs(np.diff(motion.q[:, angles], axis=0)) / step_s
    for k, which, speed in _isolated(turning, _JUMP_SPEED_RAD_S):
        jumps.setdefault(k + 1, Jump(role, k + 1, motion.dof_names[angles[which]], speed, "rad/s"))
    return tuple(jumps[frame] for frame in sorted(jumps))


def _read_person(where: str, path: Path, dof_names: tuple[str, ...]) -> tuple[FloatArray, Motion]:
    """Return the stamps (T,) and the motion in one person's file; further columns are not read."""
    try:
        table = read_table(path, (TIME, *dof_names))
    except LibraryFormatError as trouble:
        raise LibraryFormatError(f"{where}: {trouble}") from trouble
    if len(table.rows) < 2:
        raise LibraryFormatError(f"{where}: {path}: wanted at least 2 frames, got 1; remove the recording")
    t_s, q = table[TIME], np.stack([table[name] for name in dof_names], axis=1)
    check_units(where, t_s, q, dof_names)
    try:
        return t_s, Motion(t_s - t_s[0], q, dof_names, frame_id=FRAME_ID)
    except MotionError as trouble:
        raise MotionError(
            f"{where}: {str(trouble).removeprefix('-/0: ')}; correct or remove the recording"
        ) from trouble


def _isolated(speed: FloatArray, limit: float) -> list[tuple[int, int, float]]:
    """Return steps, columns and speeds where a column of speeds (T - 1, C) jumps; the fastest of each step."""
    found = []
    for k in np.flatnonzero((speed > limit).any(axis=1)):
        around = np.median(speed[max(0, k - 5) : k + 6], axis=0)
        isolated = np.logical_and(speed[k] > limit, speed[k] > _JUMP_ISOLATION * around)
        if isolated.any():
            fastest = int(np.argmax(np.where(isolated, speed[k], 0.0)))
            found.append((int(k), fastest, float(speed[k, fastest])))
    return found


def _first_turn(motion: Motion) -> tuple[Motion, list[str]]:
    """Return the motion with angles that begin within half a turn of zero, so that recordings can be compared."""
    first = motion.q[0]
    turns = np.array([round(q / (2.0 * np.pi)) if is_angle(name) and abs(q) > np.pi + 1e-9 else 0
                      for name, q in zip(motion.dof_names, first, strict=True)])  # fmt: skip
    if not turns.any():
        return motion, []
    said = [f"{motion.dof_names[d]} begins at {first[d]:.2f} rad, taken as {first[d] - 2.0 * np.pi * turns[d]:.2f}"
            for d in np.flatnonzero(turns)]  # fmt: skip
    return motion.with_postures(motion.q - 2.0 * np.pi * turns), said


def _wraps(before: Motion, after: Motion) -> list[str]:
    changed = np.abs(before.q - after.q) > 0.5  # by whole turns or not at all
    return [
        f"{before.dof_names[d]} wraps at frame {int(np.argmax(changed[:, d]))}, unwrapped"
        for d in np.flatnonzero(changed.any(axis=0))
    ]


def _gaps(motion: Motion) -> list[str]:
    step = np.diff(motion.t_s)
    late = np.flatnonzero(step > _GAP_FACTOR * np.median(step))
    return [f"{1e3 * step[k]:.0f} ms without a frame before frame {int(k) + 1}" for k in late]


def check_units(where: str, t_s: FloatArray, q: FloatArray, dof_names: Sequence[str], bones: bool = True) -> None:
    """Refuse stamps (T,) and postures (T, D) that are not in seconds, metres and radians.

    Args:
        where: for the message.
        t_s, q, dof_names: of the motion.
        bones: DoFs of the 23-DoF human that end in Trans are lengths of bones.

    Raises:
        MotionError: with the first DoF that cannot be so.
    """
    period = float(np.median(np.diff(t_s)))
    if not _PERIOD_S[0] <= abs(period) <= _PERIOD_S[1] and period != 0.0:
        raise MotionError(
            f"{where}: wanted stamps in seconds, {_PERIOD_S[0]} to {_PERIOD_S[1]} s apart, got {period:g} as the "
            "median step; convert them, they look like another unit"
        )
    most = np.abs(q).max(axis=0)
    for name, value, column in zip(dof_names, most, q.T, strict=True):
        if is_angle(name):
            if value > _MOST_RAD:
                raise MotionError(
                    f"{where}: wanted angles in radians, got {value:g} for {name}; convert them, they look like "
                    "degrees: a factor of 0.0174533 makes them so (import: --units deg)"
                )
            continue
        if value > _MOST_M:
            largest = max(x for x, other in zip(most, dof_names, strict=True) if not is_angle(other))
            unit, factor = ("mm", "0.001") if largest > 500.0 else ("cm", "0.01")
            raise MotionError(
                f"{where}: wanted lengths in metres, got {value:g} for {name}; convert them, they look like "
                f"{'millimetres' if unit == 'mm' else 'centimetres'}: a factor of {factor} makes them so (import: "
                f"--units {unit})"
            )
        length = float(np.median(column))
        if bones and name.endswith("Trans") and not _BONE_M[0] <= length <= _BONE_M[1]:
            raise MotionError(
                f"{where}: wanted the bone {name} between {_BONE_M[0]} and {_BONE_M[1]} m, got {length:g} as the "
                "median; check its unit and sign"
            )


def doubts(active: Motion, passive: Motion, model: HumanModel, hand: str = "right_palm") -> list[str]:
    """Return sentences on why the files may be swapped, or the recording may hold no reach."""
    (mine, end_m), (theirs, _) = (_way_m(motion, model, hand) for motion in (active, passive))
    if theirs > max(mine, _LEAST_WAY_M):
        return [
            f"the partner's hand goes farther ({theirs:.2f} m) than that of the person who reaches ({mine:.2f} m); "
            "check that the files are not swapped"
        ]
    if mine < _LEAST_WAY_M:
        return [f"the hand of the person who reaches goes only {mine:.2f} m; check that this is a reach"]
    if end_m < _BACK_SHARE * mine:
        return [
            f"the hand ends {end_m:.2f} m from where it began, after {mine:.2f} m: a reach and the way back? cut it at "
            "the turn"
        ]
    return []


def _way_m(motion: Motion, model: HumanModel, hand: str) -> tuple[float, float]:
    """Return how far the hand is from where it began: at the farthest, and in the end.

    "Farthest" leaves out a tenth of the frames: a lost marker displaces the hand for a frame or two.
    """
    place = model.forward(motion.q)[hand]
    far = np.linalg.norm(place - place[0], axis=1)
    return float(np.quantile(far, 0.9)), float(far[-1])
