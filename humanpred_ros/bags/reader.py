"""Reads bags, ours or ros2 bag's, and says plainly what is wrong with one that cannot be read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from mcap.reader import NonSeekingReader, SeekingReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from humanpred_ros.bags.mcap_file import MCAP_TROUBLE, SALVAGE_HINT, FileFrame, read_frame, spell
from humanpred_ros.bags.messages import decode_with, typestore
from humanpred_ros.bags.metadata import TopicInfo, qos_from, read_metadata
from humanpred_ros.errors import BagError


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
        verify: make the whole-file check on opening.

    Raises:
        BagError: missing, not a bag, truncated or damaged; the message says what to do.
    """

    def __init__(self, path: str | Path, *, verify: bool = True) -> None:
        self.path = Path(path)
        self.files = bag_files(self.path)
        self._frames: dict[Path, FileFrame] = {}
        for file in self.files:
            with _opened(file) as stream:
                self._frames[file] = read_frame(file, stream, verify_data=verify)
        self._definitions: dict[str, str] = {}
        self._stores: dict[str, Any] = {}
        self._metadata: dict[str, Mapping[str, str]] = {}
        topics: dict[str, TopicInfo] = {}
        starts: list[int] = []
        ends: list[int] = []
        for file in self.files:
            for topic in self._topics_of(file, starts, ends):
                before = topics.get(topic.name)
                topics[topic.name] = topic if before is None else before.with_count(before.count + topic.count)
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

    def messages(
        self, topics: Iterable[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield messages by log time; those of one time in the order they were written.

        Args:
            topics: only these; all if None.
            start_ns: only messages logged at or after this time.
            stop_ns: only messages logged before this time.

        Raises:
            BagError: a topic the bag lacks (at once), or damage found on the way.
        """
        wanted = None if topics is None else [topics] if isinstance(topics, str) else list(topics)
        for name in wanted or ():
            self.require_topic(name)
        return self._messages(wanted, start_ns, stop_ns)

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

    def _messages(self, wanted: list[str] | None, start_ns: int | None, stop_ns: int | None) -> Iterator[BagMessage]:
        if start_ns is not None and stop_ns is not None and start_ns >= stop_ns:
            return
        for file in self.files:
            summary = self._frames[file].summary
            # Without an index mcap's seeking reader would fall back to one that checks nothing.
            kind = SeekingReader if summary is not None and summary.chunk_indexes else NonSeekingReader
            with _opened(file) as stream:
                try:
                    reader: Any = kind(stream, validate_crcs=True)
                    for schema, channel, message in reader.iter_messages(
                        topics=wanted, starting_at=start_ns, ending_before=stop_ns
                    ):
                        yield BagMessage(
                            channel.topic,
                            "" if schema is None else schema.name,
                            message.log_time,
                            message.publish_time,
                            message.data,
                        )
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
        counts: dict[int, int] = {}
        reader: Any = NonSeekingReader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            seen[channel.id] = (channel, schema)
            counts[channel.id] = counts.get(channel.id, 0) + 1
            starts.append(message.log_time)
            ends.append(message.log_time)
        return [self._topic(channel, schema, counts) for channel, schema in seen.values()]

    def _topic(self, channel: Any, schema: Any, counts: Mapping[int, int]) -> TopicInfo:
        if schema is not None and schema.encoding == "ros2msg":
            self._definitions[schema.name] = schema.data.decode("utf-8")
        return TopicInfo(
            channel.topic,
            "" if schema is None else schema.name,
            counts.get(channel.id, 0),
            channel.message_encoding,
            qos_from(channel.metadata.get("offered_qos_profiles", "")),
            channel.metadata.get("topic_type_hash", ""),
        )

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
