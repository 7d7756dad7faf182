"""Files from strangers: each kind ends in one line and status 2, in bounded memory, and nothing leaves its folder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from mcap.writer import CompressionType, Writer
from paths import REPOSITORY
from small_library import small_library

from humanpred_ros.bags.chunks import Budget, Chunk
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.cli import main
from humanpred_ros.errors import BagError, HumanPredError, LibraryFormatError, SceneError, UsageError
from humanpred_ros.files import file_inside, json_of, name_trouble, read_arrays, read_bytes, read_yaml, yaml_of
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.robot.scene import load_scene

SCENE = (REPOSITORY / "config" / "scenes" / "four_places.yaml").read_text(encoding="utf-8")
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefghi", "bcdefghij", strict=True)
)


@pytest.mark.parametrize(
    ("text", "trouble"),
    [
        ("[" * 3000, "30 levels"),
        (BOMB, "200000 values"),
        ("a: &a [*a]", "stands for nothing"),
        ("a: !!python/object/apply:os.system [true]", "tag"),
        ("a: !!timestamp 2024-01-01", "tag"),
        ("a: 1\na: 2", "given twice"),
        ("{[1]: 2}", "as a key"),
        ("--- 1\n--- 2", "one document"),
        ("a: [1", "line"),
        ("\0", "control"),
    ],
)
def test_yaml_that_no_person_wrote_is_refused(text: str, trouble: str) -> None:
    with pytest.raises(ValueError, match=trouble):
        yaml_of(text)


def test_yaml_holds_numbers_and_texts_and_nothing_else() -> None:
    text = "[no, 2024-01-01, 1:30, 0x1F, 1e3, .inf, 010, ~, true, '1', " + "9" * 5000 + "]"
    assert yaml_of(text) == ["no", "2024-01-01", "1:30", 31, 1e3, np.inf, 10, None, True, "1", "9" * 5000]


@pytest.mark.parametrize("text", ["NaN", "[1e999]", "-Infinity", "9" * 5000, "[" * 100_000])
def test_json_numbers_are_finite_and_fit(text: str) -> None:
    with pytest.raises(ValueError, match=r"finite|64 bits|nested"):
        json_of(text)


def test_only_plain_files_of_bounded_size_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path, tmp_path / "none"):
        with pytest.raises(UsageError, match="could not be read"):
            read_bytes(path, 100, UsageError)
    (tmp_path / "large").write_bytes(bytes(101))
    with pytest.raises(UsageError, match="larger"):
        read_bytes(tmp_path / "large", 100, UsageError)
    assert read_bytes(tmp_path / "large", 101, UsageError) == bytes(101)
    (tmp_path / "link.yaml").symlink_to("/dev/zero")
    with pytest.raises(SceneError, match="plain file"):
        read_yaml(tmp_path / "link.yaml", SceneError)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "a\\b", "/x", "-x", "con", "LPT1.txt", "a.", " a", "a\n", "x" * 300]
)
def test_names_that_are_no_folders_are_refused(name: str, tmp_path: Path) -> None:
    assert name_trouble(name)
    library = small_library(1, 2, 10)
    write_library_bag(MotionLibrary(name, library.motions), tmp_path / "made")
    (tmp_path / "out").mkdir()
    keep = tmp_path / "b"
    keep.mkdir()
    if name:  # a bag without a name has that of its folder
        assert main(["import", str(tmp_path / "made"), "--out", str(tmp_path / "out"), "--overwrite"]) == 2
    assert keep.exists()
    assert not any((tmp_path / "out").iterdir())


def test_a_file_named_in_a_file_stays_in_its_folder(tmp_path: Path) -> None:
    inside, outside = tmp_path / "in", tmp_path / "out"
    inside.mkdir()
    outside.write_text("secret")
    (inside / "link").symlink_to(outside)
    for name in ("../out", str(outside), "link", "a/../../out", ".", ""):
        with pytest.raises(BagError, match="wanted the name of a file in"):
            file_inside(inside, name, BagError, "metadata.yaml")
    assert file_inside(inside, "bag_0.mcap", BagError, "metadata.yaml") == inside / "bag_0.mcap"


def test_a_chunk_unpacks_to_what_it_declares_and_no_more(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(100_000_000))
    assert len(bomb) < 20_000
    for declared in (1000, 100_000_000, 2**62):
        chunk = Chunk(bomb, declared, 0, "zstd", True, 0, len(bomb))
        with pytest.raises(ValueError, match=r"more bytes instead|chunks of up to|all chunks together"):
            chunk.content(Budget(len(bomb)))
    budget = Budget(0)
    budget.spend(40 << 20)
    with pytest.raises(ValueError, match="all chunks together"):
        budget.spend(40 << 20)


def test_small_bags_do_not_become_large(tmp_path: Path) -> None:
    file = tmp_path / "bomb.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=1 << 28, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        channel = writer.register_channel("/x", "cdr", writer.register_schema("std_msgs/msg/String", "ros2msg", b""))
        for k in range(3):
            writer.add_message(channel, log_time=k, data=bytes(40 << 20), publish_time=k)
        writer.finish()
    assert file.stat().st_size < 50_000
    with pytest.raises(BagError, match="chunks of up to"):
        list(BagReader(file).messages())
    assert main(["bag", "check", str(file)]) == 1


def changed(*path: object, value: object) -> str:
    content = yaml.safe_load(SCENE)
    part = content
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return yaml.safe_dump(content)


@pytest.mark.parametrize(
    "text",
    [
        changed("grid", "shape", value=[100_000, 100_000, 100_000]),
        changed("grid", "origin_m", value=[1e300, 0, 0]),
        changed("grid", "resolution_m", value=1e-300 * 1e-300),
        changed("name", value=7),
        changed("goals", value=[{}] * 5000),
        changed("table", "size_m", value=["9" * 5000] * 3),
    ],
)
def test_scenes_beyond_all_bounds_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(HumanPredError) as found:
        load_scene(tmp_path / "s.yaml", check=False)
    assert len(str(found.value)) < 2100


def test_archives_hold_what_they_declare(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    for save, arrays in (
        (np.savez_compressed, {"a": np.zeros(1_000_000)}),
        (np.savez, {"a": np.array([1e300])}),
        (np.savez, {"a": np.array([np.nan])}),
        (np.savez, {"a": np.array([{}], dtype=object)}),
    ):
        save(path, **arrays)  # type: ignore[operator]
        with pytest.raises(LibraryFormatError, match="not an archive of arrays, or damaged"):
            read_arrays(path, LibraryFormatError)


def test_errors_are_one_line_without_commands_for_terminals() -> None:
    text = str(UsageError("a\n\x1b[31mb" + "c" * 10_000))
    assert text.isprintable()
    assert len(text) < 2100


@pytest.mark.parametrize(
    ("words", "prepare"),
    [
        (["import", "[red]x[/nope]", "--out", "o"], None),
        (["train", "few", "--out", "f/x/model.npz"], lambda folder: (folder / "f").write_text("")),
        (["report", "none", "--out", "f/x.html"], None),
        (["bag", "check", "pipe"], lambda folder: os.mkfifo(folder / "pipe")),
        (["demo", "--scene", "z.yaml"], lambda folder: (folder / "z.yaml").symlink_to("/dev/zero")),
    ],
)
def test_commands_end_in_one_line_and_status_2(
    words: list[str], prepare: Callable[[Path], object] | None, tmp_path: Path
) -> None:
    if prepare is not None:
        prepare(tmp_path)
    write_library_bag(small_library(2, 2, 10), tmp_path / "few")
    before = sorted(path.name for path in tmp_path.iterdir())
    ended = subprocess.run(
        [sys.executable, "-m", "humanpred_ros.cli", *words], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith("humanpred: ")
    assert len(ended.stderr.splitlines()) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == before
