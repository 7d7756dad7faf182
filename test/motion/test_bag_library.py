from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bag_messages import clock
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from paths import shared_data

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError
from humanpred_ros.motion.bag_library import body_topics, motion_text, read_library_bag, write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import SKELETON_POINTS, Motion, MotionLibrary

JOINTS, MOTION, POINTS = (f"/{name}" for name in body_topics())


def bits(library: MotionLibrary) -> list[object]:
    """Everything a library holds, floats as bytes: equal only if bit-identical."""
    held: list[object] = [library.name, dict(library.provenance)]
    for m in library:
        held += [m.label, m.index, m.frame_id, m.dof_names, m.t_s.tobytes(), m.q.tobytes()]
        held += [None] if m.points_m is None else [m.points_m.shape, m.points_m.tobytes()]
    return held


def reach(label: int | None = 0, index: int = 0, n: int = 4, points: bool = False) -> Motion:
    t_s = np.arange(n) * 0.02
    q = np.stack([np.sin(t_s), np.cos(t_s)], axis=1)
    points_m = np.full((n, len(SKELETON_POINTS), 3), 0.25) if points else None
    return Motion(t_s, q, ("a", "b"), label, index, points_m=points_m)


@pytest.mark.parametrize("name", ["library_a", "library_b", "library_a_raw_timed"])
def test_the_papers_libraries_read_back_bit_for_bit(name: str, tmp_path: Path) -> None:
    library = load_library(shared_data(f"iros2013/{name}"))
    folder = write_library_bag(library, tmp_path / name)
    assert sorted(entry.name for entry in folder.iterdir()) == [f"{name}_0.mcap", "metadata.yaml"]
    assert bits(read_library_bag(folder)) == bits(library)


finite = st.floats(-1e6, 1e6)


@st.composite
def libraries(draw: st.DrawFn) -> MotionLibrary:
    n_dofs = draw(st.integers(1, 4))
    motions = []
    labels = draw(
        st.lists(
            st.one_of(st.none(), st.integers(-5, 5), st.sampled_from(["screws", "große Schraube"])),
            min_size=1,
            max_size=3,
        )
    )
    for index, label in enumerate(labels):
        ticks = draw(st.integers(-(10**9), 10**9)) + np.cumsum(
            [0, *draw(st.lists(st.integers(1, 3 * 10**9), min_size=1, max_size=4))]
        )
        shape = (len(ticks), len(SKELETON_POINTS), 3)
        points = draw(st.none() | hnp.arrays(np.float64, shape, elements=st.floats(width=64), fill=st.just(np.nan)))
        motions.append(
            Motion(
                ticks * 1e-9,
                draw(hnp.arrays(np.float64, (len(ticks), n_dofs), elements=finite)),
                tuple(f"dof{k}" for k in range(n_dofs)),
                label,
                index,
                draw(st.just("kinect")),
                points,
            )
        )
    provenance = draw(st.dictionaries(st.text("abc.: ", max_size=5), st.text("xyz\n'\"é#", max_size=9), max_size=3))
    return MotionLibrary("made up", tuple(motions), provenance)


@settings(max_examples=40)
@given(library=libraries())
def test_any_library_reads_back_bit_for_bit(library: MotionLibrary, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = write_library_bag(library, tmp_path_factory.mktemp("bags") / "bag")
    assert bits(read_library_bag(folder)) == bits(library)
    assert bits(read_library_bag(folder / "bag_0.mcap")) == bits(library)


def test_topics_and_stamps_are_those_of_a_replayable_recording(tmp_path: Path) -> None:
    library = MotionLibrary("lib", (reach(3, 7, points=True), reach(1, 0, points=True)), {"who": "me"})
    bag = BagReader(write_library_bag(library, tmp_path / "lib"))
    assert {name: (t.msgtype, t.count) for name, t in bag.topics.items()} == {
        "/humans/bodies/body_0/joint_states": (ros.JOINT_STATE, 8),
        "/humans/bodies/body_0/motion": (ros.STRING, 2),
        "/humans/bodies/body_0/points": (ros.POINT_CLOUD2, 8),
    }
    assert bag.metadata["provenance"] == {"who": "me"}
    everything = list(bag.messages())
    starts = [k for k, message in enumerate(everything) if message.topic == MOTION]
    assert starts == [0, 9]  # each before its first posture
    assert json.loads(bag.decode(everything[9]).data) == {"label": "1", "index": 0, "n_frames": 4, "t0_ns": 0}
    for k in starts:
        assert everything[k].log_time_ns == everything[k + 1].log_time_ns
    assert everything[9].log_time_ns - everything[8].log_time_ns >= 1_000_000_000
    for message in everything:
        if message.topic != MOTION:
            assert ros.ns_from_stamp(bag.decode(message).header.stamp) == message.log_time_ns > 0


def test_other_topics_do_not_matter(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "run") as bag:
        bag.write_message("/clock", 1, clock(1))
        bag.write_message(MOTION, 5, ros.string(motion_text(reach(2, 1, n=3))))
        for k in range(3):
            stamp = 5 + k
            bag.write_message("/joint_states", stamp, ros.joint_state(stamp, ("r",), (9.0,)))
            bag.write_message(JOINTS, stamp, ros.joint_state(stamp, ("a",), (float(k),), frame_id="mocap"))
    library = read_library_bag(tmp_path / "run")
    assert [motion.name for motion in library] == ["2/1"]
    assert library.motions[0].q.tolist() == [[0.0], [1.0], [2.0]]
    assert library.frame_id == "mocap"
    assert library.name == "run"


def test_a_live_recording_is_cut_at_pauses(tmp_path: Path) -> None:
    stamps = [0.1, 0.2, 0.3, 1.5, 1.6, 9.0, 9.1]
    with BagWriter(tmp_path / "live") as bag:
        for t in stamps:
            stamp = int(t * 1e9)
            bag.write_message(JOINTS, stamp + 77, ros.joint_state(stamp, ("a",), (t,)))
    library = read_library_bag(tmp_path / "live")
    assert [(motion.name, len(motion)) for motion in library] == [("-/0", 3), ("-/1", 2), ("-/2", 2)]
    # The stamp in the message counts, not when the recorder received it.
    assert library.motions[0].t_s.tolist() == pytest.approx([0.0, 0.1, 0.2])


def test_frames_without_points_have_lost_points(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        for k in range(3):
            bag.write_message(JOINTS, 10 + k, ros.joint_state(10 + k, ("a",), (0.0,)))
            if k != 1:
                fields = {axis: np.full(15, float(k)) for axis in "xyz"}
                bag.write_message(POINTS, 10 + k, ros.point_cloud2(10 + k, "", fields))
    (motion,) = read_library_bag(tmp_path / "bag")
    assert motion.points_m is not None
    assert np.isnan(motion.points_m).all(axis=(1, 2)).tolist() == [False, True, False]
    assert (motion.points_m[2] == 2.0).all()


def test_a_bag_without_the_human_is_a_bag_error(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "robot") as bag:
        bag.write_message("/joint_states", 1, ros.joint_state(1, ("r",), (0.0,)))
    with pytest.raises(BagError, match=r"human joint states on humans/bodies/body_0.*has /joint_states"):
        read_library_bag(tmp_path / "robot")
    with pytest.raises(BagError, match="body_7"):
        read_library_bag(tmp_path / "robot", body="body_7")


def test_missing_frames_are_noticed(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "cut") as bag:
        for index, n in enumerate((4, 3)):
            base = 10**9 * (1 + 2 * index)
            bag.write_message(MOTION, base, ros.string(motion_text(reach(0, index, n=4))))
            for k in range(n):
                bag.write_message(JOINTS, base + k, ros.joint_state(base + k, ("a",), (0.0,)))
    library = read_library_bag(tmp_path / "cut")
    assert [m.name for m in library] == ["0/0"]
    assert "motion 0/1: wanted 4 frames as announced, got 3" in library.provenance["left out"]


@pytest.mark.parametrize("text", ["", "{}", "[]", "3", '{"label": "a/b", "index": 0, "n_frames": 2}'])
def test_strange_announcements_are_bag_errors(tmp_path: Path, text: str) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_message(MOTION, 1, ros.string(text))
        bag.write_message(JOINTS, 1, ros.joint_state(1, ("a",), (0.0,)))
    with pytest.raises(BagError, match=r"label, index and n_frames|label: wanted a text"):
        read_library_bag(tmp_path / "bag")


def test_postures_that_contradict_each_other_are_bag_errors(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "names") as bag:
        for k, name in enumerate("ab"):
            bag.write_message(JOINTS, k, ros.joint_state(k, (name,), (0.0,)))
    with pytest.raises(BagError, match="other joints"):
        read_library_bag(tmp_path / "names")


def test_a_library_is_not_overwritten_unasked(tmp_path: Path) -> None:
    library = MotionLibrary("lib", (reach(),))
    write_library_bag(library, tmp_path / "lib")
    with pytest.raises(BagError, match="exists"):
        write_library_bag(library, tmp_path / "lib")
    write_library_bag(MotionLibrary("lib", (reach(5),)), tmp_path / "lib", overwrite=True)
    assert read_library_bag(tmp_path / "lib").labels == ("5",)
