"""One way to load a motion library, whatever form it is stored in; and how folders of CSV files are read.

Class files, one for each class, are the form of the papers' recordings. Three layouts are read; the class is the number
in the file name:

- `class_<k>.csv` with header `traj_id,frame,<DoFs>`: stamps are assumed, one frame period apart;
- `class_<k>.csv` with header `traj_id,raw_frame,t_s,<DoFs>`: recorded stamps;
- `compound_<k>.csv` without header: frame and the 12 DoFs, a motion starts where the frame is 0 (docs/papers.md,
  P1 library).

Other files, long ones with a column of labels or one for each reach, are read by `csv_reaches`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import read_library_bag
from humanpred_ros.motion.csv_files import Table, read_rows, read_table
from humanpred_ros.motion.csv_reaches import reach_files, read_reach_files
from humanpred_ros.motion.labels import label_order
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.reach_recordings import ACTIVE, FRAME_ID, load_reach_recordings

#: Assumed where a library has no stamps: 100 frames then last 1.65 s, as long as the recorded motion 77 of library_a.
DEFAULT_FRAME_PERIOD_S = 1.0 / 60.0

_CLASS_FILE = re.compile(r"(class|compound)_([0-9]{1,6})\.csv", re.IGNORECASE)
#: Files of bags, in lower case.
BAG_SUFFIXES = (".mcap", ".db3", ".bag", ".mcap.zstd", ".db3.zstd")
#: What is to be done with other files that people have, by suffix.
_ADVICE = {
    ".c3d": "this is C3D, recordings of markers: import it with --markers NAMES.yaml",
    ".trc": "this is TRC, recordings of markers: import it with --markers NAMES.yaml",
    ".bvh": "this is BVH, which is not read yet: export it as C3D, or joint positions to a bag (--skeleton)",
    ".npz": "this is NumPy's, as AMASS publishes: it is not read; put joint positions into a bag (--skeleton)",
    ".zip": "this is an archive: unpack it and name the folder in it",
}
_FRAME_COLUMNS = ("frame", "raw_frame")


def load_library(
    path: str | Path,
    *,
    frame_period_s: float = DEFAULT_FRAME_PERIOD_S,
    points: bool = True,
    body: str | None = None,
) -> MotionLibrary:
    """Return all motions of a folder of CSV files, a rosbag2 directory, or an .mcap file.

    Class files hold the 12 DoFs of a Kinect's human or the 23 of motion capture's; their columns say which. Of a folder
    of two-person recordings (`reach_recordings`) the library is what the reaching people did, without classes.

    Args:
        path: the library.
        frame_period_s: seconds between frames where a CSV library has no stamps; bags have them.
        points: whether the skeleton points that bags may hold are wanted, too; without them reading takes half as long.
        body: which tracked body of a bag with several.

    Raises:
        LibraryFormatError: nothing of that name, nothing of these kinds, or unusable CSV.
        MotionError: recordings of two people that cannot be used.
        BagError: unusable bag.
    """
    path = Path(path)
    if not path.exists():
        raise LibraryFormatError(f"{path}: wanted a motion library (CSV folder or bag), there is nothing of that name")
    if path.is_dir() and (files := class_files(path)):
        human = HumanModel.mocap23()
        if _columns(next(iter(files.values()))).issuperset(name.casefold() for name in human.dof_names):
            return read_csv_library(path, frame_period_s=frame_period_s, dof_names=human.dof_names, frame_id=FRAME_ID)
        return read_csv_library(path, frame_period_s=frame_period_s)
    names = [path.name.lower()] if path.is_file() else [entry.name.lower() for entry in path.iterdir()]
    if any(name == "metadata.yaml" or name.endswith(BAG_SUFFIXES) for name in names):
        return read_library_bag(path, points=points, body=body)
    if any(path.glob(f"*_{ACTIVE}.csv")):
        return _reaching_people(path)
    if reaches := reach_files(path):
        return read_reach_files(path, reaches, frame_period_s)
    kinds = {Path(name).suffix for name in names}
    hint = next((f"; {advice}" for suffix, advice in _ADVICE.items() if suffix in kinds), "")
    raise LibraryFormatError(
        f"{path}: wanted CSV files (class_<k>.csv, <name>_{ACTIVE}.csv, one with a column of labels, or one for each "
        f"reach in folders named by label), or a bag (folder, .mcap, .db3, .bag), got none of these{hint}"
    )


def _columns(path: Path) -> set[str]:
    """Return the titles in a file's first line, in lower case, without units; the reader says what is wrong with it."""
    try:
        return {re.split(r"[\[(]", title)[0].strip().casefold() for title in read_rows(path, most=1)[0][1]}
    except LibraryFormatError:
        return set()


def _reaching_people(folder: Path) -> MotionLibrary:
    recordings = load_reach_recordings(folder)
    motions = tuple(replace(recording.active, index=k) for k, recording in enumerate(recordings))
    name = folder.resolve().name
    provenance = {
        "format": "two-person recordings",
        "source": name,
        "stamps": "recorded",
        "recordings": "; ".join(f"{m.name} is {r.name}" for m, r in zip(motions, recordings, strict=True)),
    }
    if doubtful := [recording.unfit for recording in recordings if recording.unfit]:
        provenance["doubtful"] = "; ".join(doubtful)
    return MotionLibrary(name, motions, provenance)


def class_files(folder: Path) -> dict[str, Path]:
    """Return the class files of a folder by class, ascending; empty if there are none.

    Raises:
        LibraryFormatError: two files for one class.
    """
    found: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        match = _CLASS_FILE.fullmatch(path.name)
        if match is None or not path.is_file():
            continue
        label = str(int(match[2]))
        if label in found:
            raise LibraryFormatError(
                f"{folder}: wanted one file per class, got {found[label].name} and {path.name} for class {label}; "
                "move one of them away"
            )
        found[label] = path
    return dict(sorted(found.items(), key=lambda file: label_order(file[0])))


def read_csv_library(
    folder: str | Path,
    *,
    frame_period_s: float = DEFAULT_FRAME_PERIOD_S,
    dof_names: Sequence[str] = KINECT12_DOFS,
    frame_id: str = "kinect",
) -> MotionLibrary:
    """Return the motions of a folder of class files, by class and then in file order; drops nothing.

    Args:
        folder: holds `class_<k>.csv` or `compound_<k>.csv`; other files are not looked at.
        frame_period_s: seconds between frames of files without stamps.
        dof_names: the D columns wanted; they may stand in another order in the file.
        frame_id: frame in which the postures are expressed.

    Raises:
        LibraryFormatError: no class files, or a file that cannot be used, with its line.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise LibraryFormatError(f"{folder}: wanted a folder of class_<k>.csv files, there is no such folder")
    if not (np.isfinite(frame_period_s) and frame_period_s > 0):
        raise LibraryFormatError(f"wanted a positive frame period in seconds, got {frame_period_s}")
    files = class_files(folder)
    if not files:
        raise LibraryFormatError(
            f"{folder}: wanted files named class_<k>.csv or compound_<k>.csv (k = class number), found none"
        )
    motions: list[Motion] = []
    stamps: set[str] = set()
    not_read: set[str] = set()
    for label, path in files.items():
        table = _read_class_file(path, tuple(dof_names))
        not_read.update(table.not_read)
        stamps.add("recorded" if "t_s" in table.columns else f"assumed: one frame every {frame_period_s:.9g} s")
        q = table.rows[:, [table.columns.index(name) for name in dof_names]]
        for index, rows in _trajectories(table):
            t_s = _stamps(table, rows, frame_period_s)
            motions.append(Motion(t_s, q[rows], tuple(dof_names), label, index, frame_id))
    name = folder.resolve().name
    provenance = {"format": "csv", "source": name, "stamps": "; some files ".join(sorted(stamps, reverse=True))}
    if not_read:
        provenance["columns not read"] = ", ".join(sorted(not_read))
    return MotionLibrary(name, tuple(motions), provenance)


def _read_class_file(path: Path, dof_names: tuple[str, ...]) -> Table:
    if path.name.lower().startswith("compound"):
        return read_table(path, ("frame", *dof_names), headless=True)
    table = read_table(path, ("traj_id", *dof_names), optional=(*_FRAME_COLUMNS, "t_s"), further=True)
    if not set(_FRAME_COLUMNS) & set(table.columns):
        raise LibraryFormatError(f"{path}: columns missing: frame (or raw_frame); number the frames of each motion")
    return table


def _trajectories(table: Table) -> Iterator[tuple[int, slice]]:
    """Yield (index, rows) of each motion in the file, in file order."""
    path = table.path
    if "traj_id" in table.columns:
        ids = table["traj_id"]
        wrong = (ids != np.round(ids)) | (ids < 0)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise LibraryFormatError(f"{path}:{table.lines[row]}: traj_id: wanted a whole number >= 0, got {ids[row]}")
        starts = np.flatnonzero(np.concatenate([[True], np.diff(ids) != 0]))
    else:
        frames = table["frame"]
        ids = np.cumsum(frames == 0) - 1
        if frames[0] != 0:
            raise LibraryFormatError(f"{path}:{table.lines[0]}: frame: wanted 0 at the start, got {frames[0]:g}")
        starts = np.flatnonzero(frames == 0)
    seen: set[int] = set()
    for start, stop in zip(starts.tolist(), [*starts[1:].tolist(), len(ids)], strict=True):
        index = int(ids[start])
        line = table.lines[start]
        if index in seen:
            raise LibraryFormatError(f"{path}:{line}: trajectory {index} appears twice; wanted its rows together")
        seen.add(index)
        if stop - start < 2:
            raise LibraryFormatError(f"{path}:{line}: trajectory {index}: wanted at least 2 frames, got 1")
        yield index, slice(start, stop)


def _stamps(table: Table, rows: slice, frame_period_s: float) -> FloatArray:
    frame = next(name for name in _FRAME_COLUMNS if name in table.columns)
    timed = "t_s" in table.columns
    # Whole nanoseconds are what a Motion keeps: two stamps that differ by less are one.
    ticks = np.round(table["t_s"][rows] * 1e9) if timed else table[frame][rows]
    late = np.diff(ticks) <= 0
    if late.any():
        row = rows.start + int(np.argmax(late)) + 1
        name = "t_s" if timed else frame
        values = table[name]
        raise LibraryFormatError(
            f"{table.path}:{table.lines[row]}: {name}: wanted values that increase within a trajectory, "
            f"got {values[row]:.9g} after {values[row - 1]:.9g}"
        )
    relative: FloatArray = ticks - ticks[0]
    return relative * 1e-9 if timed else relative * frame_period_s
