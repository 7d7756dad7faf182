from __future__ import annotations

import importlib.util
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from humanpred_ros.bags import messages as ros
from humanpred_ros.errors import BagError, UsageError

#: Hashes shipped with ROS 2 Jazzy's packages (share/<package>/msg/<Name>.json).
PUBLISHED_HASHES = {
    ros.JOINT_STATE: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    ros.STRING: "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    ros.POINT_CLOUD2: "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    ros.JOINT_TRAJECTORY: "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    ros.DIAGNOSTIC_ARRAY: "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    ros.CLOCK: "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
}


@pytest.mark.parametrize(("msgtype", "published"), PUBLISHED_HASHES.items())
def test_type_hashes_are_those_of_jazzy(msgtype: str, published: str) -> None:
    assert ros.type_definition(msgtype).type_hash == published


def test_string_bytes_are_little_endian_cdr() -> None:
    # Encapsulation header, length with the closing zero, text: OMG CDR as every ROS 2 middleware sends it.
    assert ros.serialise(ros.string("abc"))[:12] == b"\x00\x01\x00\x00" + b"\x04\x00\x00\x00" + b"abc\x00"


@given(
    stamp=st.integers(0, 2**31 * 10**9 - 1),
    values=st.lists(st.floats(allow_nan=False, width=64), max_size=20),
    frame=st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=10),
)
def test_joint_state_survives_the_wire(stamp: int, values: list[float], frame: str) -> None:
    names = [f"joint_{k}" for k in range(len(values))]
    got = ros.decode(ros.serialise(ros.joint_state(stamp, names, values, frame_id=frame)), ros.JOINT_STATE)
    assert ros.ns_from_stamp(got.header.stamp) == stamp
    assert got.header.frame_id == frame
    assert list(got.name) == names
    assert np.asarray(got.position).tobytes() == np.array(values, dtype=np.float64).tobytes()


@given(
    hnp.arrays(np.float64, st.tuples(st.integers(0, 30), st.just(3))),
    hnp.arrays(np.float32, 30),
    hnp.arrays(np.int32, 30),
)
def test_point_cloud_columns_survive_the_wire_bit_for_bit(points: np.ndarray, p: np.ndarray, ids: np.ndarray) -> None:
    n = len(points)
    fields = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], "probability": p[:n], "class_id": ids[:n]}
    data = ros.serialise(ros.point_cloud2(7, "world", fields))
    message = ros.decode(data, ros.POINT_CLOUD2)
    assert message.width * message.point_step == len(message.data) == message.row_step
    got = ros.point_cloud2_fields(message)
    assert list(got) == list(fields)
    for name, values in fields.items():
        assert got[name].dtype == values.dtype
        assert got[name].tobytes() == np.ascontiguousarray(values).tobytes()


def test_lost_points_make_a_cloud_not_dense() -> None:
    assert not ros.point_cloud2(0, "k", {"x": np.array([1.0, np.nan])}).is_dense
    assert ros.point_cloud2(0, "k", {"x": np.array([1.0, 2.0])}).is_dense


def test_unknown_type_is_named() -> None:
    with pytest.raises(UsageError, match="sensor_msgs/JointState"):
        ros.type_definition("sensor_msgs/JointState")


@given(st.binary(max_size=200))
def test_wrong_bytes_are_a_bag_error(data: bytes) -> None:
    try:
        message = ros.decode(data, ros.POINT_CLOUD2)
        ros.point_cloud2_fields(message)
    except BagError:
        pass


def test_shapes_are_checked() -> None:
    with pytest.raises(UsageError, match="2 names"):
        ros.joint_state(0, ("a", "b"), (1.0,))
    with pytest.raises(UsageError, match="one length"):
        ros.point_cloud2(0, "k", {"x": np.zeros(2), "y": np.zeros(3)})
    with pytest.raises(UsageError, match="complex128"):
        ros.point_cloud2(0, "k", {"x": np.zeros(2, dtype=complex)})


def test_bytes_after_the_message_are_ignored() -> None:
    # rclpy.serialization.serialize_message returns some: the size it allots is an estimate.
    data = ros.serialise(ros.joint_state(1, ("a",), (0.5,)))
    assert ros.decode(data + b"\x7f" * 8, ros.JOINT_STATE).position.tolist() == [0.5]
    with pytest.raises(BagError, match="do not decode"):
        ros.decode(data[:-8], ros.JOINT_STATE)


def test_rclpy_reads_our_bytes_and_we_read_its() -> None:
    if importlib.util.find_spec("rclpy") is None:
        pytest.skip("needs rclpy")
    # A process of its own: the ROS wheels restart the interpreter they are imported in.
    program = (
        "import sys\n"
        "from rclpy.serialization import deserialize_message, serialize_message\n"
        "from sensor_msgs.msg import JointState\n"
        "m = JointState(name=['a', 'bc'], position=[0.5, -2.0])\n"
        "m.header.frame_id = 'kinect'; m.header.stamp.sec = 3; m.header.stamp.nanosec = 7\n"
        "print(deserialize_message(bytes.fromhex(sys.argv[1]), JointState) == m)\n"
        "print(serialize_message(m).hex())\n"
    )
    ours = ros.joint_state(3_000_000_007, ("a", "bc"), (0.5, -2.0), frame_id="kinect")
    command = [sys.executable, "-c", program, ros.serialise(ours).hex()]
    run = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    if run.returncode != 0:
        pytest.skip(f"rclpy does not start here: {run.stderr[-200:]}")
    understood, theirs = run.stdout.split()
    assert understood == "True"
    # Not compared byte by byte: the middleware leaves its padding as it finds it.
    got = ros.decode(bytes.fromhex(theirs), ros.JOINT_STATE)
    assert (got.header, got.name, list(got.position)) == (ours.header, ours.name, list(ours.position))
