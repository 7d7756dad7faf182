"""How people reach is learned from a library or from what a model file remembers of one, with or without classes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from paths import shared_data
from small_library import REST, small_library

from humanpred_ros.errors import HumanModelError, ModelFileError, UsageError
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary, unwrap_angles
from humanpred_ros.occupancy.predictor import PredictorRequest, make_predictor
from humanpred_ros.reaching.features import N_FEATURES, NAMED_WEIGHTS
from humanpred_ros.reaching.places import Places, reach_ends
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor, ReachKnowledge, library_of_model
from humanpred_ros.reaching.weights import ReachWeights, reach_weights, save_weights
from humanpred_ros.recognition.training import TrainedModel, train_model

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))


@cache
def library() -> MotionLibrary:
    return small_library(3, 4, 80, there_and_back=True)


@cache
def trained() -> TrainedModel:
    return train_model(library(), HUMAN, {})


def test_a_model_remembers_whole_motions_in_order() -> None:
    remembered = library_of_model(trained())
    assert [motion.name for motion in remembered] == [motion.name for motion in library()]
    assert (remembered.dof_names, remembered.frame_id) == (library().dof_names, library().frame_id)
    for motion, original in zip(remembered, library(), strict=True):
        q = unwrap_angles(original).q
        assert len(motion) == 50
        np.testing.assert_array_equal(motion.q[[0, -1]], q[[0, -1]])
        which = [int(np.flatnonzero((q == posture).all(axis=1))[0]) for posture in motion.q]
        assert (np.diff(which) > 0).all()
        assert motion.duration_s == pytest.approx(original.duration_s)


def test_a_model_file_is_as_good_as_the_library() -> None:
    by_model = make_predictor("reaching", PredictorRequest(HUMAN, GRID, np.eye(4), model=trained()))
    by_library = ReachingPredictor(ReachKnowledge.of_library(library(), HUMAN), GRID, np.eye(4))
    motion = small_library(3, 1, 80, there_and_back=True, seed=7).motions[2]
    assert isinstance(by_model, ReachingPredictor)
    for label, place in by_library.places.items():
        np.testing.assert_allclose(by_model.places[label], place, atol=0.02)
    for q, t_s in zip(motion.q[:40], motion.t_s.tolist(), strict=False):
        a, b = by_model.update(q, t_s), by_library.update(q, t_s)
    assert a.posterior is not None
    assert b.posterior is not None
    assert a.posterior.best == b.posterior.best == motion.label
    difference = np.abs(a.occupancy.probability - b.occupancy.probability)
    assert difference.sum() < 0.15 * b.occupancy.probability.sum()


def test_explicit_places_come_before_the_librarys() -> None:
    knowledge = ReachKnowledge.of_library(library(), HUMAN)
    assert knowledge.places is not None
    assert knowledge.places.labels == ("0", "10", "20")
    predictor = ReachingPredictor(knowledge, GRID, np.eye(4), {7: [0.4, 0.0, 0.9]})
    for labels, places in ((("7",), predictor.places), (("0", "10", "20"), None)):
        predictor.set_places(places)
        predictor.start()
        posterior = predictor.update(REST, 0.0).posterior
        assert posterior is not None
        assert posterior.labels == labels


def test_a_library_without_classes_needs_places() -> None:
    unlabelled = MotionLibrary("bare", tuple(replace(m, label=None, index=k) for k, m in enumerate(library())))
    knowledge = ReachKnowledge.of_library(unlabelled, HUMAN)
    with pytest.raises(UsageError, match=r"wanted at least one place .* bare has no classes"):
        ReachingPredictor(knowledge, GRID, np.eye(4))
    listed = Places.of_ends(reach_ends(library(), HUMAN))
    motion = small_library(3, 1, 80, there_and_back=True, seed=7).motions[1]
    predictor = ReachingPredictor(knowledge, GRID, np.eye(4), listed.by_label)
    for q, t_s in zip(motion.q[:35], motion.t_s.tolist(), strict=False):
        prediction = predictor.update(q, t_s)
    assert prediction.posterior is not None
    assert prediction.posterior.best == motion.label


def test_on_a_stream_places_may_come_and_go_at_rest_and_in_motion() -> None:
    listed = Places.of_ends(reach_ends(library(), HUMAN)).by_label
    knowledge = ReachKnowledge.of_library(library(), HUMAN)
    predictor = ReachingPredictor(knowledge, GRID, np.eye(4), listed, onsets=True)
    motion = small_library(3, 1, 80, there_and_back=True, seed=7).motions[1]
    rest = np.repeat(motion.q[:1], 60, axis=0) + np.random.default_rng(1).normal(0.0, 0.002, (60, 12))
    labels, best = [], []
    for k, q in enumerate(np.vstack([rest, motion.q[:50]])):
        if k == 30:
            predictor.set_places({"0": listed["0"], "20": listed["20"], "99": listed["10"]})
        if k == 90:
            predictor.set_places({label: place for label, place in predictor.places.items() if label != "20"})
        posterior = predictor.update(q, k / 60).posterior
        assert posterior is not None
        labels.append(posterior.labels)
        best.append(posterior.best)
    assert labels == [("0", "10", "20")] * 30 + [("0", "20", "99")] * 60 + [("0", "99")] * 20
    assert best[-15:] == ["99"] * 15
    assert set(best[:60]) <= {"0", "20"}


def test_where_motion_capture_jumps_nothing_is_learned() -> None:
    recorded = load_library(shared_data("icra2015/demos"))
    knowledge = ReachKnowledge.of_library(recorded, HumanModel.mocap23())
    assert knowledge.places is None
    assert len(knowledge.left_out) == 1
    assert len(knowledge.model.trained_on) == 6
    grid = VoxelGrid((0.0, 0.0, 0.0), 0.05, (60, 60, 40))
    predictor = ReachingPredictor(knowledge, grid, np.eye(4), {1: [1.9, 1.3, 1.0]})
    assert "mistracked" in predictor.notes[0]
    probability = predictor.update(recorded.motions[0].q[0], 0.0).occupancy.probability
    assert probability.max() == 1.0
    assert ((probability > 0.0) & (probability < 1.0)).any()


def test_weights_have_a_name_or_a_file(tmp_path: Path) -> None:
    np.testing.assert_array_equal(reach_weights("baseline_1"), NAMED_WEIGHTS["baseline_1"])
    own = np.arange(1.0, N_FEATURES + 1.0)
    save_weights(ReachWeights(own, np.empty((0, N_FEATURES)), (), {}), tmp_path / "own.json")
    np.testing.assert_array_equal(reach_weights(str(tmp_path / "own.json")), own)
    with pytest.raises(UsageError, match=r"baseline_0.*\.json file.*got 'mine'"):
        reach_weights("mine")
    with pytest.raises(ModelFileError, match="could not be read"):
        reach_weights(str(tmp_path / "absent.json"))


def test_another_human_is_refused() -> None:
    with pytest.raises(HumanModelError, match="23 DoFs"):
        ReachKnowledge.of_library(library(), HumanModel.mocap23())
    with pytest.raises(UsageError, match="another human"):
        ReachKnowledge.of_model(trained(), HumanModel.mocap23())
