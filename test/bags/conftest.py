"""A small bag with known content, written once per session."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagMessage, BagReader
from humanpred_ros.bags.writer import BagWriter, StorageOptions

SMALL_BAG_MESSAGES = 120


def write_small_bag(directory: Path, compression: str = "zstd", flush_messages: int = 11) -> Path:
    options = StorageOptions(compression=compression, flush_messages=flush_messages)  # type: ignore[arg-type]
    with BagWriter(directory, options=options) as bag:
        bag.add_metadata("provenance", {"source": "a test"})
        for k in range(SMALL_BAG_MESSAGES):
            stamp = 1_000_000_000 + 20_000_000 * k
            if k % 3:
                bag.write_message("/joints", stamp, ros.joint_state(stamp, ("a", "b"), (0.1 * k, -k), frame_id="base"))
            else:
                bag.write_message("/words", stamp, ros.string(f"word {k * 7919 % 1009}"), publish_time_ns=stamp - 5)
    return directory


@pytest.fixture(scope="session", params=["zstd", "lz4", "none"])
def small_bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of several chunks, in each compression; read only."""
    return write_small_bag(tmp_path_factory.mktemp("bags") / "small", request.param)


@pytest.fixture(scope="session")
def small_bag_content(small_bag: Path) -> tuple[bytes, list[BagMessage]]:
    """The bytes of its one file, and its messages in order."""
    return (small_bag / "small_0.mcap").read_bytes(), list(BagReader(small_bag).messages())


@pytest.fixture
def write_bag() -> Callable[..., Path]:
    return write_small_bag
