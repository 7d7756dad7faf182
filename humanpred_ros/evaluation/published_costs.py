"""What P1 published of Table I and Fig. 9, read from where the papers' data lie, to stand beside what is measured."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray

#: Where the papers' data folder keeps Table I, relative to the folder that a library lies in.
TABLE1_BESIDE_LIBRARY = Path("reference") / "table1_runs.csv"
_PUBLISHED_OURS = "least_penetration"
#: Where the papers' data folder keeps Fig. 9, relative to the folder that a library lies in.
FIG9_BESIDE_LIBRARY = Path("reference") / "fig9_costs.csv"
#: That file's names for what the arm goes by, and ours.
FIG9_VARIANTS = {"prediction": "prediction", "current": "current_occupancy"}


def read_table1(folder: Path) -> dict[int, dict[str, float]]:
    """Return P1's Table I by global id: mean and sd of both planners and their ratio; empty if it is not in a folder.

    Raises:
        UsageError: a file without the columns human_traj_id, planner, run and cost.
    """
    path = folder / TABLE1_BESIDE_LIBRARY
    if not path.is_file():
        return {}
    costs: dict[int, dict[bool, list[float]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            for row in csv.DictReader(stream):
                of_motion = costs.setdefault(int(row["human_traj_id"]), {True: [], False: []})
                of_motion[row["planner"] == _PUBLISHED_OURS].append(float(row["cost"]))
        if not all(len(values) for of_motion in costs.values() for values in of_motion.values()):
            raise ValueError("a trajectory with the runs of one planner only")
    except (OSError, KeyError, TypeError, ValueError) as trouble:
        raise UsageError(
            f"{path}: wanted a CSV file with the columns human_traj_id, planner ({_PUBLISHED_OURS} and another), run "
            f"and cost, got {type(trouble).__name__}: {trouble}; correct or remove it"
        ) from trouble
    rows = {}
    for number, of_motion in costs.items():
        ours, basic = np.array(of_motion[True]), np.array(of_motion[False])
        sd = [float(values.std(ddof=1)) if len(values) > 1 else 0.0 for values in (ours, basic)]
        rows[number] = {"ours_mean": float(ours.mean()), "ours_sd": sd[0], "basic_mean": float(basic.mean()),
                        "basic_sd": sd[1], "ratio": float(basic.mean() / ours.mean())}  # fmt: skip
    return rows


def read_fig9(folder: Path) -> dict[str, Any] | None:
    """Return P1's Fig. 9, None if it is not in a folder: `goals`, and costs (steps, goals) by `prediction`, `current`.

    Raises:
        UsageError: a file without the columns variant, step (from 1), goal (from 0), cup and cost, or without a cost
            for every step.
    """
    path = folder / FIG9_BESIDE_LIBRARY
    if not path.is_file():
        return None
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = [
                (r["variant"], int(r["step"]), int(r["goal"]), r["cup"], float(r["cost"]))
                for r in csv.DictReader(stream)
            ]
        names = {goal: cup for _, _, goal, cup, _ in rows}
        n_steps = max(step for _, step, _, _, _ in rows)
        costs = {variant: np.full((n_steps, len(names)), np.nan) for variant in FIG9_VARIANTS.values()}
        for variant, step, goal, _, cost in rows:
            costs[variant][step - 1, goal] = cost
    except (OSError, KeyError, IndexError, TypeError, ValueError) as trouble:
        raise UsageError(
            f"{path}: wanted a CSV file with the columns variant, step, goal, cup and cost, got "
            f"{type(trouble).__name__}: {trouble}; correct or remove it"
        ) from trouble
    if not all(np.isfinite(array).all() for array in costs.values()):
        wanted = " and ".join(FIG9_VARIANTS.values())
        raise UsageError(f"{path}: wanted a cost for every step and goal of {wanted}; complete it")
    return {"goals": [names[goal] for goal in sorted(names)]} | {k: costs[name] for k, name in FIG9_VARIANTS.items()}


def first_switch(costs: Sequence[Sequence[float]] | FloatArray) -> int | None:
    """Return the step, from 1, in which another goal than in the first is cheapest; None if none ever is."""
    cheapest = np.argmin(np.asarray(costs), axis=1)
    changed = np.flatnonzero(cheapest != cheapest[0])
    return int(changed[0]) + 1 if len(changed) else None
