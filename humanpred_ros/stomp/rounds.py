"""Several plans before one deadline: each gets its turn, so that time running out is fair to all goals."""

from __future__ import annotations

import heapq
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

from humanpred_ros.stomp.planner import StompRun

#: Updates of a turn: some two milliseconds of P1's problem.
TURN = 5


def advance_all(
    runs: Sequence[StompRun],
    iterations: int,
    pool: ThreadPoolExecutor | None,
    n_threads: int,
    deadline: Callable[[], bool] | None = None,
) -> None:
    """Do up to `iterations` more updates of every plan, always the one that has had the fewest.

    What comes out depends neither on threads nor on turns, unless the deadline cuts it short; then no plan has
    had more than one turn more than another that could go on.
    """
    wanted = {k: min(run.iterations + iterations, run.limit) for k, run in enumerate(runs)}
    waiting = [(run.iterations, k) for k, run in enumerate(runs)]
    heapq.heapify(waiting)
    lock = threading.Lock()

    def work() -> None:
        while True:
            with lock:
                if not waiting:
                    return
                done, k = heapq.heappop(waiting)
            run = runs[k]
            run.advance(min(TURN, wanted[k] - done) if deadline is not None else wanted[k] - done, deadline)
            cut_short = deadline is not None and deadline()
            if not run.finished and run.iterations < wanted[k] and not cut_short:
                with lock:
                    heapq.heappush(waiting, (run.iterations, k))

    if pool is None or len(runs) < 2:
        work()
        return
    for worker in [pool.submit(work) for _ in range(min(n_threads, len(runs)))]:
        worker.result()
