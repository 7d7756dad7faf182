"""Reads bags, ours or ros2 bag's, and says plainly what is wrong with one that cannot be read."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, SeekingReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from humanpred_ros.bags.messages import decode_with, typestore
from humanpred_ros.bags.metadata import TopicInfo, qos_from, read_metadata
from humanpred_ros.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length in front of every record's content.
RECORD_HEADER = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_FOOTER_OPCODE, _DATA_END_OPCODE = 0x02, 0x0F
_TAIL_BYTES = _FOOTER.size + len(MAGIC)
_BLOCK_BYTES = 1 << 20

SALVAGE_HINT = "recover what is intact with: humanpred bag salvage"

#: What mcap, its decompressors and the unpacking of damaged bytes raise (CRC errors are ValueErrors).
MCAP_TROUBLE: tuple[type[Exception], ...] = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    LookupError,
    TypeError,
    OverflowError,
    MemoryError,
    EOFError,
    RuntimeError,
)


class BagMessage(NamedTuple):
    """One message as stored: times in nanoseconds since the epoch, data as CDR bytes."""

    topic: str
    msgtype: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes


class BagReader:
    """Reads a rosbag2 directory (mcap storage, also split into several files) or a single .mcap file.

    Opening checks that the files are complete and, where they carry checksums over all their data (ours
    do), that these are right; reading checks every chunk's. No file stays open between calls.

    Args:
        path: directory with metadata.yaml, or an .mcap file.

    Raises:
        BagError: missing, not a bag, truncated or damaged; the message says what to do.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.files = bag_files(self.path)
        self._frames: dict[Path, FileFrame] = {}
        for file in self.files:
            with _opened(file) as stream:
                frame = self._frames[file] = inspect_frame(file, stream)
            if frame.trouble:
                raise BagError(f"{file}: {frame.trouble}; {SALVAGE_HINT}")
        self._definitions: dict[str, str] = {}
        self._stores: dict[str, Any] = {}
        self._metadata: dict[str, Mapping[str, str]] = {}
        topics: dict[str, TopicInfo] = {}
        starts: list[int] = []
        ends: list[int] = []
        for file in self.files:
            for topic in self._topics_of(file, starts, ends):
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

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[BagMessage]:
        """Yield messages by log time; those of one time in the order they were written.

        Args:
            topics: only these; all if None.

        Raises:
            BagError: a topic the bag lacks (at once), or damage found on the way.
        """
        wanted = None if topics is None else [topics] if isinstance(topics, str) else list(topics)
        for name in wanted or ():
            self.require_topic(name)
        return self._messages(wanted)

    def require_topic(self, name: str, msgtype: str | None = None) -> TopicInfo:
        """Return the topic's entry; raise BagError if the bag lacks it or it has another type."""
        if name not in self.topics:
            raise BagError(f"{self.path}: wanted topic {name}, the bag has {', '.join(sorted(self.topics)) or 'none'}")
        topic = self.topics[name]
        if msgtype is not None and topic.msgtype != msgtype:
            raise BagError(f"{self.path}: topic {name}: wanted type {msgtype}, got {topic.msgtype}")
        return topic

    def decode(self, message: BagMessage) -> Any:
        """Return the deserialised message, by the bag's own definition where the type is not a common one.

        Raises:
            BagError: not CDR, no usable definition, or damaged bytes.
        """
        encoding = self.topics[message.topic].encoding
        if encoding != "cdr":
            raise BagError(f"{self.path}: topic {message.topic}: wanted cdr messages, got {encoding}")
        return decode_with(self._store_of(message.msgtype), message.data, message.msgtype)

    def decoded(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield (log time in nanoseconds, deserialised message) of one topic."""
        for message in self.messages([topic]):
            yield message.log_time_ns, self.decode(message)

    def _messages(self, wanted: list[str] | None) -> Iterator[BagMessage]:
        for file in self.files:
            summary = self._frames[file].summary
            # Without an index mcap's seeking reader would fall back to one that checks nothing.
            kind = SeekingReader if summary is not None and summary.chunk_indexes else NonSeekingReader
            with _opened(file) as stream:
                try:
                    reader: Any = kind(stream, validate_crcs=True)
                    for schema, channel, message in reader.iter_messages(topics=wanted):
                        msgtype = "" if schema is None else schema.name
                        yield BagMessage(channel.topic, msgtype, message.log_time, message.publish_time, message.data)
                except MCAP_TROUBLE as trouble:
                    raise BagError(
                        f"{file}: wanted intact data, got damage ({spell(trouble)}); {SALVAGE_HINT}"
                    ) from trouble

    def _topics_of(self, file: Path, starts: list[int], ends: list[int]) -> list[TopicInfo]:
        summary = self._frames[file].summary
        try:
            with _opened(file) as stream:
                if summary is None or summary.statistics is None:
                    return self._topics_by_reading(stream, starts, ends)
                reader: Any = SeekingReader(stream)
                for record in reader.iter_metadata():
                    self._metadata[record.name] = MappingProxyType(dict(record.metadata))
                statistics = summary.statistics
                if statistics.message_count:
                    starts.append(statistics.message_start_time)
                    ends.append(statistics.message_end_time)
                return [
                    self._topic(channel, summary.schemas.get(channel.schema_id), statistics.channel_message_counts)
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
        reader: Any = NonSeekingReader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            seen[channel.id] = (channel, schema)
            counts[channel.id] += 1
            starts.append(message.log_time)
            ends.append(message.log_time)
        return [self._topic(channel, schema, counts) for channel, schema in seen.values()]

    def _topic(self, channel: Any, schema: Any, counts: Mapping[int, int]) -> TopicInfo:
        if schema is not None and schema.encoding == "ros2msg":
            self._definitions[schema.name] = schema.data.decode("utf-8")
        return topic_of(channel, schema, counts.get(channel.id, 0))

    def _store_of(self, msgtype: str) -> Any:
        if msgtype in typestore().fielddefs:
            return typestore()
        if msgtype not in self._stores:
            store: Any = get_typestore(Stores.EMPTY)
            try:
                store.register(get_types_from_msg(self._definitions[msgtype], msgtype))
            except Exception as trouble:  # rosbags' parser fails in its own ways on definitions it does not know
                raise BagError(f"{self.path}: no usable definition of message type {msgtype} in the bag") from trouble
            self._stores[msgtype] = store
        return self._stores[msgtype]


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


def spell(trouble: Exception) -> str:
    """Return an exception of another library as text; some of them have none."""
    return f"{type(trouble).__name__}: {trouble}" if str(trouble) else type(trouble).__name__


def _crc_of(stream: IO[bytes], length: int) -> int:
    stream.seek(0)
    crc = 0
    while block := stream.read(min(_BLOCK_BYTES, length)):
        crc = zlib.crc32(block, crc)
        length -= len(block)
    return crc


def topic_of(channel: Any, schema: Any, count: int = 0) -> TopicInfo:
    """Return the topic of an mcap channel. Raises BagError for profiles of service that cannot be parsed."""
    qos, type_hash = (channel.metadata.get(key, "") for key in ("offered_qos_profiles", "topic_type_hash"))
    msgtype = "" if schema is None else schema.name
    return TopicInfo(channel.topic, msgtype, count, channel.message_encoding, qos_from(qos), type_hash)


def bag_files(path: Path) -> tuple[Path, ...]:
    """Return the storage files of a bag in time order.

    Raises:
        BagError: nothing there, no bag there, or a recording that was interrupted before metadata.yaml.
    """
    if path.is_file():
        if path.suffix == ".db3":
            raise BagError(f"{path}: wanted an .mcap file, got sqlite storage; convert it with: ros2 bag convert")
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
    files = tuple(path / name for name in read_metadata(metadata)[0])
    for file in files:
        if not file.is_file():
            raise BagError(f"{path}: wanted {file.name} as metadata.yaml says, it is missing; {SALVAGE_HINT}")
    return files


def _opened(file: Path) -> Any:
    try:
        return file.open("rb")
    except OSError as trouble:
        raise BagError(f"{file}: cannot be opened ({trouble.strerror})") from trouble
