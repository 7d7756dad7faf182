"""An evaluation is many independent runs; this spreads them over processes, with the same result for any number."""

from __future__ import annotations

import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from humanpred_ros.errors import UsageError

Task = TypeVar("Task")
Result = TypeVar("Result")

#: Read by BLAS libraries when they are loaded. One thread a process: the processes themselves fill the cores, and
#: the order in which a product is summed up must not depend on how many cores there are.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
    "NUMBA_NUM_THREADS",
)  # fmt: skip
#: What asks a process to end.
_INTERRUPTS = (signal.SIGINT, signal.SIGTERM)
_PATIENCE_S = 2.0


class WorkerError(Exception):
    """The traceback of an error raised in another process, as text; the cause of the error raised here."""

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
    jobs: int,
    progress: Callable[[int], None] | None = None,
) -> list[Result]:
    """Return `function(task)` of every task, in the order of the tasks.

    All work is done in fresh processes, for `jobs` = 1 too, so that the result does not depend on `jobs`. The
    processes take the tasks one by one, in order: put long ones first. They end when this function ends, however
    it ends, and on Linux also when this process is killed.

    Args:
        function: something that can be pickled. It is sent to each process once; what a callable object keeps in
            its attributes (a library, a trained model) serves all the tasks of that process.
        tasks: what can be pickled; the results, too.
        jobs: number of processes; no more are started than there are tasks.
        progress: called with the number of tasks finished so far.

    Raises:
        UsageError: `jobs` below 1, or a process that ended by itself.
        Exception: whatever `function` raised first.
    """
    if jobs < 1:
        raise UsageError(f"jobs: wanted at least one process, got {jobs}")
    if not tasks:
        return []
    payload = pickle.dumps(function)
    results: dict[int, Result] = {}
    waiting = iter(enumerate(tasks))
    with _workers(min(jobs, len(tasks))) as workers:
        for connection, process in workers.items():
            _send(connection, process, payload)
            _send(connection, process, pickle.dumps(next(waiting)))
        while len(results) < len(tasks):
            for connection in _ready(workers):
                number, value, trace = _receive(connection, workers[connection])
                if trace is not None:
                    raise value from WorkerError(trace)
                results[number] = value
                if progress is not None:
                    progress(len(results))
                following = next(waiting, None)
                if following is not None:
                    _send(connection, workers[connection], pickle.dumps(following))
    return [results[number] for number in range(len(tasks))]


@contextmanager
def _workers(count: int) -> Iterator[dict[Connection, BaseProcess]]:
    """Start processes, each at the other end of a connection; end them all on leaving."""
    context = get_context("spawn")
    resource_tracker.ensure_running()  # else it is started below, and lets interrupts through again
    workers: dict[Connection, BaseProcess] = {}
    try:
        # Held back while processes start: they inherit it, and a Ctrl-C in the terminal reaches only this one.
        with _single_threaded(), _interrupts_held_back():
            for _ in range(count):
                here, there = context.Pipe()
                process = context.Process(target=_serve, args=(there,), daemon=True)
                workers[here] = process
                process.start()
                there.close()
        yield workers
    finally:
        _end(workers)


def _end(workers: dict[Connection, BaseProcess]) -> None:
    with _interrupts_held_back():  # a second Ctrl-C must not leave processes behind
        started = [process for process in workers.values() if process.pid is not None]
        for process in started:
            process.kill()  # not asked politely: one that is still starting would not listen, and none has a file open
        for process in started:
            process.join(_PATIENCE_S)
        for connection in workers:
            connection.close()


def _ready(workers: dict[Connection, BaseProcess]) -> list[Connection]:
    """Return connections with something to receive; the end of a process counts as something."""
    return [found for found in wait(list(workers)) if isinstance(found, Connection)]


def _send(connection: Connection, process: BaseProcess, payload: bytes) -> None:
    try:
        connection.send_bytes(payload)
    except OSError as trouble:
        raise _lost(process) from trouble


def _receive(connection: Connection, process: BaseProcess) -> tuple[int, Any, str | None]:
    try:
        answer: tuple[int, Any, str | None] = pickle.loads(connection.recv_bytes())
    except (EOFError, OSError) as trouble:
        raise _lost(process) from trouble
    return answer


def _lost(process: BaseProcess) -> UsageError:
    process.join(_PATIENCE_S)
    return UsageError(
        f"a worker process ended by itself (exit code {process.exitcode}; -9 means killed, often for want of "
        "memory); try fewer jobs"
    )


def _serve(connection: Connection) -> None:
    """Run in a worker: take the function, then tasks, until the other end closes."""
    _prepare_worker()
    number = -1
    try:
        function = pickle.loads(connection.recv_bytes())
        while True:
            number, task = pickle.loads(connection.recv_bytes())
            connection.send_bytes(pickle.dumps((number, function(task), None)))
    except (EOFError, BrokenPipeError):  # the parent has what it wanted
        return
    except Exception as error:
        connection.send_bytes(pickle.dumps((number, _portable(error), traceback.format_exc())))


def _portable(error: Exception) -> Exception:
    """Return the error, or, if it cannot travel between processes, one that can and says the same."""
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error if type(copy) is type(error) else RuntimeError(f"{type(error).__name__}: {error}")


def _prepare_worker() -> None:
    """Leave Ctrl-C to the parent, follow its order to end, and end with it should it be killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _INTERRUPTS)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _INTERRUPTS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Let processes started inside have one BLAS thread each; it must stand in the environment they start with."""
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
