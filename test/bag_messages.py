"""Messages that only tests write to bags; the package itself takes them from nodes as bytes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.bags import messages as ros


def clock(time_ns: int) -> Any:
    """Return rosgraph_msgs/Clock."""
    return ros.message_class(ros.CLOCK)(clock=ros.stamp_from_ns(time_ns))


def joint_trajectory(
    time_ns: int,
    names: Sequence[str],
    t_s: ArrayLike,
    positions: ArrayLike,
    *,
    velocities: ArrayLike | None = None,
    accelerations: ArrayLike | None = None,
    frame_id: str = "",
) -> Any:
    """Return trajectory_msgs/JointTrajectory.

    Args:
        time_ns: stamp at which the trajectory starts.
        names: D joint names.
        t_s: (N,) seconds since the stamp.
        positions: (N, D) rad; velocities (rad/s) and accelerations (rad/s^2) likewise or None.
        frame_id: frame of the header.
    """
    times, rows = np.asarray(t_s, dtype=np.float64), [np.asarray(positions, dtype=np.float64)]
    rows += [
        np.zeros((len(times), 0)) if v is None else np.asarray(v, dtype=np.float64) for v in (velocities, accelerations)
    ]
    point = ros.message_class("trajectory_msgs/msg/JointTrajectoryPoint")
    duration = ros.message_class("builtin_interfaces/msg/Duration")
    points = []
    for t, position, velocity, acceleration in zip(times, *rows, strict=True):
        sec, nanosec = divmod(round(float(t) * 1e9), 1_000_000_000)
        points.append(
            point(
                positions=position,
                velocities=velocity,
                accelerations=acceleration,
                effort=np.zeros(0),
                time_from_start=duration(sec=sec, nanosec=nanosec),
            )
        )
    return ros.message_class(ros.JOINT_TRAJECTORY)(
        header=ros.header(time_ns, frame_id), joint_names=list(names), points=points
    )


def diagnostic_array(
    time_ns: int, statuses: Iterable[tuple[int, str, str, Mapping[str, str]]], *, frame_id: str = ""
) -> Any:
    """Return diagnostic_msgs/DiagnosticArray of (level 0 to 3, name, message, values) tuples."""
    status = ros.message_class("diagnostic_msgs/msg/DiagnosticStatus")
    pair = ros.message_class("diagnostic_msgs/msg/KeyValue")
    return ros.message_class(ros.DIAGNOSTIC_ARRAY)(
        header=ros.header(time_ns, frame_id),
        status=[
            status(
                level=level,
                name=name,
                message=text,
                hardware_id="",
                values=[pair(key=key, value=value) for key, value in values.items()],
            )
            for level, name, text, values in statuses
        ],
    )
