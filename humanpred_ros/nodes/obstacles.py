"""Obstacles on topics: solids as markers, a cloud of points, and markers that show what the planner knows of both."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from humanpred_ros import topics
from humanpred_ros.bags.messages import point_cloud2_fields
from humanpred_ros.errors import ArrayError, HumanPredError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.solids import Box, EllipticCylinder, Obstacle, Shape, Sphere
from humanpred_ros.nodes import qos
from humanpred_ros.nodes.commanding_node import CommandingNode
from humanpred_ros.nodes.conversions import time_message
from humanpred_ros.nodes.frames import WORLD, Lookup, pose_matrix, tf_lookup
from humanpred_ros.nodes.markers import marker_of, points_of
from humanpred_ros.planning.live_obstacles import LiveObstacles
from humanpred_ros.robot.scene import Scene
from humanpred_ros.robot.scene_file import LARGEST_M

#: No solid at a table is larger, m: what is was given in millimetres.
_LARGEST_SOLID_M = 10.0
#: Messages that came on both subscriptions are told apart by when they were sent; so many are remembered.
_REMEMBERED = 256
#: How often what TF could not place is tried again, s.
_RETRY_S = 0.2
_CLOUD = None  # key of the cloud among the doubts


def solid_of(marker: Marker, pose_of: Callable[[str], FloatArray]) -> Obstacle:
    """Return the solid of a marker: a CUBE, a CYLINDER whose axis is z, or a SPHERE.

    Args:
        marker: as it came.
        pose_of: returns the pose (4, 4) of a frame in the world.

    Raises:
        ArrayError: for another kind, lengths that are none, or a pose that is none.
        LookupError: as `pose_of`.
    """
    what = f"obstacle {marker.ns}/{marker.id}"
    size = np.array([marker.scale.x, marker.scale.y, marker.scale.z])
    p, r = marker.pose.position, marker.pose.orientation
    place = np.array([p.x, p.y, p.z])
    if not ((size > 0.0).all() and np.isfinite(size).all() and np.isfinite(place).all()):
        raise ArrayError(f"{what}: wanted a finite place and lengths above 0, got {place.tolist()} and {size.tolist()}")
    if size.max() > _LARGEST_SOLID_M or np.abs(place).max() > LARGEST_M:
        raise ArrayError(f"{what}: wanted metres, got lengths {size.tolist()} at {place.tolist()}; divide millimetres")
    shape: Shape
    if marker.type == Marker.CUBE:
        shape = Box(*map(float, size))
    elif marker.type == Marker.CYLINDER:
        shape = EllipticCylinder(float(size[0]) / 2.0, float(size[1]) / 2.0, float(size[2]))
    elif marker.type == Marker.SPHERE and size.max() - size.min() < 1e-6:
        shape = Sphere(float(size[0]) / 2.0)
    else:
        raise ArrayError(f"{what}: wanted a CUBE, a CYLINDER or a round SPHERE, got type {marker.type}")
    try:
        T = pose_matrix((p.x, p.y, p.z), (r.x, r.y, r.z, r.w))
    except LookupError as trouble:
        raise ArrayError(f"{what}: wanted a quaternion of length 1 (w = 1 for upright), {trouble}") from trouble
    return Obstacle(what, shape, pose_of(marker.header.frame_id) @ T)


def solid_marker(obstacle: Obstacle, colour: ColorRGBA) -> Marker:
    """Return the marker that shows a solid."""
    half = np.array(obstacle.shape.half_m)
    kinds = {Box: Marker.CUBE, EllipticCylinder: Marker.CYLINDER, Sphere: Marker.SPHERE}
    kind = kinds.get(type(obstacle.shape), Marker.CUBE)  # the box around it
    marker = marker_of(kind, "obstacles", WORLD, time_message(0), 0.0, colour)
    marker.scale.x, marker.scale.y, marker.scale.z = (2.0 * float(length) for length in half)
    T = obstacle.T_world_shape
    (marker.pose.position,) = points_of(T[None, :3, 3])
    from scipy.spatial.transform import Rotation  # takes half a second to import

    turn = marker.pose.orientation
    R = np.array(T[:3, :3])  # older SciPy wants one it may write to
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(R).as_quat().tolist()
    return marker


def cloud_points(cloud: PointCloud2) -> FloatArray:
    """Return the points (N, 3) of a cloud; where it says that it is not dense, those that are finite.

    Raises:
        ArrayError: a layout that does not fit, a coordinate that is missing, points that are not finite in a dense
            cloud, or no finite point among those of one that is not.
    """
    try:
        columns = point_cloud2_fields(cloud, ("x", "y", "z"))
    except HumanPredError as trouble:
        raise ArrayError(str(trouble)) from trouble
    points = np.stack([columns[name].astype(np.float64) for name in "xyz"], axis=-1)
    finite = points[np.isfinite(points).all(axis=1)]
    if len(finite) < len(points) and (cloud.is_dense or not len(finite)):
        raise ArrayError(
            f"point cloud: wanted finite points, got {len(points) - len(finite)} of {len(points)} that are not; a "
            "cloud with gaps says is_dense = false"
        )
    return finite


class ObstacleInput:
    """Listens to obstacles for a planner; while something of them cannot be believed, its arm is held.

    Solids come as markers, each namespace and id in the place of the last one; DELETE, DELETEALL and lifetimes, from
    arrival on, are obeyed. A cloud takes the place of the last one.

    Attributes:
        live: what is known.
    """

    def __init__(self, node: CommandingNode, scene: Scene) -> None:
        self._node, self._replanner, self._scene = node, node.replanner, scene
        self.live = LiveObstacles(scene.distance_field())
        self._lookup: Lookup | None = tf_lookup(node)
        robot = scene.arm.robot
        self._known = {WORLD: np.eye(4), robot.file.base_frame or robot.description.link_names[0]: scene.T_world_base}
        if scene.human_frame:
            self._known[scene.human_frame] = scene.T_world_human
        self._seen: deque[tuple[str, int]] = deque(maxlen=_REMEMBERED)
        #: What came in a frame of which nobody says where it is.
        self._unplaced: dict[tuple[str, int] | None, Marker | PointCloud2] = {}
        self._tried_s = 0.0
        self._pictures = node.create_publisher(MarkerArray, topics.SCENE_MARKERS, qos.LATCHED)
        # Publishers may latch what they send, so that late listeners get it, or not: no one profile hears both in full.
        for profile in (qos.LATCHED_HISTORY, qos.LOSSLESS):
            self._listen(MarkerArray, topics.OBSTACLES, self._on_markers, profile)
        for profile in (qos.LATCHED, qos.NEWEST_ONLY):
            self._listen(PointCloud2, topics.OBSTACLE_CLOUD, self._on_cloud, profile)
        self.show()

    def facts(self) -> dict[str, str]:
        """Return what there is, for /diagnostics."""
        return {"live_obstacles": f"{len(self.live.solids)} solids, {len(self.live.cells_m)} cubes of a cloud"}

    def refresh(self) -> None:
        """Let the replanner know what has changed; before every answer, in the thread that plans."""
        self.live.expire(self._now_s())
        if self._unplaced and self._lookup is not None and time.monotonic() - self._tried_s > _RETRY_S:
            self._tried_s = time.monotonic()
            for key, message in list(self._unplaced.items()):
                self._take(key, message)
            self._judge()
        if self.live.changed:
            self._replanner.change(field=self.live.field())
            self.show()

    def _listen(self, kind: type[Any], topic: str, callback: Callable[[Any], None], profile: Any) -> None:
        name = self._node.resolve_topic_name(topic)

        def once(message: Any) -> bool | None:
            sent = name, heard.sent_ns
            if heard.sent_ns > 0 and sent in self._seen:
                return False
            self._seen.append(sent)
            callback(message)
            return None

        # That one of the two does not match a publisher is no news.
        quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
        self._node.listen(kind, topic, once, profile, event_callbacks=quiet)
        heard = self._node.inputs[name]

    def _on_markers(self, message: MarkerArray) -> None:
        for marker in message.markers:
            key = marker.ns, marker.id
            if marker.action == Marker.DELETEALL:
                self.live.clear()
                self._unplaced = {key: cloud for key, cloud in self._unplaced.items() if key is _CLOUD}
            elif marker.action == Marker.DELETE:
                self.live.remove(key)
                self._unplaced.pop(key, None)
            elif marker.action == Marker.ADD and marker.type == Marker.TEXT_VIEW_FACING:
                continue  # a label is no solid
            elif marker.action == Marker.ADD:
                self._take(key, marker)
            else:
                self.live.doubts[key] = (
                    f"obstacle {marker.ns}/{marker.id}: wanted action 0, 2 or 3, got {marker.action}"
                )
        self._judge()

    def _on_cloud(self, message: PointCloud2) -> None:
        self._take(_CLOUD, message)
        self._judge()

    def _take(self, key: tuple[str, int] | None, message: Marker | PointCloud2) -> None:
        """Let a solid or a cloud take the place of the last one of its key, or doubt that."""
        self._unplaced.pop(key, None)
        try:
            if isinstance(message, Marker):
                lifetime_s = message.lifetime.sec + message.lifetime.nanosec * 1e-9
                if lifetime_s < 0.0:
                    raise ArrayError(f"obstacle {key}: wanted a lifetime of at least 0, got {lifetime_s} s")
                until_s = self._now_s() + lifetime_s if lifetime_s else np.inf
                self.live.put(key, solid_of(message, self._pose), until_s)
            else:
                points, T = cloud_points(message), self._pose(message.header.frame_id)
                self.live.set_points(points @ T[:3, :3].T + T[:3, 3])
        except LookupError as trouble:
            self.live.doubts[key] = str(trouble)
            self._unplaced[key] = message
        except ArrayError as trouble:
            self.live.doubts[key] = str(trouble)

    def _judge(self) -> None:
        """Hold as long as something is in doubt."""
        doubt = f"invalid obstacles: {self.live.doubt}" if self.live.doubt else ""
        if doubt:
            self._node.refuse(doubt)
        if doubt != self._replanner.doubt:
            self._replanner.doubt = doubt
            if doubt:
                self._node.hold(doubt)

    def _now_s(self) -> float:
        """Return the time that lifetimes are counted in: the steady clock's, but in stepped runs the data's."""
        if self._node.settings.lossless:
            return self._node.get_clock().now().nanoseconds * 1e-9
        return time.monotonic()

    def _pose(self, frame_id: str) -> FloatArray:
        frame = frame_id.lstrip("/")
        trouble = "tf2_ros, which could say where that is, is not installed"
        if self._lookup is not None and frame and frame != WORLD:
            try:
                return self._lookup(frame)
            except LookupError as error:
                trouble = f"TF has no way from there to {WORLD!r}: {error}"
        if frame in self._known:
            return self._known[frame]
        raise LookupError(f"wrong frame: wanted one of {', '.join(self._known)}, got {frame!r:.80}; {trouble}")

    def show(self) -> None:
        """Publish pictures of the scene and of what is live."""
        self._pictures.publish(scene_markers(self._scene.obstacles, self.live, self._replanner.tool_places()))


def scene_markers(still: Sequence[Obstacle], live: LiveObstacles, tasks: Mapping[str, FloatArray]) -> MarkerArray:
    """Return the solids that stand, those that are live, the cubes of the cloud, and the tasks' tool places (3,)."""
    wood, signal = ColorRGBA(r=0.8, g=0.7, b=0.5, a=1.0), ColorRGBA(r=0.95, g=0.55, b=0.1, a=0.9)
    array = MarkerArray(markers=[Marker(action=Marker.DELETEALL)])
    array.markers += map(partial(solid_marker, colour=wood), still)
    array.markers += map(partial(solid_marker, colour=signal), live.solids)
    if len(live.cells_m):
        cubes = marker_of(Marker.CUBE_LIST, "cloud", WORLD, time_message(0), live.grid.resolution_m, signal)
        cubes.points = points_of(live.cells_m)
        array.markers.append(cubes)
    for name, place in tasks.items():
        for kind in (Marker.SPHERE, Marker.TEXT_VIEW_FACING):
            marker = marker_of(kind, "tasks", WORLD, time_message(0), 0.03, ColorRGBA(r=0.1, g=0.6, b=0.3, a=1.0))
            marker.text = name if kind == Marker.TEXT_VIEW_FACING else ""
            (marker.pose.position,) = points_of(place[None])
            array.markers.append(marker)
    for k, marker in enumerate(array.markers):
        marker.id = k
    return array
