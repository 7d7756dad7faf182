"""P1's occupancy: a mixture of swept volumes in the proportion of the posterior, and nothing outside them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from small_library import small_library

from humanpred_ros.errors import ArrayError, HumanPredError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.swept_volume import BodyVoxeliser, swept_volume
from humanpred_ros.occupancy.swept_volume_predictor import SweptVolumePredictor
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.recognition.training import TrainedModel, train_model

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
SMALL = VoxelGrid((0.0, 0.0, 0.0), 1.0, (5, 4, 3))


class Told(Classifier):
    """Answers what it was told."""

    def __init__(self, probability: FloatArray, labels: tuple[int, ...]) -> None:
        self.probability, self.labels, self.started = probability, labels, 0

    def fit(self, library: MotionLibrary) -> Told:
        return self

    def fit_without(self, library: MotionLibrary, name: str) -> Told:
        return self

    def start(self) -> None:
        self.started += 1

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        return ClassPosterior(self.labels, self.probability, np.zeros(len(self.labels)), t_s, 1)


@cache
def trained() -> TrainedModel:
    return train_model(small_library(3, 4), HUMAN, GmmSettings(n_components=6, max_iterations=20))


@settings(max_examples=100)
@given(
    masks=arrays(np.bool_, (3, *SMALL.shape)),
    weights=arrays(np.float64, 3, elements=st.floats(0.0, 1.0)).filter(lambda w: w.sum() > 1e-3),
)
def test_sum_law_and_bounds(masks: np.ndarray, weights: np.ndarray) -> None:
    masks[:, 0, 0, 0] = True
    posterior = weights / weights.sum()
    predictor = SweptVolumePredictor(Told(posterior, (3, 1, 2)), dict(zip((3, 1, 2), masks, strict=True)), SMALL)
    occupancy = predictor.update(np.zeros(12), 0.5).occupancy
    p = occupancy.probability
    assert p.dtype == np.float32
    assert p.sum(dtype=np.float64) == pytest.approx(posterior @ masks.sum(axis=(1, 2, 3)), rel=1e-6)
    np.testing.assert_allclose(p, np.einsum("m,mxyz->xyz", posterior, masks), atol=1e-6)
    assert p.max() <= 1.0
    assert p[0, 0, 0] == pytest.approx(1.0, abs=1e-6)
    assert not p[~masks.any(axis=0)].any()
    assert occupancy.t_s == 0.5


def test_certainty_gives_the_swept_volume_of_that_class() -> None:
    model = trained()
    for k, label in enumerate(model.labels):
        told = Told(np.eye(3)[k], model.labels)
        predictor = SweptVolumePredictor.from_model(model, HUMAN, GRID, np.eye(4), classifier=told)
        swept = swept_volume(BodyVoxeliser(HUMAN, GRID, np.eye(4)), model.regressed_q[k])
        np.testing.assert_array_equal(predictor.update(np.zeros(12), 0.0).occupancy.probability, swept)
        assert predictor.swept_voxels[label] == swept.sum()


def test_the_sum_law_holds_along_a_motion() -> None:
    predictor = SweptVolumePredictor.from_model(trained(), HUMAN, GRID, np.eye(4))
    motion = small_library(3, 1, seed=8).motions[2]
    predictor.start()
    for q, t_s in zip(motion.q, motion.t_s, strict=True):
        prediction = predictor.update(q, t_s)
        assert prediction.posterior is not None
        expected = sum(prediction.posterior.of(label) * voxels for label, voxels in predictor.swept_voxels.items())
        assert prediction.occupancy.probability.sum(dtype=np.float64) == pytest.approx(expected, rel=1e-5)
    assert prediction.posterior.best == 20


def test_earlier_predictions_do_not_change() -> None:
    predictor = SweptVolumePredictor.from_model(trained(), HUMAN, GRID, np.eye(4))
    motion = small_library(3, 1, seed=8).motions[1]
    first = predictor.update(motion.q[0], 0.0).occupancy.probability
    copy = first.copy()
    predictor.update(motion.q[-1], 1.5)
    np.testing.assert_array_equal(first, copy)


def test_start_reaches_the_classifier() -> None:
    told = Told(np.ones(1), (7,))
    predictor = SweptVolumePredictor(told, {7: np.ones(SMALL.shape, dtype=bool)}, SMALL)
    predictor.start()
    assert told.started == 1


def test_a_posture_that_cannot_be_used_never_gives_an_occupancy() -> None:
    predictor = SweptVolumePredictor.from_model(trained(), HUMAN, GRID, np.eye(4))
    for q in (np.full(12, np.nan), np.zeros(3)):
        with pytest.raises(HumanPredError):
            predictor.update(q, 0.0)


def test_what_does_not_fit_is_refused() -> None:
    full, told = np.ones(SMALL.shape, dtype=bool), Told(np.ones(1), (7,))
    with pytest.raises(ArrayError, match="at least one class"):
        SweptVolumePredictor(told, {}, SMALL)
    with pytest.raises(ArrayError, match="grid of shape"):
        SweptVolumePredictor(told, {7: full[1:]}, SMALL)
    with pytest.raises(ArrayError, match="sweep none"):
        SweptVolumePredictor(told, {7: ~full}, SMALL)
    with pytest.raises(UsageError, match="it answers"):
        SweptVolumePredictor(told, {8: full}, SMALL).update(np.zeros(12), 0.0)
    far = np.eye(4)
    far[0, 3] = 100.0
    with pytest.raises(ArrayError, match="T_world_human"):
        SweptVolumePredictor.from_model(trained(), HUMAN, GRID, far)
    bigger_head = HumanModel(HUMAN.urdf.replace('<sphere radius="0.13"', '<sphere radius="0.14"'))
    with pytest.raises(UsageError, match="another human"):
        SweptVolumePredictor.from_model(trained(), bigger_head, GRID, np.eye(4))
