"""Threads that watch come first where the system allows it, and nothing else of the process does."""

from __future__ import annotations

import os
import threading

import pytest

from humanpred_ros.nodes.priority import come_first, threads_named


def test_only_the_threads_that_are_named_come_first_and_those_that_end_meanwhile_are_passed_over() -> None:
    ended = threading.Thread(target=lambda: None)
    ended.start()
    ended.join()
    going, chosen = threading.Event(), threading.Thread(target=lambda: going.wait(60.0), daemon=True)
    chosen.start()
    try:
        assert {chosen.native_id, threading.get_native_id()} <= set(threads_named())
        said = come_first(20, [ended.native_id or 0, chosen.native_id or 0])
        if "not permitted" in said:
            pytest.skip(said)
        assert said == "priority 20"
        assert os.sched_getscheduler(chosen.native_id or 0) == os.SCHED_FIFO
        assert os.sched_getscheduler(threading.get_native_id()) == os.SCHED_OTHER
        assert come_first(0, [chosen.native_id or 0]) == "not asked for"
        assert os.sched_getscheduler(chosen.native_id or 0) == os.SCHED_OTHER
    finally:
        going.set()
        chosen.join()
