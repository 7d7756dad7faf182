"""Work spread over processes comes back in order, fails like work done here, and never leaves a process behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from operator import mod

import numpy as np
import pytest
from distributed import LocalCluster
from waiting import processes_with_environment, wait_until

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.evaluation import parallel
from humanpred_ros.evaluation.parallel import WorkerError, map_processes, usable_cores
from humanpred_ros.geometry.checks import checked

# Workers import what they run by name and cannot import this module: tasks are built-ins, or text for `eval`.
MARKER = "HUMANPRED_TEST_WORKERS"
TWO_LONG_TASKS = (
    # A shell that starts tests in the background has its children ignore Ctrl-C.
    "import signal, time\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
    "from humanpred_ros.evaluation.parallel import map_processes\n"
    "print('started', flush=True)\nmap_processes(time.sleep, [0.0, 600.0, 600.0], 2, lambda n: print(n, flush=True))\n"
)


def test_results_are_in_the_order_of_the_tasks_whichever_ends_first() -> None:
    finished: list[int] = []
    tasks = ["__import__('time').sleep(0.5) or 0", "1", "2", "3"]
    assert map_processes(eval, tasks, 2, finished.append) == [0, 1, 2, 3]
    assert finished == [1, 2, 3, 4]


@pytest.mark.parametrize("jobs", [1, 2])
def test_work_is_done_elsewhere_with_one_thread_each_for_any_number_of_jobs(jobs: int) -> None:
    before = dict(os.environ)
    tasks = ["(__import__('os').getpid(), __import__('os').environ['OPENBLAS_NUM_THREADS'])"] * 4
    found = map_processes(eval, tasks, jobs)
    assert os.getpid() not in {pid for pid, _ in found}
    assert len({pid for pid, _ in found}) <= jobs
    assert {threads for _, threads in found} == {"1"}
    assert dict(os.environ) == before


def test_the_function_keeps_what_it_carries() -> None:
    assert map_processes(partial(mod, 17), [5, 7, 4], 5) == [2, 3, 1]


def test_nothing_to_do_is_done_at_once() -> None:
    assert map_processes(abs, [], 2) == []


def test_no_jobs_are_refused() -> None:
    with pytest.raises(UsageError, match="at least one"):
        map_processes(abs, [1], 0)


def test_an_error_comes_back_as_itself_with_its_task_and_traceback() -> None:
    with pytest.raises(ArrayError, match=r"^\[1, 2\]: .*wanted shape \(3,\), got \(2,\)") as caught:
        map_processes(partial(checked, "q", shape=(3,)), [[1, 2, 3], [1, 2]], 2)
    assert isinstance(caught.value.__cause__, WorkerError)
    assert "checks.py" in str(caught.value.__cause__)


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Give the address of a Dask scheduler with two workers on this machine."""
    with LocalCluster(n_workers=2, threads_per_worker=2, host="127.0.0.1", dashboard_address=None) as started:
        yield started.scheduler_address


def test_a_cluster_gives_the_same_bit_for_bit(cluster: str) -> None:
    done: list[int] = []
    tasks = [f"__import__('numpy').random.default_rng({k}).random((90, 90)) @ ([0.1] * 90)" for k in range(6)]
    spread = map_processes(eval, tasks, 1, done.append, cluster)
    assert done == [1, 2, 3, 4, 5, 6]
    for ours, theirs in zip(map_processes(eval, tasks, 2), spread, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_an_error_on_a_cluster_comes_back_as_itself_with_its_task(cluster: str) -> None:
    with pytest.raises(ArrayError, match=r"^\[1, 2\]: .*wanted shape \(3,\)") as caught:
        map_processes(partial(checked, "q", shape=(3,)), [[1, 2, 3], [1, 2]], 1, scheduler=cluster)
    assert "checks.py" in str(caught.value.__cause__)


def test_a_scheduler_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "_CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(UsageError, match=r"scheduler: .*tcp://127\.0\.0\.1:9"):
        map_processes(abs, [1], 1, scheduler="tcp://127.0.0.1:9")


def test_an_error_that_cannot_travel_is_told_in_words() -> None:
    with pytest.raises(RuntimeError, match="LocalError: lost"):
        map_processes(eval, ["(_ for _ in ()).throw(type('LocalError', (Exception,), {})('lost'))"], 1)


def test_a_worker_that_dies_is_reported() -> None:
    with pytest.raises(UsageError, match=r"EXIT\(7\).*on 7.*fewer jobs"):
        map_processes(os._exit, [7], 1)


def test_no_worker_is_left_after_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(MARKER, str(os.getpid()))
    with pytest.raises(ValueError, match="invalid literal"):
        map_processes(eval, ["__import__('time').sleep(600)", "int('x')"], 2)
    assert len(processes_with_environment(f"{MARKER}={os.getpid()}")) <= 1  # the resource tracker may stay


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
def test_workers_end_with_their_parent(number: int) -> None:
    marker = f"{MARKER}=parent_{os.getpid()}_{number}"
    name, value = marker.split("=")
    parent = subprocess.Popen(
        [sys.executable, "-c", TWO_LONG_TASKS],
        env={**os.environ, name: value},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert parent.stdout is not None
    try:
        assert parent.stdout.readline() == "started\n"
        assert parent.stdout.readline() == "1\n"  # both workers are up, and at their long tasks
        os.killpg(parent.pid, number) if number == signal.SIGINT else parent.kill()
        _, complaints = parent.communicate(timeout=90)
        wait_until(lambda: not processes_with_environment(marker), "the workers to end", 60.0)
        # One traceback, the parent's own: no worker has a say about a Ctrl-C.
        assert complaints.count("Traceback") == (number == signal.SIGINT)
    finally:
        for pid in processes_with_environment(marker):
            os.kill(pid, signal.SIGKILL)
        parent.wait()


def test_usable_cores_is_what_this_process_may_use() -> None:
    assert 1 <= usable_cores() <= (os.cpu_count() or 1)
