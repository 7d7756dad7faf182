"""What a joint trajectory controller refuses, so that what is published is never refused on the robot.

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

Numbers that are not finite are refused too, which the controller leaves to whoever commands it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

#: A last velocity up to this counts as rest, rad/s: the controller compares with float32's epsilon.
REST_VELOCITY = float(np.finfo(np.float32).eps)

_NS_PER_S = 1_000_000_000


def controller_refusal(message: Any, joint_names: Sequence[str], now_ns: int | None = None) -> str:
    """Return why a controller of `joint_names` would refuse a trajectory; empty if it would take it.

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
        at_ns = _ns(point.time_from_start)
        if at_ns <= before_ns:
            return f"trajectory: wanted strictly increasing times from 0 on, got {at_ns} ns at point {k}"
        before_ns = at_ns
        trouble = _point_refusal(point, len(names))
        if trouble:
            return f"trajectory point {k}: {trouble}"
    moving = np.abs(np.asarray(points[-1].velocities, dtype=np.float64)).max(initial=0.0)
    if moving > REST_VELOCITY:
        return f"trajectory: wanted rest at the last point, got velocities {list(points[-1].velocities)}"
    start_ns = _ns(message.header.stamp)
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
    return "" if np.isfinite(values).all() else "wanted finite numbers, got NaN or infinity"


def _ns(stamp: Any) -> int:
    return int(stamp.sec) * _NS_PER_S + int(stamp.nanosec)
