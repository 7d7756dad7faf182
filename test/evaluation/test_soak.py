"""The bench of endurance tells what grew, what came later, what was missed, and holds that nobody called for."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from faults.catalogue import FAULTS
from faults.soak import Memory, Seen, bad_of, drift_of, late_of, memory_of
from faults.trials import TimedText, Trial

CAUGHT = Trial(0.1, 0.2, "stale", 0.3, 0.0, 0.0, 0.3)


def hold(t_s: float, reason: str) -> TimedText:
    return TimedText(t_s, "hold", reason, 0.01)


def keep(t_s: float, age_s: float = 0.02) -> TimedText:
    return TimedText(t_s, "keep", "no replanning step is due", age_s)


def test_a_graph_that_holds_out_is_told_so() -> None:
    seen = Seen(trials=[(FAULTS[0], CAUGHT)])
    seen.take([keep(1.0), hold(1.1, "the person is likely to come there"), hold(1.2, "the person is there"), keep(1.3)])
    assert sum(seen.explained.values()) == 2
    assert list(bad_of(seen, [Memory("stomp_planner", 250.0, 260.0)])) == []
    assert list(late_of(seen, 1.0)) == []


def test_a_hold_that_goes_on_counts_once_and_one_that_comes_back_again() -> None:
    seen = Seen()
    seen.take([hold(1.0, "stale human data: 0.5 s"), hold(1.1, "stale human data: 0.6 s"), keep(1.2)])
    seen.take([hold(2.0, "stale human data: 0.5 s"), hold(2.1, "the deadline left no time for a single update")])
    seen.take([hold(3.0, "the deadline left no time for a single update")])
    assert sum(seen.unexplained.values()) == 3
    assert len(list(bad_of(seen, []))) == 2  # by reason


def test_growth_drift_and_what_was_missed_are_told() -> None:
    missed = Trial.not_begun("the arm did not come to rest")
    (text,) = bad_of(Seen(trials=[(FAULTS[0], missed)]), [])
    assert text == f"{FAULTS[0].name}: the arm did not come to rest"
    (text,) = bad_of(Seen(), [Memory("stomp_planner", 250.0, 270.0)])
    assert text.startswith("stomp_planner grew by 8.0%")
    assert len(list(late_of(Seen(), 1.4))) == 1
    busy = Seen()
    busy.take([hold(1.0, "overload: no replanning step was finished for 0.7 s"), keep(1.1)] * 2)
    assert list(late_of(busy, 1.0)) == ["hold without a fault, 2 times: overload"]
    assert list(bad_of(busy, [])) == []


def test_memory_counts_of_processes_that_were_there_all_the_time_once_settled() -> None:
    seen = Seen()
    seen.memory_mb = {
        ("stomp_planner", 1): [(float(t), 100.0 + (t if t < 30 else 30.0) + 0.1 * t) for t in range(100)],
        ("simulated_arm", 2): [(float(t), 50.0) for t in range(40)],
        ("simulated_arm", 3): [(float(t), 90.0) for t in range(60, 100)],
    }
    (row,) = memory_of(seen, 30.0)
    assert row.node == "stomp_planner"
    assert row.settled_mb == pytest.approx(133.65, abs=0.1)
    assert row.growth == pytest.approx(0.041, abs=0.005)


def test_answers_that_come_later_and_later_are_a_drift() -> None:
    seen = Seen()
    seen.take([keep(float(t), 0.02 if t < 150 else 0.03) for t in range(200)])
    assert drift_of(seen, 100.0) == pytest.approx(1.5)
