"""Recordings of two people at one table, one reaching beside the other, as P2 learns from and predicts (P2 IV).

A folder holds two CSV files for each recording, `<name>_active.csv` of the person who reaches and `<name>_passive.csv`
of the partner: a header, the column `t` in seconds, and one column for each DoF of the 23-DoF human. Motion capture
loses markers now and then; what can be mended is mended and noted (angles that wrap), what cannot be judged by a
program is marked and kept (jumps), and what cannot be used at all is refused with the recording's name.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from humanpred_ros.checks import FloatArray
from humanpred_ros.errors import LibraryFormatError, MotionError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.resampling import unwrap_angles

ACTIVE, PASSIVE = "active", "passive"
#: Frame of the motion-capture system, z up, the floor at zero.
FRAME_ID = "mocap"
#: Links at which a jump shows.
WATCHED_LINKS = ("right_elbow", "right_wrist", "right_palm")


@dataclass(frozen=True)
class ReachRecordingConfig:
    """What is refused and what is marked.

    Attributes:
        synchrony_s: stamps of the two people may differ by so much, about a third of a frame at 100 Hz.
        gap_factor: a step of time longer than this many times the median is noted as a gap.
        jump_speed_m_s: a faster one-frame step of elbow, wrist or palm is a jump, if it is isolated. Own judgement:
            P2's reaches stay below 2.1 m/s, its jumps begin at 3.6 m/s.
        jump_isolation: a jump is also this many times the median speed within five frames, so that somebody who
            moves fast is not one.
        least_frames: a shorter motion is not learned from: the jerk's difference spans 7 frames (facts section 4).
    """

    synchrony_s: float = 0.003
    gap_factor: float = 3.0
    jump_speed_m_s: float = 3.0
    jump_isolation: float = 3.0
    least_frames: int = 7


@dataclass(frozen=True)
class Jump:
    """A step that no person makes: a marker was lost or mistaken.

    Attributes:
        role: ACTIVE or PASSIVE.
        frame: the first frame after the step; what lies beyond it, up to the next jump, may be displaced.
        link: the watched link that moved fastest.
        speed_m_s: its speed.
    """

    role: str
    frame: int
    link: str
    speed_m_s: float


@dataclass(frozen=True)
class ReachRecording:
    """One reach and the partner beside it: immutable, as many frames for both, at the same stamps.

    Attributes:
        name: of the recording, usually its first and last frame in the session.
        active: who reaches; angles are unwrapped, stamps begin at 0.
        passive: the partner.
        jumps: marked steps of both, by frame.
        notes: sentences about what was mended or looks doubtful.
        least_frames: a shorter one is not learned from.
    """

    name: str
    active: Motion
    passive: Motion
    jumps: tuple[Jump, ...] = ()
    notes: tuple[str, ...] = ()
    least_frames: int = ReachRecordingConfig.least_frames

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
        if len(self.active) < self.least_frames:
            return f"{self.name}: {len(self.active)} frames, the jerk's difference needs {self.least_frames}"
        if mine := [jump for jump in self.jumps if jump.role == ACTIVE]:
            jump = mine[0]
            return (
                f"{self.name}: {jump.link.replace('_', ' ')} of the reaching person jumps at frame {jump.frame} "
                f"({jump.speed_m_s:.1f} m/s)"
            )
        return None

    @property
    def usable_for_learning(self) -> bool:
        """Whether nothing speaks against learning from it."""
        return self.unfit is None


def load_reach_recordings(
    folder: str | Path, model: HumanModel | None = None, config: ReachRecordingConfig | None = None
) -> tuple[ReachRecording, ...]:
    """Return the recordings of a folder by name; other files are not looked at.

    Args:
        folder: holds `<name>_active.csv` and `<name>_passive.csv`.
        model: the human whose DoFs are the columns; P2's 23-DoF human if None.
        config: thresholds.

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
    model = model or HumanModel.mocap23()
    return tuple(
        read_reach_recording(name, files[ACTIVE][name], files[PASSIVE][name], model, config)
        for name in sorted(files[ACTIVE])
    )


def read_reach_recording(
    name: str, active: Path, passive: Path, model: HumanModel, config: ReachRecordingConfig | None = None
) -> ReachRecording:
    """Return one recording; errors as `load_reach_recordings` has them."""
    config = config or ReachRecordingConfig()
    tables = {role: _read(name, role, path, model.dof_names) for role, path in ((ACTIVE, active), (PASSIVE, passive))}
    stamps = {role: table[:, 0] for role, table in tables.items()}
    if len(stamps[ACTIVE]) != len(stamps[PASSIVE]):
        raise MotionError(
            f"recording {name}: wanted as many frames of both people, got {len(stamps[ACTIVE])} {ACTIVE} and "
            f"{len(stamps[PASSIVE])} {PASSIVE}; cut both to the frames they share"
        )
    apart = np.abs(stamps[ACTIVE] - stamps[PASSIVE])
    if apart.max() > config.synchrony_s:
        k = int(np.argmax(apart > config.synchrony_s))
        raise MotionError(
            f"recording {name}: wanted both people at the same times, at frame {k} they are {1e3 * apart[k]:.1f} ms "
            f"apart ({1e3 * config.synchrony_s:.1f} ms are allowed); resample one of them to the other's stamps"
        )
    motions: dict[str, Motion] = {}
    notes: list[str] = []
    jumps: list[Jump] = []
    for role, table in tables.items():
        # Both get the active person's stamps: what differs is less than the clock's accuracy.
        motion = _motion(f"recording {name}, {role}", stamps[ACTIVE], table[:, 1:], model.dof_names)
        motions[role] = unwrap_angles(motion)
        notes += [f"{role}: {text}" for text in (*_wraps(motion, motions[role]), *_gaps(motion, config))]
        jumps += find_jumps(motions[role], role, model, config)
    notes += [
        f"{jump.role}: {jump.link.replace('_', ' ')} jumps at frame {jump.frame} ({jump.speed_m_s:.1f} m/s)"
        for jump in jumps
    ]
    return ReachRecording(name, motions[ACTIVE], motions[PASSIVE], tuple(jumps), tuple(notes), config.least_frames)


def find_jumps(
    motion: Motion, role: str, model: HumanModel, config: ReachRecordingConfig | None = None
) -> tuple[Jump, ...]:
    """Return the isolated steps of elbow, wrist or palm that are faster than a person, at most one for each frame."""
    config = config or ReachRecordingConfig()
    places = model.forward(motion.q)
    path = np.stack([places[link] for link in WATCHED_LINKS], axis=1)
    speed = np.linalg.norm(np.diff(path, axis=0), axis=-1) / np.diff(motion.t_s)[:, None]
    found = []
    for k in np.flatnonzero((speed > config.jump_speed_m_s).any(axis=1)):
        around = np.median(speed[max(0, k - 5) : k + 6], axis=0)
        isolated = np.logical_and(speed[k] > config.jump_speed_m_s, speed[k] > config.jump_isolation * around)
        if isolated.any():
            fastest = int(np.argmax(np.where(isolated, speed[k], 0.0)))
            found.append(Jump(role, int(k) + 1, WATCHED_LINKS[fastest], float(speed[k, fastest])))
    return tuple(found)


def _motion(name: str, t_s: FloatArray, q: FloatArray, dof_names: tuple[str, ...]) -> Motion:
    try:
        return Motion(t_s - t_s[0], q, dof_names, frame_id=FRAME_ID)
    except MotionError as trouble:
        raise MotionError(f"{name}: {str(trouble).removeprefix('-/0: ')}; correct or remove the recording") from trouble


def _wraps(before: Motion, after: Motion) -> list[str]:
    changed = np.abs(before.q - after.q) > 0.5  # by whole turns or not at all
    return [
        f"{before.dof_names[d]} wraps at frame {int(np.argmax(changed[:, d]))}, unwrapped"
        for d in np.flatnonzero(changed.any(axis=0))
    ]


def _gaps(motion: Motion, config: ReachRecordingConfig) -> list[str]:
    step = np.diff(motion.t_s)
    late = np.flatnonzero(step > config.gap_factor * np.median(step))
    return [f"{1e3 * step[k]:.0f} ms without a frame before frame {int(k) + 1}" for k in late]


def _read(name: str, role: str, path: Path, dof_names: Sequence[str]) -> FloatArray:
    """Return the stamps and DoFs (T, 1 + D) of one file, in the order of `dof_names`."""
    where = f"recording {name}, {role} ({path})"
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as trouble:
        raise LibraryFormatError(f"{where}: cannot be read as CSV ({trouble})") from trouble
    header = [title.strip() for title in rows[0]] if rows else []
    wanted = ["t", *dof_names]
    if lacking := [title for title in wanted if title not in header]:
        raise LibraryFormatError(
            f"{where}: wanted the columns t and the {len(dof_names)} DoFs, got no {', '.join(lacking)}; add them"
        )
    columns = [header.index(title) for title in wanted]
    table = np.empty((len(rows) - 1, len(wanted)))
    for frame, row in enumerate(rows[1:]):
        try:
            table[frame] = [float(row[column]) for column in columns]
        except (ValueError, IndexError) as trouble:
            raise LibraryFormatError(
                f"{where}: wanted {len(header)} numbers in a row, got {len(row)} fields at frame {frame} ({trouble})"
            ) from trouble
    if len(table) < 2:
        raise LibraryFormatError(f"{where}: wanted at least 2 frames, got {len(table)}")
    if not np.isfinite(table).all():
        frame, column = (int(i) for i in np.argwhere(~np.isfinite(table))[0])
        raise LibraryFormatError(
            f"{where}: wanted finite numbers, got {table[frame, column]} for {wanted[column]} at frame {frame}; "
            "fill or cut the gap first"
        )
    return table
