"""What P1 published in Fig. 9, read from where the papers' data lie, to stand beside what is measured here."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray

#: Where the papers' data folder keeps it, relative to the folder a library lies in.
FIG9_BESIDE_LIBRARY = Path("reference") / "fig9_costs.csv"
#: The file's names for what the arm goes by, and the ones used here.
PREDICTION, CURRENT = "prediction", "current_occupancy"


@dataclass(frozen=True, eq=False)
class PublishedCosts:
    """P1's Fig. 9.

    Attributes:
        goals: names, as in the scene face_to_face.
        prediction, current: (steps, goals) cost of each candidate.
    """

    goals: tuple[str, ...]
    prediction: FloatArray
    current: FloatArray

    def switch(self, costs: FloatArray) -> int | None:
        """Return the step, from 1, in which another candidate than in the first is cheapest; None if none ever is."""
        cheapest = costs.argmin(axis=1)
        changed = np.flatnonzero(cheapest != cheapest[0])
        return int(changed[0]) + 1 if len(changed) else None


def fig9_beside(library: Path) -> PublishedCosts | None:
    """Return Fig. 9, None if it does not lie beside the library.

    Raises:
        UsageError: a file of other content.
    """
    path = library.resolve().parent / FIG9_BESIDE_LIBRARY
    return read_fig9(path) if path.is_file() else None


def read_fig9(path: Path) -> PublishedCosts:
    """Return Fig. 9 from a CSV file with the columns variant, step (from 1), goal (from 0), cup and cost.

    Raises:
        UsageError: a file that cannot be read, or of other content.
    """
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = [
                (r["variant"], int(r["step"]), int(r["goal"]), r["cup"], float(r["cost"]))
                for r in csv.DictReader(stream)
            ]
        names = {goal: cup for _, _, goal, cup, _ in rows}
        n_steps = max(step for _, step, _, _, _ in rows)
        costs = {variant: np.full((n_steps, len(names)), np.nan) for variant in (PREDICTION, CURRENT)}
        for variant, step, goal, _, cost in rows:
            costs[variant][step - 1, goal] = cost
    except (OSError, KeyError, IndexError, TypeError, ValueError) as trouble:
        raise UsageError(
            f"{path}: wanted a CSV file with the columns variant, step, goal, cup and cost, got "
            f"{type(trouble).__name__}: {trouble}; correct or remove it"
        ) from trouble
    if not all(np.isfinite(array).all() for array in costs.values()):
        raise UsageError(f"{path}: wanted a cost for every step and goal of {PREDICTION} and {CURRENT}; complete it")
    return PublishedCosts(tuple(names[goal] for goal in sorted(names)), costs[PREDICTION], costs[CURRENT])
