"""ROS messages without ROS: bags are written and read where no rclpy is installed.

Messages are the plain dataclasses of rosbags' type store; on the wire (CDR) they are the same bytes
rclpy produces. Only the types this package records have a builder here; any other common type can
be made with `message_class`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.typesys import Stores, get_typestore

from humanpred_ros.errors import BagError, UsageError

JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
POINT_CLOUD2 = "sensor_msgs/msg/PointCloud2"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
CLOCK = "rosgraph_msgs/msg/Clock"

#: PointField datatype codes of sensor_msgs and the NumPy types they stand for.
_POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_POINT_CODES = {np.dtype(name): code for code, name in _POINT_TYPES.items()}
_BYTES = 2  #: of these a text in UTF-8 is made, with zeros at its end


@dataclass(frozen=True)
class TypeDefinition:
    """What a bag stores about a message type so that any tool can decode it."""

    text: str  #: the message definition with all it depends on
    encoding: str  #: `ros2msg` or `ros2idl`
    type_hash: str  #: the REP-2011 hash (`RIHS01_...`); empty if unknown


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Return the store of all message types of ROS 2 Jazzy's common interfaces."""
    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache(maxsize=256)
def type_definition(msgtype: str) -> TypeDefinition:
    """Return definition text and type hash of a message type such as `sensor_msgs/msg/JointState`.

    Raises:
        UsageError: the type is not part of Jazzy's common interfaces.
    """
    _require_known(msgtype)
    text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
    return TypeDefinition(text, "ros2msg", typestore().hash_rihs01(msgtype))


def message_class(msgtype: str) -> Any:
    """Return the dataclass of a message type; its fields are given by keyword. Raises UsageError if unknown."""
    _require_known(msgtype)
    return typestore().types[msgtype]


def serialise(message: Any) -> bytes:
    """Return a message of the type store as little-endian CDR bytes."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def decode(data: bytes, msgtype: str) -> Any:
    """Return the message in CDR bytes. Raises BagError, also for a type outside Jazzy's common interfaces.

    Bytes after the message are ignored, as rclpy does: its serializer leaves some, the size being an estimate.
    """
    if len(data) < 4 or data[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise BagError(
            f"wanted CDR bytes holding a {msgtype}, got {data[:4].hex() or 'nothing'}; check what wrote them"
        )
    store = typestore()
    if msgtype not in store.fielddefs:
        raise BagError(f"wanted a message of ROS 2 Jazzy's common interfaces, got one of type {msgtype!r:.120}")
    try:
        definition = store.get_msgdef(msgtype)
        decode = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
        message, _ = decode(memoryview(data)[4:], 0, definition.cls, store)
        return message
    # rosbags generates its decoders; on wrong bytes these fail in whatever way Python does.
    except Exception as trouble:
        raise BagError(
            f"wanted {len(data)} bytes holding a {msgtype}, got bytes that do not decode ({trouble}); "
            "check the bag with: humanpred bag check"
        ) from trouble


def stamp_from_ns(time_ns: int) -> Any:
    """Return builtin_interfaces/Time of nanoseconds since the epoch."""
    sec, nanosec = divmod(int(time_ns), 1_000_000_000)
    return message_class("builtin_interfaces/msg/Time")(sec=sec, nanosec=nanosec)


def ns_from_stamp(stamp: Any) -> int:
    """Return nanoseconds since the epoch of a builtin_interfaces/Time (of rosbags or of rclpy)."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def header(time_ns: int, frame_id: str) -> Any:
    """Return std_msgs/Header."""
    return message_class("std_msgs/msg/Header")(stamp=stamp_from_ns(time_ns), frame_id=frame_id)


def string(text: str) -> Any:
    """Return std_msgs/String."""
    return message_class(STRING)(data=text)


def joint_state(
    time_ns: int,
    names: Sequence[str],
    position: ArrayLike,
    *,
    frame_id: str = "",
    velocity: ArrayLike = (),
) -> Any:
    """Return sensor_msgs/JointState; `position` is (D,) in radians and metres, in the order of `names`."""
    values = _floats(position)
    if values.shape != (len(names),):
        raise UsageError(f"joint state: wanted one position for each of {len(names)} names, got shape {values.shape}")
    return message_class(JOINT_STATE)(
        header=header(time_ns, frame_id),
        name=list(names),
        position=values,
        velocity=_floats(velocity),
        effort=_floats(()),
    )


def point_cloud2(time_ns: int, frame_id: str, fields: Mapping[str, ArrayLike]) -> Any:
    """Return an unordered sensor_msgs/PointCloud2 whose columns are the arrays of `fields`.

    Args:
        time_ns: stamp.
        frame_id: frame of x, y and z.
        fields: name to (N,) array; float64, float32 and integers up to 32 bits keep their type; bytes (`S<n>`) become
            n numbers each.

    Raises:
        UsageError: no fields, different lengths, or a type PointCloud2 has no code for.
    """
    columns = {name: np.asarray(values) for name, values in fields.items()}
    shapes = {column.shape for column in columns.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 1:
        raise UsageError(f"point cloud: wanted fields of one length, got shapes {sorted(shapes)}")
    unknown = [
        name for name, column in columns.items() if column.dtype not in _POINT_CODES and column.dtype.kind != "S"
    ]
    if unknown:
        raise UsageError(
            f"point cloud: field {unknown[0]!r} has type {columns[unknown[0]].dtype}; "
            f"wanted one of {', '.join(str(t) for t in _POINT_CODES)}"
        )
    layout = np.dtype([(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    offsets = np.cumsum([0] + [column.itemsize for column in columns.values()])
    (count,) = next(iter(shapes))
    table = np.empty(count, dtype=layout)
    for name, column in columns.items():
        table[name] = column
    field = message_class("sensor_msgs/msg/PointField")
    return message_class(POINT_CLOUD2)(
        header=header(time_ns, frame_id),
        height=1,
        width=count,
        fields=[
            field(
                name=name,
                offset=int(offset),
                datatype=_POINT_CODES.get(column.dtype, _BYTES),
                count=column.dtype.itemsize if column.dtype.kind == "S" else 1,
            )
            for offset, (name, column) in zip(offsets, columns.items(), strict=False)
        ],
        is_bigendian=False,
        point_step=layout.itemsize,
        row_step=layout.itemsize * count,
        data=table.view(np.uint8).reshape(-1),
        # Lost points are NaN, which is what "not dense" announces.
        is_dense=all(column.dtype.kind == "S" or bool(np.isfinite(column).all()) for column in columns.values()),
    )


def point_cloud2_fields(message: Any, names: Iterable[str] | None = None) -> dict[str, NDArray[Any]]:
    """Return the columns of a PointCloud2 by name, (N,) each, in the type they were sent in; several bytes are a text.

    Raises:
        BagError: a named field is missing, or the layout does not fit the data.
    """
    offered = {field.name: field for field in message.fields}
    wanted = list(offered) if names is None else list(names)
    missing = [name for name in wanted if name not in offered]
    if missing:
        raise BagError(f"point cloud: wanted field {missing[0]!r}, got fields {list(offered)}")
    order = ">" if message.is_bigendian else "<"
    try:
        layout = np.dtype(
            {
                "names": wanted,
                "formats": [_format_of(offered[name], order) for name in wanted],
                "offsets": [offered[name].offset for name in wanted],
                "itemsize": message.point_step,
            }
        )
        raw = np.frombuffer(bytes(message.data), dtype=np.uint8).reshape(message.height, message.row_step)
        row_bytes = message.width * message.point_step
        if row_bytes > message.row_step:
            raise ValueError(f"rows of {message.row_step} bytes hold no {message.width} points")
        rows = np.ascontiguousarray(raw[:, :row_bytes]).reshape(-1)
        table = rows.view(layout)
    except (KeyError, ValueError, TypeError) as trouble:
        raise BagError(
            f"point cloud: its layout does not fit its data ({trouble}); the message is damaged"
        ) from trouble
    return {name: table[name].astype(table[name].dtype.newbyteorder("=")) for name in wanted}


def _format_of(field: Any, order: str) -> str:
    text = field.datatype == _BYTES and field.count > 1
    return f"S{field.count}" if text else order + _POINT_TYPES[field.datatype]


def _floats(values: ArrayLike) -> NDArray[np.float64]:
    return np.array(values, dtype=np.float64)


def _require_known(msgtype: str) -> None:
    if msgtype not in typestore().fielddefs:
        raise UsageError(
            f"wanted a message type of ROS 2 Jazzy's common interfaces, got {msgtype!r}; "
            "spell it package/msg/Name, or give its definition"
        )
