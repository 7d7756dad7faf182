"""Reads CSV files of numbers, and refuses what would be misread without notice.

A header names the columns, in any order and case, perhaps with a unit in brackets, which is converted. Fields lie
between commas, semicolons or tabs; between the last two numbers may have decimal commas. A byte order mark, Windows'
line ends, blank lines, lines of comment (#, %, //), quotation marks, blanks around titles and a delimiter at the end of
every line are accepted. Everything else that is not a table of finite numbers is an error with its line.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.files import read_text
from humanpred_ros.geometry.checks import FloatArray

_COMMENT = re.compile(r"^[ \t]*(?:#|%|//)[^\r\n]*", re.MULTILINE)
_DELIMITERS = ",;\t"
_UNIT = re.compile(r"(.+?)\s*[\[(]\s*([^\])]+?)\s*[\])]")
#: What a unit in a title is of metres, radians and seconds.
UNITS = {
    "m": 1.0, "cm": 1e-2, "mm": 1e-3, "rad": 1.0, "deg": np.pi / 180.0, "°": np.pi / 180.0, "s": 1.0, "ms": 1e-3,
    "us": 1e-6, "ns": 1e-9,
}  # fmt: skip
_LONGEST_HEADER = 100_000
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+(?:[eE][-+]?[0-9]+)?")


@dataclass(frozen=True)
class Table:
    """The numbers of a file."""

    path: Path  #: the file
    columns: tuple[str, ...]  #: C titles
    rows: FloatArray  #: (R, C) numbers
    lines: Sequence[int]  #: the line each row stands on
    not_read: tuple[str, ...] = ()  #: titles of further columns

    def __getitem__(self, column: str) -> FloatArray:
        return np.asarray(self.rows[:, self.columns.index(column)])


def read_rows(path: Path, delimiter: str = "", most: int | None = None) -> list[tuple[int, list[str]]]:
    """Return the line and the fields, without blanks around them, of each row that is not blank.

    Args:
        path: the file.
        delimiter: between fields; the one that the first line has most of if empty.
        most: rows wanted; all if None.

    Raises:
        LibraryFormatError: a file that is no text in UTF-8, no CSV, or has no rows.
    """
    try:
        text = _COMMENT.sub("", read_text(path, LibraryFormatError))
        head = text.lstrip()[:_LONGEST_HEADER].partition("\n")[0]
        delimiter = delimiter or max(_DELIMITERS, key=head.count)  # commas where there are none
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
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
    further: bool = False,
) -> Table:
    """Return the columns of a file that are `wanted`, and those that are optional, in the order of the file.

    Args:
        path: the file.
        wanted: titles that must be there, each once.
        optional: titles that may be there; no others are accepted. If None, others are accepted and not read.
        headless: the file has no header; its columns are those wanted.
        gaps: an empty field, or nan, is NaN instead of an error.
        further: other titles are accepted, and not read, also where some are optional.

    Raises:
        LibraryFormatError: a file that cannot be read; titles that are missing, unknown or doubled; no rows; a row of
            another length; a field that is no finite number.
    """
    rows = read_rows(path)
    known = {*wanted, *(optional or ())}
    factors: dict[str, float] = {}
    header = list(wanted)
    if not headless:
        line, titles = rows.pop(0)
        header = _plain_header(f"{path}:{line}", titles, known, factors)
        _checked_header(path, line, header, wanted, None if further else optional)
        if len(header) < len(titles):  # a delimiter at the end of the lines
            rows = [(line, row[:-1] if len(row) == len(titles) and not row[-1] else row) for line, row in rows]
    if not rows:
        raise LibraryFormatError(f"{path}: wanted rows of numbers below the header, got none")
    chosen = [k for k, title in enumerate(header) if title in known]
    for line, row in rows:
        if len(row) != len(header):
            raise LibraryFormatError(
                f"{path}:{line}: wanted {len(header)} fields, got {len(row)}; repair the row, it may be cut off or "
                "shifted"
            )
    texts = [[_with_point(row[k]) for k in chosen] for _, row in rows]
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
    columns = tuple(header[k] for k in chosen)
    if factors:
        numbers = numbers * [factors.get(title, 1.0) for title in columns]
    not_read = tuple(title for title in header if title not in known)
    return Table(path, columns, numbers, [line for line, _ in rows], not_read)


def _plain_header(where: str, titles: list[str], known: set[str], factors: dict[str, float]) -> list[str]:
    """Return titles as they are known, whatever their case and unit; the factors of units by title.

    Raises:
        LibraryFormatError: a unit that is not known, of a column that is.
    """
    by_case: dict[str, list[str]] = {}
    for name in known:
        by_case.setdefault(name.casefold(), []).append(name)
    header = titles[:-1] if titles and not titles[-1] else list(titles)
    for k, title in enumerate(header):
        if title in known:
            continue
        match = _UNIT.fullmatch(title)
        name, unit = (match[1], match[2]) if match else (title, "")
        found = [name] if name in known else by_case.get(name.casefold(), [])
        if len(found) != 1:
            continue
        header[k] = found[0]
        if unit:
            factor = UNITS.get(unit.casefold())
            if factor is None:
                raise LibraryFormatError(
                    f"{where}: column {title}: wanted a unit among {', '.join(UNITS)}, got {unit!r:.40}"
                )
            factors[found[0]] = factor
    return header


def _with_point(text: str) -> str:
    """Return a number with a decimal point; between commas there are no such fields."""
    return text.replace(",", ".") if "," in text and _DECIMAL_COMMA.fullmatch(text) else text


def _checked_header(
    path: Path, line: int, header: list[str], wanted: Sequence[str], optional: Sequence[str] | None
) -> None:
    known = {*wanted, *(optional or ())}
    twice = sorted(title for title, count in Counter(header).items() if count > 1 and title in known)
    missing = [title for title in wanted if title not in header]
    unknown = [] if optional is None else [title for title in header if title not in known]
    for titles, what in ((twice, "twice"), (unknown, "unknown"), (missing, "missing")):
        if titles:
            hint = ""
            if len(missing) == len(wanted) and header:
                hint = (
                    f"; the first row begins with {header[0]!r:.40}: it has to be the header, with , ; or tabs between"
                )
            elif missing and (further := [title for title in header if title and title not in known]):
                hint = f"; it has {', '.join(further):.200} instead"
            others = "" if optional is None else f", and perhaps {', '.join(optional)}"
            raise LibraryFormatError(
                f"{path}:{line}: columns {what}: {', '.join(titles):.300}; wanted {', '.join(wanted)}{others}{hint}"
            )


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
