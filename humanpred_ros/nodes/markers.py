"""Pictures for people: markers of the skeleton, the occupancy and the candidate paths."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from humanpred_ros import topics
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy
from humanpred_ros.nodes import qos

if TYPE_CHECKING:  # nodes that draw a skeleton need no planner
    from humanpred_ros.planning.decision import Decision
    from humanpred_ros.stomp.costs import Float32Array

#: Pairs of named points of the human joined by a line.
BONES = (
    ("head", "neck"), ("neck", "torso"), ("torso", "pelvis"),
    ("neck", "left_shoulder"), ("left_shoulder", "left_elbow"), ("left_elbow", "left_palm"),
    ("neck", "right_shoulder"), ("right_shoulder", "right_elbow"), ("right_elbow", "right_palm"),
    ("pelvis", "left_hip"), ("left_hip", "left_knee"), ("left_knee", "left_foot"),
    ("pelvis", "right_hip"), ("right_hip", "right_knee"), ("right_knee", "right_foot"),
)  # fmt: skip

_SMALLEST_SHOWN = 0.05  # probability below which a voxel is not worth a cube


def points_of(positions: FloatArray) -> list[Point]:
    """Return positions (N, 3) as messages."""
    return [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in positions]


def marker_of(kind: int, namespace: str, frame_id: str, stamp: Time, width_m: float, colour: ColorRGBA) -> Marker:
    """Return a marker that adds something of one kind, width and colour."""
    marker = Marker(ns=namespace, type=kind, action=Marker.ADD, color=colour)
    marker.header.frame_id = frame_id
    marker.header.stamp = stamp
    marker.scale = Vector3(x=width_m, y=width_m, z=width_m)
    marker.pose.orientation.w = 1.0
    return marker


def _only_these() -> MarkerArray:
    """Return an array whose first marker removes those shown before: not every step has a path to every goal."""
    return MarkerArray(markers=[Marker(action=Marker.DELETEALL)])


def skeleton_markers(points: Mapping[str, FloatArray], frame_id: str, stamp: Time) -> MarkerArray:
    """Return the bones between the named points (3,) that are known."""
    marker = marker_of(Marker.LINE_LIST, "skeleton", frame_id, stamp, 0.03, ColorRGBA(r=0.9, g=0.6, b=0.3, a=1.0))
    for first, second in BONES:
        if first in points and second in points:
            marker.points += points_of(np.array([points[first], points[second]]))
    return MarkerArray(markers=[marker])


def occupancy_markers(occupancy: Occupancy, stamp: Time) -> MarkerArray:
    """Return one cube per voxel that is likely enough, the more opaque the likelier."""
    flat = occupancy.voxels_above(_SMALLEST_SHOWN)
    size = 0.9 * occupancy.grid.resolution_m
    marker = marker_of(Marker.CUBE_LIST, "occupancy", "world", stamp, size, ColorRGBA(r=0.9, g=0.2, b=0.2, a=1.0))
    marker.points = points_of(occupancy.grid.centres_m(flat))
    marker.colors = [
        ColorRGBA(r=0.9, g=0.2, b=0.2, a=0.1 + 0.5 * float(p)) for p in occupancy.probability.ravel()[flat]
    ]
    return MarkerArray(markers=[marker])


def future_markers(futures: Sequence[tuple[float, FloatArray]], stamp: Time) -> MarkerArray:
    """Return one line per way (N, 3), world frame, that a hand may go, the more opaque the more probable it is."""
    array, most = _only_these(), max((p for p, _ in futures), default=1.0)
    for k, (p, way_m) in enumerate(futures):
        colour = ColorRGBA(r=0.55, g=0.15, b=0.05, a=0.2 + 0.8 * float(p / most))
        marker = marker_of(Marker.LINE_STRIP, "futures", "world", stamp, 0.006, colour)
        marker.id, marker.points = k, points_of(way_m)
        array.markers.append(marker)
    return array


def candidate_markers(paths: Sequence[tuple[str, FloatArray, bool]], stamp: Time) -> MarkerArray:
    """Return one line per candidate: (goal name, tool positions (N, 3) in the world, chosen)."""
    array = _only_these()
    for name, positions, chosen in paths:
        colour = ColorRGBA(r=0.1, g=0.8, b=0.2, a=1.0) if chosen else ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.8)
        marker = marker_of(Marker.LINE_STRIP, f"candidate/{name}", "world", stamp, 0.012, colour)
        marker.points = points_of(positions)
        array.markers.append(marker)
    return array


def rollout_markers(rollouts: Sequence[tuple[str, Sequence[FloatArray]]], stamp: Time) -> MarkerArray:
    """Return the noisy paths STOMP compared for each goal: (goal name, tool positions (N, 3) of each rollout)."""
    array = _only_these()
    for name, paths in rollouts:
        colour = ColorRGBA(r=0.3, g=0.5, b=0.9, a=0.4)
        marker = marker_of(Marker.LINE_LIST, f"rollouts/{name}", "world", stamp, 0.003, colour)
        for positions in paths:
            ends = np.repeat(positions, 2, axis=0)[1:-1]  # a list of separate lines: inner points twice
            marker.points += points_of(ends)
        array.markers.append(marker)
    return array


def separation_markers(body_m: FloatArray, arm_m: FloatArray, text: str, factor: float, stamp: Time) -> MarkerArray:
    """Return the line between the two points (3,) that decide, world frame, and what is said of it; red at a stop."""
    colour = ColorRGBA(r=1.0 - factor, g=factor, b=0.1, a=1.0)
    line = marker_of(Marker.LINE_LIST, "separation", "world", stamp, 0.01, colour)
    line.points = points_of(np.array([body_m, arm_m]))
    words = marker_of(Marker.TEXT_VIEW_FACING, "separation/terms", "world", stamp, 0.0, colour)
    words.scale.z, words.text = 0.05, text
    (words.pose.position,) = points_of(0.5 * (body_m + arm_m)[None] + np.array([0.0, 0.0, 0.1]))
    return MarkerArray(markers=[line, words])


class PlanPictures:
    """Shows the paths a planner compares, while somebody looks.

    Attributes:
        candidates, rollouts: publishers of the tool's paths to each goal, and of the last step's noisy ones.
    """

    def __init__(self, node: Node, tool_path: Callable[[FloatArray], FloatArray]) -> None:
        """Take the node that publishes, and a function that returns the tool's positions (N, 3) along a path (N, D)."""
        self.candidates = node.create_publisher(MarkerArray, topics.CANDIDATES, qos.MARKERS)
        self.rollouts = node.create_publisher(MarkerArray, topics.ROLLOUTS, qos.MARKERS)
        self._tool_path = tool_path

    def show(self, decision: Decision, rollouts: Mapping[str, Float32Array], stamp: Time) -> None:
        """Publish the goals of a decision, and noisy paths (R, N, D) by goal."""
        if decision.goals and self.candidates.get_subscription_count():
            paths = [(goal.name, self._tool_path(goal.path), goal.name == decision.chosen) for goal in decision.goals]
            self.candidates.publish(candidate_markers(paths, stamp))
        if decision.goals and rollouts:
            noisy = [(name, [self._tool_path(path) for path in paths]) for name, paths in rollouts.items()]
            self.rollouts.publish(rollout_markers(noisy, stamp))
