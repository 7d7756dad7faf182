"""What a bag says of its topics: metadata.yaml (version 9, as Jazzy writes it) and their quality of service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from humanpred_ros.errors import BagError
from humanpred_ros.files import read_yaml, yaml_of

_VERSION = 9
_ROS_DISTRO = "jazzy"
#: rosbag2's starting time of a bag without messages.
_NO_START_NS = 2**63 - 1
#: The value rmw uses for "no deadline", "lives for ever": the largest signed 64-bit count of nanoseconds.
_INFINITE = QosTime(9223372036, 854775807)


def _keep_last(depth: int, durability: QosDurability) -> Qos:
    reliable, alive = QosReliability.RELIABLE, QosLiveliness.AUTOMATIC
    return Qos(QosHistory.KEEP_LAST, depth, reliable, durability, _INFINITE, _INFINITE, alive, _INFINITE, False)


#: Of topics that do not ask for another: reliable, volatile, the last 10 messages, as rclpy's default.
DEFAULT_QOS = _keep_last(10, QosDurability.VOLATILE)
#: Of topics whose last message late subscribers get (URDF, voxel lattice).
LATCHED_QOS = _keep_last(1, QosDurability.TRANSIENT_LOCAL)


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag: name, message type, number of messages, encoding, offered QoS and type hash."""

    name: str
    msgtype: str
    count: int
    encoding: str = "cdr"
    qos: tuple[Qos, ...] = ()
    type_hash: str = ""


def metadata_text(
    file: str, topics: Sequence[TopicInfo], start_ns: int, end_ns: int, custom: Mapping[str, str], *, bare: bool = False
) -> str:
    """Return metadata.yaml of a bag in one file.

    Args:
        file: name of the storage file.
        topics: in the order they were announced.
        start_ns, end_ns: log times of the first and last message.
        custom: rosbag2's custom_data.
        bare: leave out the outermost key, as in the copy inside the mcap file.
    """
    count = sum(topic.count for topic in topics)

    def times() -> dict[str, Any]:
        return {
            "starting_time": {"nanoseconds_since_epoch": start_ns if count else _NO_START_NS},
            "duration": {"nanoseconds": end_ns - start_ns if count else 0},
        }

    information: dict[str, Any] = {
        "version": _VERSION,
        "storage_identifier": "mcap",
        **times(),
        "message_count": count,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.msgtype,
                    "serialization_format": topic.encoding,
                    "offered_qos_profiles": qos_as_records(topic.qos),
                    "type_description_hash": topic.type_hash,
                },
                "message_count": topic.count,
            }
            for topic in topics
        ],
        # Chunks are compressed inside the file; these two mean compression of whole files or messages.
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, **times(), "message_count": count}],
        "custom_data": dict(custom) or None,
        "ros_distro": _ROS_DISTRO,
    }
    content = information if bare else {"rosbag2_bagfile_information": information}
    return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def read_metadata(path: Path) -> tuple[tuple[str, ...], dict[str, int]]:
    """Return what a metadata.yaml of any rosbag2 version with mcap storage says.

    Returns:
        (names of the storage files in time order, number of messages by topic).

    Raises:
        BagError: unreadable, not rosbag2's, another storage, or compressed as a whole.
    """
    try:
        content = read_yaml(path, BagError)
        information = content["rosbag2_bagfile_information"]
        storage = str(information.get("storage_identifier") or "")
        mode = str(information.get("compression_mode") or "").lower()
        # What whole-file paths lead to (rosbag2 wrote some) is beside metadata.yaml, nowhere else.
        files = tuple(str(name).rpartition("/")[2] for name in information["relative_file_paths"])
        counts = {
            str(entry["topic_metadata"]["name"]): int(entry["message_count"])
            for entry in information["topics_with_message_count"]
        }
    except (BagError, KeyError, TypeError, ValueError, OverflowError, AttributeError) as trouble:
        raise BagError(
            f"{path}: wanted rosbag2's metadata, got something else ({type(trouble).__name__}: {trouble}); "
            "rebuild it with: humanpred bag salvage"
        ) from trouble
    if not storage and files and all(name.lower().endswith(".mcap") for name in files):
        storage = "mcap"  # `ros2 bag reindex` leaves it empty
    if storage != "mcap":
        raise BagError(
            f"{path.parent}: wanted mcap storage, got {storage or 'none'}; rebuild it with: humanpred bag salvage"
        )
    if mode not in ("", "none"):
        raise BagError(
            f"{path.parent}: wanted no compression around the file, got mode {mode}; import and salvage read it"
        )
    return files, counts


def qos_as_records(qos: tuple[Qos, ...]) -> list[dict[str, Any]]:
    """Return what metadata.yaml version 9 holds under offered_qos_profiles."""
    return [dict(item) for item in dump_qos_v9(list(qos))]


def qos_as_text(qos: tuple[Qos, ...]) -> str:
    """Return what rosbag2's mcap storage keeps in a channel's metadata."""
    return str(yaml.safe_dump(qos_as_records(qos), sort_keys=False)).strip() if qos else ""


def qos_from(records: list[dict[str, Any]] | str) -> tuple[Qos, ...]:
    """Return the profiles of a bag of any rosbag2 version. Raises BagError where they cannot be parsed."""
    try:
        # Typed for its own dictionaries only; other tools write the same keys.
        return tuple(parse_qos(yaml_of(records) if isinstance(records, str) else records))  # type: ignore[arg-type, unused-ignore]
    except Exception as trouble:  # rosbags lets KeyError, TypeError and YAML errors of strange profiles through
        raise BagError(
            f"wanted offered_qos_profiles as rosbag2 writes them, got {records!r:.120} ({trouble})"
        ) from trouble
