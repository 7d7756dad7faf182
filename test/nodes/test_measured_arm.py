"""Joint states that were under way for long tell of the past, whatever their sender's clock."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from humanpred_ros.errors import ArrayError
from humanpred_ros.nodes import conversions, measured_arm
from humanpred_ros.nodes.measured_arm import Delay, MeasuredArm
from humanpred_ros.planning.following import FollowingSettings

NS = conversions.NS_PER_S
NAMES = ("a", "b")


@pytest.mark.parametrize("offset_s", [0.0, -3600.0, 40.0])
def test_what_a_stall_held_back_is_late(offset_s: float) -> None:
    delay = Delay()
    ordinary = [delay.of(offset_s + 0.01, 0.02 * k) for k in range(100)]
    assert max(ordinary) <= 0.02
    # Two seconds without a look, then all that came meanwhile, one after the other.
    stalled = [delay.of(offset_s + 2.0 - 0.02 * k, 4.0 + 0.001 * k) for k in range(100)]
    np.testing.assert_allclose(stalled, 2.0 - 0.02 * np.arange(100), atol=0.02)
    assert delay.of(offset_s + 0.01, 4.2) <= 0.02


def test_a_clock_that_was_set_is_known_again_after_two_windows() -> None:
    delay = Delay()
    for k in range(200):
        delay.of(0.01, 0.02 * k)
    late = [delay.of(5.01, 4.0 + 0.02 * k) for k in range(150)]
    assert late[0] == pytest.approx(5.0, abs=0.02)
    assert late[-1] <= 0.02


def test_an_arm_is_read_once_turn_by_turn_and_not_from_the_past(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(measured_arm.time, "monotonic", lambda: clock[0])

    def difference(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        turned: np.ndarray = (other - one + np.pi) % (2.0 * np.pi) - np.pi
        return turned

    arm = MeasuredArm(NAMES, FollowingSettings(), difference)

    def take(q: list[float], late_s: float = 0.0) -> bool:
        clock[0] += 0.05
        now_ns = round(clock[0] * NS)
        return arm.take(conversions.joint_state(NAMES, np.array(q), now_ns - round(late_s * NS)), now_ns)

    for _ in range(10):
        assert take([3.1, 0.0])
    assert arm.following.at_rest
    assert take([-3.1, 0.0])  # a driver that was restarted counts from elsewhere
    assert arm.q is not None
    np.testing.assert_allclose(arm.q, [2.0 * np.pi - 3.1, 0.0])
    assert not take([0.0, 0.0], late_s=1.0)
    np.testing.assert_allclose(arm.q, [2.0 * np.pi - 3.1, 0.0])
    clock[0] += 2.0  # silent: it was moved meanwhile
    assert take([-3.0, 0.0])
    assert not arm.following.at_rest
    with pytest.raises(ArrayError, match="too large"):
        take([1e30, 0.0])
