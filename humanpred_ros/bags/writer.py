"""Writes a rosbag2 directory that survives an interruption, readable by ros2 bag, rosbags and Foxglove."""

from __future__ import annotations

import errno
import os
import shutil
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Literal

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from rosbags.interfaces import Qos

from humanpred_ros import __version__
from humanpred_ros.bags.messages import TypeDefinition, serialise, type_definition
from humanpred_ros.bags.metadata import DEFAULT_QOS, TopicInfo, metadata_text, qos_as_text
from humanpred_ros.errors import BagError
from humanpred_ros.settings import Settings, setting

_COMPRESSION = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}
#: Times are nanoseconds since the epoch in 64 bits with a sign.
LAST_TIME_NS = 2**63 - 1
#: Ends a file without summary and checksum: records DataEnd and Footer (opcode, length, zeros for "none"), magic.
_PLAIN_END = struct.pack("<BQIBQQQI", Opcode.DATA_END, 4, 0, Opcode.FOOTER, 20, 0, 0, 0) + MCAP0_MAGIC


class StorageOptions(Settings):
    """How messages are stored; an interruption loses what has come since a chunk was last closed."""

    compression: Literal["zstd", "lz4", "none"] = setting("zstd", "compression of each chunk")
    chunk_bytes: int = setting(1 << 20, "a chunk is closed when it has grown beyond this size", unit="B", low=1)
    flush_period_s: float = setting(
        0.5, "a chunk is closed by the first message after this time; 0: after every one", unit="s", low=0.0
    )
    flush_messages: int = setting(10_000, "a chunk is closed after this many messages, too", low=1)


class BagWriter:
    """Writes one rosbag2 directory; use it as a context manager. Safe to call from several threads.

    While it runs, every closed chunk is already with the operating system: after a kill the file can be
    salvaged up to there. Leaving the block writes index and footer and then metadata.yaml. A `staged`
    bag appears under its name only when complete, and not at all if the block raises; a live bag keeps
    what was recorded until then. One that cannot be written any more is closed, and ends after the last flush.

    Args:
        directory: the bag, `<directory>/{metadata.yaml, <name>_0.mcap}`.
        options: storage.
        staged: write beside and rename at the end.
        overwrite: replace an existing bag (only a folder that holds nothing but a bag).
        clock: seconds, steady; paces the flushing only.

    Raises:
        BagError: the directory exists, or cannot be written.
    """

    def __init__(
        self,
        directory: str | Path,
        *,
        options: StorageOptions | None = None,
        staged: bool = False,
        overwrite: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.directory = Path(directory)
        self._options = options or StorageOptions()
        self._clock = clock
        self._lock = threading.Lock()
        self._topics: dict[str, TopicInfo] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._counts: dict[str, int] = {}
        self._custom: dict[str, str] = {}
        self._flushed_bytes, self._flushed_counts = 0, dict[str, int]()
        self._start_ns, self._end_ns = LAST_TIME_NS, 0
        self._pending = 0
        self._overwrite = overwrite
        name = self.directory.name
        if not name:
            raise BagError(f"wanted a name for the bag's folder, got {str(directory)!r}")
        if os.path.lexists(self.directory) and not overwrite:
            raise BagError(
                f"{self.directory}: wanted a new folder, this one exists; choose another name or overwrite it"
            )
        if self.directory.exists():
            require_only_a_bag(self.directory)
        self._staged = staged
        self._folder = self.directory.with_name(f".{name}.partial-{os.getpid()}") if staged else self.directory
        self._file_name = f"{name}_0.mcap"
        try:
            if self._folder.exists():  # a live bag being replaced, or the remains of a dead process of the same id
                require_only_a_bag(self._folder)
                shutil.rmtree(self._folder)
            self._folder.mkdir(parents=True)
            self._stream: IO[bytes] | None = (self._folder / self._file_name).open("xb")
            self._mcap: Any = Writer(
                self._stream,
                chunk_size=self._options.chunk_bytes,
                compression=_COMPRESSION[self._options.compression],
                enable_data_crcs=True,
            )
            self._mcap.start(profile="ros2", library=f"humanpred_ros {__version__}")
            self._flush(clock())
        except OSError as trouble:
            raise BagError(f"{self.directory}: cannot be created ({trouble}); choose a writable place") from trouble

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics added so far."""
        return tuple(self._topics)

    def add_topic(
        self,
        name: str,
        msgtype: str,
        *,
        qos: Qos | tuple[Qos, ...] = DEFAULT_QOS,
        definition: TypeDefinition | None = None,
        encoding: str = "cdr",
    ) -> None:
        """Announce a topic; doing it again with the same type changes nothing.

        Args:
            name: topic name.
            msgtype: such as `std_msgs/msg/String`.
            qos: what publishers offer.
            definition: needed only for types outside Jazzy's common interfaces.
            encoding: of the messages; everything in ROS 2 is `cdr`.

        Raises:
            BagError: the topic exists with another type.
            UsageError: unknown type without a definition.
        """
        definition = definition or type_definition(msgtype)
        profiles = (qos,) if isinstance(qos, Qos) else tuple(qos)
        with self._writing():
            known = self._topics.get(name)
            if known is not None:
                if known.msgtype != msgtype:
                    raise BagError(
                        f"topic {name}: wanted {known.msgtype} as announced, got {msgtype}; use another topic"
                    )
                return
            schema = (msgtype, definition.text)
            if schema not in self._schemas:
                self._schemas[schema] = self._mcap.register_schema(
                    msgtype, definition.encoding, definition.text.encode()
                )
            self._channels[name] = self._mcap.register_channel(
                name,
                encoding,
                self._schemas[schema],
                {"offered_qos_profiles": qos_as_text(profiles), "topic_type_hash": definition.type_hash},
            )
            self._topics[name] = TopicInfo(name, msgtype, 0, encoding, profiles, definition.type_hash)
            self._counts[name] = 0

    def write(self, topic: str, log_time_ns: int, data: bytes, publish_time_ns: int | None = None) -> None:
        """Write one message given as CDR bytes.

        Args:
            topic: announced by `add_topic`.
            log_time_ns: when it was received, nanoseconds since the epoch.
            data: the bytes as they travel over DDS.
            publish_time_ns: when it was sent; the same as `log_time_ns` if not known.

        Raises:
            BagError: unknown topic, impossible time, closed bag, or the disk refuses.
        """
        if topic not in self._channels:
            raise BagError(f"topic {topic}: wanted one of {list(self._topics)}; announce it with add_topic first")
        sent_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        if not (0 <= log_time_ns <= LAST_TIME_NS and 0 <= sent_ns <= LAST_TIME_NS):
            raise BagError(f"topic {topic}: wanted times from 0 to 2^63 - 1 ns, got {log_time_ns} and {sent_ns}")
        with self._writing():
            self._mcap.add_message(self._channels[topic], int(log_time_ns), bytes(data), int(sent_ns))
            self._counts[topic] += 1
            self._start_ns = min(self._start_ns, int(log_time_ns))
            self._end_ns = max(self._end_ns, int(log_time_ns))
            self._pending += 1
            now_s = self._clock()
            due = now_s - self._last_flush_s >= self._options.flush_period_s
            if due or self._pending >= self._options.flush_messages:
                self._flush(now_s)

    def write_message(self, topic: str, log_time_ns: int, message: Any, publish_time_ns: int | None = None) -> None:
        """Write one message of the type store (see `messages`), announcing its topic if need be."""
        if topic not in self._channels:
            self.add_topic(topic, message.__msgtype__)
        elif self._topics[topic].msgtype != message.__msgtype__:
            raise BagError(f"topic {topic}: wanted a {self._topics[topic].msgtype}, got a {message.__msgtype__}")
        self.write(topic, log_time_ns, serialise(message), publish_time_ns)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write facts about the bag: an MCAP metadata record, and `<name>.<key>` in metadata.yaml's custom_data."""
        if name == "rosbag2":
            raise BagError("metadata record: wanted a name other than 'rosbag2', which rosbag2 keeps for itself")
        texts = {str(key): str(value) for key, value in values.items()}
        with self._writing():
            self._mcap.add_metadata(name, texts)
            self._custom.update({f"{name}.{key}": value for key, value in texts.items()})

    def add_attachment(self, attachment: Any) -> None:
        """Write an MCAP attachment (a file inside the file), given as mcap's record."""
        with self._writing():
            self._mcap.add_attachment(
                attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data
            )

    def flush(self) -> None:
        """Close the chunk and hand it to the operating system; for recorders, on a timer of their own."""
        with self._writing():
            self._flush(self._clock())

    def close(self) -> None:
        """Write index, footer and metadata.yaml, and put a staged bag in place; a second call does nothing."""
        with self._lock:
            if self._stream is None:
                return
            try:
                text = metadata_text(*self._facts(self._counts), bare=True)
                self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})
                self._mcap.finish()
                self._stream.flush()
                self._write_metadata(self._counts)
                self._stream.close()
                self._stream = None
                if self._staged:
                    self._put_in_place()
            except OSError as trouble:
                raise self._cannot_write(trouble) from trouble

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or not self._staged:
            self.close()
        elif self._stream is not None:  # nothing of a staged bag remains
            self._stream.close()
            self._stream = None
            shutil.rmtree(self._folder, ignore_errors=True)

    def _flush(self, now_s: float) -> None:
        assert self._stream is not None
        self._mcap.flush()
        if os.fstat(self._stream.fileno()).st_nlink == 0:
            raise FileNotFoundError(errno.ENOENT, f"{self._file_name} was removed")
        self._pending, self._last_flush_s = 0, now_s
        self._flushed_bytes, self._flushed_counts = self._stream.tell(), dict(self._counts)

    def _end_after_flushed(self) -> None:
        """Close the bag with what was flushed; a disk that refuses even that leaves a file that can be salvaged."""
        stream, self._stream = self._stream, None
        if stream is None:
            return
        file = os.dup(stream.fileno())
        with suppress(OSError):
            stream.close()  # what is still in its buffer is refused again, or cut off below
        with suppress(OSError):
            os.ftruncate(file, self._flushed_bytes)
            os.lseek(file, 0, os.SEEK_END)
            if os.write(file, _PLAIN_END) == len(_PLAIN_END):
                self._write_metadata(self._flushed_counts)
            else:
                os.ftruncate(file, self._flushed_bytes)
        os.close(file)

    def _write_metadata(self, counts: Mapping[str, int]) -> None:
        temporary = self._folder / "metadata.yaml.partial"
        temporary.write_text(metadata_text(*self._facts(counts)), encoding="utf-8")
        temporary.replace(self._folder / "metadata.yaml")

    def _facts(self, counts: Mapping[str, int]) -> tuple[str, list[TopicInfo], int, int, dict[str, str]]:
        topics = [replace(topic, count=counts.get(name, 0)) for name, topic in self._topics.items()]
        return self._file_name, topics, self._start_ns, self._end_ns, self._custom

    def _put_in_place(self) -> None:
        if self.directory.exists():
            aside = self.directory.with_name(f".{self.directory.name}.replaced-{os.getpid()}")
            self.directory.rename(aside)
            self._folder.rename(self.directory)
            shutil.rmtree(aside, ignore_errors=True)
        else:
            self._folder.rename(self.directory)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Keep other threads out; raise BagError where the bag is closed or the disk refuses."""
        with self._lock:
            if self._stream is None:
                raise BagError(f"{self.directory}: wanted an open bag, this one is closed; open a new one")
            try:
                yield
            except OSError as trouble:
                raise self._cannot_write(trouble) from trouble

    def _cannot_write(self, trouble: OSError) -> BagError:
        """Close the bag, and return what to tell."""
        self._end_after_flushed()
        if self._staged:
            shutil.rmtree(self._folder, ignore_errors=True)
        full = trouble.errno in (errno.ENOSPC, errno.EDQUOT)
        why = f"disk full: {trouble.strerror}" if full else trouble.strerror
        return BagError(f"{self.directory}: cannot be written ({why}); free space or choose another place")


def require_only_a_bag(folder: Path) -> None:
    """Raise BagError unless `folder` holds nothing but a bag: it is about to be replaced."""
    if not folder.is_dir():
        raise BagError(f"{folder}: wanted a folder with a bag to replace, got a file; remove it yourself")
    for entry in folder.iterdir():
        if entry.name not in ("metadata.yaml", "metadata.yaml.partial") and entry.suffix != ".mcap":
            raise BagError(f"{folder}: wanted nothing but a bag to replace, found {entry.name}; remove it yourself")
