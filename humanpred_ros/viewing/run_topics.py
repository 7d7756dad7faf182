"""The topics of a run and what their messages say, in one place for everything that reads runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.bags.messages import ns_from_stamp, point_cloud2_fields
from humanpred_ros.errors import ArrayError, BagError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.topics import DECISION, VOXEL_GRID
from humanpred_ros.viewing.tracks import GoalPlan, RecordedDecision, SentTrajectory


def stamp_ns(message: Any) -> int:
    """Return the header stamp of a message in nanoseconds."""
    return ns_from_stamp(message.header.stamp)


def positions_of(message: Any, names: Sequence[str]) -> tuple[FloatArray, FloatArray] | None:
    """Return positions and velocities (D,) of the named joints of a JointState, velocities NaN where not told.

    None if a joint is missing or a position is not finite.
    """
    where = {name: k for k, name in enumerate(message.name)}
    if any(where.get(name, len(message.position)) >= len(message.position) for name in names):
        return None
    columns = [where[name] for name in names]
    q = np.asarray(message.position, dtype=np.float64)[columns]
    if not np.isfinite(q).all():
        return None
    told = len(message.velocity) == len(message.position)
    return q, np.asarray(message.velocity, dtype=np.float64)[columns] if told else np.full(len(q), np.nan)


def occupancy_of(message: Any) -> tuple[FloatArray, FloatArray]:
    """Return voxel centres (N, 3) and probabilities (N,) of an occupancy cloud. Raises BagError."""
    fields = point_cloud2_fields(message, ("x", "y", "z", "probability"))
    centres = np.stack([fields[name].astype(np.float64) for name in ("x", "y", "z")], axis=1)
    return centres, fields["probability"].astype(np.float64)


def posterior_of(message: Any) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return labels (C,), probabilities (C,) and goal places (C, 3) of a goals cloud. Raises BagError."""
    fields = point_cloud2_fields(message, ("x", "y", "z", "class_id", "probability"))
    goals = np.stack([fields[name].astype(np.float64) for name in ("x", "y", "z")], axis=1)
    return np.rint(fields["class_id"]).astype(np.int64), fields["probability"].astype(np.float64), goals


def grid_of(text: str) -> VoxelGrid:
    """Return the voxel lattice described by JSON. Raises BagError if the text is something else."""
    try:
        content = json.loads(text)
        return VoxelGrid(tuple(content["origin_m"]), float(content["resolution_m"]), tuple(content["shape"]))
    except (ValueError, KeyError, TypeError, ArrayError) as trouble:
        raise BagError(
            f"topic {VOXEL_GRID}: wanted JSON with origin_m, resolution_m and shape, got {text!r:.80} ({trouble})"
        ) from trouble


def decision_of(message: Any, t_s: float, t_first_occupancy_s: float) -> RecordedDecision:
    """Return the decision in a DiagnosticArray.

    Args:
        message: first status: the decision; the others: one per goal.
        t_s: its stamp in run time.
        t_first_occupancy_s: what the message's own times are counted from, in run time.

    Raises:
        BagError: no status, or values that are not numbers where numbers belong.
    """
    if not len(message.status):
        raise BagError(f"topic {DECISION}: wanted the decision in the first status, got none; is it another node's?")
    head, *others = message.status
    values = _values(head)
    try:
        return RecordedDecision(
            t_s=t_s,
            action=head.message,
            step=int(values.get("step", "-1")),
            chosen=_name(values.get("chosen", "")),
            previous=_name(values.get("previous", "")),
            switched=values.get("switched", "").lower() == "true",
            reason=values.get("reason", ""),
            t_switch_s=t_first_occupancy_s + _number(values, "t_switch_s"),
            compute_s=1e-3 * _number(values, "compute_ms"),
            margin=_number(values, "margin"),
            goals=tuple(_goal(status) for status in others),
        )
    except ValueError as trouble:
        raise BagError(
            f"topic {DECISION}: wanted numbers, got {values} ({trouble}); is it another node's?"
        ) from trouble


def trajectory_of(message: Any, origin_ns: int) -> SentTrajectory:
    """Return a JointTrajectory with its knots in run time; velocities are NaN where not told."""
    start_ns = stamp_ns(message) - origin_ns
    n_joints = len(message.joint_names)
    rows = [[_row(part, n_joints) for part in (point.positions, point.velocities)] for point in message.points]
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 2, n_joints)
    t_s = np.array([(start_ns + ns_from_stamp(point.time_from_start)) * 1e-9 for point in message.points])
    return SentTrajectory(t_s.reshape(-1), table[:, 0], table[:, 1], tuple(message.joint_names))


def _goal(status: Any) -> GoalPlan:
    values = _values(status)
    return GoalPlan(
        name=status.name,
        valid=values.get("valid", "true").lower() == "true",
        message=status.message,
        selection_cost=_number(values, "selection_cost"),
        iterations=int(values.get("iterations", "0")),
        human=_number(values, "human"),
        length=_number(values, "length"),
        warm_start=values.get("warm_start", ""),
        rest=_number(values, "rest"),
        task_cost=_number(values, "task_cost"),
        alternative=int(values.get("alternative", "0")),
        set_aside=values.get("set_aside", ""),
        revived=values.get("revived", "").lower() == "true",
        terms={key.removeprefix("cost/"): float(text) for key, text in values.items() if key.startswith("cost/")},
    )


def _values(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def _number(values: dict[str, str], key: str) -> float:
    text = values.get(key, "")
    return float(text) if text not in ("", "None") else float("nan")


def _name(text: str) -> str:
    return "" if text == "None" else text


def _row(values: Any, length: int) -> FloatArray:
    return np.asarray(values, dtype=np.float64) if len(values) == length else np.full(length, np.nan)
