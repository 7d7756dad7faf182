"""What lies beside a library: the published recognition curve, and advice on single recordings."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.recognition_scores import PERCENTS, curve_figures

#: Where the papers' data folder keeps them, relative to a library in it.
REFERENCE_BESIDE_LIBRARY = Path("reference") / "authors_fig6_curve.csv"
ADVICE_BESIDE_LIBRARY = "outliers.csv"


def read_reference(path: str | Path) -> dict[str, Any]:
    """Return the curve of a CSV file with the columns phase_percent (1 to 100) and recognition_rate (0 to 1).

    Returns:
        `source`, the name of the file; `rate`, (100,) the share of motions recognised at each percent; `figures` of
        the curve (`curve_figures`).

    Raises:
        UsageError: no such file, or other content.
    """
    path = Path(path)
    percents, rates = [], []
    for line, row in _rows(path, ("phase_percent", "recognition_rate")):
        try:
            percents.append(int(row["phase_percent"]))
            rates.append(float(row["recognition_rate"]))
        except (TypeError, ValueError):
            raise UsageError(f"{path}, line {line}: wanted a whole percent and a rate, got {row}") from None
    rate = np.array(rates)
    if percents != PERCENTS.tolist() or not ((rate >= 0) & (rate <= 1)).all():
        raise UsageError(
            f"{path}: wanted the percents 1 to 100 in order, each with a rate of 0 to 1, got {len(percents)} rows; "
            "complete it or give another file"
        )
    return {"source": path.name, "rate": rate, "figures": curve_figures(rate)}


def reference_beside(library: Path) -> dict[str, Any] | None:
    """Return the published curve that lies beside a library, None if there is none."""
    path = library.resolve().parent / REFERENCE_BESIDE_LIBRARY
    return read_reference(path) if path.exists() else None


def advice_beside(library: Path, name: str) -> Mapping[str, str]:
    """Return the advice on single motions (`class/index`) of the library called `name` that lies beside it.

    The file has the columns set, class, traj_id and advice, of which the first word counts (exclude, suspect,
    keep). Empty if there is no file.

    Raises:
        UsageError: a file with other columns.
    """
    path = library.resolve().parent / ADVICE_BESIDE_LIBRARY
    if not path.exists():
        return {}
    rows = _rows(path, ("set", "class", "traj_id", "advice"))
    return {
        f"{row['class']}/{row['traj_id']}": (row["advice"] or "").split(" ")[0] for _, row in rows if row["set"] == name
    }


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            missing = [column for column in columns if column not in (reader.fieldnames or ())]
            if missing:
                raise UsageError(
                    f"{path}: wanted the columns {', '.join(columns)}, {', '.join(missing)} is missing; "
                    "give a file that has them"
                )
            for row in reader:
                yield reader.line_num, row
    except (OSError, UnicodeDecodeError, csv.Error) as trouble:
        raise UsageError(f"{path}: cannot be read as CSV ({trouble}); give another file") from trouble
