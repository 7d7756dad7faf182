"""Leaving one out: as if trained without the motion, whatever is shared, and blind to what was left out."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros import plugins
from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.evaluation import leave_one_out as module
from humanpred_ros.evaluation.leave_one_out import FoldSettings, TrainedAnew, learned_from_class, leave_one_out
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.predictor import Predictor, predictor_type
from humanpred_ros.recognition.gmm_classifier import GmmSettings

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
CONFIG = GmmSettings(n_components=3, max_iterations=10)


@cache
def library() -> MotionLibrary:
    return small_library(3, 4, 30)


def settings_of(motions: MotionLibrary, gmm: GmmSettings = CONFIG) -> FoldSettings:
    return FoldSettings(motions, HUMAN, GRID, np.eye(4), gmm=gmm)


def played(predictor: Predictor, name: str) -> np.ndarray:
    motion = library().find(name)
    predictor.start()
    return np.array([predictor.update(q, t).occupancy.probability for q, t in zip(motion.q, motion.t_s, strict=True)])


@pytest.mark.parametrize(
    "name", [name for name in plugins.names(plugins.PREDICTORS) if name != "reaching"]
)  # it leaves out whole classes
def test_the_same_as_trained_anew(name: str) -> None:
    folds = leave_one_out(name, settings_of(library()))
    for left_out in ("0/1", "20/3"):
        shared = played(folds.without(left_out), left_out)
        if predictor_type(name).needs_model:
            anew = played(TrainedAnew(settings_of(library()), name).without(left_out), left_out)
            np.testing.assert_allclose(shared, anew, atol=1e-6)
        # Another fold in between must not have left anything behind.
        folds.without("10/0")
        np.testing.assert_array_equal(played(folds.without(left_out), left_out), shared)


def test_a_classifier_without_phase_has_mixtures_beside_it() -> None:
    config = GmmSettings(n_components=3, max_iterations=10, phase_feature=False)
    shared = leave_one_out("swept_volume", settings_of(library(), config)).without("10/2")
    anew = TrainedAnew(settings_of(library(), config), "swept_volume").without("10/2")
    # The one regresses from the same mixtures as the other, but each trains its own classifier.
    np.testing.assert_allclose(played(shared, "10/2"), played(anew, "10/2"), atol=1e-6)


def test_what_was_left_out_does_not_matter() -> None:
    other = MotionLibrary("small", tuple(m.with_postures(m.q + 0.2) if m.name == "10/1" else m for m in library()), {})
    a = leave_one_out("swept_volume", settings_of(library())).without("10/1")
    b = leave_one_out("swept_volume", settings_of(other)).without("10/1")
    np.testing.assert_array_equal(played(a, "10/1"), played(b, "10/1"))
    c = leave_one_out("swept_volume", settings_of(other)).without("10/2")
    d = leave_one_out("swept_volume", settings_of(library())).without("10/2")
    assert (played(c, "10/1") != played(d, "10/1")).any()


def test_a_motion_that_was_never_learned_from_needs_no_leaving_out() -> None:
    rest = library().select(lambda motion: motion.name != "20/0")
    never = leave_one_out("swept_volume", settings_of(rest)).without("20/0")
    left_out = leave_one_out("swept_volume", settings_of(library())).without("20/0")
    np.testing.assert_array_equal(played(never, "20/0"), played(left_out, "20/0"))


def test_who_learned_from_the_class_says_so() -> None:
    assert {name: learned_from_class(name) for name in plugins.names(plugins.PREDICTORS)} == {
        "forecast": "yes",
        "swept_volume": "yes",
        "reaching": "no",
        "current": "–",
        "current_accumulated": "–",
        "constant_velocity": "–",
    }


def test_a_new_predictor_needs_no_entry_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SHARED", {})
    assert isinstance(leave_one_out("swept_volume", settings_of(library())), TrainedAnew)


def test_what_is_wrong_is_named() -> None:
    with pytest.raises(UsageError, match="wanted one of"):
        leave_one_out("crystal_ball", settings_of(library())).without("0/0")
    with pytest.raises(LibraryFormatError, match="at least two motions"):
        leave_one_out("swept_volume", settings_of(small_library(2, 2, 20))).without("0/0")
    unknown = FoldSettings(library(), HUMAN, GRID, np.eye(4), classifier="svm")
    with pytest.raises(UsageError, match="svm"):
        leave_one_out("swept_volume", unknown).without("0/0")
