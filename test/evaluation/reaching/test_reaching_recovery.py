"""Known weights, once learned exactly, cost nothing more; and more samples come closer to what was done."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from reaching_people import MODEL, recording

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.reaching import recovery
from humanpred_ros.evaluation.reaching.recovery import (
    Recovery,
    RecoveryConfig,
    RecoveryFigures,
    RecoveryRun,
    known_weights,
)
from humanpred_ros.reaching.piirl import PiirlSolution

RECORDINGS = [recording(seed, n_frames=40) for seed in range(2)]
CONFIG = RecoveryConfig(samples=(2, 6, 20), repetitions=2)


@pytest.fixture(scope="module")
def run() -> RecoveryRun:
    return Recovery(RECORDINGS, MODEL, CONFIG, seed=0)(1)


def test_a_run_compares_every_demonstration(run: RecoveryRun) -> None:
    assert set(run.learned) == {"published", "improved, distances too"}
    for shares in (*run.learned.values(), run.best_sample):
        assert shares.shape == (3, 2)
        assert np.isfinite(shares).all()
    # Of more samples the best can only be better; none of so few is as good as what was planned.
    assert (np.diff(run.best_sample, axis=0) <= 0.0).all()
    assert (run.best_sample > 0.0).all()


def test_who_finds_the_known_weights_pays_nothing_more(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = PiirlSolution(known_weights(), 0.0, np.zeros(24, dtype=np.bool_), 0)
    monkeypatch.setattr(recovery, "learn_weights", lambda found, config: exact)
    found = Recovery(RECORDINGS, MODEL, dataclasses.replace(CONFIG, samples=(2,)), seed=0)(0)
    for shares in found.learned.values():
        np.testing.assert_array_equal(shares, 0.0)


def test_repetitions_differ_and_come_again(run: RecoveryRun) -> None:
    few = Recovery(RECORDINGS, MODEL, dataclasses.replace(CONFIG, samples=(2, 6, 20)), seed=0)
    np.testing.assert_array_equal(few(1).best_sample, run.best_sample)
    assert (few(0).best_sample != run.best_sample).all()


def test_figures_are_percent_of_means_over_demonstrations() -> None:
    def made_up(x: float) -> RecoveryRun:
        shares = np.array([[x, 3.0 * x]])
        return RecoveryRun({"published": shares}, 2.0 * shares, shares[0])

    config = RecoveryConfig(samples=(5,), repetitions=2)
    figures = RecoveryFigures.of([made_up(0.1), made_up(0.2)], config)
    assert figures.demonstrations == 2
    assert figures.learned["published"][0].mean == pytest.approx(30.0)
    assert figures.learned["published"][0].low == pytest.approx(20.0)
    assert figures.best_sample[0].high == pytest.approx(80.0)
    assert figures.line.sd == pytest.approx(10.0)


def test_impossible_numbers_are_refused() -> None:
    for samples in ((0, 3), (5, 3), (3, 3)):
        with pytest.raises(UsageError, match="ascending"):
            RecoveryConfig(samples=samples)
    with pytest.raises(UsageError, match="repetition"):
        RecoveryConfig(repetitions=0)
    assert RecoveryConfig(samples=()).tasks == []
