"""Reads one person's CSV file of a two-person recording, and refuses what would be misread in silence.

A header names the columns, in any order: `t` in seconds, one for each DoF; further columns are not looked at. A byte
order mark, Windows' line ends, blank lines and blanks around names do no harm.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray

TIME = "t"


def read_table(where: str, path: Path, dof_names: Sequence[str]) -> FloatArray:
    """Return the stamps and DoFs (T, 1 + D) of a file, in the order of `dof_names`.

    Args:
        where: what the file is, for messages.
        path: the file.
        dof_names: D names of columns.

    Raises:
        LibraryFormatError: a file that cannot be read, lacks columns or has them twice, rows of other lengths, fields
            that are no finite numbers, less than 2 frames.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (OSError, UnicodeDecodeError, csv.Error) as trouble:
        raise LibraryFormatError(
            f"{where}: wanted a CSV file in UTF-8, it cannot be read ({trouble}); save it again as one"
        ) from trouble
    if not rows:
        raise LibraryFormatError(f"{where}: wanted a header and rows of numbers, got an empty file; record it again")
    header = [title.strip() for title in rows[0]]
    wanted = [TIME, *dof_names]
    _check_header(where, header, wanted)
    columns = [header.index(title) for title in wanted]
    table = np.empty((len(rows) - 1, len(wanted)))
    for frame, row in enumerate(rows[1:]):
        if len(row) != len(header):
            raise LibraryFormatError(
                f"{where}: wanted {len(header)} fields in a row, as the header has, got {len(row)} at frame {frame}; "
                "correct the row, it may be cut off or shifted"
            )
        for k, column in enumerate(columns):
            table[frame, k] = _number(where, row[column], wanted[k], frame)
    if len(table) < 2:
        raise LibraryFormatError(f"{where}: wanted at least 2 frames, got {len(table)}; remove the recording")
    return table


def _check_header(where: str, header: list[str], wanted: list[str]) -> None:
    lacking = [title for title in wanted if title not in header]
    if len(lacking) == len(wanted):
        hint = "the first row has to be the header, with a comma between names"
        raise LibraryFormatError(
            f"{where}: wanted the columns {wanted[0]}, {wanted[1]}, {wanted[2]} and so on, got a first row of "
            f"{len(header)} fields that begins with {header[0]!r:.40}; {hint}"
        )
    if lacking:
        raise LibraryFormatError(
            f"{where}: wanted the columns {TIME} and the {len(wanted) - 1} DoFs, got no {', '.join(lacking)}; add them"
        )
    if doubled := [title for title in wanted if header.count(title) > 1]:
        raise LibraryFormatError(
            f"{where}: wanted each column once, got {', '.join(doubled)} more than once; remove the wrong one"
        )


def _number(where: str, text: str, column: str, frame: int) -> float:
    try:
        # Python reads 1_0 as 10; in a file it is a slip.
        value = float("" if "_" in text else text)
    except ValueError as trouble:
        raise LibraryFormatError(
            f"{where}: wanted a number, got {text!r:.40} for {column} at frame {frame}; correct it"
        ) from trouble
    if not np.isfinite(value):
        raise LibraryFormatError(
            f"{where}: wanted finite numbers, got {value} for {column} at frame {frame}; fill or cut the gap first"
        )
    return value
