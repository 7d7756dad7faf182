"""Bags of other forms become MCAP bags in a temporary folder: sqlite, ROS 1, and what rosbag2 has compressed.

rosbag2 compresses whole files (`x.mcap.zstd`) or each message; the latter only metadata.yaml tells. Times and bytes of
messages stay, those of ROS 1 are written anew as ROS 2's; topics whose messages cannot be are left out.
"""

from __future__ import annotations

import atexit
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import zstandard
from rosbags.convert.converter import migrate_message
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.typesys import Stores, get_typestore

from humanpred_ros.bags.messages import TypeDefinition, serialise, typestore
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError
from humanpred_ros.files import read_yaml

_ZSTD = ".zstd"
#: A file or message may unpack to so many times its size, and this many bytes beside.
_MOST_RATIO, _MOST_BYTES = 300, 64 << 20


def as_mcap(path: Path) -> Path | None:
    """Return the folder of an MCAP bag made of a bag of another form; None if it is of none.

    Raises:
        BagError: it is damaged.
    """
    if path.is_file():
        name = path.name.lower()
        known = name.endswith((".db3", ".bag", _ZSTD))
    else:
        known = path.is_dir() and any(f.name.lower().endswith((".db3", _ZSTD)) for f in path.iterdir())
        known = known or (path.is_dir() and _mode(path) == "message")
    return _made(path.resolve()) if known else None


@lru_cache(maxsize=8)
def _made(path: Path) -> Path:
    folder = Path(tempfile.mkdtemp(prefix="humanpred-bag-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    try:
        return _convert(path, folder)
    except (sqlite3.Error, zstandard.ZstdError, OSError, ValueError, KeyError, TypeError, AssertionError) as trouble:
        raise BagError(
            f"{path}: wanted a readable bag, got damage ({trouble}); recover it with its own tools"
        ) from trouble
    except Exception as trouble:  # rosbags has errors of its own for each form
        form = "ROS 1 bag" if path.suffix.lower() == ".bag" else "bag"
        raise BagError(
            f"{path}: wanted a readable {form}, got {type(trouble).__name__}: {trouble}; try rosbags-convert"
        ) from trouble


def _convert(path: Path, folder: Path) -> Path:
    if path.is_file() and path.name.lower().endswith(".bag"):
        return _written(folder / path.stem, _of_ros1(path))
    files = [path] if path.is_file() else sorted(
        (f for f in path.iterdir() if f.name != "metadata.yaml" and f.is_file()), key=_number
    )  # fmt: skip
    unpacked = []
    for k, file in enumerate(files):
        if file.name.lower().endswith(_ZSTD):
            plain = folder / f"{k}_{file.name[: -len(_ZSTD)]}"
            most = _MOST_RATIO * file.stat().st_size + _MOST_BYTES
            with file.open("rb") as source, plain.open("wb") as target:
                for part in zstandard.ZstdDecompressor().read_to_iter(source):
                    target.write(part)
                    if target.tell() > most:
                        raise ValueError(f"{file.name} unpacks to more than {_MOST_RATIO} times its size")
            file = plain
        unpacked.append(file)
    databases = [file for file in unpacked if file.name.lower().endswith(".db3")]
    unzip = path.is_dir() and _mode(path) == "message"
    messages = _of_sqlite(databases) if databases else _of_mcap(unpacked)
    return _written(folder / path.name.split(".")[0], messages, unzip)


#: Topic, type, encoding, text of the type's definition ("" if not known), time, bytes.
_Raw = tuple[str, str, str, str, int, bytes]


def _written(out: Path, messages: Iterator[_Raw], unzip: bool = False) -> Path:
    known = typestore().fielddefs
    with BagWriter(out) as bag:
        for topic, msgtype, encoding, text, time_ns, data in messages:
            if topic not in bag.topics:
                definition = None if msgtype in known else TypeDefinition(text, "ros2msg" if text else "", "")
                bag.add_topic(topic, msgtype, definition=definition, encoding=encoding)
            if unzip:
                most = _MOST_RATIO * len(data) + _MOST_BYTES
                data = zstandard.ZstdDecompressor().decompress(data, max_output_size=most)
            bag.write(topic, time_ns, data)
    return out


def _of_sqlite(files: list[Path]) -> Iterator[_Raw]:
    for file in files:
        connection = sqlite3.connect(f"file:{file}?mode=ro&immutable=1", uri=True)
        try:
            topics = {row[0]: row[1:] for row in connection.execute(
                "SELECT id, name, type, serialization_format FROM topics")}  # fmt: skip
            rows = connection.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id")
            for number, time_ns, data in rows:
                name, msgtype, encoding = topics[number]
                yield str(name), str(msgtype), str(encoding), "", int(time_ns), bytes(data)
        finally:
            connection.close()


def _of_mcap(files: list[Path]) -> Iterator[_Raw]:
    from humanpred_ros.bags.salvage import scan_records

    for file in files:
        schemas: dict[int, Any] = {}
        channels: dict[int, Any] = {}
        for record in scan_records(file):
            kind = type(record).__name__
            if kind == "Schema":
                schemas[record.id] = record
            elif kind == "Channel":
                channels[record.id] = record
            elif kind == "Message":
                channel = channels[record.channel_id]
                schema = schemas[channel.schema_id]
                text = schema.data.decode("utf-8", "replace")
                yield channel.topic, schema.name, channel.message_encoding, text, record.log_time, record.data
            elif kind == "Damage":
                raise ValueError(f"{file.name}: {record.text}")


def _of_ros1(path: Path) -> Iterator[_Raw]:
    ours, theirs, cache = typestore(), get_typestore(Stores.ROS1_NOETIC), dict[str, object]()
    with Ros1Reader(path) as reader:
        for connection, time_ns, raw in reader.messages():
            msgtype = connection.msgtype
            if msgtype not in ours.fielddefs or msgtype not in theirs.fielddefs:
                continue
            old = theirs.deserialize_ros1(raw, msgtype)
            message: Any = migrate_message(theirs, ours, msgtype, msgtype, cache, old)
            yield connection.topic, msgtype, "cdr", "", time_ns, serialise(message)


def _mode(folder: Path) -> str:
    try:
        information = read_yaml(folder / "metadata.yaml", BagError)["rosbag2_bagfile_information"]
        return str(information.get("compression_mode") or "").lower()
    except (BagError, KeyError, TypeError, AttributeError):
        return ""


def _number(file: Path) -> tuple[int, str]:
    """Return what sorts the files of a bag: rosbag2 numbers them, _10 comes after _9."""
    numbers = re.findall(r"[0-9]+", file.name.split(".")[0])
    return (int(numbers[-1]) if numbers else 0), file.name
