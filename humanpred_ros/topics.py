"""The names of the topics the nodes use, for nodes and for whatever reads their bags.

Names are relative: a node in the namespace `/robot1` publishes `/robot1/human_occupancy`, one without a namespace
`/human_occupancy`. `/diagnostics` and `/clock` are of the whole graph, as everywhere in ROS. Bags hold full names.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping

from humanpred_ros.errors import BagError

OCCUPANCY = "human_occupancy"
COMPACT_OCCUPANCY = "human_occupancy/compact"
VOXEL_GRID = "human_occupancy/voxel_grid"
OCCUPANCY_MARKERS = "human_occupancy/markers"
FUTURES = "human_occupancy/futures"
HUMAN_GOALS = "human_goals"
#: The same as numbers with names (JointState), for plots and for `ros2 topic echo`.
POSTERIOR = "human_goals/posterior"
JOINT_STATES = "joint_states"
TRAJECTORY = "r_arm_controller/joint_trajectory"
#: In front of the planner's own topics and services.
PLANNER = "stomp_planner"
DECISION = "stomp_planner/decision"
COSTS = "stomp_planner/costs"
CANDIDATES = "stomp_planner/candidates"
ROLLOUTS = "stomp_planner/rollouts"
#: Solids and a cloud of points that come and go, as anybody tells the planner; and what it knows of the scene.
OBSTACLES = "obstacles"
OBSTACLE_CLOUD = "obstacles/cloud"
SCENE_MARKERS = "stomp_planner/scene"
#: What the separation guard says: whole percents of speed, and why the arm stands.
SPEED_FACTOR = "speed_ovr"
GUARD_STOP = "separation_guard/stop"
GUARD_MARKERS = "separation_guard/markers"
#: On which a tracker says, again and again, that it sees nobody.
NOBODY = "humans/bodies/nobody"
DIAGNOSTICS = "/diagnostics"
CLOCK = "/clock"

#: What only a robot of ours has: the namespaces in which they are found are those of the robots in a bag.
_OF_A_ROBOT = (OCCUPANCY, COMPACT_OCCUPANCY, HUMAN_GOALS, TRAJECTORY, DECISION)
#: Of the longest relative name.
_MOST_PARTS = 4


def recorded_occupancy(counts: Mapping[str, int]) -> str:
    """Return the topic of the occupancies in a bag: the compact form where there are any of it, else the clouds.

    Args:
        counts: number of messages of each topic, by relative names.
    """
    return COMPACT_OCCUPANCY if counts.get(COMPACT_OCCUPANCY) else OCCUPANCY


def human_joint_states(body_id: str) -> str:
    """Return the REP-155 topic of a tracked body's joint states."""
    return f"humans/bodies/{body_id}/joint_states"


def human_urdf(body_id: str) -> str:
    """Return the topic on which a tracked body's URDF is latched."""
    return f"humans/bodies/{body_id}/urdf"


def human_held(body_id: str) -> str:
    """Return the topic on which a tracker says that it repeats its last posture on purpose."""
    return f"humans/bodies/{body_id}/held"


def human_markers(body_id: str) -> str:
    """Return the topic of a tracked body's skeleton markers."""
    return f"humans/bodies/{body_id}/markers"


def human_lost(body_id: str) -> str:
    """Return the topic on which a tracker says which points of a body it does not see."""
    return f"humans/bodies/{body_id}/lost"


def human_left(body_id: str) -> str:
    """Return the topic on which a tracker says, again and again, that a body has left."""
    return f"humans/bodies/{body_id}/left"


def human_goals(body_id: str) -> str:
    """Return the topic of where a body's hand may go, with how probable each place is."""
    return f"humans/bodies/{body_id}/goals"


def body_topic(topics: Iterable[str], of: Callable[[str], str]) -> str | None:
    """Return the topic of the tracked body (the first by name) among `topics`, None if there is none.

    Args:
        topics: relative names of topics.
        of: one of the functions above, for which topic of the body.
    """
    pattern = re.compile(of("[^/]+"))
    return min((topic for topic in topics if pattern.fullmatch(topic)), default=None)


def names_in_bag(topics: Iterable[str], told: Mapping[str, str], namespace: str | None = None) -> dict[str, str]:
    """Return the full names of the topics in a bag by their relative names.

    Args:
        topics: full names of all topics in the bag.
        told: full by relative names, as the recorder wrote them: topics may have been remapped.
        namespace: of the robot that is wanted, as `/robot1`; if None, the bag must hold one robot only.

    Raises:
        BagError: the namespace is not there, or several are and none was named.
    """
    topics = set(topics)
    if namespace is None and told:
        return {name: topic for name, topic in told.items() if topic in topics}
    found: dict[str, dict[str, str]] = {}
    for topic in sorted(topics):
        for name in _endings(topic):
            found.setdefault(name, {})[topic.removesuffix(f"/{name}")] = topic
    robots = sorted({where for name in _OF_A_ROBOT for where in found.get(name, {})})
    if namespace is None:
        if len(robots) > 1:
            raise BagError(f"wanted one robot, the bag has {_listed(robots)}; name one with namespace (--namespace)")
        namespace = robots[0] if robots else ""
    wanted = namespace.rstrip("/")
    if robots and wanted not in robots:
        raise BagError(f"namespace: wanted one of those in the bag, {_listed(robots)}, got {namespace or '/'}")
    # What several robots share, as the people seen by one tracker, lies elsewhere.
    chosen = {name: where.get(wanted) or _only(where) for name, where in found.items()}
    return {name: topic for name, topic in chosen.items() if topic}


def _endings(topic: str) -> list[str]:
    """Return the relative names that a topic may have; a person's joint states are not an arm's."""
    parts = topic.strip("/").split("/")[-_MOST_PARTS:]
    if "bodies" in parts[1:] and parts[parts.index("bodies", 1) - 1] == "humans":
        return ["/".join(parts[parts.index("bodies", 1) - 1 :])]
    return ["/".join(parts[k:]) for k in range(len(parts))]


def _only(where: Mapping[str, str]) -> str | None:
    return next(iter(where.values())) if len(where) == 1 else None


def _listed(namespaces: Iterable[str]) -> str:
    return ", ".join(namespace or "/" for namespace in namespaces)
