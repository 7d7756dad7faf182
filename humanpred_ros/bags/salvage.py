"""Finds what is wrong with a bag, and copies what is intact of a broken one to a fresh bag.

mcap's readers stop at the first broken byte and need the index at the end; a recording that was killed has no index,
and a damaged one is good before and after the damage. So the file is read record by record here. A chunk is intact
when its CRC is right. Only a chunk that the end of the file cuts off is read in part: its first bytes decompress to the
first of its messages.
"""

from __future__ import annotations

import io
import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped, unused-ignore]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema

from humanpred_ros.bags.messages import TypeDefinition
from humanpred_ros.bags.metadata import read_metadata
from humanpred_ros.bags.reader import MAGIC, MCAP_TROUBLE, RECORD_HEADER, bag_files, inspect_frame, spell, topic_of
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError

#: The record rosbag2 keeps its own metadata in; a fresh bag gets a fresh one.
_ROSBAG2_RECORD = "rosbag2"
#: First and last message time, uncompressed size, CRC, length of the compression's name.
_CHUNK_START = struct.Struct("<QQQII")
_COMPRESSED_SIZE = struct.Struct("<Q")
_LONGEST_NAME = 16
_DATA_END_BYTES = 4
#: Opcodes from here on are private to applications and may be skipped (MCAP specification).
_PRIVATE_OPCODES = 0x80
_STEP_BYTES = 4096


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
        if not report.messages:
            raise BagError(f"{path}: wanted at least one intact message, found none; the bag is lost")
    return report


def _examine(path: Path, bag: BagWriter | None) -> BagReport:
    files, problems = _files(path)
    counts: Counter[str] = Counter()
    copied: set[tuple[str, tuple[tuple[str, str], ...]]] = set()
    for file in files:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        lost: Counter[int] = Counter()
        for record in scan_records(file):
            if isinstance(record, Damage):
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
            problems.append(f"{file.name}: {count} messages of channel {channel_id}, whose description is lost")
    problems += _against_metadata(path, counts)
    return BagReport(path, dict(counts), tuple(problems))


def _copy(bag: BagWriter, channel: Any, schema: Any, message: Any) -> None:
    if channel.topic not in bag.topics:
        text, encoding = ("", "") if schema is None else (schema.data.decode("utf-8", "replace"), schema.encoding)
        topic = topic_of(channel, schema)
        definition = TypeDefinition(text, encoding, topic.type_hash)
        bag.add_topic(topic.name, topic.msgtype, qos=topic.qos, definition=definition, encoding=topic.encoding)
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
        _, told = read_metadata(path / "metadata.yaml")
    except BagError:
        return []  # already a problem of its own
    return [
        f"metadata.yaml: topic {name}: wanted {told.get(name, 0)} messages as it says, found {counts.get(name, 0)}"
        for name in sorted({*told, *counts})
        if told.get(name, 0) != counts.get(name, 0)
    ]


class Damage(NamedTuple):
    """Something wrong at a byte of the file."""

    offset: int
    text: str


def scan_records(path: Path) -> Iterator[Any]:
    """Yield mcap's Schema, Channel, Message and Metadata records in file order, and Damage where something is wrong.

    Schemas and channels of an intact summary come first, since damage may have taken their originals.

    Raises:
        BagError: the file cannot be opened or does not start like an mcap file.
    """
    try:
        with path.open("rb") as stream:
            frame = inspect_frame(path, stream)
            if frame.summary is not None:
                yield from frame.summary.schemas.values()
                yield from frame.summary.channels.values()
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                found = 0
                for record in _walk(data):
                    found += isinstance(record, Message)
                    yield record
                statistics = None if frame.summary is None else frame.summary.statistics
                if statistics is not None and statistics.message_count != found:
                    yield Damage(len(data), f"wanted {statistics.message_count} messages, found {found} intact")
                if frame.trouble:
                    yield Damage(len(data), frame.trouble)
    except OSError as trouble:
        raise BagError(f"{path}: cannot be read ({trouble.strerror}); check that it is there") from trouble


def _walk(data: mmap.mmap) -> Iterator[Any]:
    position, size = len(MAGIC), len(data)
    # Up to here nothing can be missed: after damage the search for the next chunk starts here, not at the
    # damage, because a wrong length may have led over several chunks before anything looked wrong.
    sure = position
    while position < size:
        # Zeros stand for a header that the end of the file cuts off: there is no such opcode.
        opcode, length = RECORD_HEADER.unpack(
            data[position : position + RECORD_HEADER.size].ljust(RECORD_HEADER.size, b"\0")
        )
        end = position + RECORD_HEADER.size + length
        if opcode == Opcode.DATA_END and length == _DATA_END_BYTES:
            return
        try:
            if opcode == Opcode.CHUNK:
                sure = position + 1
                chunk = _Chunk.at(data, position)
                yield from _inner_records(chunk.content())
                if not chunk.consistent or chunk.cut_off:
                    raise ValueError("the file ends inside it" if chunk.consistent else "its length is wrong")
                sure = end
            elif end > size:
                raise ValueError("the file ends inside it")
            elif not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE_OPCODES):
                raise ValueError(f"there is no kind {opcode}")
            else:
                yield from _record(data[position + RECORD_HEADER.size : end], opcode)
            position = end
        except MCAP_TROUBLE as trouble:
            what = "chunk" if opcode == Opcode.CHUNK else "record"
            yield Damage(position, f"damaged {what} ({spell(trouble)})")
            position = _next_chunk(data, sure)


@dataclass(frozen=True)
class _Chunk:
    """A chunk's header and as much of its compressed bytes as there are."""

    uncompressed_size: int  #: from its header
    crc: int
    compression: str
    consistent: bool  #: the record's length and the compressed size agree
    cut_off: bool  #: the compressed bytes should go on beyond the end of the file
    compressed: bytes  #: the bytes there are

    @staticmethod
    def at(data: mmap.mmap, position: int) -> _Chunk:
        """Return the chunk record starting at `position`. Raises ValueError if there is no whole header."""
        start = position + RECORD_HEADER.size
        if start + _CHUNK_START.size + _LONGEST_NAME + _COMPRESSED_SIZE.size > len(data):
            raise ValueError("the file ends inside its header")
        _, length = RECORD_HEADER.unpack_from(data, position)
        _, _, uncompressed_size, crc, name_length = _CHUNK_START.unpack_from(data, start)
        if name_length > _LONGEST_NAME:
            raise ValueError("its compression has no sensible name")
        name_start = start + _CHUNK_START.size
        size_start = name_start + name_length
        (compressed_size,) = _COMPRESSED_SIZE.unpack_from(data, size_start)
        first = size_start + _COMPRESSED_SIZE.size
        end = first + compressed_size
        return _Chunk(
            uncompressed_size,
            crc,
            data[name_start:size_start].decode("ascii", "replace"),
            start + length == end,
            end > len(data),
            data[first : min(end, len(data))],
        )

    def content(self) -> bytes:
        """Return the records inside: all of them, verified, or what the end of the file left of them.

        Raises:
            one of MCAP_TROUBLE: the chunk is damaged.
        """
        content = self._decompressed()
        if len(content) == self.uncompressed_size:
            if self.crc and zlib.crc32(content) != self.crc:
                raise ValueError("its checksum is wrong")
        elif not (self.cut_off and self.consistent) or len(content) > self.uncompressed_size:
            raise ValueError(f"it holds {len(content)} bytes instead of {self.uncompressed_size}")
        return content

    def _decompressed(self) -> bytes:
        if self.compression == "":
            return self.compressed
        if self.compression == "zstd":
            decoder: Any = zstandard.ZstdDecompressor().decompressobj()
        elif self.compression == "lz4":
            decoder = lz4.frame.LZ4FrameDecompressor()
        else:
            raise ValueError(f"unknown compression {self.compression!r}")
        # In small steps: a decoder keeps back what a step that fails had already given.
        steps = range(0, len(self.compressed), _STEP_BYTES)
        return b"".join(decoder.decompress(self.compressed[k : k + _STEP_BYTES]) for k in steps)


def _inner_records(content: bytes) -> Iterator[Any]:
    """Yield the complete records at the start of a chunk's content."""
    position = 0
    while position + RECORD_HEADER.size <= len(content):
        opcode, length = RECORD_HEADER.unpack_from(content, position)
        start, position = position + RECORD_HEADER.size, position + RECORD_HEADER.size + length
        if position <= len(content):
            yield from _record(content[start:position], opcode)


def _record(body: bytes, opcode: int) -> Iterator[Any]:
    """Yield the record in `body` if it is of a kind that matters here."""
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.MESSAGE:
        yield Message.read(stream, len(body))
    elif opcode == Opcode.SCHEMA:
        yield Schema.read(stream)
    elif opcode == Opcode.CHANNEL:
        yield Channel.read(stream)
    elif opcode == Opcode.METADATA:
        yield Metadata.read(stream)


def _next_chunk(data: mmap.mmap, position: int) -> int:
    """Return the offset of the next chunk at or after `position`, or the end of the file.

    A chunk states its length twice, 64 bits each: where both agree there is one, whatever comes before it.
    """
    while (position := data.find(bytes([Opcode.CHUNK]), position)) >= 0:
        try:
            if _Chunk.at(data, position).consistent:
                return position
        except MCAP_TROUBLE:
            pass
        position += 1
    return len(data)
