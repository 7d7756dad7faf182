"""What a planner sent, read as a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from trajectory_msgs.msg import JointTrajectory

from humanpred_ros.errors import PlanningError
from humanpred_ros.nodes.conversions import controller_refusal, stamp_ns
from humanpred_ros.planning.trajectory import TimedTrajectory


def trajectory_from_message(
    message: JointTrajectory, names: Sequence[str], origin_ns: int, now_ns: int | None = None
) -> TimedTrajectory:
    """Return the trajectory of a message, with times in seconds after `origin_ns`.

    Refuses what a joint trajectory controller refuses, and what leaves open how the robot moves between
    points: missing velocities or accelerations, or a last acceleration that is not 0.

    Args:
        names: joints wanted; the message may have them in any order.
        now_ns: refuse trajectories that are over by then; None takes them.

    Raises:
        PlanningError: with the reason.
    """
    refusal = controller_refusal(message, names, now_ns)
    if refusal:
        raise PlanningError(refusal)
    column = [list(message.joint_names).index(name) for name in names]
    start_ns = stamp_ns(message.header.stamp) - origin_ns
    knots: list[list[Any]] = [[], [], [], []]
    for point in message.points:
        row = (point.positions, point.velocities, point.accelerations)
        if any(len(part) != len(names) for part in row):
            raise PlanningError(f"trajectory: wanted {len(names)} positions, velocities and accelerations per point")
        knots[0].append((start_ns + stamp_ns(point.time_from_start)) * 1e-9)
        for k, part in enumerate(row):
            knots[k + 1].append(part)
    t_s, q, v, a = (np.array(part, dtype=np.float64) for part in knots)
    v[-1] = 0.0  # to within float32's resolution it is
    return TimedTrajectory(t_s, q[:, column], v[:, column], a[:, column])
