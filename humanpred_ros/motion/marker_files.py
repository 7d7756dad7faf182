"""Reads recordings of markers: C3D, TRC, and CSV in two layouts.

- C3D: labels, frame rate and unit are in the file. Needs the package ezc3d (`pip install 'humanpred_ros[markers]'`).
- TRC: a table with tabs; labels stand above X1 Y1 Z1, unit and rate in the third line.
- CSV with one header: columns `t` (or `time`, `time_s`) in seconds and `<marker>_x`, `<marker>_y`, `<marker>_z` (also
  with a point, colon or blank before x, y, z, in any case). Without a column of times the frame rate has to be given.
- CSV with two headers, as Vicon Nexus exports "Trajectories": labels above columns X, Y, Z, rate in the second line,
  units in the line below.

A marker is hidden where a coordinate is empty or nan, and where all three are exactly 0, which many programs write.
"""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.files import arrays_in, open_plain
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.csv_files import number_in, read_rows, read_table

SUFFIXES = (".c3d", ".trc", ".csv")
_TIMES = ("t", "time", "time_s")
_COORDINATE = re.compile(r"(?P<marker>.+?)[_.: ](?P<axis>[xyz])", re.IGNORECASE)


@dataclass(frozen=True)
class MarkerRecording:
    """One take."""

    path: Path  #: the file
    names: tuple[str, ...]  #: M labels as the file has them
    points: FloatArray  #: (T, M, 3) positions in the file's unit and axes, NaN where hidden
    t_s: FloatArray  #: (T,) stamps, rising
    unit: str | None  #: what the file says about its unit ("mm"), None if it says nothing

    @property
    def name(self) -> str:
        """The file's name without its suffix."""
        return self.path.stem


def read_marker_file(path: Path, rate_hz: float | None = None) -> MarkerRecording:
    """Return the take in a C3D, TRC or CSV file.

    Args:
        path: the file; its suffix, in any case, tells the format.
        rate_hz: frames per second; None: what the file says.

    Raises:
        LibraryFormatError: another kind of file; one that cannot be read; without markers, frames or times.
        UsageError: a C3D file, and ezc3d is not installed.
    """
    reader = {".c3d": _read_c3d, ".trc": _read_trc, ".csv": _read_csv}.get(path.suffix.lower())
    if reader is None or not path.is_file():
        raise LibraryFormatError(f"{path}: wanted a file of markers that ends with {', '.join(SUFFIXES)}")
    names, points, t_s, unit, own_rate_hz = reader(path)
    rate_hz = rate_hz or own_rate_hz
    if not names or len(points) < 2:
        raise LibraryFormatError(f"{path}: wanted markers in at least 2 frames, got {len(names)} in {len(points)}")
    if t_s is None:
        if not rate_hz or not np.isfinite(rate_hz):
            raise LibraryFormatError(f"{path}: wanted a column of times or a frame rate, got neither; state rate_hz")
        t_s = np.arange(len(points)) / rate_hz
    if not np.isfinite(t_s).all() or (np.diff(t_s) <= 0).any():
        k = int(np.argmax(~(np.diff(t_s) > 0)))
        raise LibraryFormatError(
            f"{path}: wanted rising times, got {t_s[k]} s and then {t_s[k + 1]} s in frame {k + 1}"
        )
    hidden = ~np.isfinite(points).all(axis=2) | (points == 0.0).all(axis=2)
    return MarkerRecording(path, tuple(names), np.where(hidden[..., None], np.nan, points), t_s, unit)


#: What a reader returns: labels, points (T, M, 3), and if the file has them: stamps (T,), unit, frame rate.
_Content = tuple[list[str], FloatArray, FloatArray | None, str | None, float | None]


def _read_c3d(path: Path) -> _Content:
    if find_spec("ezc3d") is None:
        raise UsageError(
            f"{path}: wanted the package ezc3d, which reads C3D files, it is not installed; install it with: "
            "pip install 'humanpred_ros[markers]'"
        )
    open_plain(path, LibraryFormatError).close()
    # An absolute path: to ezc3d's program a name that begins with a dash would be something else.
    command = [sys.executable, "-m", "humanpred_ros.motion.c3d_reader", str(path.resolve())]
    done = subprocess.run(command, capture_output=True, check=False, stdin=subprocess.DEVNULL)
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2] or f"status {done.returncode}"
        raise LibraryFormatError(f"{path}: wanted a C3D file with markers, it cannot be read ({said:.200})")
    found = arrays_in(done.stdout, path, LibraryFormatError)
    labels, units = ([str(text)[1:] for text in found[name]] for name in ("labels", "units"))
    points = np.where(found["lost"][..., None], np.nan, found["points"])
    return labels, points, None, units[0] if units else None, float(found["rate"])


def _read_trc(path: Path) -> _Content:
    rows = read_rows(path, "\t")
    facts: dict[str, str] = {}
    if len(rows) > 2:
        facts = {title.lower(): value for title, value in zip(rows[1][1], rows[2][1], strict=False)}
    rate = facts.get("datarate")
    rate_hz = number_in(rate) if rate else None
    if rate and rate_hz is None:
        raise LibraryFormatError(f"{path}: DataRate: wanted a number, got {rate!r}")
    names, points, columns = _two_headers(path, rows, re.compile(r"[xyz]\d+", re.IGNORECASE))
    return names, points, columns.get("time"), facts.get("units") or None, rate_hz


def _read_csv(path: Path) -> _Content:
    rows = read_rows(path)
    header = rows[0][1]
    found: dict[str, dict[str, str]] = {}
    for title in header:
        if match := _COORDINATE.fullmatch(title):
            found.setdefault(match["marker"], {})[match["axis"].lower()] = title
    if not found:
        names, points, _ = _two_headers(path, rows, re.compile("[xyz]", re.IGNORECASE))
        units = {field.lower() for _, row in rows[:8] for field in row} & {"mm", "cm", "m"}
        return names, points, None, units.pop() if len(units) == 1 else None, number_in(rows[1][1][0])
    lacking = sorted(marker for marker, axes in found.items() if len(axes) < 3)
    if lacking:
        raise LibraryFormatError(
            f"{path}: wanted the columns x, y and z of each marker, some of {lacking[0]} are missing"
        )
    times = [title for title in header if title.lower() in _TIMES][:1]
    titles = [title for axes in found.values() for title in (axes["x"], axes["y"], axes["z"])]
    table = read_table(path, [*times, *titles], gaps=True)
    points = np.stack([table[title] for title in titles], axis=1).reshape(len(table.rows), -1, 3)
    return list(found), points, table[times[0]] if times else None, None, None


def _two_headers(
    path: Path, rows: list[tuple[int, list[str]]], axis: re.Pattern[str]
) -> tuple[list[str], FloatArray, dict[str, FloatArray]]:
    """Return labels, points and the other columns of a table with labels above a row of axes (X1 Y1 Z1 or X Y Z)."""
    k = next((k for k, (_, row) in enumerate(rows[:12]) if sum(bool(axis.fullmatch(f)) for f in row) >= 3), 0)
    axes = rows[k][1]
    starts = [c for c, field in enumerate(axes) if axis.fullmatch(field) and field[0].lower() == "x"]
    if not k or [field[:1].lower() for c in starts for field in axes[c : c + 3]] != ["x", "y", "z"] * len(starts):
        raise LibraryFormatError(
            f"{path}: wanted a header with <marker>_x, <marker>_y, <marker>_z, or labels above a row of X, Y, Z; the "
            f"first row begins with {rows[0][1][0]!r:.40}"
        )
    above = rows[k - 1][1]
    names = [above[c] if c < len(above) else "" for c in starts]
    titles = above if above[0] else axes  # TRC has Frame# and Time beside the labels, Nexus beside the axes
    width, first = starts[-1] + 3, k + 1
    while first < len(rows) and number_in(rows[first][1][0]) is None:
        first += 1  # units
    numbers = np.full((len(rows) - first, width), np.nan)
    for t, (line, row) in enumerate(rows[first:]):
        if len(row) > width and any(row[width:]):
            raise LibraryFormatError(f"{path}:{line}: wanted {width} fields, got {len(row)}; repair the row")
        for c, field in enumerate(row[:width]):
            if field and (value := number_in(field)) is None:
                raise LibraryFormatError(f"{path}:{line}: column {c + 1}: wanted a number, got {field!r:.40}")
            numbers[t, c] = value if field else np.nan
    others = {titles[c].lower(): numbers[:, c] for c in range(starts[0]) if c < len(titles)}
    points = np.stack([numbers[:, c : c + 3] for c in starts], axis=1)
    return names, points, others
