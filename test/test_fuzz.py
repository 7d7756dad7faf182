"""Damaged files and messages are accepted or refused by name; what is neither is found, and can be done again."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fuzz import samples
from fuzz.damage import damaged
from fuzz.files import case_of, fuzz, fuzz_messages

from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.evaluation.checkout_benches import KINDS, FuzzSettings


def quiet(what: str, total: int) -> Callable[[int], None]:
    return lambda done: None


def test_a_thousand_damaged_files_are_accepted_or_refused_by_name(tmp_path: Path) -> None:
    report = fuzz(FuzzSettings(files=1000, seed=20261129, keep=tmp_path / "kept"), quiet)
    assert report.figures["failures"] == []
    told = {kind["kind"]: kind for kind in report.figures["files"]}
    assert set(told) == set(samples.KINDS) == set(KINDS)
    assert all(kind["accepted"] and kind["refused"] for kind in told.values()), "damage must be neither all nor nothing"
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("trouble", [MemoryError(), HumanPredError("refused")])
def test_a_refusal_that_took_all_memory_is_a_failure(
    trouble: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def greedy(folder: Path, out: Path, number: int) -> None:
        raise trouble from MemoryError()

    monkeypatch.setitem(samples.KINDS, "weights", greedy)
    assert samples.outcome("weights", tmp_path, tmp_path / "out", 0).startswith("failed")


def a_sample(tmp_path: Path) -> Path:
    sample = tmp_path / "samples" / "weights"
    sample.mkdir(parents=True)
    (sample / "w.json").write_text('{"a": [1, 2, {"b": "c"}], "d": 0.5}')
    return sample


def test_a_file_is_known_by_seed_and_number(tmp_path: Path) -> None:
    made = []
    sample = a_sample(tmp_path)
    for k, number in enumerate((0, 0, 1)):
        damaged(sample, tmp_path / str(k), np.random.default_rng([7, number]))
        made.append((tmp_path / str(k) / "w.json").read_bytes())
    assert made[0] == made[1] != made[2]


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_file_that_ends_its_process_is_found_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    a_sample(tmp_path)
    monkeypatch.setitem(samples.KINDS, "weights", lambda folder, out, number: os._exit(11))
    settings = FuzzSettings(kinds=("weights",), seed=5, keep=tmp_path / "kept")
    case = case_of(3, tmp_path, tmp_path / "worker" / "work", settings)
    assert case.outcome == "failed: it ended the process with status 11"
    assert (tmp_path / "kept" / "5_3_weights" / "w.json").exists()


messages = pytest.importorskip("fuzz.messages", reason="needs ROS 2: install the `ros` extra")


def test_a_thousand_mutated_messages_do_no_harm() -> None:
    told = fuzz_messages(1000, 0)
    assert told["failures"] == []
    assert set(told["targets"]) == set(messages.targets())
    assert told["messages"] >= 1000
    predictors = [one for name, one in told["targets"].items() if name.startswith("occupancy_predictor")]
    assert all(one["holds"] and one["refused"] for one in predictors)


def test_there_is_a_message_for_every_node() -> None:
    with pytest.raises(UsageError, match="for each of"):
        fuzz_messages(3, 0)


class Faulty(messages.Target):  # type: ignore[name-defined, misc]
    """A node that once, or always, does what none may do."""

    def __init__(self, fault: str) -> None:
        super().__init__(fault, lambda: None)

    def handler(self) -> None:
        self.shown += 1
        if self.shown == 7 and self.name == "raises":
            raise KeyError("seven")
        if self.shown == 7 and self.name == "hangs":
            until_s = time.thread_time() + 1.2 * messages.HANG_S
            while time.thread_time() < until_s:
                pass

    def open(self, node: Any, bench: Any) -> None:
        self.shown = 0

    def cases(self, node: Any, bench: Any, spoil: Any, spoiled: bool, now_ns: int) -> Iterator[Any]:
        self.spoiled = spoiled
        yield messages.Case(self.handler, (), unusable=spoiled, good=not spoiled)

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
    monkeypatch.setattr(messages, "HANG_S", 0.2)
    clock = SimpleNamespace(set_ros_time_override=lambda time: None)
    node = SimpleNamespace(get_clock=lambda: clock, refused={})
    told = messages.Fuzzing(Faulty(fault), SimpleNamespace(), 0).run(node, 2000)
    assert what in (told["failures"][0]["what"] if what else "")
    assert bool(told["failures"]) == bool(what)
