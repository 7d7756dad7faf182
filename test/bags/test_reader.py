from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.messages import TypeDefinition
from humanpred_ros.bags.reader import BagMessage, BagReader
from humanpred_ros.bags.salvage import check_bag, salvage_bag
from humanpred_ros.bags.writer import BagWriter, StorageOptions
from humanpred_ros.errors import BagError

pytestmark = pytest.mark.core

shared_fixture = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)


def test_topics_counts_times_and_records(small_bag: Path) -> None:
    for path in (small_bag, small_bag / "small_0.mcap"):
        bag = BagReader(path)
        assert {name: (t.msgtype, t.count) for name, t in bag.topics.items()} == {
            "/words": (ros.STRING, 40),
            "/joints": (ros.JOINT_STATE, 80),
        }
        assert bag.message_count == 120
        assert (bag.start_ns, bag.end_ns) == (1_000_000_000, 1_000_000_000 + 119 * 20_000_000)
        assert bag.metadata["provenance"] == {"source": "a test"}


def test_messages_come_back_as_written(small_bag: Path) -> None:
    bag = BagReader(small_bag)
    for k, message in enumerate(bag.messages()):
        stamp = 1_000_000_000 + 20_000_000 * k
        assert message.log_time_ns == stamp
        content = bag.decode(message)
        if k % 3:
            assert message.publish_time_ns == stamp
            assert np.asarray(content.position).tolist() == [0.1 * k, -k]
        else:
            assert message.publish_time_ns == stamp - 5
            assert content.data == f"word {k * 7919 % 1009}"


def test_filters_are_those_of_a_list(small_bag: Path, small_bag_content: tuple[bytes, list[BagMessage]]) -> None:
    bag, everything = BagReader(small_bag), small_bag_content[1]
    assert list(bag.messages(["/words"])) == [m for m in everything if m.topic == "/words"]
    assert [stamp for stamp, _ in bag.decoded("/words")] == [m.log_time_ns for m in everything if m.topic == "/words"]


def test_messages_are_ordered_by_time_then_by_writing(tmp_path: Path) -> None:
    stamps = [5, 3, 3, 9, 1, 3, 5]
    with BagWriter(tmp_path / "bag", options=StorageOptions(flush_messages=2)) as bag:
        for k, stamp in enumerate(stamps):
            bag.write_message("/words", stamp, ros.string(str(k)))
    got = [(stamp, int(m.data)) for stamp, m in BagReader(tmp_path / "bag").decoded("/words")]
    assert got == sorted((stamp, k) for k, stamp in enumerate(stamps))


def test_missing_topics_are_named_at_once(small_bag: Path) -> None:
    bag = BagReader(small_bag)
    with pytest.raises(BagError, match=r"wanted topic /speech, the bag has /joints, /words"):
        bag.messages(["/words", "/speech"])
    with pytest.raises(BagError, match="wanted type std_msgs/msg/String, got sensor_msgs"):
        bag.require_topic("/joints", ros.STRING)


def test_what_is_not_a_bag_is_said_to_be_none(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="nothing of that name"):
        BagReader(tmp_path / "absent")
    with pytest.raises(BagError, match=r"without metadata\.yaml and \.mcap files"):
        BagReader(tmp_path)
    for name, content in (("notes.txt", b"hello, this is text " * 10), ("empty.mcap", b""), ("short.mcap", b"\x89MC")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BagError, match="wanted"):
            BagReader(tmp_path / name)
    (tmp_path / "old.db3").write_bytes(b"SQLite format 3\0")
    with pytest.raises(BagError, match="not a database"):
        BagReader(tmp_path / "old.db3")


@pytest.mark.parametrize("text", ["", "]", "just words", "rosbag2_bagfile_information: {version: 9}", "a: [1"])
def test_strange_metadata_is_a_bag_error(tmp_path: Path, text: str, write_bag: Callable[..., Path]) -> None:
    folder = write_bag(tmp_path / "bag")
    (folder / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=r"metadata\.yaml"):
        BagReader(folder)


def test_missing_storage_file_is_a_bag_error(tmp_path: Path, write_bag: Callable[..., Path]) -> None:
    folder = write_bag(tmp_path / "bag")
    (folder / "bag_0.mcap").rename(folder / "renamed.mcap")
    with pytest.raises(BagError, match=r"bag_0\.mcap"):
        BagReader(folder)


@shared_fixture
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_truncation_anywhere_is_a_bag_error(
    share: float, small_bag_content: tuple[bytes, list[BagMessage]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    data, _ = small_bag_content
    file = tmp_path_factory.mktemp("cut") / "cut.mcap"
    file.write_bytes(data[: int(share * len(data))])
    with pytest.raises(BagError):
        list(BagReader(file).messages())


@shared_fixture
@given(share=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_anywhere_is_a_bag_error(
    share: float, bit: int, small_bag_content: tuple[bytes, list[BagMessage]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    damaged = bytearray(small_bag_content[0])
    damaged[int(share * len(damaged))] ^= 1 << bit
    file = tmp_path_factory.mktemp("flip") / "flip.mcap"
    file.write_bytes(damaged)
    with pytest.raises(BagError):
        list(BagReader(file).messages())


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.STORAGE])
def test_bags_of_other_writers(tmp_path: Path, mode: CompressionMode) -> None:
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/words", ros.STRING, typestore=ros.typestore())
        for k in range(5):
            writer.write(topic, 10 + k, ros.serialise(ros.string(str(k))))
    bag = BagReader(tmp_path / "bag")
    assert [(stamp, m.data) for stamp, m in bag.decoded("/words")] == [(10 + k, str(k)) for k in range(5)]


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize("chunked", [True, False])
def test_files_without_chunks_or_summary(tmp_path: Path, chunked: bool, summary: bool) -> None:
    # rosbag2's "fastwrite" preset writes no chunks; a stream may have no summary.
    file = tmp_path / "stream.mcap"
    with file.open("wb") as stream:
        kept = {"repeat_channels": summary, "repeat_schemas": summary, "use_statistics": summary}
        indexes = IndexType.ALL if summary else IndexType.NONE
        writer = McapWriter(stream, use_chunking=chunked, use_summary_offsets=summary, index_types=indexes, **kept)
        writer.start(profile="ros2")
        definition = ros.type_definition(ros.STRING)
        schema = writer.register_schema(ros.STRING, "ros2msg", definition.text.encode())
        channel = writer.register_channel("/words", "cdr", schema)
        for k in (3, 1, 2):
            writer.add_message(channel, log_time=k, data=ros.serialise(ros.string(str(k))), publish_time=k)
        writer.finish()
    bag = BagReader(file)
    assert bag.topics["/words"].count == 3
    assert (bag.start_ns, bag.end_ns) == (1, 3)
    assert [m.data for _, m in bag.decoded("/words")] == ["1", "2", "3"]
    assert check_bag(file).ok
    file.write_bytes(file.read_bytes()[:-9])
    with pytest.raises(BagError, match="humanpred bag salvage"):
        BagReader(file)
    assert salvage_bag(file, tmp_path / "saved").messages == {"/words": 3}


def test_older_metadata_and_split_files(tmp_path: Path, write_bag: Callable[..., Path]) -> None:
    # As Humble's recorder leaves them: version 5, QoS as one string of numbers, several files.
    folder = tmp_path / "split"
    folder.mkdir()
    for part in ("split_0", "split_1"):
        shutil.copy(write_bag(tmp_path / part) / f"{part}_0.mcap", folder / f"{part}.mcap")
    qos = (
        "- history: 3\n  depth: 0\n  reliability: 1\n  durability: 2\n  deadline: {sec: 1, nsec: 2}\n"
        "  lifespan: {sec: 1, nsec: 2}\n  liveliness: 1\n  liveliness_lease_duration: {sec: 1, nsec: 2}\n"
        "  avoid_ros_namespace_conventions: false"
    )
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n"
        "  relative_file_paths: [split_0.mcap, split_1.mcap]\n  duration: {nanoseconds: 1}\n"
        "  starting_time: {nanoseconds_since_epoch: 1}\n  message_count: 240\n  compression_format: ''\n"
        "  compression_mode: ''\n  topics_with_message_count:\n"
        "    - message_count: 80\n      topic_metadata:\n        name: /words\n        type: std_msgs/msg/String\n"
        "        serialization_format: cdr\n        offered_qos_profiles: " + repr(qos).replace("'", '"') + "\n"
    )
    bag = BagReader(folder)
    assert bag.topics["/words"].count == 80
    assert sum(1 for _ in bag.messages(["/words"])) == 80
    assert bag.message_count == 240


def test_definitions_in_a_bag_are_never_made_into_programs(tmp_path: Path) -> None:
    definition = TypeDefinition("float64 reach_m\nstring who", "ros2msg", "")
    data = b"\x00\x01\x00\x00" + np.float64(0.5).tobytes() + b"\x03\x00\x00\x00me\x00"
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/reach", "my_msgs/msg/Reach", definition=definition)
        bag.write("/reach", 1, data)
    read = BagReader(tmp_path / "bag")
    assert [message.data for message in read.messages()] == [data]
    with pytest.raises(BagError, match="common interfaces, got one of type 'my_msgs/msg/Reach'"):
        list(read.decoded("/reach"))
