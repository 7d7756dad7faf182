"""What is done to files to see that nothing breaks: damage of their bytes, and of what they say.

Bytes are cut off, flipped, spliced, and numbers among them replaced. What a file says is written anew as a sound file
with huge, negative and missing values, names that lead elsewhere, other types, doubled or exchanged entries. The same
draws give the same file again.
"""

from __future__ import annotations

import io
import json
import re
import shutil
import struct
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.writer import CompressionType, Writer
from numpy.random import Generator

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagReader

#: Where a name inside a file would write if it were followed, seen from the folder of a case.
ESCAPE = "escaped"
_NUMBERS: tuple[Any, ...] = (
    0, -1, 1e308, -1e308, 5e-324, float("inf"), float("nan"), 2**31, 2**63, -(2**63), 2**64, 10**15, 10**30, 1e12, 0.1,
)  # fmt: skip
_TEXTS: tuple[str, ...] = (
    "", " ", ".", "..", f"../{ESCAPE}", f"../../{ESCAPE}", f"/{ESCAPE}", "a/b", "CON", "-x", "\0", "\x1b[31m\n",
    "[red]", "[/nope]", "$x^$", "{{ 7 }}", "<b>", "%s%n", "no", "2024-01-01", "NaN", "1e999", "9" * 5000, "[" * 3000,
    "x" * 70000, "!!python/object/apply:os.system [true]", "&a [*a]", "\u202e", "\xed\xa0\x80", "/dev/zero",
    "{'a': 1}", "true", "null", "-inf",
)  # fmt: skip
_VALUES: tuple[Any, ...] = (*_NUMBERS, *_TEXTS, None, True, [], {}, [[]], {"a": {}}, [0] * 100)


def _one_of(choices: Sequence[Any], rng: Generator) -> Any:
    return choices[int(rng.integers(len(choices)))]


def damaged(sample: Path, folder: Path, rng: Generator) -> None:
    """Copy a sample to `folder` and damage one of its files."""
    shutil.copytree(sample, folder)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = _one_of(files, rng)
    rewrite = _REWRITE.get(path.suffix)
    if rewrite is not None and rng.random() < 0.7:
        rewrite(path, rng)
    if rewrite is None or rng.random() < 0.4:
        data = path.read_bytes()
        for _ in range(int(rng.integers(1, 4))):
            data = _one_of(_BYTES, rng)(data, rng)
        path.write_bytes(data)
    if rng.random() < 0.02:  # a folder, or nothing, where a file is wanted
        path.unlink()
        if rng.random() < 0.5:
            path.mkdir()


def _splice(data: bytes, rng: Generator) -> bytes:
    """Move, repeat, or leave out a part."""
    a, b, c = sorted(int(x) for x in rng.integers(len(data) + 1, size=3))
    return data[:a] + data[b:c] * int(rng.integers(4)) + (data[a:b] + data[c:] if rng.random() < 0.7 else b"")


def _flip(data: bytes, rng: Generator) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(len(data), size=int(rng.integers(1, 9))) if data else ():
        changed[int(place)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _put(data: bytes, rng: Generator) -> bytes:
    """Put a text or a binary number somewhere, often in place of what is there."""
    if rng.random() < 0.5:
        part = str(_one_of(_TEXTS, rng)).encode("utf-8", "surrogateescape")
    elif rng.random() < 0.5:
        kind = _one_of("fd", rng)
        value = float(rng.choice([0.0, 1.0, 2.0**31, 1e30, np.inf, np.nan]))
        part = struct.pack(f"<{kind}", value)
    else:
        part = _one_of((b"\xff", b"\x7f", b"\0"), rng) * int(rng.choice([1, 2, 4, 8]))
    a = int(rng.integers(len(data) + 1))
    return data[:a] + part + data[a + len(part) * (rng.random() < 0.7) :]


def _number(data: bytes, rng: Generator) -> bytes:
    """Replace a number written in text."""
    found = list(_WRITTEN.finditer(data[:200_000]))
    if not found:
        return _put(data, rng)
    a, b = _one_of(found, rng).span()
    return data[:a] + str(_one_of(_NUMBERS, rng)).encode() + data[b:]


def _swap_words(data: bytes, rng: Generator) -> bytes:
    separator = _one_of((b"\n", b",", b" ", b'"', b"\t"), rng)
    words = data.split(separator)
    a, b = (int(x) for x in rng.integers(len(words), size=2))
    words[a], words[b] = words[b], words[a]
    return bytes(separator.join(words))


_WRITTEN = re.compile(rb"\d[\d.eE+-]*")
_BYTES = (_splice, _flip, _put, _number, _swap_words)


def changed_value(value: Any, rng: Generator) -> Any:
    """Return a value of lists and mappings with something in it replaced, dropped, doubled, renamed or nested."""
    inside = list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    if not inside or rng.random() < 0.12:
        return _one_of(_VALUES, rng)
    key = _one_of(inside, rng)
    what = rng.random()
    copy = dict(value) if isinstance(value, dict) else list(value)
    if what < 0.7:
        copy[key] = changed_value(value[key], rng)
    elif what < 0.8:
        del copy[key]
    elif what < 0.9 and isinstance(copy, list):
        copy += copy[: int(rng.integers(1, 200))] * int(rng.integers(1, 20))
    elif isinstance(copy, dict):
        copy[_one_of(_TEXTS, rng)] = copy.pop(key)
    else:
        for _ in range(int(rng.integers(1, 60))):
            copy = [copy]
    return copy


def _rewrite_yaml(path: Path, rng: Generator) -> None:
    value = changed_value(yaml.safe_load(path.read_text(encoding="utf-8")), rng)
    path.write_text(yaml.dump(value, sort_keys=False, allow_unicode=bool(rng.random() < 0.5)), "utf-8", "surrogatepass")


def _rewrite_json(path: Path, rng: Generator) -> None:
    path.write_text(json.dumps(changed_value(json.loads(path.read_text(encoding="utf-8")), rng)), encoding="utf-8")


def _rewrite_table(path: Path, rng: Generator) -> None:
    delimiter = "\t" if path.suffix == ".trc" else ","
    rows = [line.split(delimiter) for line in path.read_text(encoding="utf-8").splitlines()]
    for _ in range(int(rng.integers(1, 4))):
        row = rows[int(rng.integers(len(rows)))]
        row[int(rng.integers(len(row)))] = str(_one_of(_VALUES, rng))
    if rng.random() < 0.2:
        column, value = int(rng.integers(len(rows[0]))), str(_one_of(_NUMBERS, rng))
        for row in rows[1:]:
            row[min(column, len(row) - 1)] = value
    path.write_text("\n".join(delimiter.join(row) for row in rows), "utf-8", "surrogatepass")


def _with_other_numbers(array: Any, rng: Generator) -> Any:
    if array.dtype.kind not in "iuf" or not array.size:
        return array
    value = float(rng.choice([0, -1, 1, 7, 1e6, -1e6, 1e12, -1e12, 2.0**31, 1e-300, 1e300, np.nan]))
    changed = np.where(rng.random(array.shape) < rng.choice([0.02, 0.5, 1.0]), value, array)
    return changed.astype(array.dtype) if rng.random() < 0.8 else changed


#: Ways to change an array of an archive; the first is the most frequent.
_ARRAYS: tuple[Callable[[Any, Generator], Any], ...] = (
    *[_with_other_numbers] * 5,
    lambda array, rng: array[: int(rng.integers(len(array) + 1))] if array.ndim else array[None],
    lambda array, rng: np.concatenate([array, array]) if array.ndim else np.array([array, array]),
    lambda array, rng: array.reshape(-1)[::-1].reshape(array.shape),
    lambda array, rng: array.T if array.ndim > 1 else array[None],
    lambda array, rng: np.array(["text"]) if rng.random() < 0.5 else array.astype(str),
)


def _rewrite_archive(path: Path, rng: Generator) -> None:
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for _ in range(int(rng.integers(1, 3))):
        name = list(arrays)[int(rng.integers(len(arrays)))]
        array = np.array(arrays[name])
        if name == "metadata":
            value = changed_value(json.loads(array.tobytes()), rng)
            arrays[name] = np.frombuffer(json.dumps(value).encode(), np.uint8)
            continue
        with np.errstate(all="ignore"):
            array = _one_of(_ARRAYS, rng)(array, rng)
        arrays[name] = array
    if rng.random() < 0.1:
        arrays.pop(list(arrays)[int(rng.integers(len(arrays)))])
    stream = io.BytesIO()
    (np.savez_compressed if rng.random() < 0.05 else np.savez)(stream, **arrays)
    data = stream.getvalue()
    if rng.random() < 0.1:  # a member that says that it is larger than it is
        data = _put(data[: len(data) // 2], rng) + data[len(data) // 2 :]
    if rng.random() < 0.05:
        with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive_file:
            archive_file.writestr("bomb.npy", bytes(1 << 20))
        data = stream.getvalue()
    path.write_bytes(data)


def _rewrite_bag(path: Path, rng: Generator) -> None:
    """Write the messages again, with some of them and of what is said about them changed, often without checksums."""
    bag = BagReader(path)
    kept, facts = list(bag.messages()), {name: dict(values) for name, values in bag.metadata.items()}
    if rng.random() < 0.4:
        facts = changed_value(facts, rng)
    compression = (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)[int(rng.integers(3))]
    sums, chunks = bool(rng.random() < 0.5), bool(rng.random() < 0.8)
    with path.open("wb") as stream:
        writer: Any = Writer(
            stream, chunk_size=4096, compression=compression, use_chunking=chunks, enable_crcs=sums,
            enable_data_crcs=sums,
        )  # fmt: skip
        writer.start(profile="ros2")
        for name, values in facts.items() if isinstance(facts, dict) else ():
            texts = values if isinstance(values, dict) else {"value": values}
            writer.add_metadata(_utf8(name), {_utf8(key): _utf8(value) for key, value in texts.items()})
        channels: dict[str, int] = {}
        for message in kept:
            topic, data = message.topic, message.data
            if topic not in channels:
                told = bag.topics[topic]
                strange = rng.random(3) < 0.03
                definition = ros.type_definition(told.msgtype)
                msgtype = _utf8(rng.choice(_TEXTS)) if strange[0] else told.msgtype
                schema = writer.register_schema(msgtype, "ros2msg", definition.text.encode())
                name = _utf8(rng.choice(_TEXTS)) if strange[1] else topic
                qos = {"offered_qos_profiles": _utf8(rng.choice(_TEXTS))} if strange[2] else {}
                channels[topic] = writer.register_channel(name, "cdr", schema, qos)
            what = rng.random()
            times = [message.log_time_ns, message.publish_time_ns]
            if what < 0.01:
                data = _one_of(_BYTES, rng)(data, rng)
            elif what < 0.02 and bag.topics[topic].msgtype == ros.STRING:
                text = ros.decode(data, ros.STRING).data
                try:
                    text = json.dumps(changed_value(json.loads(text), rng))
                except ValueError:
                    text = _put(text.encode(), rng).decode("utf-8", "replace")
                data = ros.serialise(ros.string(text.replace("\0", "")))
            elif what < 0.03:
                times = [int(rng.choice(np.array([0, 1, 2**63 - 1, 2**63, 2**64 - 1], np.uint64))) for _ in times]
            elif what < 0.04:
                continue
            writer.add_message(channels[topic], log_time=times[0], data=data, publish_time=times[1])
        writer.finish()


def _utf8(value: Any) -> str:
    return str(value).encode("utf-8", "replace").decode()


_REWRITE: dict[str, Callable[[Path, Generator], None]] = {
    ".yaml": _rewrite_yaml,
    ".json": _rewrite_json,
    ".csv": _rewrite_table,
    ".trc": _rewrite_table,
    ".npz": _rewrite_archive,
    ".mcap": _rewrite_bag,
}
