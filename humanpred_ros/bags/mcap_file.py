"""The outer frame of one .mcap file: whether it is complete and undamaged, and its summary.

A complete file ends with a summary section, a footer that holds the summary's CRC, and the magic
bytes; the record before the summary may hold the CRC of everything above it. mcap's reader checks
chunk CRCs only, so these outer checks are made here. Layout: the MCAP specification, version 0.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.exceptions import McapError
from mcap.reader import SeekingReader

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


@dataclass(frozen=True)
class FileFrame:
    """What the outer frame of an mcap file says."""

    summary: Any | None = None  #: mcap's Summary (schemas, channels, statistics, indexes), None if there is none
    trouble: str = ""  #: what is wrong with the frame, empty if nothing
    checksum: bool = False  #: whether a wrong CRC is what is wrong


def read_frame(path: Path, stream: IO[bytes], *, verify_data: bool = True) -> FileFrame:
    """Return the frame of an mcap file after checking it.

    Args:
        path: for messages.
        stream: the file, opened for reading.
        verify_data: also compare the CRC over all data, where one is recorded (reads the whole file).

    Raises:
        BagError: not an mcap file, truncated, or damaged.
    """
    frame = inspect_frame(path, stream, verify_data=verify_data)
    if frame.trouble:
        raise BagError(f"{path}: {frame.trouble}; {SALVAGE_HINT}")
    return frame


def inspect_frame(path: Path, stream: IO[bytes], *, verify_data: bool = True) -> FileFrame:
    """Return the frame as `read_frame` does, but with its trouble as a finding.

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
        return FileFrame(trouble="wanted a summary with its recorded checksum, got another", checksum=True)
    stream.seek(data_end - _DATA_END.size)
    opcode, length, data_crc = _DATA_END.unpack(stream.read(_DATA_END.size))
    if opcode != _DATA_END_OPCODE or length != _DATA_END.size - RECORD_HEADER.size:
        return FileFrame(trouble="wanted the end of the data just before the summary, got something else")
    try:
        stream.seek(0)
        summary = SeekingReader(stream).get_summary()
    except MCAP_TROUBLE as trouble:
        return FileFrame(trouble=f"wanted a readable summary, got {spell(trouble)}")
    if data_crc and verify_data and _crc_of(stream, data_end - _DATA_END.size) != data_crc:
        return FileFrame(summary, "wanted data with their recorded checksum, got another", checksum=True)
    return FileFrame(summary)


def spell(trouble: Exception) -> str:
    """Return an exception of another library as text; some of them have none."""
    return f"{type(trouble).__name__}: {trouble}" if str(trouble) else type(trouble).__name__


def _crc_of(stream: IO[bytes], length: int) -> int:
    stream.seek(0)
    crc = 0
    while length > 0:
        block = stream.read(min(_BLOCK_BYTES, length))
        if not block:
            break
        crc = zlib.crc32(block, crc)
        length -= len(block)
    return crc
