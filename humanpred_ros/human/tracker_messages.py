"""The bodies in a tracker's messages, by the message's type: live ones of rclpy and those read from bags alike.

A message gives, for each body by the tracker's id, points (N, 3) in the skeleton's order and a confidence (N,) or None.
Nothing here imports ROS: messages are looked at by the names of their fields.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.urdf import parse_description
from humanpred_ros.human.skeletons import Skeleton

Bodies = dict[str, tuple[FloatArray, FloatArray | None]]

#: No message tells of more bodies.
_MOST_BODIES = 100
_URDF_BYTES = 1 << 20
_ADD = 0  # of a marker's actions
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"  # begins a message in CDR
_SEEN = 1  # of ZED's tracking states: what is searched for is extrapolated
_ZED_FORMATS = {0: "zed_body18", 1: "zed_body34", 2: "zed_body38"}
#: Fields of clouds that tell the point, the body, and how sure the tracker is; the first that is there counts.
_CLOUD_FIELDS = (("joint", "index", "id", "keypoint"), ("body", "person", "label", "track"), ("confidence", "score"))


@dataclass(frozen=True)
class SeenBodies:
    """What one message says."""

    stamp_ns: int  #: 0 where it has none
    frame_id: str
    bodies: Bodies  #: none: the tracker sees nobody


def seen_bodies(message: Any, kind: str, skeleton: Skeleton) -> SeenBodies:
    """Return the bodies in a message.

    Args:
        message: of a type in `READERS`.
        kind: the type's name, as `visualization_msgs/msg/MarkerArray`.
        skeleton: which the tracker has.

    Raises:
        ArrayError: a message that does not hold this skeleton.
        BagError: a cloud whose layout does not fit its data.
    """
    return READERS[kind](message, skeleton)


class _Marker(NamedTuple):
    ns: str
    id: int
    action: int
    stamp_ns: int
    frame_id: str
    place: tuple[float, float, float]


def _of_markers(message: Any, skeleton: Skeleton) -> SeenBodies:
    return _bodies_of(_decoded_markers(message), skeleton)


def bodies_in_markers(data: bytes, skeleton: Skeleton) -> SeenBodies | None:
    """Return the bodies in a serialized MarkerArray, as `seen_bodies`: rclpy takes 1 ms to decode that of one body.

    None where it is not in the usual form (little-endian CDR), or not whole: rclpy then says what is wrong.
    """
    if data[:4] != _LITTLE_ENDIAN:
        return None
    try:
        return _bodies_of(list(_raw_markers(data)), skeleton)
    except (struct.error, UnicodeDecodeError):
        return None


def _decoded_markers(message: Any) -> list[_Marker]:
    return [
        _Marker(m.ns, int(m.id), m.action, _stamp_ns(m.header), str(m.header.frame_id), (p.x, p.y, p.z))
        for m in message.markers
        for p in (m.pose.position,)
    ]


def _raw_markers(data: bytes) -> Iterator[_Marker]:
    """Yield the markers of a MarkerArray in little-endian CDR; numbers are aligned from the end of its header on."""
    u32, at = struct.Struct("<I").unpack_from, 8

    def skipped(at: int, size: int, align: int = 4) -> int:
        """Return where a sequence ends whose length is told at `at`, of elements so large."""
        at += -at % 4
        n = int(u32(data, at)[0])
        at += 4
        return at + n * size + (-(at - 4) % align if n else 0)

    def text(at: int) -> tuple[str, int]:
        end = skipped(at, 1)
        return data[at + -at % 4 + 4 : end - 1].decode(), end

    for _ in range(u32(data, 4)[0]):
        at += -at % 4
        sec, nanosec = struct.unpack_from("<iI", data, at)
        frame_id, at = text(at + 8)
        ns, at = text(at)
        at += -at % 4
        number, _, action = struct.unpack_from("<iii", data, at)
        at += 12
        at += -(at - 4) % 8
        place = struct.unpack_from("<ddd", data, at)
        at += 10 * 8 + 4 * 4 + 8 + 1  # pose and scale, colour, lifetime, frame_locked
        at = skipped(skipped(at, 24, 8), 16)  # points, colors
        at = skipped(at, 1)  # texture_resource
        at += -at % 4
        at = skipped(skipped(skipped(at + 8, 1), 1), 1)  # texture: stamp, frame, format, data
        at = skipped(skipped(skipped(at, 8), 1), 1)  # uv_coordinates, text, mesh_resource
        at = skipped(skipped(at, 1), 1) + 1  # mesh_file, mesh_use_embedded_materials
        yield _Marker(ns, number, action, sec * 1_000_000_000 + nanosec, frame_id, place)
    if at > len(data):
        raise struct.error("markers that end beyond the message")


def _bodies_of(markers: Sequence[_Marker], skeleton: Skeleton) -> SeenBodies:
    n = len(skeleton.names)
    bodies: Bodies = {}
    first: _Marker | None = None
    for marker in markers:
        body, joint = divmod(marker.id, skeleton.per_body)
        joint -= skeleton.first_index
        if marker.action != _ADD or not 0 <= joint < n:
            continue
        first = first or marker
        points, _ = bodies.setdefault(f"{marker.ns}{body}", (np.full((n, 3), np.nan), None))
        points[joint] = marker.place
        _few(bodies)
    if first is None:
        if any(marker.action == _ADD for marker in markers):
            raise ArrayError(
                f"markers: wanted ids of body * {skeleton.per_body} + point, points up to {n - 1}, got none such"
            )
        return SeenBodies(0, "", {})
    return SeenBodies(first.stamp_ns, first.frame_id, bodies)


def _of_poses(message: Any, skeleton: Skeleton) -> SeenBodies:
    n = len(skeleton.names)
    if len(message.poses) % n:
        raise ArrayError(f"poses: wanted {n} points for each body, got {len(message.poses)} poses")
    places = [pose.position for pose in message.poses]
    points = np.array([(place.x, place.y, place.z) for place in places], dtype=np.float64).reshape(-1, n, 3)
    return _listed(message.header, points, None)


def _of_cloud(message: Any, skeleton: Skeleton) -> SeenBodies:
    from humanpred_ros.bags.messages import point_cloud2_fields  # only those who get clouds load a store of types

    n, known = len(skeleton.names), {field.name for field in message.fields}
    joint, body, confidence = (next((name for name in names if name in known), None) for names in _CLOUD_FIELDS)
    wanted = ["x", "y", "z", *(name for name in (joint, body, confidence) if name)]
    column = {name: np.asarray(x, dtype=np.float64) for name, x in point_cloud2_fields(message, wanted).items()}
    table = np.stack([column[name] for name in "xyz"], axis=1)
    sure = column[confidence] if confidence else None
    if joint is None:
        if len(table) % n:
            raise ArrayError(f"cloud: wanted {n} points for each body, or a field joint, got {len(table)} points")
        return _listed(message.header, table.reshape(-1, n, 3), None if sure is None else sure.reshape(-1, n))
    if not np.isfinite(column[joint]).all() or (body and not np.isfinite(column[body]).all()):
        raise ArrayError("cloud: wanted whole numbers for points and bodies, got others")
    bodies: Bodies = {}
    for row in range(len(table)):
        index = int(column[joint][row]) - skeleton.first_index
        if not 0 <= index < n:
            raise ArrayError(f"cloud: wanted points up to {n - 1 + skeleton.first_index}, got {column[joint][row]:g}")
        of = str(int(column[body][row])) if body else "0"
        points, told = bodies.setdefault(of, (np.full((n, 3), np.nan), None if sure is None else np.zeros(n)))
        points[index] = table[row]
        if told is not None and sure is not None:
            told[index] = sure[row]
        _few(bodies)
    return SeenBodies(_stamp_ns(message.header), str(message.header.frame_id), bodies)


def _of_zed(message: Any, skeleton: Skeleton) -> SeenBodies:
    n = len(skeleton.names)
    bodies: Bodies = {}
    for told in message.objects:
        fitting = _ZED_FORMATS.get(int(told.body_format), "none of this package's")
        if fitting != f"zed_body{n}":
            raise ArrayError(f"ZED: wanted bodies of {n} points, got another format; its skeleton is {fitting}")
        if int(told.tracking_state) == _SEEN:
            points = np.array([point.kp for point in told.skeleton_3d.keypoints[:n]], dtype=np.float64)
            bodies[str(told.label_id)] = points, np.full(n, float(told.confidence))
    return SeenBodies(_stamp_ns(message.header), str(message.header.frame_id), _few(bodies))


def _of_yolo(message: Any, skeleton: Skeleton) -> SeenBodies:
    n = len(skeleton.names)
    bodies: Bodies = {}
    frame = ""
    for k, told in enumerate(message.detections):
        if not len(told.keypoints3d.data):
            continue
        points, sure = np.full((n, 3), np.nan), np.zeros(n)
        for point in told.keypoints3d.data:
            index = int(point.id) - skeleton.first_index
            if not 0 <= index < n:
                raise ArrayError(f"YOLO: wanted ids from {skeleton.first_index} to {n - 1 + skeleton.first_index}, "
                                 f"got {point.id}; its skeleton is yolo")  # fmt: skip
            points[index] = point.point.x, point.point.y, point.point.z
            sure[index] = point.score
        bodies[str(told.id) or f"#{k}"] = points, sure
        frame = frame or str(told.keypoints3d.frame_id)
    return SeenBodies(_stamp_ns(message.header), frame or str(message.header.frame_id), _few(bodies))


#: Who reads which type of message.
READERS: Mapping[str, Callable[[Any, Skeleton], SeenBodies]] = {
    "visualization_msgs/msg/MarkerArray": _of_markers,
    "geometry_msgs/msg/PoseArray": _of_poses,
    "sensor_msgs/msg/PointCloud2": _of_cloud,
    "zed_msgs/msg/ObjectsStamped": _of_zed,
    "yolo_msgs/msg/DetectionArray": _of_yolo,
}


class Ros4HriBody:
    """The points of a ROS4HRI body: its URDF, moved by its joint states.

    Raises:
        UsageError: a URDF that cannot be read.
    """

    def __init__(self, body_id: str, urdf: str, skeleton: Skeleton) -> None:
        """Take the body's id, which ends the names of its joints and links, its URDF, and which points are wanted."""
        self._tree = parse_description(_bare(urdf))
        self._end = f"_{body_id}"
        links = {name.removesuffix(self._end): k for k, name in enumerate(self._tree.link_names)}
        joints = {name.removesuffix(self._end): k + 1 for k, name in enumerate(self._tree.joint_names)}
        self._links: list[int | None] = []
        for name in skeleton.names:
            k = links.get(name)
            if name in joints:  # the link that begins at the joint
                at = np.flatnonzero(self._tree.link_joint == joints[name])
                k = int(min(at, key=lambda k: float(np.abs(self._tree.T_joint_link[k] - np.eye(4)).max())))
            self._links.append(k)

    def points(self, names: list[str], positions: FloatArray) -> FloatArray:
        """Return points (N, 3) in the body's frame, NaN for those the URDF does not have.

        Raises:
            ArrayError: positions that are missing, or not finite.
        """
        told = dict(zip(names, positions, strict=False))
        missing = [name for name in self._tree.joint_names if not np.isfinite(told.get(name, np.nan))]
        if missing:
            raise ArrayError(f"missing joints: wanted all of the body's URDF, {', '.join(missing)} did not come")
        poses = self._tree.link_poses({name: float(told[name]) for name in self._tree.joint_names})
        return np.array([np.full(3, np.nan) if k is None else poses[k, :3, 3] for k in self._links])


def _bare(urdf: str) -> str:
    """Return a URDF without shapes: it comes from a stranger, and only its joints are wanted.

    Raises:
        UsageError: no XML, or one that defines entities.
    """
    if len(urdf) > _URDF_BYTES or "<!" in urdf.replace("<!--", ""):
        raise UsageError(
            f"body's URDF: wanted at most {_URDF_BYTES >> 20} MiB and no document type, got something else"
        )
    try:
        robot = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as trouble:
        raise UsageError(f"body's URDF: wanted XML, got text that does not parse: {trouble}") from trouble
    for link in robot.iterfind("link"):
        for part in [*link.iterfind("visual"), *link.iterfind("collision"), *link.iterfind("inertial")]:
            link.remove(part)
    return ElementTree.tostring(robot, encoding="unicode")


def _listed(header: Any, points: FloatArray, sure: FloatArray | None) -> SeenBodies:
    """Return bodies that have no ids: they are told by where they stand."""
    bodies = {f"#{k}": (own, None if sure is None else sure[k]) for k, own in enumerate(points)}
    return SeenBodies(_stamp_ns(header), str(header.frame_id), _few(bodies))


def _few(bodies: Bodies) -> Bodies:
    if len(bodies) > _MOST_BODIES:
        raise ArrayError(f"too many bodies: wanted at most {_MOST_BODIES}, got more")
    return bodies


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
