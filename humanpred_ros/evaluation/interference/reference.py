"""What P1 published of Table I, read from where the papers' data lie, to stand beside what is measured here."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from humanpred_ros.errors import UsageError

#: Where the papers' data folder keeps it, relative to the folder a library lies in.
TABLE1_BESIDE_LIBRARY = Path("reference") / "table1_runs.csv"
_OURS = "least_penetration"


@dataclass(frozen=True)
class PublishedRow:
    """One human trajectory of P1's Table I: mean and standard deviation over its runs.

    Attributes:
        ours_mean, ours_sd: P1's planner.
        basic_mean, basic_sd: basic STOMP.
    """

    ours_mean: float
    ours_sd: float
    basic_mean: float
    basic_sd: float

    @property
    def ratio(self) -> float:
        """Basic through ours."""
        return self.basic_mean / self.ours_mean


def table1_beside(library: Path) -> dict[int, PublishedRow]:
    """Return the rows of Table I by global id of the human trajectory; none if they do not lie beside the library.

    Raises:
        UsageError: a file of other content.
    """
    path = library.resolve().parent / TABLE1_BESIDE_LIBRARY
    return read_table1(path) if path.is_file() else {}


def read_table1(path: Path) -> dict[int, PublishedRow]:
    """Return Table I from a CSV file with the columns human_traj_id, planner, run and cost.

    Raises:
        UsageError: a file that cannot be read, or of other content.
    """
    costs: dict[int, dict[str, list[float]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                costs.setdefault(int(row["human_traj_id"]), {}).setdefault(row["planner"], []).append(
                    float(row["cost"])
                )
        return {number: _row(by_planner) for number, by_planner in costs.items()}
    except (OSError, KeyError, TypeError, ValueError) as trouble:
        raise UsageError(
            f"{path}: wanted a CSV file with the columns human_traj_id, planner ({_OURS} and another), run and cost, "
            f"got {type(trouble).__name__}: {trouble}; correct or remove it"
        ) from trouble


def _row(by_planner: Mapping[str, list[float]]) -> PublishedRow:
    ours = np.array(by_planner[_OURS])
    (basic,) = (np.array(costs) for planner, costs in by_planner.items() if planner != _OURS)
    return PublishedRow(*(float(f) for f in (ours.mean(), _sd(ours), basic.mean(), _sd(basic))))


def _sd(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else 0.0
