"""Finds what is wrong with a bag, and copies what is intact of a broken one to a fresh bag.

mcap's readers stop at the first broken byte and need the index at the end; a recording that was killed has no index,
and a damaged one is good before and after the damage. So the file is read record by record here. A chunk is intact
when its CRC is right. Only a chunk that the end of the file cuts off is read in part: its first bytes decompress to the
first of its messages.
"""

from __future__ import annotations

import mmap
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Message, Metadata, Schema

from humanpred_ros.bags.chunks import Damage, walk
from humanpred_ros.bags.messages import TypeDefinition, decode, typestore
from humanpred_ros.bags.metadata import read_metadata
from humanpred_ros.bags.reader import bag_files, inspect_frame, qos_trouble, topic_of
from humanpred_ros.bags.writer import LAST_TIME_NS, BagWriter
from humanpred_ros.errors import BagError
from humanpred_ros.files import open_plain

#: The record rosbag2 keeps its own metadata in; a fresh bag gets a fresh one.
_ROSBAG2_RECORD = "rosbag2"


@dataclass(frozen=True)
class BagReport:
    """What is in a bag and what is wrong with it."""

    path: Path  #: the bag looked at
    messages: Mapping[str, int]  #: number of intact messages per topic
    problems: tuple[str, ...]  #: in words, with file and byte; empty if all is well

    @property
    def ok(self) -> bool:
        """Nothing is wrong."""
        return not self.problems


def check_bag(path: str | Path) -> BagReport:
    """Read every byte of a bag and report; changes nothing.

    Raises:
        BagError: nothing there, or no mcap file in it at all.
    """
    return _examine(Path(path), None)


def salvage_bag(path: str | Path, out: str | Path) -> BagReport:
    """Write every intact message of a bag into the fresh bag `out`; the original stays as it is.

    Messages keep their order, times and types; of a chunk whose checksum is wrong none can be trusted
    and none is taken. The report tells what was saved and what was found wrong on the way.

    Raises:
        BagError: nothing there, nothing intact in it, or `out` exists (or is the bag itself).
    """
    path, out = Path(path), Path(out)
    if out.resolve() in (path.resolve(), *path.resolve().parents):
        raise BagError(f"{out}: wanted a new folder for what is recovered, got the damaged bag itself; choose another")
    with BagWriter(out, staged=True) as bag:
        report = _examine(path, bag)
        if not report.messages and report.ok:
            raise BagError(f"{path}: the bag is intact and holds no messages: there is nothing to recover")
        if not report.messages:
            raise BagError(f"{path}: wanted at least one intact message, found none; the bag is lost")
    return report


def _examine(path: Path, bag: BagWriter | None) -> BagReport:
    files, problems = _files(path)
    counts: Counter[str] = Counter()
    types: dict[str, str] = {}
    copied: set[tuple[str, tuple[tuple[str, str], ...]]] = set()
    unreadable: list[BagError] = []
    for file in files:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        lost: Counter[int] = Counter()
        spoilt: Counter[str] = Counter()
        impossible = 0
        for record in _records(file, unreadable):
            if isinstance(record, Damage):
                problems.append(f"{file.name}, byte {record.offset}: {record.text}")
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                if record.id not in channels and (trouble := qos_trouble(record)) and trouble not in problems:
                    problems.append(trouble)
                channels[record.id] = record
            elif isinstance(record, Attachment):
                if bag is not None:
                    bag.add_attachment(record)
            elif isinstance(record, Metadata):
                facts = (record.name, tuple(sorted(record.metadata.items())))
                if bag is not None and record.name != _ROSBAG2_RECORD and facts not in copied:
                    bag.add_metadata(record.name, record.metadata)
                copied.add(facts)
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if max(record.log_time, record.publish_time) > LAST_TIME_NS:
                    impossible += 1
                    continue
                if channel is None:
                    lost[record.channel_id] += 1
                    continue
                schema = schemas.get(channel.schema_id)
                topic = _topic_for(channel, "" if schema is None else schema.name, types, problems)
                if getattr(record, "unguarded", False) and (why := _undecodable(channel, schema, record)):
                    spoilt[f"{file.name}: messages on {topic} that do not decode ({why})"] += 1
                    continue
                counts[topic] += 1
                if bag is not None:
                    _copy(bag, topic, channel, schema, record)
        problems += [f"{what}: {count}" for what, count in spoilt.items()]
        if impossible:
            problems.append(f"{file.name}: {impossible} messages with times that do not fit 64 bits")
        for channel_id, count in lost.items():
            problems.append(f"{file.name}: {count} messages of channel {channel_id}, whose description is lost")
    if len(unreadable) == len(files) and unreadable:
        raise unreadable[0]
    problems += [str(trouble).split(";")[0] for trouble in unreadable]
    problems += _against_metadata(path, counts)
    return BagReport(path, dict(counts), tuple(problems))


def _records(file: Path, unreadable: list[BagError]) -> Iterator[Any]:
    """Yield the records of a file; one that is none is put aside, so that it does not cost the others."""
    try:
        yield from scan_records(file)
    except BagError as trouble:
        unreadable.append(trouble)


def _topic_for(channel: Any, msgtype: str, types: dict[str, str], problems: list[str]) -> str:
    """Return the topic's name; messages of another type than the first are told, and get a topic of their own."""
    first = types.setdefault(channel.topic, msgtype)
    if msgtype == first:
        return str(channel.topic)
    other = f"{channel.topic}/as_{msgtype.replace('/', '_')}"
    problem = f"topic {channel.topic}: wanted one type, got {first} and {msgtype}; the latter is taken as {other}"
    if problem not in problems:
        problems.append(problem)
    return other


def _undecodable(channel: Any, schema: Any, message: Any) -> str:
    """Return why a message that no checksum guards does not decode; empty if it does, or its type is not known."""
    if channel.message_encoding != "cdr" or schema is None or schema.name not in typestore().fielddefs:
        return ""
    try:
        decode(message.data, schema.name)
    except BagError as trouble:
        return str(trouble)[:100]
    return ""


def _copy(bag: BagWriter, name: str, channel: Any, schema: Any, message: Any) -> None:
    if name not in bag.topics:
        text, encoding = ("", "") if schema is None else (schema.data.decode("utf-8", "replace"), schema.encoding)
        topic = topic_of(channel, schema)
        definition = TypeDefinition(text, encoding, topic.type_hash)
        bag.add_topic(name, topic.msgtype, qos=topic.qos, definition=definition, encoding=topic.encoding)
    bag.write(name, message.log_time, message.data, message.publish_time)


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
        _, told = read_metadata(path / "metadata.yaml")
    except BagError:
        return []  # already a problem of its own
    return [
        f"metadata.yaml: topic {name}: wanted {told.get(name, 0)} messages as it says, found {counts.get(name, 0)}"
        for name in sorted({*told, *counts})
        if told.get(name, 0) != counts.get(name, 0)
    ]


def scan_records(path: Path) -> Iterator[Any]:
    """Yield mcap's Schema, Channel, Message and Metadata records in file order, and Damage where something is wrong.

    Schemas and channels of an intact summary come first, since damage may have taken their originals.

    Raises:
        BagError: the file cannot be opened or does not start like an mcap file.
    """
    try:
        with open_plain(path, BagError) as stream:
            frame = inspect_frame(path, stream)
            if frame.summary is not None:
                yield from frame.summary.schemas.values()
                yield from frame.summary.channels.values()
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                found = 0
                for record in walk(data):
                    found += isinstance(record, Message)
                    yield record
                statistics = None if frame.summary is None else frame.summary.statistics
                if statistics is not None and statistics.message_count != found:
                    yield Damage(len(data), f"wanted {statistics.message_count} messages, found {found} intact")
                if frame.trouble:
                    yield Damage(len(data), frame.trouble)
    except OSError as trouble:
        raise BagError(f"{path}: cannot be read ({trouble.strerror}); check that it is there") from trouble
