"""Weights are learned once for all tables: from everything, without each, from each; and made comparable."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from reaching_people import MODEL, recording

from humanpred_ros.evaluation.reaching import learned as learned_module
from humanpred_ros.evaluation.reaching.learned import ALONE, IMPROVED, LEARNING, PUBLISHED, LearnedWeights, learn_all
from humanpred_ros.evaluation.reaching.weights import WeightFigures, feature_deviation, influence, weight_figures
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.learner import ReachLearner

RECORDINGS = [recording(seed, n_frames=40) for seed in range(3)]
NAMES = [entry.name for entry in RECORDINGS]


@pytest.fixture(scope="module")
def quick() -> dict[str, LearnedWeights]:
    with pytest.MonkeyPatch.context() as patch:
        few = {
            how: config.replaced(sampling=config.sampling.replaced(n_samples=40), collisions=None, bootstrap=4)
            for how, config in LEARNING.items()
        }
        patch.setattr(learned_module, "LEARNING", few)
        return {how: learn_all(RECORDINGS, MODEL, how, seed=1) for how in few}


@pytest.fixture(scope="module")
def figures(quick: dict[str, LearnedWeights]) -> WeightFigures:
    return weight_figures(quick, RECORDINGS, MODEL, seed=1)


def test_leaving_one_out_is_learning_from_the_others() -> None:
    config = LEARNING[IMPROVED].replaced(sampling=LEARNING[IMPROVED].sampling.replaced(n_samples=30), bootstrap=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learned_module, "LEARNING", {IMPROVED: config})
        table = learn_all(RECORDINGS, MODEL, IMPROVED, seed=5).table
    learner = ReachLearner(RECORDINGS, MODEL, config.replaced(seed=5))
    for name in NAMES:
        others = learner.learn([other for other in NAMES if other != name])
        np.testing.assert_array_equal(table.without(name), others.weights)
    np.testing.assert_array_equal(table.without("somebody else"), learner.learn().weights)


def test_tables_travel_to_processes(quick: dict[str, LearnedWeights]) -> None:
    for how, learned in quick.items():
        copy = pickle.loads(pickle.dumps(learned.table))
        np.testing.assert_array_equal(copy.without(NAMES[0]), learned.table.without(NAMES[0]))
        assert list(copy.alone) == (NAMES if how == ALONE else [])


def test_influence_is_shares() -> None:
    shares = influence(np.array([1.0, 3.0, 0.0]), np.array([2.0, 2.0, 9.0]))
    np.testing.assert_allclose(shares, [0.25, 0.75, 0.0])
    assert not influence(np.zeros(3), np.ones(3)).any()


def test_influence_forgets_the_scale_of_the_weights() -> None:
    deviation = feature_deviation(RECORDINGS, MODEL, seed=0)
    weights = NAMED_WEIGHTS["authors_static"]
    np.testing.assert_allclose(influence(weights, deviation), influence(7.0 * weights, deviation))


def test_every_column_sums_to_one(figures: WeightFigures) -> None:
    names = [column.name for column in figures.columns]
    assert names == [PUBLISHED, IMPROVED, ALONE, "authors_static", "authors_dynamic"]
    for column in figures.columns:
        assert column.influence.sum() == pytest.approx(1.0)
    assert figures.columns[0].spread is not None
    assert figures.columns[-1].spread is None
    assert set(figures.learn_s) == set(LEARNING)


def test_leave_one_out_weights_have_a_row_for_each_recording(
    figures: WeightFigures, quick: dict[str, LearnedWeights]
) -> None:
    assert [found.how for found in figures.left_out] == [PUBLISHED, IMPROVED]
    for found in figures.left_out:
        assert found.recordings == tuple(NAMES)
        np.testing.assert_array_equal(found.weights[1], quick[found.how].table.without(NAMES[1]))
        np.testing.assert_allclose(found.influence.sum(axis=1), 1.0)


def test_what_was_not_learned_is_not_shown(quick: dict[str, LearnedWeights]) -> None:
    found = weight_figures({IMPROVED: quick[IMPROVED]}, RECORDINGS, MODEL, seed=1)
    assert [column.name for column in found.columns] == [IMPROVED, "authors_static", "authors_dynamic"]
    assert [entry.how for entry in found.left_out] == [IMPROVED]
