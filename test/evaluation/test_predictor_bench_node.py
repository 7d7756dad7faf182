"""The node is measured as it is: started, held to one core, fed at a sensor's rate, heard by a recorder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mocap_library import mocap_library
from small_library import small_library
from waiting import processes_with_environment, wait_until

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation import predictor_bench
from humanpred_ros.evaluation.bench_nodes import PostureAnswer
from humanpred_ros.evaluation.predictor_bench import (
    PLACES,
    TOLD,
    People,
    hold_to_one_core,
    measure_node,
    rates_hz,
    settled,
)
from humanpred_ros.plugins import DEFAULT_PREDICTOR
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


def test_the_issues_case() -> None:
    assert (PLACES, ReachFuturesSettings().n_samples) == (8, 16)


def test_the_rate_is_that_of_occupancies_not_of_postures() -> None:
    median, slow = rates_hz(answers(10, None, 210, None, 410, None, None, 810, None, 1010))
    assert median == pytest.approx(1.0 / 0.2)
    assert slow == pytest.approx(1.0 / np.quantile([0.2, 0.2, 0.4, 0.2], 0.99))
    with pytest.raises(UsageError, match="wanted occupancies of 3 postures, got 1"):
        rates_hz(answers(None, 150, None))


def test_the_beginning_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predictor_bench, "_SETTLING_S", 0.2)
    assert [answer.stamp_ns for answer in settled(answers(None, 900, 910, None))] == [200 * MS, 300 * MS]


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    running = subprocess.Popen([sys.executable, "-c", THREADS], stdout=subprocess.PIPE)
    yield running
    running.kill()
    running.communicate()


@HOLDS
def test_threads_started_later_are_held_to_the_core_too(process: subprocess.Popen[bytes]) -> None:
    assert hold_to_one_core(process.pid)
    assert process.stdout is not None
    process.stdout.readline()  # the thread runs
    cores = [os.sched_getaffinity(int(task.name)) for task in Path(f"/proc/{process.pid}/task").iterdir()]
    assert [len(each) for each in cores] == [1, 1]
    assert cores[0] == cores[1]


def test_the_real_node_is_measured_with_both_humans_and_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    monkeypatch.setattr(predictor_bench, "_SECONDS", 3.0)
    monkeypatch.setattr(predictor_bench, "_SETTLING_S", 1.0)
    captured = mocap_library(3, 3, 40)
    recorded = replace(captured, motions=tuple(replace(m, label=None, index=k) for k, m in enumerate(captured)))
    runs = ((People.of(small_library(2, 4), 1), DEFAULT_PREDICTOR), (People.of(recorded, 1), TOLD))
    nodes = [measure_node(people, name, tmp_path / f"{people.human_name}_{name}") for people, name in runs]
    assert [(node["human"], node["predictor"], node["places"]) for node in nodes] == [
        ("kinect12", "forecast", None), ("mocap23", "reaching", 8),
    ]  # fmt: skip
    for node in nodes:
        assert node["postures"] == 61
        assert node["skipped"] == 61 - node["delay_ms"].n < 60
        assert 0.0 < node["slow_hz"] <= node["median_hz"]
        assert 0.0 < node["delay_ms"].median <= node["delay_ms"].p99
        assert node["one_core"] == hasattr(os, "sched_setaffinity")
        assert not node["one_core"] or node["cpu_percent"] <= 110.0
    wait_until(lambda: not processes_with_environment(f"ROS_LOG_DIR={tmp_path}"), "the nodes to end", 10.0)
