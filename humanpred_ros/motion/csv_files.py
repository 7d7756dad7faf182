"""Reads CSV files of numbers, and refuses what would be misread without notice.

A header names the columns, in any order. A byte order mark, Windows' line ends, blank lines, quotation marks and blanks
around titles are accepted. Everything else that is not a table of finite numbers is an error with its line.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.files import read_text
from humanpred_ros.geometry.checks import FloatArray


@dataclass(frozen=True)
class Table:
    """The numbers of a file."""

    path: Path  #: the file
    columns: tuple[str, ...]  #: C titles
    rows: FloatArray  #: (R, C) numbers
    lines: Sequence[int]  #: the line each row stands on

    def __getitem__(self, column: str) -> FloatArray:
        return np.asarray(self.rows[:, self.columns.index(column)])


def read_rows(path: Path, delimiter: str = ",", most: int | None = None) -> list[tuple[int, list[str]]]:
    """Return the line and the fields, without blanks around them, of each row that is not blank.

    Args:
        path: the file.
        delimiter: between fields.
        most: rows wanted; all if None.

    Raises:
        LibraryFormatError: a file that is no text in UTF-8, no CSV, or has no rows.
    """
    try:
        reader = csv.reader(io.StringIO(read_text(path, LibraryFormatError), newline=""), delimiter=delimiter)
        rows = [(reader.line_num, [field.strip() for field in row]) for row in islice(reader, most)]
    except csv.Error as trouble:
        raise LibraryFormatError(f"{path}: wanted a table, it cannot be read ({trouble})") from trouble
    rows = [(line, row) for line, row in rows if any(row)]
    if not rows:
        raise LibraryFormatError(f"{path}: wanted a header and rows of numbers, got an empty file")
    return rows


def read_records(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file as texts by title, those beyond the header left out; raises as `read_rows`."""
    (_, header), *rows = read_rows(path)
    return [dict(zip(header, row, strict=False)) for _, row in rows]


def read_table(
    path: Path,
    wanted: Sequence[str],
    *,
    optional: Sequence[str] | None = None,
    headless: bool = False,
    gaps: bool = False,
) -> Table:
    """Return the columns of a file that are `wanted`, and those that are optional, in the order of the file.

    Args:
        path: the file.
        wanted: titles that must be there, each once.
        optional: titles that may be there; no others are accepted. If None, others are accepted and not read.
        headless: the file has no header; its columns are those wanted.
        gaps: an empty field, or nan, is NaN instead of an error.

    Raises:
        LibraryFormatError: a file that cannot be read; titles that are missing, unknown or doubled; no rows; a row of
            another length; a field that is no finite number.
    """
    rows = read_rows(path)
    header = list(wanted) if headless else _checked_header(path, *rows.pop(0), wanted, optional)
    if not rows:
        raise LibraryFormatError(f"{path}: wanted rows of numbers below the header, got none")
    known = {*wanted, *(optional or ())}
    chosen = [k for k, title in enumerate(header) if title in known]
    for line, row in rows:
        if len(row) != len(header):
            raise LibraryFormatError(
                f"{path}:{line}: wanted {len(header)} fields, got {len(row)}; repair the row, it may be cut off or "
                "shifted"
            )
    texts = [[row[k] for k in chosen] for _, row in rows]
    if gaps:
        texts = [[text or "nan" for text in row] for row in texts]
    try:
        numbers = np.array(texts, dtype=np.float64)
        sound = (np.isfinite(numbers) | gaps).all() and not any("_" in text for row in texts for text in row)
    except ValueError:
        sound = False
    if not sound:
        for (line, _), row in zip(rows, texts, strict=True):
            for k, text in zip(chosen, row, strict=True):
                _check_number(f"{path}:{line}: column {header[k]}", text, gaps)
    return Table(path, tuple(header[k] for k in chosen), numbers, [line for line, _ in rows])


def _checked_header(
    path: Path, line: int, header: list[str], wanted: Sequence[str], optional: Sequence[str] | None
) -> list[str]:
    known = {*wanted, *(optional or ())}
    twice = sorted(title for title, count in Counter(header).items() if count > 1 and title in known)
    missing = [title for title in wanted if title not in header]
    unknown = [] if optional is None else [title for title in header if title not in known]
    for titles, what in ((twice, "twice"), (unknown, "unknown"), (missing, "missing")):
        if titles:
            hint = ""
            if len(missing) == len(wanted):
                hint = f"; the first row begins with {header[0]!r:.40}: it has to be the header, with commas between"
            others = "" if optional is None else f", and perhaps {', '.join(optional)}"
            raise LibraryFormatError(
                f"{path}:{line}: columns {what}: {', '.join(titles):.300}; wanted {', '.join(wanted)}{others}{hint}"
            )
    return header


def number_in(text: str) -> float | None:
    """Return the number that a field holds, None if it holds none; 1_0, which Python reads as 10, is a mistake."""
    try:
        return float("" if "_" in text else text)
    except ValueError:
        return None


def _check_number(where: str, text: str, gaps: bool) -> None:
    value = number_in(text)
    if value is None:
        raise LibraryFormatError(f"{where}: wanted a number, got {text!r:.40}; correct it")
    if not np.isfinite(value) and not gaps:
        raise LibraryFormatError(f"{where}: wanted a finite number, got {value}; repair or remove the motion")
