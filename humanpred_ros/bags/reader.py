"""Reads bags, ours or ros2 bag's, and says plainly what is wrong with one that cannot be read."""

from __future__ import annotations

import heapq
import mmap
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, NamedTuple

from mcap.reader import SeekingReader
from mcap.records import Channel, Message, Schema

from humanpred_ros.bags.chunks import (
    MAGIC,
    MCAP_TROUBLE,
    RECORD_HEADER,
    Budget,
    Chunk,
    Damage,
    inner_records,
    spell,
    walk,
)
from humanpred_ros.bags.foreign import as_mcap
from humanpred_ros.bags.messages import decode
from humanpred_ros.bags.metadata import DEFAULT_QOS, TopicInfo, qos_from, read_metadata
from humanpred_ros.bags.writer import LAST_TIME_NS
from humanpred_ros.errors import BagError
from humanpred_ros.files import file_inside, open_plain
from humanpred_ros.topics import names_in_bag

_FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_FOOTER_OPCODE, _DATA_END_OPCODE = 0x02, 0x0F
_TAIL_BYTES = _FOOTER.size + len(MAGIC)
_BLOCK_BYTES = 1 << 20
#: Messages that are kept at a time while they are put in order, and metadata records.
_MOST_HELD, _MOST_RECORDS = 1_000_000, 1_000

#: Metadata record in which the recorder keeps full by relative names.
TOPICS_RECORD = "topics"

SALVAGE_HINT = "recover what is intact with: humanpred bag salvage"


class BagMessage(NamedTuple):
    """One message as stored: times in nanoseconds since the epoch, data as CDR bytes."""

    topic: str
    msgtype: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes


class BagReader:
    """Reads a rosbag2 directory (also split into several files), an .mcap file, or a bag of another form (`foreign`).

    Opening checks that the files are complete and, where they carry checksums over all their data (ours
    do), that these are right; reading checks every chunk's. No file stays open between calls.

    Topics are asked for by full name, or by relative name as nodes do (`topics`): `joint_states` is the robot's, in
    whatever namespace it was recorded.

    Args:
        path: directory with metadata.yaml, or an .mcap file.
        namespace: of the robot that relative names are about; only needed where a bag holds several.

    Raises:
        BagError: missing, not a bag, truncated or damaged; the message says what to do.
    """

    def __init__(self, path: str | Path, namespace: str | None = None) -> None:
        self.path, self.namespace = Path(path), namespace
        self.files = bag_files(self.path)
        self._frames: dict[Path, FileFrame] = {}
        for file in self.files:
            with open_plain(file, BagError) as stream:
                frame = self._frames[file] = inspect_frame(file, stream)
            if frame.trouble:
                raise BagError(f"{file}: {frame.trouble}; {SALVAGE_HINT}")
        self._metadata: dict[str, Mapping[str, str]] = {}
        topics: dict[str, TopicInfo] = {}
        starts: list[int] = []
        ends: list[int] = []
        self._spans: dict[Path, tuple[int, int]] = {}
        for file in self.files:
            before_file = len(starts)
            found = self._topics_of(file, starts, ends)
            if starts[before_file:]:
                self._spans[file] = min(starts[before_file:]), max(ends[before_file:])
            for topic in found:
                before = topics.get(topic.name)
                topics[topic.name] = replace(topic, count=topic.count + (before.count if before else 0))
        self.topics: Mapping[str, TopicInfo] = MappingProxyType(topics)
        self.start_ns: int | None = min(starts, default=None)
        self.end_ns: int | None = max(ends, default=None)

    @property
    def message_count(self) -> int:
        """Number of messages of all topics."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """The MCAP metadata records by name (of several with one name, the last)."""
        return MappingProxyType(self._metadata)

    @cached_property
    def names(self) -> Mapping[str, str]:
        """Full names of topics by their relative names; BagError where it is not clear of which robot."""
        try:
            return names_in_bag(self.topics, self._metadata.get(TOPICS_RECORD, {}), self.namespace)
        except BagError as error:
            raise BagError(f"{self.path}: {error}") from None

    def find(self, name: str) -> str | None:
        """Return the full name of a topic; None if the bag lacks it."""
        return name if name in self.topics else None if name.startswith("/") else self.names.get(name)

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[BagMessage]:
        """Yield messages by log time; those of one time in the order they were written.

        Args:
            topics: only these; all if None.

        Raises:
            BagError: a topic the bag lacks (at once), or damage found on the way.
        """
        wanted = None if topics is None else [topics] if isinstance(topics, str) else list(topics)
        return self._messages(None if wanted is None else [self.require_topic(name).name for name in wanted])

    def require_topic(self, name: str, msgtype: str | None = None) -> TopicInfo:
        """Return the topic's entry; raise BagError if the bag lacks it or it has another type."""
        found = self.find(name)
        if found is None:
            raise BagError(f"{self.path}: wanted topic {name}, the bag has {', '.join(sorted(self.topics)) or 'none'}")
        topic = self.topics[found]
        if msgtype is not None and topic.msgtype != msgtype:
            raise BagError(f"{self.path}: topic {found}: wanted type {msgtype}, got {topic.msgtype}")
        return topic

    def decode(self, message: BagMessage) -> Any:
        """Return the deserialised message; its type must be one of Jazzy's common interfaces.

        Definitions in a bag are copied, never used: decoders are programs, and would be made from a stranger's text.

        Raises:
            BagError: not CDR, another type, or damaged bytes.
        """
        encoding = self.topics[message.topic].encoding
        if encoding != "cdr":
            raise BagError(f"{self.path}: topic {message.topic}: wanted cdr messages, got {encoding}")
        return decode(message.data, message.msgtype)

    def decoded(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield (log time in nanoseconds, deserialised message) of one topic."""
        for message in self.messages([topic]):
            yield message.log_time_ns, self.decode(message)

    def _messages(self, wanted: list[str] | None) -> Iterator[BagMessage]:
        of_files = [self._messages_of(file, wanted) for file in self.files]
        # Files follow each other, unless a recorder wrote late messages into the next one.
        spans = [self._spans[file] for file in self.files if file in self._spans]
        if all(before[1] <= after[0] for before, after in pairwise(spans)):
            yield from chain.from_iterable(of_files)
        else:
            yield from heapq.merge(*of_files, key=lambda message: message.log_time_ns)

    def _messages_of(self, file: Path, wanted: list[str] | None) -> Iterator[BagMessage]:
        summary = self._frames[file].summary
        with open_plain(file, BagError) as stream:
            try:
                indexed = summary is not None and summary.chunk_indexes
                records = _indexed(stream, summary, wanted) if indexed else _linear(stream)
                for schema, channel, message in records:
                    if wanted is None or channel.topic in wanted:
                        if max(message.log_time, message.publish_time) > LAST_TIME_NS:
                            raise ValueError(f"a time of {message.log_time} ns does not fit 64 bits")
                        msgtype = "" if schema is None else schema.name
                        yield BagMessage(channel.topic, msgtype, message.log_time, message.publish_time, message.data)
            except MCAP_TROUBLE as trouble:
                raise BagError(
                    f"{file}: wanted intact data, got damage ({spell(trouble)}); {SALVAGE_HINT}"
                ) from trouble

    def _topics_of(self, file: Path, starts: list[int], ends: list[int]) -> list[TopicInfo]:
        summary = self._frames[file].summary
        try:
            with open_plain(file, BagError) as stream:
                if summary is None or summary.statistics is None:
                    return self._topics_by_reading(stream, starts, ends)
                reader: Any = SeekingReader(stream)
                if len(summary.metadata_indexes) > _MOST_RECORDS:
                    raise ValueError(f"more than {_MOST_RECORDS} metadata records")
                for record in reader.iter_metadata():
                    self._metadata[record.name] = MappingProxyType(dict(record.metadata))
                statistics = summary.statistics
                if statistics.message_count:
                    starts.append(statistics.message_start_time)
                    ends.append(statistics.message_end_time)
                return [
                    topic_of(
                        channel,
                        summary.schemas.get(channel.schema_id),
                        statistics.channel_message_counts.get(channel.id, 0),
                    )
                    for channel in summary.channels.values()
                ]
        except MCAP_TROUBLE as trouble:
            raise BagError(
                f"{file}: wanted an intact MCAP file, got damage ({spell(trouble)}); {SALVAGE_HINT}"
            ) from trouble

    def _topics_by_reading(self, stream: Any, starts: list[int], ends: list[int]) -> list[TopicInfo]:
        """Count messages in a file that has no statistics."""
        seen: dict[int, tuple[Any, Any]] = {}
        counts: Counter[int] = Counter()
        for schema, channel, message in _linear(stream):
            seen[channel.id] = (channel, schema)
            counts[channel.id] += 1
            starts.append(message.log_time)
            ends.append(message.log_time)
        return [topic_of(channel, schema, counts[channel.id]) for channel, schema in seen.values()]


@dataclass(frozen=True)
class FileFrame:
    """What the outer frame of an mcap file says."""

    summary: Any | None = None  #: mcap's Summary (schemas, channels, statistics, indexes), None if there is none
    trouble: str = ""  #: what is wrong with the frame, empty if nothing


def inspect_frame(path: Path, stream: IO[bytes]) -> FileFrame:
    """Return the outer frame of an mcap file, opened for reading.

    A complete file ends with a summary section, a footer that holds the summary's CRC, and the magic bytes; the record
    before the summary may hold the CRC of everything above it. mcap's reader checks chunk CRCs only, so these outer
    checks are made here; they read the whole file. Layout: the MCAP specification, version 0.

    Raises:
        BagError: the file does not start like an mcap file.
    """
    size = stream.seek(0, 2)
    stream.seek(0)
    start = stream.read(len(MAGIC))
    if start != MAGIC[: len(start)] or not start:
        raise BagError(f"{path}: wanted an MCAP file, got {size} bytes that do not start like one; name a bag")
    if size < len(MAGIC) + _TAIL_BYTES:
        return FileFrame(trouble=f"wanted a complete MCAP file, got only its first {size} bytes")
    stream.seek(size - _TAIL_BYTES)
    footer, end = stream.read(_FOOTER.size), stream.read()
    opcode, length, summary_start, offsets_start, summary_crc = _FOOTER.unpack(footer)
    if end != MAGIC or opcode != _FOOTER_OPCODE or length != _FOOTER.size - RECORD_HEADER.size:
        return FileFrame(trouble="wanted a complete MCAP file, its end is missing (interrupted, truncated or damaged)")
    data_end = summary_start or size - _TAIL_BYTES  # 0 stands for "no summary"
    if not len(MAGIC) + _DATA_END.size <= data_end <= size - _TAIL_BYTES or offsets_start > size:
        return FileFrame(trouble=f"wanted a footer pointing into the file, got offset {summary_start}")
    stream.seek(data_end)
    if summary_crc and zlib.crc32(stream.read(size - _TAIL_BYTES - data_end) + footer[:-4]) != summary_crc:
        return FileFrame(trouble="wanted a summary with its recorded checksum, got another")
    stream.seek(data_end - _DATA_END.size)
    opcode, length, data_crc = _DATA_END.unpack(stream.read(_DATA_END.size))
    if opcode != _DATA_END_OPCODE or length != _DATA_END.size - RECORD_HEADER.size:
        return FileFrame(trouble="wanted the end of the data just before the summary, got something else")
    try:
        stream.seek(0)
        summary = SeekingReader(stream).get_summary()
    except MCAP_TROUBLE as trouble:
        return FileFrame(trouble=f"wanted a readable summary, got {spell(trouble)}")
    if data_crc and _crc_of(stream, data_end - _DATA_END.size) != data_crc:
        return FileFrame(summary, "wanted data with their recorded checksum, got another")
    return FileFrame(summary)


def _indexed(stream: IO[bytes], summary: Any, wanted: list[str] | None) -> Iterator[tuple[Any, Any, Any]]:
    """Yield (schema, channel, message) by log time, each chunk read once, when its first message is due."""
    due: list[tuple[int, int, int, Any]] = []
    budget = Budget(stream.seek(0, 2))
    for index in {index.chunk_start_offset: index for index in summary.chunk_indexes}.values():
        channels = [summary.channels[channel_id] for channel_id in index.message_index_offsets]
        if wanted is None or not channels or any(channel.topic in wanted for channel in channels):
            due.append((index.message_start_time, index.chunk_start_offset, -1, index))
    heapq.heapify(due)
    while due:
        _, offset, _, item = heapq.heappop(due)
        if isinstance(item, Message):
            channel = summary.channels[item.channel_id]
            yield summary.schemas.get(channel.schema_id), channel, item
            continue
        stream.seek(offset)
        chunk = Chunk.at(stream.read(min(item.chunk_length, budget.left)), 0)
        if not chunk.consistent or chunk.cut_off:
            raise ValueError("the index leads to something that is no chunk")
        for k, record in enumerate(inner_records(chunk.content(budget))):
            if isinstance(record, Message) and (wanted is None or summary.channels[record.channel_id].topic in wanted):
                heapq.heappush(due, (record.log_time, offset, k, record))
                _check_held(len(due))


def _linear(stream: IO[bytes]) -> Iterator[tuple[Any, Any, Any]]:
    """Yield (schema, channel, message) by log time, of a file without an index of its chunks."""
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    found: list[tuple[Any, Any, Any]] = []
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for record in walk(data):
            if isinstance(record, Damage):
                raise ValueError(record.text)
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                found.append((schemas.get(channel.schema_id), channel, record))
                _check_held(len(found))
    yield from sorted(found, key=lambda entry: int(entry[2].log_time))


def _check_held(count: int) -> None:
    if count > _MOST_HELD:
        raise ValueError(f"more than {_MOST_HELD} messages in a chunk, or in a file without an index")


def _crc_of(stream: IO[bytes], length: int) -> int:
    stream.seek(0)
    crc = 0
    while block := stream.read(min(_BLOCK_BYTES, length)):
        crc = zlib.crc32(block, crc)
        length -= len(block)
    return crc


def qos_trouble(channel: Any) -> str:
    """Return that the profiles of service of an mcap channel cannot be read; empty if they can."""
    try:
        qos_from(channel.metadata.get("offered_qos_profiles", ""))
    except BagError:
        return f"topic {channel.topic}: its quality of service cannot be read, the default is taken"
    return ""


def topic_of(channel: Any, schema: Any, count: int = 0) -> TopicInfo:
    """Return the topic of an mcap channel; profiles of service that cannot be read are the default."""
    qos, type_hash = (channel.metadata.get(key, "") for key in ("offered_qos_profiles", "topic_type_hash"))
    msgtype = "" if schema is None else schema.name
    profiles = (DEFAULT_QOS,) if qos_trouble(channel) else qos_from(qos)
    return TopicInfo(channel.topic, msgtype, count, channel.message_encoding, profiles, type_hash)


def bag_files(path: Path) -> tuple[Path, ...]:
    """Return the storage files of a bag in time order.

    Raises:
        BagError: nothing there, no bag there, or a recording that was interrupted before metadata.yaml.
    """
    converted = as_mcap(path)
    if converted is not None:
        return bag_files(converted)
    if path.is_file():
        return (path,)
    if not path.is_dir():
        raise BagError(f"{path}: wanted a bag (a rosbag2 directory or an .mcap file), there is nothing of that name")
    metadata = path / "metadata.yaml"
    if not metadata.is_file():
        if any(path.glob("*.mcap")):
            raise BagError(
                f"{path}: wanted a complete bag, got one without metadata.yaml (recording interrupted); {SALVAGE_HINT}"
            )
        raise BagError(f"{path}: wanted a rosbag2 directory, got a folder without metadata.yaml and .mcap files")
    files = tuple(file_inside(path, name, BagError, str(metadata)) for name in read_metadata(metadata)[0])
    for file in files:
        if not file.is_file():
            raise BagError(f"{path}: wanted {file.name} as metadata.yaml says, it is missing; {SALVAGE_HINT}")
    return files
