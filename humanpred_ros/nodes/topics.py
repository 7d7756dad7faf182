"""Topic names, in one place."""

from __future__ import annotations

OCCUPANCY = "/human_occupancy"
VOXEL_GRID = "/human_occupancy/voxel_grid"
OCCUPANCY_MARKERS = "/human_occupancy/markers"
HUMAN_GOALS = "/human_goals"
JOINT_STATES = "/joint_states"
TRAJECTORY = "/r_arm_controller/joint_trajectory"
DECISION = "/stomp_planner/decision"
CANDIDATES = "/stomp_planner/candidates"
ROLLOUTS = "/stomp_planner/rollouts"
DIAGNOSTICS = "/diagnostics"
CLOCK = "/clock"


def human_joint_states(body_id: str) -> str:
    """Return the REP-155 topic of a tracked body's joint states."""
    return f"/humans/bodies/{body_id}/joint_states"


def human_urdf(body_id: str) -> str:
    """Return the topic on which a tracked body's URDF is latched."""
    return f"/humans/bodies/{body_id}/urdf"


def human_markers(body_id: str) -> str:
    """Return the topic of a tracked body's skeleton markers."""
    return f"/humans/bodies/{body_id}/markers"
