"""Spreads independent tasks over processes of this machine (joblib's loky) or over the workers of a Dask cluster.

The result is the same, bit for bit, for any number of processes: all work is done in workers with one thread each, and
a task that draws random numbers gets its seed with the task.
"""

from __future__ import annotations

import importlib
import multiprocessing.resource_tracker
import os
import pickle
import re
import signal
import threading
import time
import traceback
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from contextlib import contextmanager
from typing import Any, TypeAlias, TypeVar

from joblib.externals.loky import ProcessPoolExecutor, process_executor
from joblib.externals.loky.backend import resource_tracker as loky_resource_tracker
from threadpoolctl import threadpool_limits

from humanpred_ros.errors import UsageError

Task = TypeVar("Task")
Result = TypeVar("Result")

#: Read by numerical libraries when they are loaded. One thread a process: the processes themselves fill the cores, and
#: the order in which a product is summed up must not depend on how many cores there are.
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
     "NUMBA_NUM_THREADS"), "1",
)  # fmt: skip
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
#: How often a worker looks whether the process that started it still lives.
_WATCH_PERIOD_S = 0.5
_CONNECT_TIMEOUT_S = 10.0

#: In a worker: the function of the call that is worked on, by the call's key, and what a local worker started with.
_function_of_call: dict[str, Callable[[Any], Any]] = {}
_started_with: list[bytes] = []
_one_at_a_time = threading.Lock()
#: Begins the work on a task elsewhere.
_Submit: TypeAlias = "Callable[[Any], Future[tuple[Any, Exception | None, str]]]"


class WorkerError(Exception):
    """The traceback of an error raised in a worker, as text; the cause of the error raised here."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


def usable_cores() -> int:
    """Return the number of cores this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def map_processes(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    jobs: int | None = None,
    progress: Callable[[int], None] | None = None,
    scheduler: str | None = None,
) -> list[Result]:
    """Return `function(task)` of every task, in the order of the tasks.

    Tasks are started in their order: put long ones first. Local workers end when this function ends, however it ends,
    and also when this process is killed.

    Args:
        function: is sent to each worker once; what a callable object keeps in its attributes (a library, a fitted
            model) serves all the tasks of that worker.
        tasks: what can be pickled; the results, too. `str(task)` names a task in an error.
        jobs: number of local processes; None starts one for each core, but never more than there are tasks.
        progress: is called with the number of tasks finished so far.
        scheduler: address of a Dask scheduler, as in tcp://host:8786; its workers do the work, and need this package.
            None works with `jobs` processes of this machine.

    Raises:
        UsageError: `jobs` below 1, a worker that ended by itself, or a scheduler that does not answer.
        Exception: what `function` raised first, with the name of the task in front of its message.
    """
    jobs = usable_cores() if jobs is None else jobs
    if jobs < 1:
        raise UsageError(f"jobs: wanted at least one process, got {jobs}")
    if not tasks:
        return []
    payload = pickle.dumps(function)
    workers = _local_workers(payload, min(jobs, len(tasks))) if scheduler is None else _cluster(payload, scheduler)
    results: dict[int, Result] = {}
    with workers as submit:
        with _interrupts_held_back():  # inherited by the workers that start here: a Ctrl-C is for this process
            futures = {submit(task): number for number, task in enumerate(tasks)}
        for future in as_completed(futures):
            number = futures[future]
            try:
                value, error, trace = future.result()
            except Exception as trouble:
                raise UsageError(
                    f"a worker ended by itself ({_how_it_ended(trouble)}) while it worked on {tasks[number]} or on a "
                    "task beside it; SIGKILL often means that memory ran out: try fewer jobs"
                ) from trouble
            if error is not None:
                raise error from WorkerError(trace)
            results[number] = value
            if progress is not None:
                progress(len(results))
    return [results[number] for number in range(len(tasks))]


@contextmanager
def _local_workers(payload: bytes, count: int) -> Iterator[_Submit]:
    """Give what submits a task to processes of this machine; they end on leaving."""
    pool = ProcessPoolExecutor(
        count, initializer=_prepare_local_worker, initargs=(os.getpid(), payload), env=dict(_ONE_THREAD)
    )
    key = uuid.uuid4().hex
    for tracker in (multiprocessing.resource_tracker, loky_resource_tracker):
        tracker.ensure_running()  # else it is started with the workers, and lets interrupts through again
    try:
        yield lambda task: pool.submit(_run, key, None, task)
    finally:
        with _interrupts_held_back():  # a second Ctrl-C must not leave processes behind
            pool.shutdown(wait=True, kill_workers=True)


@contextmanager
def _cluster(payload: bytes, scheduler: str) -> Iterator[_Submit]:
    """Give what submits a task to the workers of a Dask cluster; what is not done on leaving is cancelled."""
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise UsageError(
            "scheduler: wanted the package distributed, which is not installed; pip install 'humanpred_ros[cluster]'"
        ) from None
    try:
        client = distributed.Client(scheduler, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as trouble:
        raise UsageError(
            f"scheduler: wanted the address of a running Dask scheduler, as in tcp://host:8786, got {scheduler!r} "
            f"({trouble})"
        ) from trouble
    with client:
        if not client.scheduler_info()["workers"]:
            raise UsageError(f"scheduler {scheduler}: wanted at least one worker, it has none; start some")
        key, sent = uuid.uuid4().hex, client.scatter(payload, broadcast=True, hash=False)
        executor = client.get_executor()
        try:
            yield lambda task: executor.submit(_run, key, sent, task)
        finally:
            executor.shutdown(wait=False)


def _how_it_ended(trouble: Exception) -> str:
    """Return the exit codes that loky tells of in a long text, or else the text."""
    codes = re.search(r"\{.*\}", str(trouble))
    return codes[0].strip("{}") if codes else f"{type(trouble).__name__}: {trouble}"


def _run(key: str, payload: bytes | None, task: Any) -> tuple[Any, Exception | None, str]:
    """Run one task in a worker; return its result, or the error and its traceback.

    Args:
        key: of the call of `map_processes`; the function is unpickled once for each.
        payload: the pickled function; None for the one that the worker started with.
        task: is given to the function.
    """
    with _one_at_a_time, threadpool_limits(1):
        try:
            if key not in _function_of_call:
                _function_of_call.clear()
                _function_of_call[key] = pickle.loads(_started_with[0] if payload is None else payload)
            return _function_of_call[key](task), None, ""
        except Exception as error:
            return None, _portable(error, task), traceback.format_exc()


def _portable(error: Exception, task: Any) -> Exception:
    """Return an error that can travel between processes: of the same type if possible, named after its task."""
    try:
        named = type(error)(f"{task}: {error}")
        copy = pickle.loads(pickle.dumps(named))
    except Exception:
        copy = None
    same = type(copy) is type(error) and str(copy) == str(named)
    return named if same else RuntimeError(f"{task}: {type(error).__name__}: {error}")


def _prepare_local_worker(parent: int, payload: bytes) -> None:
    """Leave Ctrl-C to the parent process, and end with it should it be killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
    # What a function keeps from task to task is meant to grow; loky would take it for a leak and start a new worker.
    process_executor._USE_PSUTIL = False
    _started_with.append(payload)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_PERIOD_S)
    os._exit(1)


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Let Ctrl-C and a polite kill wait until the block ends."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
