"""Predictors by name: every name works, and what is wrong is named."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from small_library import REST, small_library

from humanpred_ros import plugins
from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.predictor import PredictorRequest, make_predictor, predictor_type
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.recognition.training import TrainedModel, train_model

pytestmark = pytest.mark.core

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))


@cache
def trained() -> TrainedModel:
    return train_model(
        small_library(2, 3),
        HUMAN,
        {"gmm": GmmSettings(n_components=4, max_iterations=10), "forest": ForestSettings(n_trees=10)},
    )


def request(**changes: Any) -> PredictorRequest:
    return PredictorRequest(HUMAN, GRID, np.eye(4), **changes)


@pytest.mark.parametrize("name", plugins.names(plugins.PREDICTORS))
def test_every_name_makes_a_predictor_that_sees_the_human(name: str) -> None:
    predictor = make_predictor(name, request(model=trained()))
    predictor.start()
    prediction = predictor.update(REST, 0.0)
    assert prediction.occupancy.grid == predictor.grid == GRID
    assert prediction.occupancy.probability.max() == pytest.approx(1.0, abs=1e-6)
    assert (prediction.posterior is not None) == predictor_type(name).needs_model


def test_baselines_need_no_model() -> None:
    for name in ("current", "current_accumulated"):
        assert make_predictor(name, request()).update(REST, 0.0).posterior is None


def test_online_settings_reach_the_classifier() -> None:
    motion = small_library(2, 1, seed=4).motions[0]
    evidence = []
    for online in ({}, {"evidence": "mean"}):
        predictor = make_predictor(
            "swept_volume",
            request(model=trained(), classifier="gmm", classifier_settings=online),
        )
        for k in range(4):
            posterior = predictor.update(motion.q[k], motion.t_s[k]).posterior
        assert posterior is not None
        evidence.append(posterior.log_evidence)
    np.testing.assert_allclose(evidence[0], 4 * evidence[1])


def test_what_is_wrong_is_named() -> None:
    with pytest.raises(UsageError, match=r"constant_velocity, current, .*, swept_volume"):
        make_predictor("crystal_ball", request(model=trained()))
    with pytest.raises(UsageError, match="trained model"):
        make_predictor("swept_volume", request())
    with pytest.raises(UsageError, match=r"wanted one of .*gmm"):
        make_predictor("swept_volume", request(model=trained(), classifier="svm"))
    with pytest.raises(UsageError, match="cannot change seed"):
        make_predictor(
            "swept_volume",
            PredictorRequest(
                HUMAN, GRID, np.eye(4), model=trained(), classifier="gmm", classifier_settings={"seed": 4}
            ),
        )
    with pytest.raises(SettingsError, match=r"forest\.evidence: forest has no setting"):
        make_predictor(
            "swept_volume",
            request(model=trained(), classifier_settings={"evidence": "mean"}),
        )
    with pytest.raises(UsageError, match="forecast: wanted the classifier forest"):
        make_predictor("forecast", request(model=trained(), classifier="gmm"))


def test_on_a_stream_a_person_at_rest_gets_the_prior() -> None:
    for name in ("forecast", "swept_volume"):
        predictor = make_predictor(name, request(model=trained(), onsets=True))
        for k in range(60):
            posterior = predictor.update(REST, k / 60).posterior
        assert posterior is not None
        assert posterior.n_frames == 0
        assert np.ptp(posterior.probability) == 0.0
