"""Tells what is wrong with a bag, and saves what is intact of a broken one into a fresh bag."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Metadata, Schema

from humanpred_ros.bags.messages import TypeDefinition
from humanpred_ros.bags.metadata import read_metadata
from humanpred_ros.bags.qos import qos_from
from humanpred_ros.bags.reader import bag_files
from humanpred_ros.bags.scan import Damage, scan_records
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError

#: The record rosbag2 keeps its own metadata in; a fresh bag gets a fresh one.
_ROSBAG2_RECORD = "rosbag2"


@dataclass(frozen=True)
class BagReport:
    """What is in a bag and what is wrong with it.

    Attributes:
        path: the bag looked at.
        readable: the ordinary reader reads it from beginning to end.
        crc_ok: no checksum is wrong.
        messages: number of intact messages per topic.
        problems: in words, with file and byte; empty if all is well.
    """

    path: Path
    readable: bool
    crc_ok: bool
    messages: Mapping[str, int]
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Nothing is wrong."""
        return self.readable and self.crc_ok and not self.problems


def check_bag(path: str | Path) -> BagReport:
    """Read every byte of a bag and report; changes nothing.

    Raises:
        BagError: nothing there, or no mcap file in it at all.
    """
    return _examine(Path(path), None)


def salvage_bag(path: str | Path, out: str | Path, *, overwrite: bool = False) -> BagReport:
    """Write every intact message of a bag into the fresh bag `out`; the original stays as it is.

    Messages keep their order, times and types; of a chunk whose checksum is wrong none can be trusted
    and none is taken. The report tells what was saved and what was found wrong on the way.

    Raises:
        BagError: nothing there, nothing intact in it, or `out` exists (or is the bag itself).
    """
    path, out = Path(path), Path(out)
    if out.resolve() in (path.resolve(), *path.resolve().parents):
        raise BagError(f"{out}: wanted a new folder for what is recovered, got the damaged bag itself; choose another")
    with BagWriter(out, staged=True, overwrite=overwrite) as bag:
        report = _examine(path, bag)
        if not report.messages:
            raise BagError(f"{path}: wanted at least one intact message, found none; the bag is lost")
    return report


def _examine(path: Path, bag: BagWriter | None) -> BagReport:
    files, problems = _files(path)
    readable, crc_ok = not problems, True
    counts: Counter[str] = Counter()
    copied: set[tuple[str, tuple[tuple[str, str], ...]]] = set()
    for file in files:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        lost: Counter[int] = Counter()
        for record in scan_records(file):
            if isinstance(record, Damage):
                readable, crc_ok = False, crc_ok and not record.checksum
                problems.append(f"{file.name}, byte {record.offset}: {record.text}")
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Metadata):
                facts = (record.name, tuple(sorted(record.metadata.items())))
                if bag is not None and record.name != _ROSBAG2_RECORD and facts not in copied:
                    bag.add_metadata(record.name, record.metadata)
                copied.add(facts)
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    lost[record.channel_id] += 1
                    continue
                counts[channel.topic] += 1
                if bag is not None:
                    _copy(bag, channel, schemas.get(channel.schema_id), record)
        for channel_id, count in lost.items():
            readable = False
            problems.append(f"{file.name}: {count} messages of channel {channel_id}, whose description is lost")
    problems += _against_metadata(path, counts)
    return BagReport(path, readable, crc_ok, dict(counts), tuple(problems))


def _copy(bag: BagWriter, channel: Any, schema: Any, message: Any) -> None:
    if channel.topic not in bag.topics:
        definition = TypeDefinition(
            "" if schema is None else schema.data.decode("utf-8", "replace"),
            "" if schema is None else schema.encoding,
            channel.metadata.get("topic_type_hash", ""),
        )
        bag.add_topic(
            channel.topic,
            "" if schema is None else schema.name,
            qos=qos_from(channel.metadata.get("offered_qos_profiles", "")),
            definition=definition,
            encoding=channel.message_encoding,
        )
    bag.write(channel.topic, message.log_time, message.data, message.publish_time)


def _files(path: Path) -> tuple[list[Path], list[str]]:
    """Return the bag's mcap files in time order, found without metadata.yaml if need be, and why."""
    try:
        return list(bag_files(path)), []
    except BagError as trouble:
        # rosbag2 numbers its files; _10 comes after _9.
        found = sorted(path.glob("*.mcap"), key=lambda f: [int(n) for n in re.findall(r"\d+", f.stem)[-1:]] + [0])
        if not found:
            raise
        return found, [str(trouble).split(";")[0]]


def _against_metadata(path: Path, counts: Mapping[str, int]) -> list[str]:
    """Return where metadata.yaml and the messages found disagree."""
    if not (path / "metadata.yaml").is_file():
        return []
    try:
        told = {topic.name: topic.count for topic in read_metadata(path / "metadata.yaml").topics}
    except BagError:
        return []  # already a problem of its own
    return [
        f"metadata.yaml: topic {name}: wanted {told.get(name, 0)} messages as it says, found {counts.get(name, 0)}"
        for name in sorted({*told, *counts})
        if told.get(name, 0) != counts.get(name, 0)
    ]
