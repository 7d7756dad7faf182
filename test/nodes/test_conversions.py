from __future__ import annotations

import array
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sent_trajectories import trajectory_from_message

from humanpred_ros.errors import ArrayError, PlanningError
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.planning.time_parameterisation import time_parameterise
from humanpred_ros.planning.trajectory import TimedTrajectory

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from humanpred_ros.nodes import conversions

pytestmark = pytest.mark.core

GRID = VoxelGrid((-2.0, -3.0, -0.4), 0.05, (80, 80, 48))


@given(seed=st.integers(0, 2**32 - 1), threshold=st.sampled_from([0.0, 1e-3, 0.5]))
def test_an_occupancy_survives_the_wire_bit_for_bit(seed: int, threshold: float) -> None:
    rng = np.random.default_rng(seed)
    probability = np.zeros(GRID.size, dtype=np.float32)
    probability[rng.integers(0, GRID.size, 500)] = rng.random(500, dtype=np.float32)
    occupancy = Occupancy(GRID, probability.reshape(GRID.shape), 1.5)
    cloud = conversions.occupancy_cloud(occupancy, threshold, 1_500_000_000)
    back = conversions.occupancy_from_cloud(cloud, GRID, 1.5)
    assert np.array_equal(back.probability, occupancy.sparse(threshold).probability)


def test_a_cloud_of_another_lattice_is_refused() -> None:
    shifted = VoxelGrid((-2.02, -3.0, -0.4), 0.05, GRID.shape)
    probability = np.zeros(GRID.shape, dtype=np.float32)
    probability[40, 40, 20] = 0.5
    cloud = conversions.occupancy_cloud(Occupancy(shifted, probability), 0.0, 0)
    with pytest.raises(ArrayError, match="other lattice"):
        conversions.occupancy_from_cloud(cloud, GRID, 0.0)


@pytest.mark.parametrize(("value", "words"), [(np.nan, "not finite"), (1.5, "within"), (-0.5, "within")])
def test_impossible_probabilities_are_refused(value: float, words: str) -> None:
    probability = np.zeros(GRID.shape, dtype=np.float32)
    probability[1, 2, 3] = 0.5
    cloud = conversions.occupancy_cloud(Occupancy(GRID, probability), 0.0, 0)
    points = np.frombuffer(bytearray(cloud.data), dtype="<f4").reshape(-1, 4)
    points[0, 3] = value
    cloud.data = points.tobytes()
    with pytest.raises(ArrayError, match=words):
        conversions.occupancy_from_cloud(cloud, GRID, 0.0)


def test_a_description_of_the_lattice_is_json() -> None:
    described = json.loads(conversions.grid_description(GRID))
    assert VoxelGrid(described["origin_m"], described["resolution_m"], described["shape"]) == GRID


def test_positions_are_found_by_name_in_any_order() -> None:
    message = conversions.joint_state(("b", "x", "a"), np.array([2.0, 9.0, 1.0]), 5)
    assert conversions.ordered_positions(message, ("a", "b")).tolist() == [1.0, 2.0]
    with pytest.raises(ArrayError, match=r"missing joints.*c did not come"):
        conversions.ordered_positions(message, ("a", "c"))
    message.position[2] = np.nan
    with pytest.raises(ArrayError, match="not finite"):
        conversions.ordered_positions(message, ("a", "b"))
    message.position.pop()  # fewer positions than names
    assert conversions.ordered_positions(message, ("b", "x")).tolist() == [2.0, 9.0]
    with pytest.raises(ArrayError, match=r"missing joints.*a did not come"):
        conversions.ordered_positions(message, ("a", "b"))


def trajectory() -> TimedTrajectory:
    t = np.array([0.25, 0.5, 0.75])
    q = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]])
    v = np.array([[0.1, 0.0], [2.0, -2.0], [0.0, 0.0]])
    return TimedTrajectory(t, q, v, np.zeros_like(q))


def test_a_trajectory_survives_the_wire() -> None:
    message = conversions.trajectory_message(("a", "b"), trajectory(), 7_000_000_000)
    assert conversions.stamp_ns(message.header.stamp) == 7_250_000_000
    back = trajectory_from_message(message, ("a", "b"), 7_000_000_000)
    np.testing.assert_allclose(back.t_s, trajectory().t_s, atol=1e-9)
    assert np.array_equal(back.q, trajectory().q)
    assert np.array_equal(back.v, trajectory().v)


def test_joints_may_come_in_any_order() -> None:
    message = conversions.trajectory_message(("a", "b"), trajectory(), 0)
    back = trajectory_from_message(message, ("b", "a"), 0)
    assert np.array_equal(back.q, trajectory().q[:, ::-1])
    assert np.array_equal(back.v, trajectory().v[:, ::-1])


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), apart_s=st.sampled_from([1e-12, 3e-10, 1.7e-9, 1e-3]))
def test_times_stay_strictly_increasing_on_the_wire(seed: int, apart_s: float) -> None:
    rng = np.random.default_rng(seed)
    t = rng.uniform(0.0, 100.0) + np.cumsum(rng.uniform(0.01, 1.0, 12) * apart_s)
    t = np.unique(t)  # steps below float64's resolution are gone
    q = rng.normal(size=(len(t), 2))
    origin_ns = int(rng.integers(0, 2**60))
    message = conversions.trajectory_message(("a", "b"), TimedTrajectory(t, q, 0.0 * q, 0.0 * q), origin_ns)
    assert conversions.controller_refusal(message, ("a", "b")) == ""
    assert conversions.stamp_ns(message.header.stamp) == origin_ns + round(float(t[0]) * 1e9)
    off = [
        conversions.stamp_ns(p.time_from_start) * 1e-9 - (when - t[0])
        for p, when in zip(message.points, t, strict=True)
    ]
    assert np.abs(off).max() <= (len(t) + 1) * 1e-9
    assert np.array_equal(trajectory_from_message(message, ("a", "b"), origin_ns).q, q)


def test_the_switch_is_where_the_robot_is_then() -> None:
    """Over the wire too: what arrives begins in the state that what arrived before has at that time."""
    v, a = 1.0, 4.0
    now = time_parameterise(np.linspace([0.0, 0.0], [1.0, -0.7], 30), v, a, start_s=0.1)
    t_switch = 0.1 + 0.123456789123
    state = now.sample(t_switch)
    new = time_parameterise(np.linspace(state[0], [0.4, 0.9], 30), v, a, *state[1:], start_s=t_switch)
    origin_ns = 1_700_000_000_123_456_789
    executed, taken = (
        trajectory_from_message(conversions.trajectory_message(("a", "b"), each, origin_ns), ("a", "b"), origin_ns)
        for each in (now, new)
    )
    before, after = executed.sample(taken.start_s), taken.sample(taken.start_s)
    np.testing.assert_allclose(after[0], before[0], atol=1e-8)
    np.testing.assert_allclose(after[1], before[1], atol=1e-7)
    np.testing.assert_allclose(after[2], before[2], atol=1e-5)


def test_what_a_controller_refuses_is_refused() -> None:
    def spoiled() -> object:
        return conversions.trajectory_message(("a", "b"), trajectory(), 0)

    def take(message: object, now_ns: int | None = None) -> TimedTrajectory:
        return trajectory_from_message(message, ("a", "b"), 0, now_ns)

    with pytest.raises(PlanningError, match="joints"):
        trajectory_from_message(spoiled(), ("b", "c"), 0)
    message = spoiled()
    message.points[1].time_from_start = message.points[0].time_from_start
    with pytest.raises(PlanningError, match="increasing"):
        take(message)
    message = spoiled()
    message.points[-1].velocities = [0.1, 0.0]
    with pytest.raises(PlanningError, match="rest"):
        take(message)
    message.points[-1].velocities = [1e-8, 0.0]
    assert not take(message).v[-1].any()
    message = spoiled()
    message.points[1].positions = [np.inf, 0.0]
    with pytest.raises(PlanningError, match="finite"):
        take(message)
    message = spoiled()
    message.points[1].velocities = []
    with pytest.raises(PlanningError, match="per point"):
        take(message)
    message = spoiled()
    message.points = []
    with pytest.raises(PlanningError, match="at least one"):
        take(message)
    assert take(spoiled(), 750_000_000) == take(spoiled())
    with pytest.raises(PlanningError, match="over"):
        take(spoiled(), 750_000_001)


def cloud_of(layout: np.dtype, **changes: object) -> PointCloud2:  # type: ignore[type-arg]
    """Return a cloud of two voxels of GRID (the first twice) with points laid out as another maker does."""
    flat = np.array([5, 7, 5])
    points = np.zeros(3, dtype=layout)
    for k, name in enumerate("xyz"):
        points[name] = GRID.centres_m(flat)[:, k]
    points["probability"] = (0.25, 0.5, 0.75)
    numbers = {"f4": 7, "f8": 8, "u1": 2}
    fields = [
        PointField(name=name, offset=layout.fields[name][1], datatype=numbers[layout.fields[name][0].str[1:]], count=1)
        for name in layout.names
    ]
    message = PointCloud2(
        height=1, width=3, fields=fields, point_step=layout.itemsize, row_step=points.nbytes, is_dense=True
    )
    message.data = array.array("B", points.tobytes())
    message.header.frame_id = "world"
    for name, value in changes.items():
        setattr(message, name, value)
    return message


NAMES = ["x", "y", "z", "probability"]
PLAIN = np.dtype([(name, "<f4") for name in NAMES])


@pytest.mark.parametrize(
    ("layout", "bigendian"),
    [
        (PLAIN, False),
        (np.dtype([(name, "<f8") for name in NAMES]), False),
        (np.dtype([(name, ">f4") for name in NAMES]), True),
        (np.dtype({"names": NAMES, "formats": ["<f4"] * 4, "offsets": [0, 4, 8, 16], "itemsize": 32}), False),
        (np.dtype([("probability", "<f8"), ("seen", "u1"), ("z", "<f4"), ("y", "<f4"), ("x", "<f4")]), False),
    ],
    ids=["plain", "double", "big endian", "padded", "another order and one more field"],
)
def test_clouds_of_other_makers_are_read_by_their_fields(layout: np.dtype, bigendian: bool) -> None:  # type: ignore[type-arg]
    occupancy = conversions.occupancy_from_cloud(cloud_of(layout, is_bigendian=bigendian), GRID, 0.0)
    voxels = occupancy.probability.ravel()
    assert (voxels[5], voxels[7], voxels.sum()) == (0.75, 0.5, 1.25)  # the larger of two counts


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"width": 400}, "400.* of 16 bytes.* 48 bytes in all"),
        ({"width": 400, "row_step": 6400, "data": array.array("B")}, "400.* of 16 bytes.* 0 bytes in all"),
        ({"width": 2, "row_step": 32}, "2 points.* 48 bytes in all"),
        ({"height": 2}, "6 points .2 rows of 3."),
        ({"point_step": 12, "row_step": 36, "data": array.array("B", bytes(36))}, "probability.* within a point of 12"),
        ({"fields": []}, "got none"),
        ({"fields": [PointField(name="x", datatype=7, count=1)]}, "wanted x, y, z, probability"),
        ({"fields": [PointField(name=name, offset=4 * k, datatype=99, count=1) for k, name in enumerate(NAMES)]}, "99"),
        (
            {"fields": [PointField(name=name, offset=4 * k, datatype=7, count=3) for k, name in enumerate(NAMES)]},
            "3 of",
        ),
        ({"fields": [PointField(name=n, datatype=7, count=1) for n in [*NAMES, "x"]]}, "each once"),
        ({"header": Header(frame_id="kinect")}, "frame: wanted 'world', got 'kinect'"),
        ({"header": Header()}, "frame: wanted 'world', got ''"),
    ],
)
def test_clouds_that_cannot_be_trusted_name_what_differs(changes: dict[str, object], words: str) -> None:
    with pytest.raises(ArrayError, match=words):
        conversions.occupancy_from_cloud(cloud_of(PLAIN, **changes), GRID, 0.0)
