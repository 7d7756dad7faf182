"""The records of an MCAP file, read one after the other, and its chunks, unpacked within bounds.

What a file declares is compared with what it holds before memory is taken. A chunk is intact when its CRC is right.
"""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped, unused-ignore]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema

MAGIC = b"\x89MCAP0\r\n"
#: Opcode and length in front of every record's content.
RECORD_HEADER = struct.Struct("<BQ")
#: A chunk ends with the message that makes it longer than about a megabyte.
MOST_CHUNK_BYTES = 64 << 20
#: Bytes that may be unpacked for each byte of a file, beside one chunk: recordings shrink to a third, or a fiftieth.
MOST_RATIO = 300
#: First and last message time, uncompressed size, CRC, length of the compression's name.
_CHUNK_START = struct.Struct("<QQQII")
_COMPRESSED_SIZE = struct.Struct("<Q")
_LONGEST_NAME = 16
_DATA_END_BYTES = 4
#: Opcodes from here on are private to applications and may be skipped (MCAP specification).
_PRIVATE_OPCODES = 0x80

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


def spell(trouble: Exception) -> str:
    """Return an exception of another library as text; some of them have none."""
    return f"{type(trouble).__name__}: {trouble}" if str(trouble) else type(trouble).__name__


class Damage(NamedTuple):
    """Something wrong at a byte of the file."""

    offset: int
    text: str


class Budget:
    """How many bytes may still be unpacked from one file."""

    def __init__(self, file_bytes: int) -> None:
        self.left = MOST_RATIO * file_bytes + MOST_CHUNK_BYTES

    def spend(self, n_bytes: int) -> None:
        """Take note of bytes that are about to be unpacked. Raises ValueError where they are too many."""
        if n_bytes > self.left:
            raise ValueError(f"all chunks together unpack to more than {MOST_RATIO} times the file's size")
        self.left -= n_bytes


@dataclass(frozen=True)
class Chunk:
    """A chunk's header and where its compressed bytes are."""

    data: bytes | mmap.mmap  #: that hold it
    uncompressed_size: int  #: from its header
    crc: int
    compression: str
    consistent: bool  #: the record's length and the compressed size agree
    first: int  #: where the compressed bytes begin
    end: int  #: and where they end, which may be beyond the end of the data

    @staticmethod
    def at(data: bytes | mmap.mmap, position: int) -> Chunk:
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
        name = data[name_start:size_start].decode("ascii", "replace")
        return Chunk(data, uncompressed_size, crc, name, start + length == end, first, end)

    @property
    def cut_off(self) -> bool:
        """Whether the compressed bytes should go on beyond the end of the data."""
        return self.end > len(self.data)

    def content(self, budget: Budget) -> bytes:
        """Return the records inside: all of them, verified, or what the end of the file left of them.

        Raises:
            one of MCAP_TROUBLE: the chunk is damaged, or larger than anything that is read here.
        """
        if self.uncompressed_size > MOST_CHUNK_BYTES:
            raise ValueError(f"wanted chunks of up to {MOST_CHUNK_BYTES} bytes, it declares {self.uncompressed_size}")
        compressed = min(self.end, len(self.data)) - self.first
        budget.spend(self.uncompressed_size + compressed)
        content = self._unpacked(self.data[self.first : self.first + compressed])
        if len(content) == self.uncompressed_size:
            if self.crc and zlib.crc32(content) != self.crc:
                raise ValueError("its checksum is wrong")
        elif not (self.cut_off and self.consistent) or len(content) > self.uncompressed_size:
            more = "more" if len(content) > self.uncompressed_size else len(content)
            raise ValueError(f"it holds {more} bytes instead of {self.uncompressed_size}")
        return content

    def _unpacked(self, compressed: bytes) -> bytes:
        """Return the bytes inside, one more than the header says at the most."""
        most = self.uncompressed_size + 1
        if self.compression == "":
            return compressed[:most]
        if self.compression == "zstd":
            unpacked = bytearray()
            with zstandard.ZstdDecompressor().stream_reader(compressed) as stream:
                while len(unpacked) < most and (part := stream.read(most - len(unpacked))):
                    unpacked += part
            return bytes(unpacked)
        if self.compression == "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(compressed, most))
        raise ValueError(f"unknown compression {self.compression!r}")


def walk(data: mmap.mmap) -> Iterator[Any]:
    """Yield Schema, Channel, Message and Metadata records in file order, and Damage where something is wrong."""
    position, size, budget = len(MAGIC), len(data), Budget(len(data))
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
                chunk = Chunk.at(data, position)
                for record in inner_records(chunk.content(budget)):
                    record.unguarded = not chunk.crc
                    yield record
                if not chunk.consistent or chunk.cut_off:
                    raise ValueError("the file ends inside it" if chunk.consistent else "its length is wrong")
                sure = end
            elif end > size:
                raise ValueError("the file ends inside it")
            elif not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE_OPCODES):
                raise ValueError(f"there is no kind {opcode}")
            else:
                for record in _record(data[position + RECORD_HEADER.size : end], opcode):
                    record.unguarded = True  # no checksum is over it
                    yield record
            position = end
        except MCAP_TROUBLE as trouble:
            what = "chunk" if opcode == Opcode.CHUNK else "record"
            yield Damage(position, f"damaged {what} ({spell(trouble)})")
            position = _next_chunk(data, sure)


def inner_records(content: bytes) -> Iterator[Any]:
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
    elif opcode == Opcode.ATTACHMENT:
        yield Attachment.read(stream)


def _next_chunk(data: mmap.mmap, position: int) -> int:
    """Return the offset of the next chunk at or after `position`, or the end of the file.

    A chunk states its length twice, 64 bits each: where both agree there is one, whatever comes before it.
    """
    while (position := data.find(bytes([Opcode.CHUNK]), position)) >= 0:
        try:
            if Chunk.at(data, position).consistent:
                return position
        except MCAP_TROUBLE:
            pass
        position += 1
    return len(data)
