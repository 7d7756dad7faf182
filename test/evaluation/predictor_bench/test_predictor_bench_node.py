"""The node is measured as it is: started, held to one core, fed at a sensor's rate, heard by a recorder."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mocap_library import mocap_library
from rich.console import Console
from small_library import small_library
from waiting import processes_with_environment, wait_until

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.graph_bench.latency import Delays, PostureAnswer
from humanpred_ros.evaluation.predictor_bench import node as predictor_bench_node
from humanpred_ros.evaluation.predictor_bench.bench import PredictorBench
from humanpred_ros.evaluation.predictor_bench.command import print_bench
from humanpred_ros.evaluation.predictor_bench.node import (
    PLACES,
    TARGET_HZ,
    NodeResult,
    bench_nodes,
    rates_hz,
    settled,
)
from humanpred_ros.evaluation.predictor_bench.one_core import cores_of, hold_to_one_core
from humanpred_ros.evaluation.predictor_bench.people import People
from humanpred_ros.reaching.futures import ReachFuturesSettings

HOLDS = pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="needs a system that holds processes to cores")
MS = 1_000_000
THREADS = "import threading, time\nthreading.Thread(target=time.sleep, args=(60,)).start()\nprint(flush=True)"


def answers(*heard_ms: int | None) -> list[PostureAnswer]:
    """Return answers to postures sent every 100 ms."""
    return [
        PostureAnswer(k * 100 * MS, k * 100 * MS + 1, None if heard is None else heard * MS)
        for k, heard in enumerate(heard_ms)
    ]


def result(predictor: str = "reaching", slow_hz: float = 20.0, cores: int | None = 1) -> NodeResult:
    return NodeResult("kinect12", predictor, 8, 30.0, 29.0, slow_hz, Delays.of([0.01]), 300, 9, 50.0, cores)


def test_the_issues_case() -> None:
    assert (PLACES, TARGET_HZ, ReachFuturesSettings().n_samples) == (8, 5.0, 16)


def test_the_rate_is_that_of_occupancies_not_of_postures() -> None:
    median, slow = rates_hz(answers(10, None, 210, None, 410, None, None, 810, None, 1010))
    assert median == pytest.approx(1.0 / 0.2)
    assert slow == pytest.approx(1.0 / np.quantile([0.2, 0.2, 0.4, 0.2], 0.99))
    with pytest.raises(UsageError, match="wanted occupancies of 3 postures, got 1"):
        rates_hz(answers(None, 150, None))


def test_the_beginning_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predictor_bench_node, "_SETTLING_S", 0.2)
    assert [answer.stamp_ns for answer in settled(answers(None, 900, 910, None))] == [200 * MS, 300 * MS]


def test_the_slow_moments_decide_whether_the_target_is_met() -> None:
    met, missed, free = result().target, result(slow_hz=4.9).target, result(cores=2).target
    assert met is not None
    assert missed is not None
    assert free is not None
    assert (met.met, missed.met, missed.reached) == (True, False, "4.9")
    assert "on one core" in met.what
    assert "holds no process to one" in free.what
    assert result("forecast").target is None


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    running = subprocess.Popen([sys.executable, "-c", THREADS], stdout=subprocess.PIPE)
    yield running
    running.kill()
    running.communicate()


@HOLDS
def test_threads_started_later_are_held_to_the_core_too(process: subprocess.Popen[bytes]) -> None:
    hold_to_one_core(process.pid)
    assert process.stdout is not None
    process.stdout.readline()  # the thread runs
    assert len(list(Path(f"/proc/{process.pid}/task").iterdir())) == 2
    assert cores_of(process.pid) == 1
    process.kill()
    process.wait()
    assert cores_of(process.pid) is None


@HOLDS
def test_without_that_nothing_happens_and_nothing_is_claimed(
    process: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = cores_of(process.pid)
    assert before == len(os.sched_getaffinity(0))
    for name in ("sched_setaffinity", "sched_getaffinity"):
        monkeypatch.delattr(os, name)
    hold_to_one_core(process.pid)
    assert cores_of(process.pid) is None
    monkeypatch.undo()
    assert cores_of(process.pid) == before


def test_the_real_node_is_measured_with_both_humans_and_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    monkeypatch.setattr(predictor_bench_node, "_SECONDS", 3.0)
    monkeypatch.setattr(predictor_bench_node, "_SETTLING_S", 1.0)
    captured = mocap_library(3, 3, 40)
    recorded = replace(captured, motions=tuple(replace(m, label=None, index=k) for k, m in enumerate(captured)))
    everybody = [People.of(small_library(2, 4), 1), People.of(recorded, 1)]
    said: list[str] = []
    nodes = tuple(bench_nodes(everybody, tmp_path / "runs", said.append))
    assert [(node.human, node.predictor, node.places) for node in nodes] == [
        ("kinect12", "forecast", None), ("kinect12", "reaching", 8), ("mocap23", "reaching", 8),
    ]  # fmt: skip
    assert len(said) == 3
    for node in nodes:
        assert node.postures == 61
        assert node.skipped == 61 - node.delay.n < 60
        assert 0.0 < node.slow_hz <= node.median_hz
        assert 0.0 < node.delay.median_ms <= node.delay.p99_ms
        assert node.cores == (1 if hasattr(os, "sched_setaffinity") else None)
        assert not node.cores or node.cpu_percent <= 110.0
    text = io.StringIO()
    print_bench(PredictorBench("drawn", 8, 2, {}, {}, (), nodes), Console(file=text, width=150))
    assert "reaching, mocap23" in text.getvalue()
    assert text.getvalue().count("8 places, on ") == 2
    wait_until(lambda: not processes_with_environment(f"ROS_LOG_DIR={tmp_path}"), "the nodes to end", 10.0)
