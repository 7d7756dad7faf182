"""Predictors by name: every name works, and what is wrong is named."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from small_library import REST, small_library

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.predictors.factory import PREDICTORS, make_predictor, needs_model
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.recognition.training import TrainedModel, train_model

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))


@cache
def trained() -> TrainedModel:
    return train_model(
        small_library(2, 3), HUMAN, GmmConfig(n_components=4, max_iterations=10), ForestConfig(n_trees=10)
    )


@pytest.mark.parametrize("name", list(PREDICTORS))
def test_every_name_makes_a_predictor_that_sees_the_human(name: str) -> None:
    predictor = make_predictor(name, trained(), HUMAN, GRID, np.eye(4))
    predictor.start()
    prediction = predictor.update(REST, 0.0)
    assert prediction.occupancy.grid == predictor.grid == GRID
    assert prediction.occupancy.probability.max() == pytest.approx(1.0, abs=1e-6)
    assert (prediction.posterior is not None) == needs_model(name)


def test_baselines_need_no_model() -> None:
    for name in ("current", "current_accumulated"):
        assert make_predictor(name, None, HUMAN, GRID, np.eye(4)).update(REST, 0.0).posterior is None


def test_online_settings_reach_the_classifier() -> None:
    motion = small_library(2, 1, seed=4).motions[0]
    evidence = []
    for online in ({}, {"evidence": "mean"}):
        predictor = make_predictor("swept_volume", trained(), HUMAN, GRID, np.eye(4), classifier="gmm", **online)
        for k in range(4):
            posterior = predictor.update(motion.q[k], motion.t_s[k]).posterior
        assert posterior is not None
        evidence.append(posterior.log_evidence)
    np.testing.assert_allclose(evidence[0], 4 * evidence[1])


def test_what_is_wrong_is_named() -> None:
    with pytest.raises(UsageError, match="forecast, swept_volume, reaching, current, current_accumulated"):
        make_predictor("crystal_ball", trained(), HUMAN, GRID, np.eye(4))
    with pytest.raises(UsageError, match="trained model"):
        make_predictor("swept_volume", None, HUMAN, GRID, np.eye(4))
    with pytest.raises(UsageError, match=r"wanted one of .*gmm"):
        make_predictor("swept_volume", trained(), HUMAN, GRID, np.eye(4), classifier="svm")
    with pytest.raises(UsageError, match="cannot change seed"):
        make_predictor("swept_volume", trained(), HUMAN, GRID, np.eye(4), classifier="gmm", seed=4)
    with pytest.raises(UsageError, match="evidence; they belong to gmm"):
        make_predictor("swept_volume", trained(), HUMAN, GRID, np.eye(4), evidence="mean")
    with pytest.raises(UsageError, match="forecast: wanted the classifier forest"):
        make_predictor("forecast", trained(), HUMAN, GRID, np.eye(4), classifier="gmm")


def test_on_a_stream_a_person_at_rest_gets_the_prior() -> None:
    for name in ("forecast", "swept_volume"):
        predictor = make_predictor(name, trained(), HUMAN, GRID, np.eye(4), onsets=True)
        for k in range(60):
            posterior = predictor.update(REST, k / 60).posterior
        assert posterior is not None
        assert posterior.n_frames == 0
        assert np.ptp(posterior.probability) == 0.0
