"""The files an evaluation leaves: JSON, CSV and a plot, each written whole or not at all; and the facts it states."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import os
import platform
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from humanpred_ros import __version__
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.parallel import usable_cores
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.resources import replacing
from humanpred_ros.settings import Settings
from humanpred_ros.viewing.figures import report_style

_DPI = 150
#: A list of numbers, which reads better on one line.
_NUMBERS = re.compile(r"\[[-+.\deE\s,nul]+\]")


def check_writable(path: str | Path, *suffixes: str) -> Path:
    """Return `path` if a file can be written there, and if its name ends with one of the suffixes, if any are given.

    Raises:
        UsageError: another suffix, no such folder, a folder of that name, or no right to write.
    """
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: wanted a file name that ends with {' or '.join(suffixes)}; rename it")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: wanted a file in a folder that exists, there is no {path.parent}; make it first")
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise UsageError(f"{path}: wanted a file that can be written, this cannot; choose another")
    return path


def write_json(path: Path, value: Any) -> None:
    """Write `plain(value)`; a file of that name is replaced when the new one is complete.

    Raises:
        UsageError: the file cannot be written.
    """
    text = json.dumps(plain(value), indent=1, allow_nan=False) + "\n"
    text = _NUMBERS.sub(lambda found: " ".join(found[0].split()), text)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_csv(path: Path, heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a CSV file; a file of that name is replaced when the new one is complete.

    Raises:
        UsageError: the file cannot be written.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(heads)
        writer.writerows([plain(value) for value in row] for row in rows)


def write_plot(path: Path, draw: Callable[[], Figure]) -> None:
    """Write what `draw` makes as PNG, SVG or PDF, by the name of the file.

    Raises:
        UsageError: the file cannot be written.
    """
    with replacing(path) as temporary, report_style():
        figure = draw()
        kind = path.suffix.lower().lstrip(".")
        dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # the same figures give the same file
        figure.savefig(temporary, format=kind, dpi=_DPI, facecolor="white", metadata=dates.get(kind))


def plain(value: Any) -> Any:
    """Return a value as JSON knows it: dataclasses as objects, arrays as lists, what is not finite as null."""
    if isinstance(value, Settings):
        return {name: plain(getattr(value, name)) for name in type(value).model_fields}
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def library_facts(library: MotionLibrary, *, by_class: bool = False, **further: Any) -> dict[str, Any]:
    """Return what an evaluation says of the recordings it was made with, and what else there is to say of them."""
    sizes = {label: len(library.of_class(label)) for label in library.labels}
    return {
        "name": library.name,
        "n_motions": len(library),
        **({"motions_per_class": sizes} if by_class else {}),
        **further,
        "provenance": dict(library.provenance),
    }


def machine_facts() -> dict[str, Any]:
    """Return what the times in an evaluation depend on, and the version it was made with."""
    return {
        "package_version": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "platform": platform.platform(),
        "usable_cores": usable_cores(),
    }
