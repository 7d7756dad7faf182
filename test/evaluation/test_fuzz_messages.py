"""Mutated messages lead to refusals, holds or ordinary answers; what else they lead to is found."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.fuzz_messages import TARGETS, fuzz_messages

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from humanpred_ros.nodes import fuzzing


def test_a_thousand_mutated_messages_do_no_harm() -> None:
    told = fuzz_messages(1000, 0)
    assert told["failures"] == []
    assert set(told["targets"]) == set(TARGETS) == set(fuzzing.targets())
    assert told["messages"] >= 1000
    predictors = [one for name, one in told["targets"].items() if name.startswith("occupancy_predictor")]
    assert all(one["holds"] and one["refused"] for one in predictors)


class Faulty(fuzzing.Target):
    """A node that once, or always, does what none may do."""

    def __init__(self, fault: str) -> None:
        super().__init__(fault, lambda: None)  # type: ignore[arg-type, return-value]

    def handler(self) -> None:
        self.shown += 1
        if self.shown == 7 and self.name == "raises":
            raise KeyError("seven")
        if self.shown == 7 and self.name == "hangs":
            until_s = time.thread_time() + 1.2 * fuzzing.HANG_S
            while time.thread_time() < until_s:
                pass

    def open(self, node: Any, bench: Any) -> None:
        self.shown = 0

    def cases(self, node: Any, bench: Any, spoil: Any, spoiled: bool, now_ns: int) -> Iterator[fuzzing.Case]:
        self.spoiled = spoiled
        yield fuzzing.Case(self.handler, (), unusable=spoiled, good=not spoiled)

    def answered(self, node: Any) -> tuple[bool, bool]:
        usual = {"believes": True, "silent": False}.get(self.name, not self.spoiled)
        return usual, not usual


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ("raises", "KeyError: 'seven'"),
        ("hangs", "took 0."),
        ("believes", "an ordinary answer to data that cannot be used"),
        ("silent", "no ordinary answer"),
        ("careful", ""),
    ],
)
def test_what_no_node_may_do_is_found(fault: str, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fuzzing, "HANG_S", 0.2)
    clock = SimpleNamespace(set_ros_time_override=lambda time: None)
    node = SimpleNamespace(get_clock=lambda: clock, refused={})
    told = fuzzing.Fuzzing(Faulty(fault), SimpleNamespace(), 0).run(node, 2000)  # type: ignore[arg-type]
    assert what in (told["failures"][0]["what"] if what else "")
    assert bool(told["failures"]) == bool(what)


def test_targets_that_are_not_there_are_named() -> None:
    with pytest.raises(UsageError, match=r"occupancy_predictor/forecast.*got stomp"):
        fuzz_messages(100, 0, ["stomp"])
