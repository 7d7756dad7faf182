"""Turns: everybody gets as much as anybody else, and the result does not depend on who waited for whom."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from humanpred_ros.planning.path import straight
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.costs import SmoothnessCost
from humanpred_ros.stomp.planner import TURN, StompPlanner, StompRun, advance_all

CONFIG = StompConfig(waypoints=20, iterations=60, noise_std=0.01)


def runs(count: int) -> list[StompRun]:
    planner = StompPlanner([SmoothnessCost(1.0)], [-9.0] * 3, [9.0] * 3, CONFIG)
    return [planner.begin(straight([0.0] * 3, [1.0, k, -1.0], 20), np.random.default_rng(k)) for k in range(count)]


@pytest.mark.parametrize("n_threads", [1, 2, 3])
def test_threads_change_nothing(n_threads: int) -> None:
    alone = runs(5)
    for run in alone:
        run.advance(40)
    with ThreadPoolExecutor(n_threads) as pool:
        together = runs(5)
        advance_all(together, 15, pool, n_threads)
        assert [run.iterations for run in together] == [15] * 5
        advance_all(together, 25, pool, n_threads)
    for one, other in zip(alone, together, strict=True):
        assert one.iterations == other.iterations == 40
        np.testing.assert_array_equal(one.result().waypoints, other.result().waypoints)


@pytest.mark.parametrize("asked", [0, 1, 7, 20, 55])
def test_a_deadline_leaves_nobody_behind(asked: int) -> None:
    subjects = runs(7)
    answers = iter([False] * asked + [True] * 10000)
    advance_all(subjects, 60, None, 1, deadline=lambda: next(answers))
    done = [run.iterations for run in subjects]
    assert max(done) - min(done) <= TURN
    assert (sum(done) > 0) == (asked > 0)
    # Time again: they go on where they were.
    advance_all(subjects, 60, None, 1)
    assert [run.iterations for run in subjects] == [60] * 7


def test_nothing_to_do_is_done() -> None:
    advance_all([], 10, None, 1)
    finished = runs(1)
    advance_all(finished, 1000, None, 1)
    assert finished[0].finished
    advance_all(finished, 10, None, 1, deadline=lambda: False)
    assert finished[0].iterations == 60


def test_a_failure_is_not_swallowed() -> None:
    def trouble() -> bool:
        raise ZeroDivisionError

    with ThreadPoolExecutor(2) as pool, pytest.raises(ZeroDivisionError):
        advance_all(runs(3), 10, pool, 2, deadline=trouble)
