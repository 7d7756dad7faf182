"""What was recorded of each part of a run, as arrays on one time axis, and how it is read from messages.

Times `t_s` are data time (header stamps) in seconds after the run's origin, the stamp of the first posture. Every
series may be empty: a run that was interrupted at once still has all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.bags.messages import ns_from_stamp, point_cloud2_fields
from humanpred_ros.errors import ArrayError, BagError
from humanpred_ros.files import json_of
from humanpred_ros.geometry import compact_occupancy
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.topics import COMPACT_OCCUPANCY, DECISION, VOXEL_GRID

_NAN = float("nan")
#: Probabilities travel as float32; what their sum lacks of 1 by rounding is far less than this.
_ROUNDING = 1e-6
#: Numbers of visualization_msgs/Marker.
_ADD, _LINE_STRIP, _LINE_LIST = 0, 4, 5


@dataclass(frozen=True)
class JointTrack:
    """Joints over time: the human's postures, the arm's measured configurations, or a trajectory sent to the arm."""

    t_s: FloatArray  #: (T,) strictly increasing
    q: FloatArray  #: (T, J) metres and radians; endless joints of the arm have no jumps of full turns
    v: FloatArray  #: (T, J) per second; NaN where not told, of the arm differences there
    names: tuple[str, ...] = ()  #: of the J joints
    frame_id: str = ""  #: of the tracker that observed the postures

    def __len__(self) -> int:
        return len(self.t_s)

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return (N, J) positions at times (N,), linear between samples; NaN outside the recorded time."""
        q = np.full((len(t_s), self.q.shape[1]), np.nan)
        for k in range(q.shape[1] if len(self) else 0):
            q[:, k] = np.interp(t_s, self.t_s, self.q[:, k], left=np.nan, right=np.nan)
        return q

    @property
    def motion_end_s(self) -> float:
        """Time of the last posture that differs from the one before: trackers may repeat the last posture."""
        moved = np.flatnonzero(np.any(np.diff(self.q, axis=0) != 0.0, axis=1)) if len(self) > 1 else np.zeros(0)
        return float(self.t_s[int(moved[-1]) + 1]) if len(moved) else 0.0


@dataclass(frozen=True)
class PosteriorTrack:
    """The class posterior after each posture."""

    t_s: FloatArray  #: (T,) strictly increasing
    labels: tuple[str, ...]  #: of all C classes there were, in `motion.label_order`
    #: (T, C); each row sums to 1 less the probability that the motion is of no class; 0 of a class that is not told of
    probability: FloatArray
    goals_m: FloatArray  #: (C, 3) goal place of each class, world frame; the last one told

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def unknown(self) -> FloatArray:
        """(T,) probability of no class; 0 where the classifier took it for granted that the motion is of one."""
        rest = 1.0 - self.probability.sum(axis=1)
        return np.where(rest > _ROUNDING, np.minimum(rest, 1.0), 0.0)

    @property
    def telling(self) -> NDArray[np.bool_]:
        """(T,) whether it tells classes apart; of a person at rest a posterior is a prior that knows all as equal."""
        if len(self.labels) < 2:
            return np.ones(len(self), dtype=np.bool_)
        told: NDArray[np.bool_] = np.ptp(self.probability, axis=1) > _ROUNDING
        return told

    def movements(self, until_s: float = np.inf) -> tuple[slice, ...]:
        """Return the stretches of posteriors up to `until_s` that tell classes apart without interruption."""
        told = self.telling & (self.t_s <= until_s)
        edges = np.flatnonzero(np.diff(told, prepend=False, append=False)).tolist()
        return tuple(slice(first, end) for first, end in zip(edges[::2], edges[1::2], strict=True))

    def most_probable_since(self, movement: slice, column: int) -> int:
        """Return from which posterior of a movement on a class was the most probable; its `stop` if not in the end."""
        other = np.flatnonzero(self.probability[movement].argmax(axis=1) != column)
        return int(movement.start) + (int(other[-1]) + 1 if len(other) else 0)

    def at(self, t_s: float) -> tuple[str | None, float | None]:
        """Return the most probable class and its probability by the last posterior up to `t_s`; None if none is."""
        k = int(np.searchsorted(self.t_s, t_s + 1e-9, side="right")) - 1
        if k < 0 or not self.telling[k]:
            return None, None
        best = int(np.argmax(self.probability[k]))
        return self.labels[best], float(self.probability[k, best])


@dataclass(frozen=True)
class OccupancySnapshot:
    """One occupancy as it was published: voxel centres (N, 3) in the world frame and their probabilities (N,)."""

    t_s: float
    centres_m: FloatArray
    probability: FloatArray


@dataclass(frozen=True)
class OccupancyTrack:
    """The predicted occupancies."""

    t_s: FloatArray  #: (T,) strictly increasing
    n_voxels: NDArray[np.int64]  #: (T,) published
    expected_voxels: FloatArray  #: (T,) sum of their probabilities: the expected number of occupied voxels
    grid: VoxelGrid | None = None  #: the voxel lattice, None if it was not recorded
    snapshots: tuple[OccupancySnapshot, ...] = ()  #: those that replanning steps were computed on, by time
    samples: tuple[OccupancySnapshot, ...] = ()  #: some spread evenly over the human's motion, and some after it

    def __len__(self) -> int:
        return len(self.t_s)


@dataclass(frozen=True)
class LatencyFigures:
    """Median, 99th percentile and maximum of a latency over `count` samples; None without samples."""

    count: int
    median_ms: float | None = None
    p99_ms: float | None = None
    max_ms: float | None = None


@dataclass(frozen=True)
class Latency:
    """Wall-clock delays between two messages that belong together, or times that something took."""

    name: str  #: from what to what
    t_s: FloatArray  #: (N,) data time of the posture each began with
    delay_s: FloatArray  #: (N,) difference of the times of sending

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def figures(self) -> LatencyFigures:
        """What is said of it in short."""
        if not len(self):
            return LatencyFigures(0)
        delay_ms = 1e3 * self.delay_s
        median, p99 = np.percentile(delay_ms, [50.0, 99.0])
        return LatencyFigures(len(self), float(median), float(p99), float(delay_ms.max()))


@dataclass(frozen=True)
class GoalPlan:
    """What a replanning step found for one goal: `planning.decision.GoalReport`, as far as the bag tells."""

    name: str = ""
    valid: bool = True  #: the plan can be executed
    message: str = ""  #: "chosen", "candidate", or why it could not be chosen
    selection_cost: float = _NAN
    iterations: int = 0  #: of STOMP
    terms: Mapping[str, float] = field(default_factory=dict)  #: STOMP's cost terms by name
    human: float = _NAN
    length: float = _NAN
    warm_start: str = ""
    rest: float = _NAN
    task_cost: float = _NAN
    alternative: int = 0
    set_aside: str = ""
    revived: bool = False

    @property
    def eligible(self) -> bool:
        """Whether the goal could have been chosen."""
        return self.valid and not self.set_aside


@dataclass(frozen=True)
class RecordedDecision:
    """What was recorded of the planner's answer to one occupancy: `planning.decision.Decision` without its paths."""

    t_s: float = _NAN  #: stamp of the occupancy
    action: str = ""  #: replan, keep, hold, evade, missed or arrived
    step: int = -1  #: the planner's number of the replanning step, from 1; -1 where none was computed
    chosen: str = ""  #: goal, empty if none
    previous: str = ""  #: goal before, empty if none
    switched: bool = False
    reason: str = ""  #: the planner's explanation
    t_switch_s: float = _NAN  #: when the trajectory takes over, NaN if none
    compute_s: float = _NAN  #: wall time from receiving the occupancy to deciding, NaN if not told
    goals: tuple[GoalPlan, ...] = ()  #: what was found for each goal, where a replanning step was computed
    margin: float = _NAN  #: by how much the chosen goal was cheaper than the next one; NaN if none was, or not told

    @property
    def is_step(self) -> bool:
        """Whether goals were planned to and compared, whatever came of it; at rest at its goal the arm has no step."""
        return bool(self.goals) and self.action != "arrived"

    @property
    def begins_s(self) -> float:
        """When the decision takes effect: at its switch time, or at once."""
        return self.t_s if np.isnan(self.t_switch_s) else self.t_switch_s

    @property
    def plan_of_chosen(self) -> GoalPlan | None:
        """The plan for the chosen goal, None if the decision carries none."""
        return next((goal for goal in self.goals if goal.name == self.chosen), None)


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


def cloud_of(message: Any, *others: str) -> tuple[FloatArray, ...]:
    """Return the points (N, 3) of a cloud and some other fields of it (N,) as float64. Raises BagError."""
    columns = point_cloud2_fields(message, ("x", "y", "z", *others))
    points = np.stack([columns[name].astype(np.float64) for name in ("x", "y", "z")], axis=1)
    return points, *(columns[name].astype(np.float64) for name in others)


def lines_of(message: Any) -> tuple[FloatArray, FloatArray]:
    """Return from where to where the lines of a MarkerArray go (N, 2, 3), as it places them, and their colours (N, 3).

    What is transparent is paler. Markers that are no lines are left out.
    """
    ends, colours = [np.zeros((0, 2, 3))], [np.zeros((0, 3))]
    for marker in message.markers:
        points = np.array([(point.x, point.y, point.z) for point in marker.points]).reshape(-1, 3)
        if marker.action == _ADD and marker.type in (_LINE_STRIP, _LINE_LIST) and len(points) > 1:
            some = points[: len(points) // 2 * 2].reshape(-1, 2, 3)
            ends.append(some if marker.type == _LINE_LIST else np.stack([points[:-1], points[1:]], axis=1))
            colour = marker.color
            shade = 1.0 - colour.a * (1.0 - np.array([colour.r, colour.g, colour.b]))
            colours.append(np.tile(shade, (len(ends[-1]), 1)))
    return np.concatenate(ends), np.concatenate(colours)


def posterior_of(message: Any) -> tuple[FloatArray, list[str], FloatArray]:
    """Return the places (C, 3) of a posterior, their labels and probabilities (C,); old ones have numbers alone."""
    texts = any(field.name == "label" for field in message.fields)
    columns = point_cloud2_fields(message, ("x", "y", "z", "probability", "label" if texts else "class_id"))
    places = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    if texts:
        labels = [name.decode(errors="replace") for name in columns["label"].tolist()]
    else:
        labels = [f"{number:.0f}" for number in columns["class_id"].tolist()]
    return places, labels, columns["probability"].astype(np.float64)


def occupied_of(message: Any) -> tuple[FloatArray, FloatArray]:
    """Return the centres (N, 3), world frame, m, and probabilities (N,) of an occupancy of either form.

    None where nobody knew where people were. Raises BagError.
    """
    if not hasattr(message, "format"):
        points, probability = cloud_of(message, "probability")
        return points, probability
    if message.format.startswith(compact_occupancy.UNKNOWN):
        return np.empty((0, 3)), np.empty(0)
    try:
        points, codes = compact_occupancy.voxels(compact_occupancy.unpacked(message.format, bytes(message.data)))
    except ArrayError as error:
        raise BagError(f"topic {COMPACT_OCCUPANCY}: {error}") from error
    return points, codes.astype(np.float64)


def grid_of(text: str) -> VoxelGrid:
    """Return the voxel lattice described by JSON. Raises BagError if the text is something else."""
    try:
        content = json_of(text)
        return VoxelGrid(tuple(content["origin_m"]), float(content["resolution_m"]), tuple(content["shape"]))
    except (ValueError, KeyError, TypeError, OverflowError, ArrayError) as trouble:
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
    head = _values(message.status[0])
    try:
        told = _told(RecordedDecision, head)
        told["t_switch_s"] = t_first_occupancy_s + told.get("t_switch_s", _NAN)
        told["compute_s"] = 1e-3 * _number(head.get("compute_ms", ""))
        told |= {"t_s": t_s, "action": message.status[0].message}
        return RecordedDecision(**told | {"goals": tuple(_goal(status) for status in message.status[1:])})
    except ValueError as trouble:
        raise BagError(f"topic {DECISION}: wanted numbers, got {head} ({trouble}); is it another node's?") from trouble


def trajectory_of(message: Any, origin_ns: int) -> JointTrack:
    """Return a JointTrajectory with its knots in run time."""
    names, points = tuple(message.joint_names), message.points
    table = np.full((len(points), 2, len(names)), np.nan)
    for row, point in zip(table, points, strict=True):
        for part, values in zip(row, (point.positions, point.velocities), strict=True):
            if len(values) == len(names):
                part[:] = values
    start_ns = ns_from_stamp(message.header.stamp) - origin_ns
    t_s = np.array([(start_ns + ns_from_stamp(point.time_from_start)) * 1e-9 for point in points])
    return JointTrack(t_s.reshape(-1), table[:, 0], table[:, 1], names)


def _goal(status: Any) -> GoalPlan:
    values = _values(status)
    terms = {key.removeprefix("cost/"): float(text) for key, text in values.items() if key.startswith("cost/")}
    return GoalPlan(**_told(GoalPlan, values) | {"name": status.name, "message": status.message, "terms": terms})


def _values(status: Any) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def _told(kind: type[RecordedDecision | GoalPlan], values: Mapping[str, str]) -> dict[str, Any]:
    """Return those of the type's fields that the texts tell; ValueError for a text that is no such number."""
    told = [one for one in fields(kind) if one.name in values and one.type in _READ]
    return {one.name: _READ[str(one.type)](values[one.name]) for one in told}


def _number(text: str) -> float:
    return float(text) if text not in ("", "None") else _NAN


#: How the text of a field is read, by the field's type.
_READ: dict[str, Callable[[str], Any]] = {
    "float": _number,
    "int": int,
    "bool": lambda text: text.lower() == "true",
    "str": lambda text: "" if text == "None" else text,
}
