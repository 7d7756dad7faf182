from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError, PlanningError
from humanpred_ros.occupancy.grid import Occupancy, VoxelGrid
from humanpred_ros.planning.trajectory import TimedTrajectory

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from humanpred_ros.nodes import conversions

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


def trajectory() -> TimedTrajectory:
    t = np.array([0.25, 0.5, 0.75])
    q = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]])
    v = np.array([[0.1, 0.0], [2.0, -2.0], [0.0, 0.0]])
    return TimedTrajectory(t, q, v, np.zeros_like(q))


def test_a_trajectory_survives_the_wire() -> None:
    message = conversions.trajectory_message(("a", "b"), trajectory(), 7_000_000_000)
    assert conversions.stamp_ns(message.header.stamp) == 7_250_000_000
    back = conversions.trajectory_from_message(message, ("a", "b"), 7_000_000_000)
    np.testing.assert_allclose(back.t_s, trajectory().t_s, atol=1e-9)
    assert np.array_equal(back.q, trajectory().q)
    assert np.array_equal(back.v, trajectory().v)


def test_what_a_controller_refuses_is_refused() -> None:
    def spoiled() -> object:
        return conversions.trajectory_message(("a", "b"), trajectory(), 0)

    with pytest.raises(PlanningError, match="joints"):
        conversions.trajectory_from_message(spoiled(), ("b", "a"), 0)
    message = spoiled()
    message.points[1].time_from_start = message.points[0].time_from_start
    with pytest.raises(PlanningError, match="increasing"):
        conversions.trajectory_from_message(message, ("a", "b"), 0)
    message = spoiled()
    message.points[-1].velocities = [0.1, 0.0]
    with pytest.raises(PlanningError, match="rest"):
        conversions.trajectory_from_message(message, ("a", "b"), 0)
    message = spoiled()
    message.points[1].positions = [np.inf, 0.0]
    with pytest.raises(PlanningError, match="finite"):
        conversions.trajectory_from_message(message, ("a", "b"), 0)
    message = spoiled()
    message.points = []
    with pytest.raises(PlanningError, match="at least one"):
        conversions.trajectory_from_message(message, ("a", "b"), 0)
