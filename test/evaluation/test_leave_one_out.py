"""Leaving one out: as if trained without the motion, whatever is shared, and blind to what was left out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros import plugins
from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.evaluation.leave_one_out import (
    LEARNS_CLASSES,
    LEARNS_FROM_OTHERS,
    LeaveOneOut,
    Needs,
    check_needs,
    learned_from_class,
)
from humanpred_ros.evaluation.recognition import REACHING, evaluated_names, needs_of, unknown_left_out
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary, turn_and_shift
from humanpred_ros.occupancy.predictor import Predictor, predictor_type
from humanpred_ros.reaching.places import Places, reach_ends
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.gmm_classifier import GmmSettings

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
LEFT_OUT = "10/1"
CONFIG = GmmSettings(n_components=3, max_iterations=10)


@cache
def library() -> MotionLibrary:
    return small_library(3, 4, 30)


def leave_one_out(name: str, motions: MotionLibrary, gmm: GmmSettings = CONFIG, **others: Any) -> LeaveOneOut:
    return LeaveOneOut(name, motions, HUMAN, GRID, np.eye(4), gmm=gmm, **others)


def played(predictor: Predictor, name: str) -> np.ndarray:
    motion = library().find(name)
    predictor.start()
    return np.array([predictor.update(q, t).occupancy.probability for q, t in zip(motion.q, motion.t_s, strict=True)])


@pytest.mark.parametrize(
    "name", [name for name in plugins.names(plugins.PREDICTORS) if name != "reaching"]
)  # it leaves out whole classes
def test_the_same_as_trained_anew(name: str) -> None:
    folds = leave_one_out(name, library())
    for left_out in ("0/1", "20/3"):
        shared = played(folds.without(left_out), left_out)
        if predictor_type(name).needs_model:
            anew = played(leave_one_out(name, library(), shared=False).without(left_out), left_out)
            np.testing.assert_allclose(shared, anew, atol=1e-6)
        # Another fold in between must not have left anything behind.
        folds.without("10/0")
        np.testing.assert_array_equal(played(folds.without(left_out), left_out), shared)


def test_a_classifier_without_phase_has_mixtures_beside_it() -> None:
    config = GmmSettings(n_components=3, max_iterations=10, phase_feature=False)
    shared = leave_one_out("swept_volume", library(), config).without("10/2")
    anew = leave_one_out("swept_volume", library(), config, shared=False).without("10/2")
    # The one regresses from the same mixtures as the other, but each trains its own classifier.
    np.testing.assert_allclose(played(shared, "10/2"), played(anew, "10/2"), atol=1e-6)


def test_what_was_left_out_does_not_matter() -> None:
    other = MotionLibrary("small", tuple(m.with_postures(m.q + 0.2) if m.name == "10/1" else m for m in library()), {})
    a = leave_one_out("swept_volume", library()).without("10/1")
    b = leave_one_out("swept_volume", other).without("10/1")
    np.testing.assert_array_equal(played(a, "10/1"), played(b, "10/1"))
    c = leave_one_out("swept_volume", other).without("10/2")
    d = leave_one_out("swept_volume", library()).without("10/2")
    assert (played(c, "10/1") != played(d, "10/1")).any()


def test_a_motion_that_was_never_learned_from_needs_no_leaving_out() -> None:
    rest = library().select(lambda motion: motion.name != "20/0")
    never = leave_one_out("swept_volume", rest).without("20/0")
    left_out = leave_one_out("swept_volume", library()).without("20/0")
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


def test_what_is_wrong_is_named() -> None:
    with pytest.raises(UsageError, match="wanted one of"):
        leave_one_out("crystal_ball", library()).without("0/0")
    with pytest.raises(LibraryFormatError, match="at least two motions"):
        leave_one_out("swept_volume", small_library(2, 2, 20)).without("0/0")
    with pytest.raises(UsageError, match="svm"):
        leave_one_out("swept_volume", library(), classifier="svm").without("0/0")


def reaching_without(name: str, motions: MotionLibrary, **others: Any) -> ReachingPredictor:
    predictor = leave_one_out("reaching", motions, **others).without(name)
    assert isinstance(predictor, ReachingPredictor)
    return predictor


def after_a_third(predictor: ReachingPredictor) -> np.ndarray:
    """Return what is predicted after a third of the motion left out."""
    motion = library().find(LEFT_OUT)
    predictor.start()
    for q, t_s in zip(motion.q[:10], motion.t_s.tolist(), strict=False):
        prediction = predictor.update(q, t_s)
    return prediction.occupancy.probability


def test_no_motion_of_the_class_is_learned_from() -> None:
    folds = leave_one_out("reaching", library())
    for name in ("10/1", "10/3", "0/2"):
        folds.without(name)
    learned = {label: knowledge.model.trained_on for label, knowledge in folds._knowledge.items()}
    assert set(learned) == {"10", "0"}, "motions of one class share what was learned"
    for label, names in learned.items():
        assert len(names) == 8
        assert not any(name.startswith(f"{label}/") for name in names)


def test_the_motion_left_out_says_nothing_about_its_place() -> None:
    moved = tuple(m.with_postures(m.q + 0.2) if m.name == LEFT_OUT else m for m in library())
    a, b = reaching_without(LEFT_OUT, library()), reaching_without(LEFT_OUT, MotionLibrary("small", moved))
    np.testing.assert_array_equal(a.places["10"], b.places["10"])
    np.testing.assert_array_equal(after_a_third(a), after_a_third(b))


def test_the_class_has_its_place_among_the_others() -> None:
    goals = Places.of(reaching_without(LEFT_OUT, library()).places)
    assert goals.labels == ("0", "10", "20")
    own = Places.of_ends(reach_ends(library(), HUMAN), without_motion=LEFT_OUT)
    np.testing.assert_allclose(goals.places_m, own.places_m)


def test_a_motion_that_was_never_in_the_library_has_its_class_left_out_too() -> None:
    rest = library().select(lambda motion: motion.name != LEFT_OUT)
    np.testing.assert_array_equal(
        after_a_third(reaching_without(LEFT_OUT, rest)), after_a_third(reaching_without(LEFT_OUT, library()))
    )


def test_places_are_told_where_the_tested_people_stand() -> None:
    T = turn_and_shift(0.3, (0.5, 0.1, 0.0))
    here = Places.of(reaching_without(LEFT_OUT, library()).places)
    np.testing.assert_allclose(
        Places.of(reaching_without(LEFT_OUT, library(), T_shift=T).places).places_m, here.moved(T).places_m
    )


ENTRIES: dict[str, Needs | None] = {"trees": LEARNS_CLASSES, "places": LEARNS_FROM_OTHERS, "now": None}


def of(n_classes: int, n_motions: int) -> MotionLibrary:
    return small_library(n_classes=n_classes, n_motions=n_motions, n_frames=10)


def complaint(library: MotionLibrary, *names: str) -> str:
    with pytest.raises(LibraryFormatError) as caught:
        check_needs(library, {name: ENTRIES[name] for name in names}, "--entry")
    return str(caught.value)


@pytest.mark.parametrize(
    ("n_classes", "n_motions", "able"),
    [
        (1, 1, {"now"}),
        (1, 5, {"now"}),
        (3, 1, {"now"}),
        (2, 2, {"places", "now"}),
        (2, 3, {"trees", "places", "now"}),
    ],
)
def test_who_can_be_evaluated_is_and_who_cannot_is_named(n_classes: int, n_motions: int, able: set[str]) -> None:
    library = of(n_classes, n_motions)
    check_needs(library, {name: ENTRIES[name] for name in able}, "--entry")
    for name in ENTRIES.keys() - able:
        assert f"wanted for {name} at least" in complaint(library, name)


def test_the_others_are_said_as_they_are_typed_and_only_if_there_are_any() -> None:
    assert complaint(of(2, 2), *ENTRIES).endswith("or evaluate only the others: --entry places,now")
    assert complaint(of(2, 2), "trees").endswith("class 0 has 2; record more or leave the class out")
    assert complaint(of(1, 9), "trees", "places").endswith("got 1; record more")


def test_unlabelled_motions_are_only_for_who_learns_nothing() -> None:
    library = of(2, 3)
    mixed = MotionLibrary("mixed", (*library.motions, replace(library.motions[0], label=None)))
    check_needs(mixed, {"now": None}, "--entry")
    text = complaint(mixed, *ENTRIES)
    assert "for trees and places a class for every motion, -/0 and 0 more have none; label them" in text
    assert text.endswith("--entry now")


def test_only_goal_inference_needs_no_more_than_a_place_of_the_tested_class() -> None:
    assert {name for name in evaluated_names() if needs_of(name).n_motions < 3} == {REACHING}


def test_why_no_class_is_left_out_whole_is_said_of_two_and_not_of_three() -> None:
    assert unknown_left_out(of(3, 1)) is None
    assert "small has 2" in str(unknown_left_out(replace(of(2, 3), name="small")))
