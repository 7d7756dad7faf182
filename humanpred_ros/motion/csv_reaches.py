"""Reaches in CSV files as people write them: one long file with a column of labels, or one file per reach.

A file has a column for each DoF of a human model, and may have times (`t_s`, `time`, `t`, `timestamp`), the label of
each row (`label`, `class`, `action`, `goal`, `place`, `activity`) and the number of its motion (`traj_id`, `motion`,
`trial`, `rep`, `repetition`, `sequence`). A new motion begins where label or number change, or where time steps back.
A folder holds one file per reach, in folders named by their label, or a few long files.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from humanpred_ros.errors import LibraryFormatError, MotionError
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.model import MOCAP23_DOFS
from humanpred_ros.motion.csv_files import Table, read_rows, read_table
from humanpred_ros.motion.labels import checked_label
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.reach_recordings import FRAME_ID

_TIMES = ("t_s", "time", "t", "timestamp")
_LABELS = ("label", "class", "action", "goal", "place", "activity")
_NUMBERS = ("traj_id", "motion", "trial", "rep", "repetition", "sequence")
SUFFIX = ".csv"


def reach_files(path: Path) -> dict[Path, str | None]:
    """Return the CSV files of reaches at a path with the label that their folder gives them; empty if there are none.

    Args:
        path: a file, a folder of files, or a folder of folders of files.
    """
    if path.is_file():
        return {path: None} if path.suffix.lower() == SUFFIX else {}
    found: dict[Path, str | None] = {}
    for entry in sorted(path.iterdir()):
        if entry.is_dir():
            found |= {file: entry.name for file in sorted(entry.iterdir()) if file.suffix.lower() == SUFFIX}
        elif entry.suffix.lower() == SUFFIX:
            found[entry] = None
    return found


def read_reach_files(path: Path, files: dict[Path, str | None], frame_period_s: float) -> MotionLibrary:
    """Return the library of some files of reaches; motions are numbered by class, in the order of files and rows.

    Args:
        path: which they were found at; names the library.
        files: with the label that counts where a file has no column of labels; None: no label.
        frame_period_s: seconds between the rows of files without times.

    Raises:
        LibraryFormatError: a file that cannot be used, with its line.
    """
    motions: list[Motion] = []
    counts: Counter[str | None] = Counter()
    assumed, not_read, short, repeated = 0, set[str](), 0, 0
    for file, label in files.items():
        table, labels = _table(file, label)
        times = next((name for name in _TIMES if name in table.columns), None)
        assumed += times is None
        not_read |= set(table.not_read) - {title for title in table.not_read if title.casefold() in _LABELS}
        dofs = KINECT12_DOFS if KINECT12_DOFS[0] in table.columns and not _is_mocap(table) else MOCAP23_DOFS
        q = table.rows[:, [table.columns.index(name) for name in dofs]]
        for rows in _motions(table, labels, times):
            if rows.stop - rows.start < 2:
                short += 1
                continue
            t_s = table[times][rows] if times else np.arange(rows.stop - rows.start) * frame_period_s
            later = np.diff(t_s, prepend=-np.inf) > 0
            repeated += int((~later).sum())
            whose, frame = labels[rows.start], FRAME_ID if dofs is MOCAP23_DOFS else "kinect"
            try:
                motions.append(Motion(t_s[later] - t_s[0], q[rows][later], dofs, whose, counts[whose], frame))
            except MotionError as error:
                raise LibraryFormatError(f"{file}:{table.lines[rows.start]}: {error}") from error
            counts[whose] += 1
    if not motions:
        raise LibraryFormatError(f"{path}: wanted motions of 2 rows or more, got {short} of one row")
    stamps = "recorded" if not assumed else f"assumed: one frame every {frame_period_s:.9g} s"
    provenance = {"format": "csv", "source": path.name, "stamps": stamps}
    if not_read:
        provenance["columns not read"] = ", ".join(sorted(not_read))
    left_out = {"motions of one row": short, "rows at a time that was told": repeated}
    if any(left_out.values()):
        provenance["left out"] = "; ".join(f"{n} {what}" for what, n in left_out.items() if n)
    return MotionLibrary(path.resolve().stem if path.is_file() else path.resolve().name, tuple(motions), provenance)


def _is_mocap(table: Table) -> bool:
    return set(MOCAP23_DOFS) <= set(table.columns)


def _table(file: Path, label: str | None) -> tuple[Table, list[str | None]]:
    """Return the numbers of a file, and the label of each row."""
    rows = read_rows(file)
    titles = [re.split(r"[\[(]", title)[0].strip().casefold() for title in rows[0][1]]
    mocap = {name.casefold() for name in MOCAP23_DOFS} <= set(titles)
    optional = [name for name in (*_TIMES, *_NUMBERS) if name in titles]
    table = read_table(file, MOCAP23_DOFS if mocap else KINECT12_DOFS, optional=optional, further=True)
    columns = [titles.index(name) for name in _LABELS if name in titles]
    if not columns:
        return table, [None if label is None else checked_label(label, LibraryFormatError)] * len(table.rows)
    by_line = {line: row[columns[0]] for line, row in rows[1:]}
    return table, [checked_label(by_line[line], LibraryFormatError) if by_line[line] else None for line in table.lines]


def _motions(table: Table, labels: list[str | None], times: str | None) -> Iterator[slice]:
    changes = np.array([a != b for a, b in zip(labels[1:], labels[:-1], strict=True)], dtype=np.bool_)
    if times is not None:
        changes |= np.diff(table[times]) < 0
    for name in _NUMBERS:
        if name in table.columns:
            changes |= np.diff(table[name]) != 0
    starts = [0, *(np.flatnonzero(changes) + 1).tolist()]
    for start, stop in zip(starts, [*starts[1:], len(labels)], strict=True):
        yield slice(start, stop)
