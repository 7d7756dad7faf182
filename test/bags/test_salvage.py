from __future__ import annotations

import itertools
import random
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagMessage, BagReader
from humanpred_ros.bags.salvage import check_bag, salvage_bag
from humanpred_ros.bags.writer import BagWriter, StorageOptions
from humanpred_ros.errors import BagError

Content = tuple[bytes, list[BagMessage]]
shared_fixture = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)


def salvaged(data: bytes, folder: Path) -> list[BagMessage]:
    """Salvage a file of these bytes; [] where nothing is left."""
    (folder / "bad.mcap").write_bytes(data)
    try:
        report = salvage_bag(folder / "bad.mcap", folder / "saved")
    except BagError:
        assert not (folder / "saved").exists()
        return []
    messages = list(BagReader(folder / "saved").messages())
    assert sum(report.messages.values()) == len(messages)
    assert check_bag(folder / "saved").ok
    assert (folder / "bad.mcap").read_bytes() == data
    return messages


def test_a_good_bag_is_reported_good(small_bag: Path) -> None:
    for path in (small_bag, small_bag / "small_0.mcap"):
        report = check_bag(path)
        assert report.ok
        assert report.problems == ()
        assert report.messages == {"/joints": 80, "/words": 40}


@shared_fixture
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_of_a_truncated_file_a_prefix_is_saved(
    share: float, small_bag_content: Content, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data, messages = small_bag_content
    cut = int(share * len(data))
    got = salvaged(data[:cut], tmp_path_factory.mktemp("cut"))
    assert got == messages[: len(got)]


def test_only_the_last_chunk_can_be_lost_by_truncation(small_bag_content: Content, tmp_path: Path) -> None:
    data, messages = small_bag_content
    saved = []
    for k, cut in enumerate(range(0, len(data), max(1, len(data) // 12))):
        (tmp_path / str(k)).mkdir()
        saved.append(len(salvaged(data[:cut], tmp_path / str(k))))
    assert saved == sorted(saved)
    assert saved[-1] == len(messages)
    # Chunks of the fixture hold 11 messages, a step some 11 more: what was written before the last one is there.
    assert all(later - earlier <= 22 for earlier, later in itertools.pairwise(saved))


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_messages_inside_the_cut_chunk_are_saved(compression: str, tmp_path: Path) -> None:
    # One chunk of several compression blocks (some 128 and 64 KiB) of text that does not compress.
    noise = random.Random(3)
    options = StorageOptions(compression=compression, chunk_bytes=1 << 30, flush_period_s=1e9)  # type: ignore[arg-type]
    with BagWriter(tmp_path / "bag", options=options) as bag:
        for k in range(600):
            bag.write_message("/words", k, ros.string(noise.randbytes(600).hex()))
    messages = list(BagReader(tmp_path / "bag").messages())
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    got = salvaged(data[: int(0.7 * len(data))], tmp_path)
    assert got == messages[: len(got)]
    assert len(got) > 300


@shared_fixture
@given(share=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_reported_and_costs_one_chunk_at_most(
    share: float, bit: int, small_bag_content: Content, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data, messages = small_bag_content
    place = int(share * len(data))
    damaged = bytearray(data)
    damaged[place] ^= 1 << bit
    folder = tmp_path_factory.mktemp("flip")
    (folder / "flip.mcap").write_bytes(damaged)
    if place < 8:
        with pytest.raises(BagError, match="start"):
            check_bag(folder / "flip.mcap")
        return
    report = check_bag(folder / "flip.mcap")
    assert not report.ok
    assert report.problems
    got = salvaged(bytes(damaged), folder)
    remaining = iter(messages)
    assert all(message in remaining for message in got), "order or content changed"
    assert len(got) >= len(messages) - 11


def test_a_hole_in_the_middle_leaves_both_ends(small_bag_content: Content, tmp_path: Path) -> None:
    data, messages = small_bag_content
    third = len(data) // 3
    got = salvaged(data[:third] + bytes(third) + data[2 * third :], tmp_path)
    assert got[0] == messages[0]
    assert got[-1] == messages[-1]
    assert 30 < len(got) < len(messages)


def test_types_qos_times_and_records_survive(small_bag: Path, tmp_path: Path) -> None:
    salvage_bag(small_bag, tmp_path / "saved")
    before, after = BagReader(small_bag), BagReader(tmp_path / "saved")
    assert dict(after.topics) == dict(before.topics)
    assert after.metadata["provenance"] == before.metadata["provenance"]
    assert list(after.messages()) == list(before.messages())


def test_a_bag_without_metadata_is_rebuilt(tmp_path: Path, write_bag: Callable[..., Path]) -> None:
    folder = write_bag(tmp_path / "bag")
    (folder / "metadata.yaml").unlink()
    report = check_bag(folder)
    assert "metadata.yaml" in report.problems[0]
    salvage_bag(folder, tmp_path / "saved")
    assert BagReader(tmp_path / "saved").message_count == 120


def test_metadata_that_counts_otherwise_is_reported(tmp_path: Path, write_bag: Callable[..., Path]) -> None:
    folder = write_bag(tmp_path / "bag")
    text = (folder / "metadata.yaml").read_text().replace("message_count: 40", "message_count: 41")
    (folder / "metadata.yaml").write_text(text)
    report = check_bag(folder)
    assert not report.ok
    assert "topic /words: wanted 41 messages as it says, found 40" in report.problems[0]


def test_the_original_cannot_be_the_target(tmp_path: Path, write_bag: Callable[..., Path]) -> None:
    folder = write_bag(tmp_path / "bag")
    for source in (folder, folder / "bag_0.mcap"):
        with pytest.raises(BagError, match="itself"):
            salvage_bag(source, folder)
    assert check_bag(folder).ok


def test_what_is_not_there_is_a_bag_error(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="nothing of that name"):
        check_bag(tmp_path / "absent")
    with pytest.raises(BagError, match="nothing of that name"):
        salvage_bag(tmp_path / "absent", tmp_path / "out")
    (tmp_path / "text.mcap").write_text("no bag, but long enough to be looked at closely")
    with pytest.raises(BagError, match="MCAP"):
        check_bag(tmp_path / "text.mcap")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["text.mcap"]
