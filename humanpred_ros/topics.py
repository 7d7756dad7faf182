"""The names of the topics the nodes use, for nodes and for whatever reads their bags."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

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


def human_held(body_id: str) -> str:
    """Return the topic on which a tracker says that it repeats its last posture on purpose."""
    return f"/humans/bodies/{body_id}/held"


def human_markers(body_id: str) -> str:
    """Return the topic of a tracked body's skeleton markers."""
    return f"/humans/bodies/{body_id}/markers"


def body_topic(topics: Iterable[str], of: Callable[[str], str]) -> str | None:
    """Return the topic of the tracked body (the first by name) among `topics`, None if there is none.

    Args:
        topics: names of topics.
        of: one of the functions above, for which topic of the body.
    """
    pattern = re.compile(of("[^/]+"))
    return min((topic for topic in topics if pattern.fullmatch(topic)), default=None)
