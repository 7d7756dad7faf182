"""ROS messages from and to the library's types; no algorithm in here."""

from __future__ import annotations

import array
import json
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy.typing import NDArray
from sensor_msgs.msg import JointState, PointCloud2, PointField
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from humanpred_ros.errors import ArrayError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid, codes_of, probability_of_code
from humanpred_ros.motion.labels import LONGEST_BYTES
from humanpred_ros.planning.decision import Decision
from humanpred_ros.planning.trajectory import TimedTrajectory

NS_PER_S = 1_000_000_000
#: A last velocity up to this counts as rest, rad/s: the controller compares with float32's epsilon.
REST_VELOCITY = float(np.finfo(np.float32).eps)
#: No joint, velocity or acceleration is as large: beyond, whole turns and differences drown in rounding.
_LARGEST = 1e6
#: So many points may tell of one voxel.
_MOST_POINTS = 4
_CENTRE_TOLERANCE = 1e-3  # of a voxel: what float32 coordinates can be off by, with room to spare


def time_message(stamp_ns: int) -> Time:
    """Return a Time for integer nanoseconds; the first or last one for what a Time cannot hold."""
    sec = stamp_ns // NS_PER_S
    return Time(sec=min(max(sec, -(2**31)), 2**31 - 1), nanosec=stamp_ns % NS_PER_S)


def stamp_ns(stamp: Time | Duration) -> int:
    """Return the integer nanoseconds of a Time or Duration."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def joint_state(names: Sequence[str], q: FloatArray, t_ns: int, frame_id: str = "", v: FloatArray | None = None) -> Any:
    """Return a JointState with the positions `q` (D,) and, where given, velocities `v` (D,).

    It is also the message for numbers with names, as costs by task: programs that plot show it by the names.
    """
    message = JointState(name=list(names), position=array.array("d", q))
    if v is not None:
        message.velocity = array.array("d", v)
    message.header.stamp = time_message(t_ns)
    message.header.frame_id = frame_id
    return message


def ordered_positions(message: JointState, names: Sequence[str]) -> FloatArray:
    """Return the positions of `names` (D,), wherever they stand in the message.

    Raises:
        ArrayError: a name is missing or stands there twice, or a position is not finite, or larger than any joint's.
    """
    where = _places_of(message, names)
    missing = [name for name in names if name not in where or where[name] >= len(message.position)]
    if missing:
        raise ArrayError(f"missing joints: wanted {', '.join(names)}; {', '.join(missing)} did not come")
    q = np.array([message.position[where[name]] for name in names], dtype=np.float64)
    if not np.isfinite(q).all():
        raise ArrayError(f"not finite: wanted numbers for {', '.join(names)}, got {q}")
    if np.abs(q).max(initial=0.0) > _LARGEST:
        raise ArrayError(f"too large: wanted positions of at most {_LARGEST:g} rad or m, got {q}")
    return q


def ordered_velocities(message: JointState, names: Sequence[str]) -> FloatArray | None:
    """Return the velocities of `names` (D,); None if the message does not have them all, or one that none can have.

    Raises:
        ArrayError: a name stands there twice.
    """
    where = _places_of(message, names)
    if any(where.get(name, len(message.velocity)) >= len(message.velocity) for name in names):
        return None
    v = np.array([message.velocity[where[name]] for name in names], dtype=np.float64)
    return v if (np.abs(v) <= _LARGEST).all() else None


def _places_of(message: JointState, names: Sequence[str]) -> dict[str, int]:
    where = {name: k for k, name in enumerate(message.name)}
    if len(where) < len(message.name):
        twice = sorted({name for name in where if list(message.name).count(name) > 1} & set(names))
        if twice:
            raise ArrayError(f"joint twice: wanted every joint once, got {', '.join(twice)} more than once")
    return where


@lru_cache
def _point_fields(layout: np.dtype[Any]) -> tuple[PointField, ...]:
    """Return the fields of clouds of float32 numbers and texts; many messages hold the same ones."""
    return tuple(
        PointField(name=name, offset=offset, datatype=PointField.UINT8, count=kind.itemsize)
        if kind.kind == "S"
        else PointField(name=name, offset=offset, datatype=PointField.FLOAT32, count=1)
        for name, (kind, offset, *_) in (layout.fields or {}).items()
    )


def _cloud(columns: NDArray[Any], t_ns: int, frame_id: str) -> PointCloud2:
    """Return an unordered cloud of a structured array, one point per element, fields of float32 or of bytes."""
    message = PointCloud2(
        height=1,
        width=len(columns),
        fields=list(_point_fields(columns.dtype)),
        point_step=columns.dtype.itemsize,
        row_step=columns.nbytes,
        is_dense=True,
    )
    message.data = array.array("B", columns.tobytes())
    message.header.stamp = time_message(t_ns)
    message.header.frame_id = frame_id
    return message


def occupancy_cloud(occupancy: Occupancy, threshold: float, t_ns: int, frame_id: str = "world") -> PointCloud2:
    """Return what `Occupancy.sparse(threshold)` keeps: voxel centres as x, y, z, probability."""
    flat = occupancy.voxels_above(threshold)
    points = np.empty(len(flat), dtype=[(name, "<f4") for name in ("x", "y", "z", "probability")])
    grid = occupancy.grid
    for name, index, origin_m, n in zip(
        "xyz", np.unravel_index(flat, grid.shape), grid.origin_m, grid.shape, strict=True
    ):
        # As `VoxelGrid.centres_m`, but once for each layer instead of once for each voxel.
        points[name] = (origin_m + (np.arange(n) + 0.5) * grid.resolution_m).astype(np.float32)[index]
    points["probability"] = probability_of_code()[codes_of(occupancy.probability.ravel()[flat])]
    return _cloud(points, t_ns, frame_id)


#: Begins the name of a field of clouds that say why nobody knows where people are.
_UNKNOWN = "unknown: "


def unknown_cloud(reason: str, t_ns: int, frame_id: str = "world") -> PointCloud2:
    """Return a cloud that says that nobody knows where people are, and why; `occupancy_from_cloud` raises it."""
    return _saying(f"{_UNKNOWN}{reason}", t_ns, frame_id)


def _saying(what: str, t_ns: int, frame_id: str) -> PointCloud2:
    """Return a cloud without voxels that has a field of this name."""
    cloud = _cloud(np.empty(0, dtype=[(name, "<f4") for name in ("x", "y", "z", "probability")]), t_ns, frame_id)
    cloud.fields = [*cloud.fields, PointField(name=what, datatype=PointField.FLOAT32, count=1)]
    return cloud


#: Name of a field of clouds without voxels that say that nobody is there.
_NOBODY = "nobody"


def nobody_cloud(t_ns: int, frame_id: str = "world") -> PointCloud2:
    """Return a cloud that says that nobody is there: one without voxels alone is not believed (`says_nobody`)."""
    return _saying(_NOBODY, t_ns, frame_id)


def says_nobody(cloud: PointCloud2) -> bool:
    """Return whether an occupancy cloud says that nobody is there, as whoever sees people must."""
    return any(field.name == _NOBODY for field in cloud.fields)


#: Types of numbers in a cloud (sensor_msgs/PointField), as NumPy knows them.
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def cloud_columns(message: PointCloud2, names: Sequence[str]) -> NDArray[np.float64]:
    """Return the (N, K) values of K fields of a cloud, wherever they stand in a point and whatever their type.

    Raises:
        ArrayError: a field that is missing, given twice, or of no known type; sizes that disagree.
    """
    fields = {field.name: field for field in message.fields}
    absent = [name for name in names if name not in fields]
    if absent or len(fields) < len(message.fields):
        raise ArrayError(
            f"cloud fields: wanted {', '.join(names)}, each once, got "
            f"{', '.join(field.name for field in message.fields) or 'none'}"
        )
    step, points = message.point_step, message.width * message.height
    if message.row_step != message.width * step or len(message.data) != message.height * message.row_step:
        raise ArrayError(
            f"cloud data: wanted {points} points ({message.height} rows of {message.width}) of {step} bytes, got rows "
            f"of {message.row_step} bytes and {len(message.data)} bytes in all"
        )
    kinds = []
    for name in names:
        field = fields[name]
        if field.datatype not in _NUMBERS or field.count != 1:
            raise ArrayError(
                f"cloud field {name}: wanted one number of a known type, got {field.count} of type {field.datatype}"
            )
        kind = np.dtype((">" if message.is_bigendian else "<") + _NUMBERS[field.datatype])
        if field.offset + kind.itemsize > step:
            raise ArrayError(
                f"cloud field {name}: wanted {kind.itemsize} bytes within a point of {step}, got them at {field.offset}"
            )
        kinds.append(kind)
    if not points:
        return np.empty((0, len(names)))
    offsets = [fields[name].offset for name in names]
    layout = np.dtype({"names": list(names), "formats": kinds, "offsets": offsets, "itemsize": step})
    table = np.frombuffer(message.data, dtype=layout)
    return np.stack([table[name].astype(np.float64) for name in names], axis=1)


def occupancy_from_cloud(message: PointCloud2, grid: VoxelGrid, t_s: float, frame_id: str = "world") -> Occupancy:
    """Return the occupancy a cloud describes on `grid`; voxels that did not travel are 0.

    A voxel that is given twice counts with its larger probability.

    Raises:
        ArrayError: a cloud in another frame than `frame_id`; one that cannot be read (`cloud_columns`); points that are
            not voxel centres of `grid`; probabilities that are not finite or outside [0, 1].
    """
    if message.header.frame_id.lstrip("/") != frame_id:
        raise ArrayError(f"cloud frame: wanted {frame_id!r}, got {message.header.frame_id!r}")
    said = [field.name.removeprefix(_UNKNOWN) for field in message.fields if field.name.startswith(_UNKNOWN)]
    if said:
        raise ArrayError(f"where people are is not known: {said[0]}")
    if message.width * message.height > _MOST_POINTS * grid.size:
        raise ArrayError(
            f"huge cloud: wanted at most {_MOST_POINTS} points for each of {grid.size} voxels, got "
            f"{message.width * message.height}"
        )
    values = cloud_columns(message, ("x", "y", "z", "probability"))
    probability = np.zeros(grid.size, dtype=np.float32)
    if len(values):
        if not np.isfinite(values).all():
            raise ArrayError("not finite: the occupancy cloud holds NaN or infinity")
        flat = grid.flat_index(values[:, :3])
        off = np.abs(grid.centres_m(np.maximum(flat, 0)) - values[:, :3]).max(axis=1)
        if (flat < 0).any() or off.max() > _CENTRE_TOLERANCE * grid.resolution_m:
            raise ArrayError(
                f"other lattice: points are not voxel centres of the scene's grid "
                f"(origin {grid.origin_m}, {grid.resolution_m} m, {grid.shape}); use one scene for both nodes"
            )
        low, high = float(values[:, 3].min()), float(values[:, 3].max())
        if low < 0.0 or high > 1.0:
            raise ArrayError(f"occupancy: wanted probabilities within [0, 1], got {low:g} to {high:g}")
        np.maximum.at(probability, flat, values[:, 3].astype(np.float32))
    return Occupancy(grid, probability.reshape(grid.shape), t_s)


def goals_cloud(goals_m: FloatArray, labels: Sequence[str], probability: FloatArray, t_ns: int) -> PointCloud2:
    """Return the goal places (C, 3) of the classes with their posterior, world frame.

    The field `label` holds a class's label in UTF-8, with zeros at its end; `class_id` is its place among the classes.
    """
    numbers = [(name, "<f4") for name in ("x", "y", "z", "class_id", "probability")]
    points = np.empty(len(labels), dtype=[*numbers, ("label", f"S{LONGEST_BYTES}")])
    points["x"], points["y"], points["z"] = goals_m[:, 0], goals_m[:, 1], goals_m[:, 2]
    points["class_id"], points["probability"] = np.arange(len(labels)), probability
    points["label"] = [label.encode() for label in labels]
    return _cloud(points, t_ns, "world")


def grid_description(grid: VoxelGrid, frame_id: str = "world") -> str:
    """Return the lattice as JSON, for the latched description topic."""
    return json.dumps(
        {"frame_id": frame_id, "origin_m": grid.origin_m, "resolution_m": grid.resolution_m, "shape": grid.shape}
    )


def trajectory_message(names: Sequence[str], trajectory: TimedTrajectory, origin_ns: int) -> JointTrajectory:
    """Return the trajectory with absolute times: header.stamp is its first knot, `origin_ns` its time zero.

    Times are rounded to nanoseconds; knots that would fall on the same one are put one apart.
    """
    message = JointTrajectory(joint_names=list(names))
    start_ns = origin_ns + round(float(trajectory.t_s[0]) * NS_PER_S)
    message.header.stamp = time_message(start_ns)
    after = -1
    for t, q, v, a in zip(trajectory.t_s, trajectory.q, trajectory.v, trajectory.a, strict=True):
        after = max(origin_ns + round(float(t) * NS_PER_S) - start_ns, after + 1)
        message.points.append(
            JointTrajectoryPoint(
                positions=array.array("d", q),
                velocities=array.array("d", v),
                accelerations=array.array("d", a),
                time_from_start=Duration(sec=after // NS_PER_S, nanosec=after % NS_PER_S),
            )
        )
    return message


def controller_refusal(message: Any, joint_names: Sequence[str], now_ns: int | None = None) -> str:
    """Return why a controller of `joint_names` would refuse a trajectory; empty if it would take it.

    The rules are those of ros2_controllers' joint_trajectory_controller (Jazzy) with position commands and its
    default parameters, in our words:

    - joints are named, all of the controller's and no others (`allow_partial_joints_goal` is false); their order is
      free, but nobody may be named twice;
    - there are points, and each is later than the one before it (the first may be at 0);
    - every point has as many positions as joints, and as many velocities and accelerations, or none; a point with
      none of the three says nothing;
    - efforts are not given: Jazzy's controller does not take them;
    - the last point's velocities are zero to float32's resolution
      (`allow_nonzero_velocity_at_trajectory_end` is false);
    - a trajectory with a stamp does not end in the past; a stamp of 0 means "from now on".

    Numbers that are not finite, or larger than any joint's, are refused too; the controller leaves that to others.

    Args:
        message: a trajectory_msgs/JointTrajectory, or anything with the same fields.
        now_ns: the controller's time; None leaves out whether the trajectory is over.
    """
    names = list(message.joint_names)
    if sorted(names) != sorted(joint_names):
        return f"trajectory joints: wanted {list(joint_names)}, got {names}"
    points = list(message.points)
    if not points:
        return "trajectory: wanted at least one point, got none"
    before_ns = -1
    for k, point in enumerate(points):
        at_ns = stamp_ns(point.time_from_start)
        if at_ns <= before_ns:
            return f"trajectory: wanted strictly increasing times from 0 on, got {at_ns} ns at point {k}"
        before_ns = at_ns
        trouble = _point_refusal(point, len(names))
        if trouble:
            return f"trajectory point {k}: {trouble}"
    moving = np.abs(np.asarray(points[-1].velocities, dtype=np.float64)).max(initial=0.0)
    if moving > REST_VELOCITY:
        return f"trajectory: wanted rest at the last point, got velocities {list(points[-1].velocities)}"
    start_ns = stamp_ns(message.header.stamp)
    if now_ns is not None and start_ns != 0 and start_ns + before_ns < now_ns:
        late_s = (now_ns - start_ns - before_ns) * 1e-9
        return f"trajectory: wanted one that is not over, got one that ended {late_s:.3f} s ago"
    return ""


def _point_refusal(point: Any, n: int) -> str:
    if len(point.effort):
        return "wanted no efforts, got some"
    if len(point.positions) != n:
        return f"wanted {n} positions, got {len(point.positions)}"
    for name in ("velocities", "accelerations"):
        if len(getattr(point, name)) not in (0, n):
            return f"wanted {n} {name} or none, got {len(getattr(point, name))}"
    values = np.concatenate([np.asarray(part) for part in (point.positions, point.velocities, point.accelerations)])
    if (np.abs(values) <= _LARGEST).all():
        return ""
    return f"wanted finite numbers of at most {_LARGEST:g}, got others"


#: Key of a decision of a planner that does not command the arm yet, whatever the decision says.
WAITS = "waits"


def decision_message(decision: Decision, t_ns: int, compute_ms: float, waits: bool = False) -> DiagnosticArray:
    """Return a decision as one status for itself and one per goal; numbers read back exactly.

    `waits` says that the planner does not command the arm yet.
    """
    head = DiagnosticStatus(
        name="decision",
        level=DiagnosticStatus.WARN if decision.action in ("hold", "missed") else DiagnosticStatus.OK,
        message=decision.action,
        values=_key_values(
            step=decision.step if decision.goals else -1,
            chosen=decision.chosen or "",
            previous=decision.previous or "",
            switched=str(decision.switched).lower(),
            reason=decision.reason,
            t_switch_s=repr(float(decision.t_switch_s)),
            margin=repr(float(decision.margin)),
            compute_ms=f"{compute_ms:.3f}",
            **({WAITS: "true"} if waits else {}),
        ),
    )
    message = DiagnosticArray(status=[head])
    for goal in decision.goals:
        verdict = goal.obstacle_to_choice or ("chosen" if goal.name == decision.chosen else "candidate")
        values = {
            "selection_cost": repr(float(goal.selection_cost)),
            "human": repr(float(goal.human)),
            "length": repr(float(goal.length)),
            "rest": repr(float(goal.rest)),
            "task_cost": repr(float(goal.task_cost)),
            "alternative": goal.alternative,
            "valid": str(goal.valid).lower(),
            "set_aside": goal.set_aside,
            "revived": str(goal.revived).lower(),
            "iterations": goal.iterations,
            "warm_start": goal.warm_start,
            **{f"cost/{term}": repr(float(cost)) for term, cost in goal.cost.items()},
        }
        level = DiagnosticStatus.OK if goal.eligible else DiagnosticStatus.WARN
        message.status.append(
            DiagnosticStatus(name=goal.name, level=level, message=verdict, values=_key_values(**values))
        )
    message.header.stamp = time_message(t_ns)
    return message


def _key_values(**values: Any) -> list[KeyValue]:
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]
