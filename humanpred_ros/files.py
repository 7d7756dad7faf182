"""Files that a stranger may have made are read here: within bounds, as plain values, and never through a foreign path.

Whatever comes from such a file is text, numbers, lists and mappings. Sizes are bounded before memory is taken, and
nothing in a file is run. docs/trust.md lists what is read this way.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import stat
import zipfile
import zlib
from collections.abc import Hashable
from pathlib import Path
from typing import IO, Any

import numpy as np
import yaml
from numpy.typing import NDArray

from humanpred_ros.errors import HumanPredError

#: Sizes up to which files are read, in bytes.
YAML_BYTES, JSON_BYTES, TEXT_BYTES, ARCHIVE_BYTES = 1 << 20, 16 << 20, 64 << 20, 1 << 30
_BLOCK_BYTES = 1 << 20
#: Values nested deeper than this, or more of them with aliases written out, are in no file that people wrote.
_DEPTH, _VALUES = 30, 200_000
#: No number of an archive is larger: metres, radians, seconds, counts and log densities are far below.
LARGEST = 1e12
#: Numbers as YAML 1.2 has them, no longer than 64 bits need; anything else is text.
_INTEGER, _HEX = re.compile(r"[-+]?[0-9]{1,19}"), re.compile(r"0x[0-9a-fA-F]{1,15}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]{1,40}|[0-9]{1,40}(\.[0-9]{0,40})?)([eE][-+]?[0-9]{1,4})?|[-+]?\.(inf|Inf|INF)")
_WORDS = {
    "": None, "~": None, "null": None, "Null": None, "NULL": None, "true": True, "True": True, "TRUE": True,
    "false": False, "False": False, "FALSE": False, ".nan": math.nan, ".NaN": math.nan, ".NAN": math.nan,
}  # fmt: skip
#: Names that Windows keeps for devices; data are shared between machines.
_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
_LONGEST_NAME_BYTES = 200
#: Whatever zipfile and NumPy raise on bytes that are not an archive they wrote.
_UNREADABLE = (
    EOFError, KeyError, TypeError, ValueError, RuntimeError, NotImplementedError, OverflowError, MemoryError,
    SyntaxError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def open_plain(path: Path, error: type[HumanPredError]) -> IO[bytes]:
    """Return a file opened for reading, if it is a plain one: pipes, devices and folders may never end or answer.

    Raises:
        error: with the file and why it is not read.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as trouble:  # ValueError: a zero byte in the name
        reason = trouble.strerror if isinstance(trouble, OSError) else str(trouble)
        raise error(f"{path}: could not be read ({reason}); check that it is there") from trouble
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise error(f"{path}: could not be read: wanted a plain file, got a folder, pipe or device; name a file")
    return os.fdopen(handle, "rb")


def read_bytes(path: Path, most: int, error: type[HumanPredError]) -> bytes:
    """Return the content of a plain file of up to `most` bytes; raises `error` for anything else."""
    with open_plain(path, error) as stream:
        data = bytearray()
        try:
            while len(data) <= most and (block := stream.read(_BLOCK_BYTES)):  # a size asked for is taken at once
                data += block
        except OSError as trouble:
            raise error(f"{path}: could not be read ({trouble.strerror}); check that it is there") from trouble
    if len(data) > most:
        raise error(f"{path}: could not be read: wanted at most {most >> 20} MiB, it is larger; cut it into parts")
    return bytes(data)


def read_text(path: Path, error: type[HumanPredError], most: int = TEXT_BYTES) -> str:
    """Return the text of a plain file in UTF-8, without a byte order mark; raises `error` for anything else."""
    try:
        return read_bytes(path, most, error).decode("utf-8-sig")
    except UnicodeDecodeError as trouble:
        raise error(f"{path}: could not be read: wanted text in UTF-8, got something else ({trouble})") from trouble


def read_yaml(path: Path, error: type[HumanPredError]) -> Any:
    """Return the value of a YAML file, as `yaml_of`; raises `error`, with the file, where there is none."""
    try:
        return yaml_of(read_text(path, error, YAML_BYTES))
    except ValueError as trouble:
        raise error(f"{path}: wanted YAML, got something else: {trouble}") from trouble


def read_json(path: Path, error: type[HumanPredError]) -> Any:
    """Return the value of a JSON file, as `json_of`; raises `error`, with the file, where there is none."""
    try:
        return json_of(read_text(path, error, JSON_BYTES))
    except ValueError as trouble:
        raise error(f"{path}: wanted JSON, it could not be read ({trouble})") from trouble


def yaml_of(text: str) -> Any:
    """Return the value of a YAML text: mappings, lists, texts, numbers, true, false and null, as in YAML 1.2.

    Dates, `yes` and `no`, and numbers beyond 64 bits are texts. Tags, merge keys and keys given twice are refused, and
    so is what is nested deeper than 30 or holds more than 200,000 values with its aliases written out.

    Raises:
        ValueError: with the line and what is wrong there.
    """
    if len(text) > YAML_BYTES:
        raise ValueError(f"wanted at most {YAML_BYTES >> 20} MiB, got {len(text) >> 20}")
    try:
        return _Composer().value(text)
    except yaml.MarkedYAMLError as trouble:
        where = f"line {trouble.problem_mark.line + 1}: " if trouble.problem_mark else ""
        raise ValueError(f"{where}{trouble.problem}") from None
    except yaml.YAMLError as trouble:
        raise ValueError(str(trouble)) from None


class _Composer:
    """Puts the value of a YAML text together from its events; nothing of it recurses."""

    def __init__(self) -> None:
        self.open: list[_Open] = [_Open([], None)]
        self.anchors: dict[str, tuple[Any, int]] = {}
        self.count = 0

    def value(self, text: str) -> Any:
        n_documents = 0
        event: Any
        for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
            try:
                n_documents += isinstance(event, yaml.DocumentStartEvent)
                if n_documents > 1:
                    raise ValueError("wanted one document")
                self._take(event)
            except ValueError as trouble:
                raise ValueError(f"line {event.start_mark.line + 1}: {trouble}") from None
        whole = self.open[0].value
        return whole[0] if whole else None

    def _take(self, event: yaml.Event) -> None:
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self.anchors:
                raise ValueError(f"the alias {event.anchor!r:.40} stands for nothing that is complete")
            self._add(*self.anchors[event.anchor])
        elif isinstance(event, yaml.ScalarEvent):
            self._plain(event)
            value = _scalar(event.value) if event.implicit[0] else event.value
            if event.anchor:
                self.anchors[event.anchor] = value, 1
            self._add(value, 1)
        elif isinstance(event, yaml.MappingStartEvent | yaml.SequenceStartEvent):
            self._plain(event)
            if len(self.open) > _DEPTH:
                raise ValueError(f"wanted at most {_DEPTH} levels, one in another")
            self.open.append(_Open({} if isinstance(event, yaml.MappingStartEvent) else [], event.anchor))
        elif isinstance(event, yaml.MappingEndEvent | yaml.SequenceEndEvent):
            done = self.open.pop()
            if done.anchor:
                self.anchors[done.anchor] = done.value, done.count
            self._add(done.value, done.count)

    def _plain(self, event: Any) -> None:
        if event.tag not in (None, "!"):
            raise ValueError(f"wanted plain values, got one with the tag {event.tag!r:.60}")

    def _add(self, value: Any, count: int) -> None:
        parent = self.open[-1]
        parent.count += count
        if parent.count > _VALUES:
            raise ValueError(f"wanted at most {_VALUES} values, with aliases written out")
        if isinstance(parent.value, list):
            parent.value.append(value)
        elif parent.key is None:
            if not isinstance(value, Hashable) or value == "<<":
                raise ValueError(f"wanted a text or number as a key, got {value!r:.60}")
            if value in parent.value:
                raise ValueError(f"the key {value!r:.60} is given twice")
            parent.key = [value]
        else:
            parent.value[parent.key[0]], parent.key = value, None


class _Open:
    """A list or mapping that is being read, the number of values in it so far, and the key that waits for its value."""

    def __init__(self, value: Any, anchor: str | None) -> None:
        self.value, self.anchor = value, anchor
        self.count = 1
        self.key: list[Any] | None = None


def _scalar(text: str) -> Any:
    """Return what an unquoted text stands for."""
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return number if -(2**63) <= (number := int(text)) < 2**63 else text
    if _HEX.fullmatch(text):
        return int(text, 16)
    return float(text.replace(".i", "i").replace(".I", "I")) if _FLOAT.fullmatch(text) else text


def json_of(text: str) -> Any:
    """Return the value of a JSON text; numbers are finite, and whole ones fit 64 bits.

    Raises:
        ValueError: no JSON, or a number that is neither.
    """
    if len(text) > JSON_BYTES:
        raise ValueError(f"wanted at most {JSON_BYTES >> 20} MiB, got {len(text) >> 20}")
    try:
        return json.loads(text, parse_int=_whole, parse_float=_finite, parse_constant=_finite)
    except RecursionError:
        raise ValueError("values nested too deep") from None


def _whole(text: str) -> int:
    if len(text) > 20 or not -(2**63) <= (number := int(text)) < 2**64:
        raise ValueError(f"wanted whole numbers that fit 64 bits, got {text:.30}")
    return number


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise ValueError(f"wanted finite numbers, got {text:.30}")
    return number


def read_arrays(path: Path, error: type[HumanPredError]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a NumPy archive (.npz) by name: numbers, truth values and texts, stored uncompressed.

    No more is allocated than the file is large: what its headers declare is compared with what it holds.

    Raises:
        error: no such archive, objects in it, or numbers that are not finite or beyond 1e12.
    """
    return arrays_in(read_bytes(path, ARCHIVE_BYTES, error), path, error)


def arrays_in(data: bytes, path: Path, error: type[HumanPredError]) -> dict[str, NDArray[Any]]:
    """Return the arrays in the bytes of an archive that stands for a file; raises as `read_arrays`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if any(info.compress_type != zipfile.ZIP_STORED for info in members):
                raise ValueError("wanted members stored uncompressed")
            if sum(info.file_size for info in members) > len(data):
                raise ValueError("wanted members no larger than the file")
            arrays = {info.filename.removesuffix(".npy"): _array(info.filename, archive.read(info)) for info in members}
            if len(arrays) < len(members):
                raise ValueError("wanted members of different names")
            return arrays
    except _UNREADABLE as trouble:
        raise error(f"{path}: not an archive of arrays, or damaged ({type(trouble).__name__}: {trouble})") from trouble


def _array(name: str, data: bytes) -> NDArray[Any]:
    """Return the array in the bytes of a .npy file. Raises ValueError, with the name, for one that cannot be."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran_order, dtype = read_header(stream)
    if dtype.kind not in "biufU" or dtype.itemsize == 0:
        raise ValueError(f"{name:.80}: wanted numbers, truth values or texts, got {dtype}")
    if math.prod(shape) * dtype.itemsize != len(data) - stream.tell() or min(shape, default=0) < 0:
        raise ValueError(f"{name:.80}: it declares {shape!s:.80} of {dtype}, which is not what it holds")
    array = np.frombuffer(data, dtype, offset=stream.tell()).reshape(shape, order="F" if fortran_order else "C")
    if dtype.kind in "iuf" and array.size and not np.abs(array.astype(np.float64)).max() <= LARGEST:
        raise ValueError(f"{name:.80}: wanted finite numbers up to {LARGEST:g}")
    return array


def name_trouble(name: str) -> str:
    """Return why a name from a file cannot be that of a file or folder here; empty if it can."""
    if not name.strip():
        return "it is empty"
    if name != name.strip() or name[0] in ".-" or name[-1] == ".":
        return "it begins with a point, a dash or a blank, or ends with a point or a blank"
    if any(c in '/\\:*?"<>|' or not c.isprintable() for c in name):
        return "it holds a slash, or a character that file names do not have everywhere"
    if _DEVICES.fullmatch(name):
        return "some systems keep it for a device"
    return "it is too long" if len(name.encode("utf-8", "replace")) > _LONGEST_NAME_BYTES else ""


def file_inside(folder: Path, name: str, error: type[HumanPredError], where: str) -> Path:
    """Return the file in `folder` that a file of data names, if the name, and links on the way, stay in the folder.

    Args:
        folder: that the user named.
        name: a file's name or relative path.
        error: what is raised.
        where: what names it, for the message.

    Raises:
        error: the name leads out of the folder.
    """
    parts = name.split("/")
    trouble = ""
    if any(part in ("", ".", "..") or "\0" in part or len(part.encode("utf-8", "replace")) > 255 for part in parts):
        trouble = "it is no relative path below that folder"
    elif not (folder / name).resolve().is_relative_to(folder.resolve()):
        trouble = "a link leads out of the folder"
    if trouble:
        raise error(f"{where}: wanted the name of a file in {folder}, got {name!r:.120}: {trouble}; rename it")
    return folder / name
