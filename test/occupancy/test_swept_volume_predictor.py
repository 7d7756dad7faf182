"""P1's occupancy: swept volumes are the voxels of the body's points; mixed in the proportion of the posterior."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from paths import shared_data
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, HumanModelError, HumanPredError, SettingsError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.predictor import PredictorRequest, make_predictor
from humanpred_ros.occupancy.swept_volume_predictor import SweptVolumePredictor, SweptVolumeSettings, swept_volume
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.recognition.classifier import Classifier, ClassPosterior
from humanpred_ros.recognition.gmm_classifier import GmmClassifier, GmmSettings
from humanpred_ros.recognition.training import TrainedModel, train_model

pytestmark = pytest.mark.core

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
SMALL = VoxelGrid((0.0, 0.0, 0.0), 1.0, (5, 4, 3))


class Told(Classifier):
    """Answers what it was told."""

    def __init__(self, probability: FloatArray, labels: tuple[str, ...]) -> None:
        self.probability, self.labels, self.started = probability, labels, 0

    def fit(self, library: MotionLibrary) -> Told:
        return self

    def start(self) -> None:
        self.started += 1

    def update(self, q: FloatArray, t_s: float) -> ClassPosterior:
        return ClassPosterior(self.labels, self.probability, np.zeros(len(self.labels)), t_s, 1)


@cache
def trained() -> TrainedModel:
    return train_model(small_library(3, 4), HUMAN, {"gmm": GmmSettings(n_components=6, max_iterations=20)})


def predictor_of(model: TrainedModel, T_world_human: np.ndarray) -> SweptVolumePredictor:
    made = make_predictor("swept_volume", PredictorRequest(HUMAN, GRID, T_world_human, model, "gmm"))
    assert isinstance(made, SweptVolumePredictor)
    return made


@settings(max_examples=100)
@given(
    masks=arrays(np.bool_, (3, *SMALL.shape)),
    weights=arrays(np.float64, 3, elements=st.floats(0.0, 1.0)).filter(lambda w: w.sum() > 1e-3),
)
def test_sum_law_and_bounds(masks: np.ndarray, weights: np.ndarray) -> None:
    masks[:, 0, 0, 0] = True
    posterior = weights / weights.sum()
    predictor = SweptVolumePredictor(
        Told(posterior, ("3", "1", "2")), dict(zip(("3", "1", "2"), masks, strict=True)), SMALL
    )
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
    gmm = trained().classifier("gmm")
    assert isinstance(gmm, GmmClassifier)
    voxeliser = BodyVoxeliser(HUMAN, GRID, np.eye(4))
    swept = {label: swept_volume(voxeliser, q) for label, q in zip(("0", "10", "20"), gmm.expected_q, strict=True)}
    assert predictor_of(trained(), np.eye(4)).swept_voxels == {label: mask.sum() for label, mask in swept.items()}
    for k, label in enumerate(swept):
        predictor = SweptVolumePredictor(Told(np.eye(3)[k], ("0", "10", "20")), swept, GRID)
        np.testing.assert_array_equal(predictor.update(np.zeros(12), 0.0).occupancy.probability, swept[label])


def test_the_sum_law_holds_along_a_motion() -> None:
    predictor = predictor_of(trained(), np.eye(4))
    motion = small_library(3, 1, seed=8).motions[2]
    predictor.start()
    for q, t_s in zip(motion.q, motion.t_s, strict=True):
        prediction = predictor.update(q, t_s)
        assert prediction.posterior is not None
        expected = sum(prediction.posterior.of(label) * voxels for label, voxels in predictor.swept_voxels.items())
        assert prediction.occupancy.probability.sum(dtype=np.float64) == pytest.approx(expected, rel=1e-5)
    assert prediction.posterior.best == "20"


def test_earlier_predictions_do_not_change() -> None:
    predictor = predictor_of(trained(), np.eye(4))
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
    predictor = predictor_of(trained(), np.eye(4))
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
        predictor_of(trained(), far)
    bigger_head = HumanModel(HUMAN.urdf.replace('<sphere radius="0.13"', '<sphere radius="0.14"'))
    with pytest.raises(UsageError, match="another human"):
        make_predictor("swept_volume", PredictorRequest(bigger_head, GRID, np.eye(4), trained(), "gmm"))


#: P1's environment box and voxels (docs/papers.md, P1 occupancy).
P1_GRID = VoxelGrid((-2.0, -3.0, -0.4), 0.05, (80, 80, 48))


def placement(x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T


@pytest.mark.parametrize("T", [placement(), placement(0.1, -0.5, 0.15, 0.7), placement(1.9, -2.8, 0.9, 3.0)])
def test_voxels_are_those_of_the_surface_points(T: np.ndarray) -> None:
    """Also with half the body outside the grid, where indices must not wrap around."""
    q = small_library(1, 1, 30).motions[0].q
    points = HUMAN.surface_points(q, 0.02) @ T[:3, :3].T + T[:3, 3]
    swept = swept_volume(BodyVoxeliser(HUMAN, P1_GRID, T), q)
    expected = P1_GRID.mask_of(points)
    assert swept.sum() > 0
    # The two compute in another order; a point on a voxel's face may fall to either side.
    assert (swept != expected).sum() <= 2


def test_more_postures_sweep_no_less() -> None:
    q = small_library(1, 1, 60).motions[0].q
    voxeliser = BodyVoxeliser(HUMAN, P1_GRID, placement())
    coarse = swept_volume(voxeliser, q, 4)
    fine = swept_volume(voxeliser, q)
    each = np.any([voxeliser.mask(posture) for posture in q], axis=0)
    np.testing.assert_array_equal(fine, each)
    assert (fine | ~coarse).all()
    assert coarse.sum() < fine.sum()


def test_moving_the_human_by_whole_voxels_moves_the_volume() -> None:
    here = BodyVoxeliser(HUMAN, P1_GRID, placement()).mask(REST)
    there = BodyVoxeliser(HUMAN, P1_GRID, placement(0.05 * 7, -0.05 * 3, 0.0)).mask(REST)
    assert (np.roll(here, (7, -3, 0), axis=(0, 1, 2)) != there).sum() <= 2


def test_a_human_outside_the_grid_touches_nothing() -> None:
    assert not BodyVoxeliser(HUMAN, P1_GRID, placement(50.0)).mask(REST).any()


def test_sizes_are_the_published_ones() -> None:
    """Voxels of the authors' regressed motions without legs and left arm (docs/papers.md, P1 occupancy)."""
    urdf = ET.fromstring(HUMAN.urdf)
    for link in urdf.findall("link"):
        name = link.get("name", "")
        if name.startswith("left_") or name.endswith(("hip", "knee", "foot")):
            for body in [*link.findall("collision"), *link.findall("collision_checking")]:
                link.remove(body)
    upper_right = HumanModel(ET.tostring(urdf, encoding="unicode"))
    voxeliser = BodyVoxeliser(upper_right, P1_GRID, placement(0.10, 0.50, 0.15))
    published = (1424, 1309, 1606, 2100, 1995, 1776, 2266, 2891)
    for label, expected in enumerate(published):
        file = shared_data("iros2013/reference/authors_regressed") / f"class_{label}.csv"
        q = np.loadtxt(file, delimiter=",", skiprows=1)[:, 1:]
        assert swept_volume(voxeliser, q).sum() == pytest.approx(expected, rel=0.03)
        kept = swept_volume(voxeliser, q, 10).sum()
        assert 0.88 < kept / expected < 0.99


@pytest.mark.parametrize(
    "T",
    [np.eye(3), 2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.full((4, 4), np.nan), np.eye(4)[[0, 1, 2, 0]]],
)
def test_placements_that_are_not_rigid_are_refused(T: np.ndarray) -> None:
    with pytest.raises(ArrayError, match="T_world_human"):
        BodyVoxeliser(HUMAN, P1_GRID, T)


def test_postures_and_settings_are_checked() -> None:
    voxeliser = BodyVoxeliser(HUMAN, P1_GRID, placement())
    for q in (np.zeros(11), np.full(12, np.nan)):
        with pytest.raises(HumanModelError):
            voxeliser.mask(q)
    for name in ("spacing_m", "n_postures"):
        with pytest.raises(SettingsError, match=name):
            SweptVolumeSettings(**{name: 0})


@pytest.mark.parametrize(("n_recorded", "n_counted"), [(7, 3), (250, 100), (101, 100), (5, 1)])
def test_thinning_keeps_the_first_and_the_last_posture(n_recorded: int, n_counted: int) -> None:
    """Each posture stands in a place of its own, so that every one shows in the volume."""
    voxeliser = BodyVoxeliser(HUMAN, P1_GRID, placement())
    q = np.tile(REST, (n_recorded, 1))
    q[:, 0] += np.linspace(0.0, 1.5, n_recorded)
    swept = swept_volume(voxeliser, q, n_counted)
    assert swept[voxeliser.mask(q[0])].all()
    if n_counted > 1:
        assert swept[voxeliser.mask(q[-1])].all()
    counted = [
        swept_volume(voxeliser, posture) for posture in q[np.linspace(0, n_recorded - 1, n_counted).round().astype(int)]
    ]
    np.testing.assert_array_equal(swept, np.any(counted, axis=0))
