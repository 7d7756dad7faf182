"""metadata.yaml: what rosbag2 knows of a bag without opening its storage (version 9, as Jazzy writes it)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Qos

from humanpred_ros.bags.qos import qos_as_records, qos_from
from humanpred_ros.errors import BagError

METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
#: rosbag2's starting time of a bag without messages.
_NO_START_NS = 2**63 - 1


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag: name, message type, number of messages, encoding, offered QoS and type hash."""

    name: str
    msgtype: str
    count: int
    encoding: str = "cdr"
    qos: tuple[Qos, ...] = ()
    type_hash: str = ""

    def with_count(self, count: int) -> TopicInfo:
        """Return the same topic with another number of messages."""
        return replace(self, count=count)


@dataclass(frozen=True)
class BagSummary:
    """The content of metadata.yaml.

    Attributes:
        files: storage files in time order, names without folder.
        start_ns, end_ns: log times of the first and last message.
        topics: in the order they were announced.
        custom: rosbag2's custom_data.
    """

    files: tuple[str, ...]
    start_ns: int
    end_ns: int
    topics: tuple[TopicInfo, ...]
    custom: Mapping[str, str] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of messages of all topics."""
        return sum(topic.count for topic in self.topics)


def metadata_text(summary: BagSummary, *, bare: bool = False) -> str:
    """Return metadata.yaml of a bag in one file; `bare` leaves out the outermost key, as inside the mcap file."""
    count = summary.count
    start = {"nanoseconds_since_epoch": summary.start_ns if count else _NO_START_NS}
    duration = {"nanoseconds": summary.end_ns - summary.start_ns if count else 0}
    information: dict[str, Any] = {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": dict(duration),
        "starting_time": dict(start),
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
            for topic in summary.topics
        ],
        # Chunks are compressed inside the file; these two mean compression of whole files or messages.
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": list(summary.files),
        "files": [
            {"path": name, "starting_time": dict(start), "duration": dict(duration), "message_count": count}
            for name in summary.files
        ],
        "custom_data": dict(summary.custom) or None,
        "ros_distro": ROS_DISTRO,
    }
    content = information if bare else {"rosbag2_bagfile_information": information}
    return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def read_metadata(path: Path) -> BagSummary:
    """Return the content of a metadata.yaml of any rosbag2 version with mcap storage.

    Raises:
        BagError: unreadable, not rosbag2's, another storage, or compressed as a whole.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        information = content["rosbag2_bagfile_information"]
        storage = str(information["storage_identifier"])
        mode = str(information.get("compression_mode") or "").lower()
        start_ns = int(information["starting_time"]["nanoseconds_since_epoch"])
        summary = BagSummary(
            tuple(Path(name).name for name in information["relative_file_paths"]),
            start_ns,
            start_ns + int(information["duration"]["nanoseconds"]),
            tuple(
                TopicInfo(
                    str(entry["topic_metadata"]["name"]),
                    str(entry["topic_metadata"]["type"]),
                    int(entry["message_count"]),
                    str(entry["topic_metadata"]["serialization_format"]),
                    qos_from(entry["topic_metadata"].get("offered_qos_profiles") or []),
                    str(entry["topic_metadata"].get("type_description_hash") or ""),
                )
                for entry in information["topics_with_message_count"]
            ),
            {str(key): str(value) for key, value in (information.get("custom_data") or {}).items()},
        )
    except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as trouble:
        raise BagError(
            f"{path}: wanted rosbag2's metadata, got something else ({type(trouble).__name__}: {trouble}); "
            "rebuild it with: humanpred bag salvage"
        ) from trouble
    if storage != "mcap":
        raise BagError(f"{path.parent}: wanted mcap storage, got {storage}; convert it with: ros2 bag convert")
    if mode not in ("", "none"):
        raise BagError(f"{path.parent}: wanted no compression around the file, got mode {mode}; use ros2 bag convert")
    return summary
