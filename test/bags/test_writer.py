from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from bag_messages import clock
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.stream_reader import StreamReader
from paths import REPOSITORY
from rosbags.interfaces import QosDurability
from rosbags.rosbag2 import Reader

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.metadata import LATCHED_QOS
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.salvage import salvage_bag
from humanpred_ros.bags.writer import BagWriter, StorageOptions
from humanpred_ros.errors import BagError, SettingsError, UsageError

pytestmark = pytest.mark.core


def test_metadata_is_version_9_with_hashes_and_qos(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as bag:
        bag.add_metadata("provenance", {"scene": "null"})
        bag.add_topic("/urdf", ros.STRING, qos=LATCHED_QOS)
        bag.write_message("/urdf", 5, ros.string("<robot/>"))
        bag.write_message("/urdf", 9, ros.string("<robot/>"))
    content = yaml.safe_load((tmp_path / "run" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert content["version"] == 9
    assert content["storage_identifier"] == "mcap"
    assert content["relative_file_paths"] == ["run_0.mcap"]
    assert (content["starting_time"]["nanoseconds_since_epoch"], content["duration"]["nanoseconds"]) == (5, 4)
    assert content["message_count"] == 2
    assert content["custom_data"] == {"provenance.scene": "null"}
    topic = content["topics_with_message_count"][0]["topic_metadata"]
    assert topic["type_description_hash"] == ros.type_definition(ros.STRING).type_hash
    assert topic["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert topic["offered_qos_profiles"][0]["depth"] == 1


def test_rosbags_reads_what_was_written(small_bag: Path, small_bag_content: tuple[bytes, list]) -> None:
    for path in (small_bag, small_bag / "small_0.mcap"):
        with Reader(path) as bag:
            got = [(connection.topic, stamp, data) for connection, stamp, data in bag.messages()]
            digests = {connection.topic: connection.digest for connection in bag.connections}
        assert got == [(m.topic, m.log_time_ns, m.data) for m in small_bag_content[1]]
        if path.is_dir():  # of a bare file rosbags does not read them
            assert digests["/joints"] == ros.type_definition(ros.JOINT_STATE).type_hash
            assert digests["/words"] == ros.type_definition(ros.STRING).type_hash


def test_rosbags_understands_the_qos(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/urdf", ros.STRING, qos=LATCHED_QOS)
        bag.write_message("/urdf", 1, ros.string(""))
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag_0.mcap"):
        with Reader(path) as read:
            assert read.connections[0].ext.offered_qos_profiles[0] == LATCHED_QOS
            assert read.connections[0].ext.offered_qos_profiles[0].durability is QosDurability.TRANSIENT_LOCAL


def test_mcaps_validating_readers_accept_it(small_bag: Path, small_bag_content: tuple[bytes, list]) -> None:
    with (small_bag / "small_0.mcap").open("rb") as stream:
        assert sum(1 for _ in SeekingReader(stream, validate_crcs=True).iter_messages()) == 120
        stream.seek(0)
        # The sequential reader also compares the checksum over the whole data section.
        assert sum(1 for _ in NonSeekingReader(stream, validate_crcs=True).iter_messages()) == 120
        stream.seek(0)
        chunks = [r for r in StreamReader(stream, emit_chunks=True).records if type(r).__name__ == "Chunk"]
    assert len(chunks) > 5
    assert all(chunk.uncompressed_crc for chunk in chunks)


def test_an_empty_bag_is_a_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "empty") as bag:
        bag.add_topic("/words", ros.STRING)
    assert BagReader(tmp_path / "empty").message_count == 0
    with Reader(tmp_path / "empty") as read:
        assert read.message_count == 0


def test_existing_folders_are_not_overwritten(tmp_path: Path, write_bag: Callable[..., Path]) -> None:
    write_bag(tmp_path / "bag")
    before = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    for staged in (False, True):
        with pytest.raises(BagError, match="exists"):
            BagWriter(tmp_path / "bag", staged=staged)
    assert (tmp_path / "bag" / "bag_0.mcap").read_bytes() == before


@pytest.mark.parametrize("staged", [False, True])
def test_overwriting_takes_bags_only(tmp_path: Path, staged: bool, write_bag: Callable[..., Path]) -> None:
    write_bag(tmp_path / "bag")
    with BagWriter(tmp_path / "bag", overwrite=True, staged=staged) as bag:
        bag.write_message("/new", 1, ros.string("new"))
    assert list(BagReader(tmp_path / "bag").topics) == ["/new"]
    (tmp_path / "bag" / "thesis.tex").write_text("years of work")
    with pytest.raises(BagError, match=r"thesis\.tex"):
        BagWriter(tmp_path / "bag", overwrite=True, staged=staged)
    assert (tmp_path / "bag" / "thesis.tex").read_text() == "years of work"


def test_a_staged_bag_appears_only_when_complete(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", staged=True) as bag:
        bag.write_message("/words", 1, ros.string(""))
        assert not (tmp_path / "bag").exists()
    assert BagReader(tmp_path / "bag").message_count == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["bag"]


def write_and_fail(directory: Path, *, staged: bool) -> None:
    with BagWriter(directory, staged=staged) as bag:
        bag.write_message("/words", 1, ros.string(""))
        raise ZeroDivisionError


def test_a_staged_bag_leaves_nothing_behind_when_the_work_fails(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        write_and_fail(tmp_path / "bag", staged=True)
    assert list(tmp_path.iterdir()) == []


def test_a_live_bag_keeps_what_it_has_when_the_work_fails(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        write_and_fail(tmp_path / "bag", staged=False)
    assert BagReader(tmp_path / "bag").message_count == 1


def test_messages_reach_the_disk_every_flush_period(tmp_path: Path) -> None:
    now = [100.0]
    options = StorageOptions(flush_period_s=0.5)
    with BagWriter(tmp_path / "bag", options=options, clock=lambda: now[0]) as bag:
        file = tmp_path / "bag" / "bag_0.mcap"
        bag.write_message("/words", 1, ros.string("first"))
        empty = file.stat().st_size
        now[0] += 0.49
        bag.write_message("/words", 2, ros.string("second"))
        assert file.stat().st_size == empty
        now[0] += 0.02
        bag.write_message("/words", 3, ros.string("third"))
        assert file.stat().st_size > empty
        assert salvage_bag(file, tmp_path / "saved").messages == {"/words": 3}


def test_a_killed_recording_can_be_salvaged(tmp_path: Path) -> None:
    program = (
        "import itertools, sys\n"
        "from humanpred_ros.bags.writer import BagWriter, StorageOptions\n"
        "from humanpred_ros.bags import messages as ros\n"
        "bag = BagWriter(sys.argv[1], options=StorageOptions(flush_messages=10, flush_period_s=1e9))\n"
        "for k in itertools.count():\n"
        "    bag.write_message('/words', k, ros.string(str(k)))\n"
        "    if k % 10 == 9: print(k, flush=True)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path / "bag")], stdout=subprocess.PIPE, text=True, cwd=REPOSITORY
    )
    assert process.stdout is not None
    deadline_s = time.monotonic() + 60.0
    last = 0
    while last < 200 and time.monotonic() < deadline_s:
        last = int(process.stdout.readline())
    os.kill(process.pid, signal.SIGKILL)
    last = max([last, *(int(line) for line in process.stdout.read().split("\n")[:-1])])
    process.wait(timeout=10)
    process.stdout.close()

    with pytest.raises(BagError, match=r"interrupted.*humanpred bag salvage"):
        BagReader(tmp_path / "bag")
    report = salvage_bag(tmp_path / "bag", tmp_path / "saved")
    words = [int(message.data) for _, message in BagReader(tmp_path / "saved").decoded("/words")]
    assert words == list(range(len(words)))
    assert len(words) > last
    assert report.messages == {"/words": len(words)}


def test_misuse_is_explained(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/words", ros.STRING)
        bag.add_topic("/words", ros.STRING)
        with pytest.raises(BagError, match="announced"):
            bag.add_topic("/words", ros.JOINT_STATE)
        with pytest.raises(BagError, match="add_topic"):
            bag.write("/other", 1, b"")
        with pytest.raises(BagError, match="times"):
            bag.write("/words", -1, b"")
        with pytest.raises(BagError, match="wanted a std_msgs/msg/String"):
            bag.write_message("/words", 1, clock(1))
        with pytest.raises(UsageError, match="my_msgs"):
            bag.add_topic("/mine", "my_msgs/msg/Mine")
        with pytest.raises(BagError, match="rosbag2"):
            bag.add_metadata("rosbag2", {})
    with pytest.raises(BagError, match="closed"):
        bag.write("/words", 1, b"")
    with pytest.raises(SettingsError, match="compression"):
        StorageOptions(compression="gzip")  # type: ignore[arg-type]
    with pytest.raises(BagError, match="cannot be created"):
        BagWriter(tmp_path / "bag" / "metadata.yaml" / "inner")


def test_several_threads_may_write(tmp_path: Path) -> None:
    def work(bag: BagWriter, name: str) -> None:
        for k in range(200):
            bag.write_message(name, k, ros.string(f"{name} {k}"))
            bag.add_topic("/shared", ros.STRING)

    with BagWriter(tmp_path / "bag", options=StorageOptions(flush_messages=7)) as bag:
        threads = [threading.Thread(target=work, args=(bag, f"/t{n}")) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    read = BagReader(tmp_path / "bag")
    assert {name: topic.count for name, topic in read.topics.items()} == {"/shared": 0} | {
        f"/t{n}": 200 for n in range(4)
    }
    for n in range(4):
        assert [m.data for _, m in read.decoded(f"/t{n}")] == [f"/t{n} {k}" for k in range(200)]


def test_a_full_disk_is_a_bag_error_and_what_was_flushed_is_kept(tmp_path: Path) -> None:
    # A limit on the file size stands for a full disk; it must not reach this process.
    program = (
        "import resource, sys\n"
        "from humanpred_ros.errors import BagError\n"
        "from humanpred_ros.bags.writer import BagWriter, StorageOptions\n"
        "from humanpred_ros.bags import messages as ros\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))\n"
        "try:\n"
        "    with BagWriter(sys.argv[1], options=StorageOptions(compression='none', flush_messages=5)) as bag:\n"
        "        for k in range(2000):\n"
        "            bag.write_message('/words', k, ros.string(str(k)))\n"
        "except BagError as trouble:\n"
        "    print(trouble)\n"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "bag")]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, cwd=REPOSITORY)
    assert "cannot be written" in run.stdout
    assert salvage_bag(tmp_path / "bag", tmp_path / "saved").messages["/words"] > 100
