"""The quality of service a bag says its topics were offered with, so that `ros2 bag play` offers the same."""

from __future__ import annotations

from typing import Any, Literal

import yaml
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2.metadata import dump_qos_v9, parse_qos

from humanpred_ros.errors import BagError

#: The value rmw uses for "no deadline", "lives for ever": the largest signed 64-bit count of nanoseconds.
_INFINITE = QosTime(9223372036, 854775807)


def topic_qos(
    *,
    reliability: Literal["reliable", "best_effort"] = "reliable",
    durability: Literal["volatile", "transient_local"] = "volatile",
    depth: int = 10,
) -> Qos:
    """Return a keep-last quality of service; the defaults are rclpy's."""
    return Qos(
        QosHistory.KEEP_LAST,
        depth,
        QosReliability[reliability.upper()],
        QosDurability[durability.upper()],
        _INFINITE,
        _INFINITE,
        QosLiveliness.AUTOMATIC,
        _INFINITE,
        False,
    )


#: Default: reliable, volatile, keep last 10.
DEFAULT_QOS = topic_qos()
#: Latched: late subscribers get the last message (URDF, goals, voxel geometry).
LATCHED_QOS = topic_qos(durability="transient_local", depth=1)


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
        return tuple(parse_qos(records))  # type: ignore[arg-type, unused-ignore]
    except Exception as trouble:  # rosbags lets KeyError, TypeError and YAML errors of strange profiles through
        raise BagError(
            f"wanted offered_qos_profiles as rosbag2 writes them, got {records!r:.120} ({trouble})"
        ) from trouble
