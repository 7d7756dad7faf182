"""Nothing is learned from the class of the motion left out, and its place is told by the class's other motions."""

from __future__ import annotations

from functools import cache

import numpy as np
from small_library import small_library

from humanpred_ros.evaluation.leave_one_out import FoldSettings, UnseenClass
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary, turn_and_shift
from humanpred_ros.reaching.places import Places
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
LEFT_OUT = "10/1"


@cache
def library() -> MotionLibrary:
    return small_library(3, 4, 30)


def folds_of(motions: MotionLibrary, T_shift: np.ndarray | None = None) -> UnseenClass:
    shift = np.eye(4) if T_shift is None else T_shift
    return UnseenClass(FoldSettings(motions, HUMAN, GRID, np.eye(4), T_shift=shift))


def played(predictor: ReachingPredictor) -> np.ndarray:
    """Return what is predicted after a third of the motion left out."""
    motion = library().find(LEFT_OUT)
    predictor.start()
    for q, t_s in zip(motion.q[:10], motion.t_s.tolist(), strict=False):
        prediction = predictor.update(q, t_s)
    return prediction.occupancy.probability


def test_no_motion_of_the_class_is_learned_from() -> None:
    folds = folds_of(library())
    for name in ("10/1", "10/3", "0/2"):
        folds.without(name)
    learned = {label: knowledge.model.trained_on for label, knowledge in folds._knowledge.items()}
    assert set(learned) == {"10", "0"}, "motions of one class share what was learned"
    for label, names in learned.items():
        assert len(names) == 8
        assert not any(name.startswith(f"{label}/") for name in names)


def test_the_motion_left_out_says_nothing_about_its_place() -> None:
    moved = tuple(m.with_postures(m.q + 0.2) if m.name == LEFT_OUT else m for m in library())
    a, b = folds_of(library()).without(LEFT_OUT), folds_of(MotionLibrary("small", moved)).without(LEFT_OUT)
    np.testing.assert_array_equal(a.places[10], b.places[10])
    np.testing.assert_array_equal(played(a), played(b))


def test_the_class_has_its_place_among_the_others() -> None:
    goals = Places.of(folds_of(library()).without(LEFT_OUT).places)
    assert goals.labels == (0, 10, 20)
    own = Places.of_library(library(), HUMAN, without_motion=LEFT_OUT)
    np.testing.assert_allclose(goals.places_m, own.places_m)


def test_a_motion_that_was_never_in_the_library_has_its_class_left_out_too() -> None:
    rest = library().select(lambda motion: motion.name != LEFT_OUT)
    np.testing.assert_array_equal(
        played(folds_of(rest).without(LEFT_OUT)), played(folds_of(library()).without(LEFT_OUT))
    )


def test_places_are_told_where_the_tested_people_stand() -> None:
    T = turn_and_shift(0.3, (0.5, 0.1, 0.0))
    here = Places.of(folds_of(library()).without(LEFT_OUT).places)
    np.testing.assert_allclose(
        Places.of(folds_of(library(), T).without(LEFT_OUT).places).places_m, here.moved(T).places_m
    )
