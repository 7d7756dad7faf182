"""Weights are learned once for all tables, made comparable, and known ones are found again from enough samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reaching_people import MODEL, recording

from humanpred_ros.evaluation import reaching_weights
from humanpred_ros.evaluation.reaching_weights import (
    ALONE,
    IMPROVED,
    LEARNING,
    PUBLISHED,
    LearnedWeights,
    known_weights,
    learn_all,
    recover,
    recovery_figures,
    spread,
    weight_columns,
)
from humanpred_ros.reaching.learner import ReachLearner
from humanpred_ros.reaching.piirl import PiirlSolution

RECORDINGS = [recording(seed, n_frames=40) for seed in range(3)]
NAMES = [entry.name for entry in RECORDINGS]


@pytest.fixture(scope="module")
def quick() -> dict[str, LearnedWeights]:
    with pytest.MonkeyPatch.context() as patch:
        few = {
            how: config.replaced(sampling=config.sampling.replaced(n_samples=40), collisions=False, bootstrap=4)
            for how, config in LEARNING.items()
        }
        patch.setattr(reaching_weights, "LEARNING", few)
        return {how: learn_all(RECORDINGS, MODEL, how, seed=1) for how in few}


def test_leaving_one_out_is_learning_from_the_others() -> None:
    config = LEARNING[IMPROVED].replaced(sampling=LEARNING[IMPROVED].sampling.replaced(n_samples=30), bootstrap=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reaching_weights, "LEARNING", {IMPROVED: config})
        found = learn_all(RECORDINGS, MODEL, IMPROVED, seed=5)
    learner = ReachLearner(RECORDINGS, MODEL, config.replaced(seed=5))
    for name in NAMES:
        others = learner.learn([other for other in NAMES if other != name])
        np.testing.assert_array_equal(found.each[name], others.weights)
    np.testing.assert_array_equal(found.everything.weights, learner.learn().weights)


def test_alone_is_learning_from_each(quick: dict[str, LearnedWeights]) -> None:
    config = LEARNING[ALONE]
    config = config.replaced(sampling=config.sampling.replaced(n_samples=40), collisions=False, bootstrap=0, seed=1)
    learner = ReachLearner(RECORDINGS, MODEL, config)
    assert list(quick[ALONE].each) == NAMES
    for name in NAMES:
        np.testing.assert_array_equal(quick[ALONE].each[name], learner.learn([name]).weights)


def test_what_was_learned_stands_beside_what_was_published(quick: dict[str, LearnedWeights]) -> None:
    columns = weight_columns(quick)
    assert [column["name"] for column in columns] == [PUBLISHED, IMPROVED, ALONE, "authors_static", "authors_dynamic"]
    assert columns[0]["spread"] is not None
    assert columns[-1]["spread"] is None
    few = weight_columns({IMPROVED: quick[IMPROVED]})
    assert [column["name"] for column in few] == [IMPROVED, "authors_static", "authors_dynamic"]


def test_statistics_are_those_of_the_paper() -> None:
    found = spread(np.array([[1.0, 3.0], [5.0, 5.0]]))
    np.testing.assert_array_equal(found, [[2.0, 5.0], [1.0, 0.0], [1.0, 5.0], [3.0, 5.0]])


SAMPLES = (2, 6, 20)


@pytest.fixture(scope="module")
def run() -> dict[str, Any]:
    return recover(RECORDINGS[:2], MODEL, SAMPLES, 0, 1)


def test_a_run_compares_every_demonstration(run: dict[str, Any]) -> None:
    assert set(run["learned"]) == {"published", "improved, distances too"}
    for shares in (*run["learned"].values(), run["best_sample"]):
        assert shares.shape == (3, 2)
        assert np.isfinite(shares).all()
    # Of more samples the best can only be better; none of so few is as good as what was planned.
    assert (np.diff(run["best_sample"], axis=0) <= 0.0).all()
    assert (run["best_sample"] > 0.0).all()


def test_who_finds_the_known_weights_pays_nothing_more(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = PiirlSolution(known_weights(), 0.0, np.zeros(24, dtype=np.bool_))
    monkeypatch.setattr(reaching_weights, "learn_weights", lambda found, config: exact)
    found = recover(RECORDINGS[:2], MODEL, (2,), 0, 0)
    for shares in found["learned"].values():
        np.testing.assert_array_equal(shares, 0.0)


def test_repetitions_differ_and_come_again(run: dict[str, Any]) -> None:
    again, other = (recover(RECORDINGS[:2], MODEL, SAMPLES, 0, repetition)["best_sample"] for repetition in (1, 0))
    np.testing.assert_array_equal(again, run["best_sample"])
    assert (other != run["best_sample"]).all()


def test_figures_are_percent_of_means_over_demonstrations() -> None:
    def made_up(x: float) -> dict[str, Any]:
        shares = np.array([[x, 3.0 * x]])
        return {"learned": {"published": shares}, "best_sample": 2.0 * shares, "line": shares[0]}

    figures = recovery_figures([made_up(0.1), made_up(0.2)], (5,))
    assert figures["demonstrations"] == 2
    assert figures["learned"]["published"][0]["mean"] == pytest.approx(30.0)
    assert figures["learned"]["published"][0]["low"] == pytest.approx(20.0)
    assert figures["best_sample"][0]["high"] == pytest.approx(80.0)
    assert figures["line"]["sd"] == pytest.approx(10.0)
