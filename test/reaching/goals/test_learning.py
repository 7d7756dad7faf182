"""What is learned makes true goals probable, knows nothing of what was left out, and needs few motions."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from reaching_people import MODEL as MOCAP
from reaching_people import recording
from small_library import small_library

from humanpred_ros.checks import FloatArray
from humanpred_ros.errors import ArrayError, HumanModelError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.reaching.goals.features import N_PARTS, PARTS, REACHED_M, excess_costs
from humanpred_ros.reaching.goals.learning import (
    ReachLesson,
    _Choice,
    _fit_unknown,
    _fit_weights,
    fit_goal_model,
    learn_goal_model,
    reach_lessons,
)
from humanpred_ros.reaching.goals.model import PRIOR_UNKNOWN, PRIOR_WEIGHTS, GoalConfig, GoalModel, unknown_inputs
from humanpred_ros.reaching.goals.places import GoalPlaces

HUMAN = HumanModel.kinect12()
CONFIG = GoalConfig()


@cache
def library() -> MotionLibrary:
    return small_library(4, 6, 50, there_and_back=True)


@cache
def lessons() -> tuple[ReachLesson, ...]:
    return reach_lessons(library(), HUMAN, CONFIG)


@cache
def learned() -> GoalModel:
    return fit_goal_model(lessons(), HUMAN, CONFIG)


def made_up_choices(weights: FloatArray, n_motions: int, seed: int, n_places: int = 5) -> list[_Choice]:
    """Return motions, of one posture each, whose goals were chosen with just these weights."""
    rng = np.random.default_rng(seed)
    choices = []
    for _ in range(n_motions):
        costs = rng.exponential(0.1, (1, n_places, N_PARTS))
        p = np.exp(-costs[0] @ weights)
        k = rng.choice(n_places, p=p / p.sum())
        costs[:, [0, k]] = costs[:, [k, 0]]
        choices.append(_Choice(costs, np.full(1, 0.5)))
    return choices


def test_the_weights_by_which_goals_were_chosen_are_found_again() -> None:
    true = np.array([5.0, 20.0, 1.0, 3.0, 0.0, 25.0, 12.0])
    found = _fit_weights(made_up_choices(true, 6000, 0))
    np.testing.assert_allclose(found, true, atol=2.0)
    assert (found >= 0).all()


def test_without_motions_weights_are_the_prior_ones_and_a_few_move_them_little() -> None:
    true = np.array([5.0, 30.0, 1.0, 3.0, 0.0, 25.0, 12.0])
    assert learn_goal_model([], HUMAN).n_motions == 0
    np.testing.assert_array_equal(learn_goal_model([], HUMAN).weights, PRIOR_WEIGHTS)
    few, many = (_fit_weights(made_up_choices(true, n, 1)) for n in (5, 3000))
    assert np.abs(few - PRIOR_WEIGHTS).max() < 0.5 * np.abs(many - PRIOR_WEIGHTS).max()


def test_posteriors_are_calibrated_when_people_choose_as_the_model_says() -> None:
    true = np.array([5.0, 20.0, 1.0, 3.0, 0.0, 25.0, 12.0])
    model = GoalModel(_fit_weights(made_up_choices(true, 3000, 2)), PRIOR_UNKNOWN)
    costs = np.concatenate([choice.costs for choice in made_up_choices(true, 3000, 3)])
    likelihood = np.exp(-(costs @ model.weights))
    p = likelihood / likelihood.sum(axis=1, keepdims=True)
    confidence, right = p.max(axis=1), p.argmax(axis=1) == 0
    for low in np.arange(0.3, 1.0, 0.1):
        held = (confidence >= low) & (confidence < low + 0.1)
        if held.sum() > 100:
            assert right[held].mean() == pytest.approx(confidence[held].mean(), abs=0.07)


def test_known_goals_are_told_from_none_of_them() -> None:
    rng = np.random.default_rng(4)
    known = np.sort(rng.exponential(0.02, (300, 1, N_PARTS)), axis=0)
    others = rng.uniform(0.1, 0.3, (300, 5, N_PARTS))
    costs = np.concatenate([known, others], axis=1)
    choices = [_Choice(each[None], np.full(1, 0.5)) for each in costs]
    unknown = _fit_unknown(choices, PRIOR_WEIGHTS)
    assert unknown[0] < 0 < unknown[1]
    odds_known, odds_unknown = (
        unknown_inputs(-(costs[:, first:] @ PRIOR_WEIGHTS), np.full(300, 0.5)) @ unknown for first in (0, 1)
    )
    assert np.median(odds_known) < 0 < np.median(odds_unknown)


def test_before_the_hand_moves_nothing_is_said_about_no_goal() -> None:
    inputs = unknown_inputs(np.array([[-3.0, -2.0], [-3.0, -2.0]]), np.array([0.0, 0.5]))
    assert not inputs[0].any()
    assert inputs[1].all()


def test_true_goals_are_more_probable_than_by_the_prior_weights() -> None:
    def log_loss(model: GoalModel) -> float:
        places = GoalPlaces.of_ends([lesson.end for lesson in lessons()])
        losses = []
        for lesson in lessons():
            log_likelihood = -(excess_costs(lesson.rows, places.places_m) @ model.weights)
            log_p = log_likelihood - np.logaddexp.reduce(log_likelihood, axis=1, keepdims=True)
            assert lesson.end.label is not None
            losses.append(-log_p[:, places.labels.index(lesson.end.label)].mean())
        return float(np.mean(losses))

    model = learned()
    assert model.n_motions == 24
    assert (model.weights >= 0).all()
    hand_only = GoalModel(np.where(np.array(PARTS) == "body", 0.0, model.weights), model.unknown)
    assert log_loss(hand_only) < log_loss(GoalModel.prior()) + 0.02
    assert model.ends is not None


def test_nothing_is_learned_of_a_label_left_out() -> None:
    rest = library().select(lambda motion: motion.label != 10)
    without = fit_goal_model(lessons(), HUMAN, CONFIG, without=(10,))
    anew = learn_goal_model(rest, HUMAN)
    np.testing.assert_allclose(without.weights, anew.weights, rtol=1e-6)
    np.testing.assert_allclose(without.unknown, anew.unknown, rtol=1e-6)
    assert without.n_motions == 18
    assert np.abs(without.weights - learned().weights).max() > 1e-3


def test_given_places_are_used_and_motions_without_one_left_out() -> None:
    places = GoalPlaces.of_library(library(), HUMAN)
    model = learn_goal_model(library(), HUMAN, places.without(20))
    assert model.n_motions == 18
    off = places.with_goal(0, places.place(0) + np.array([0.0, 0.0, 0.4]))
    assert np.abs(learn_goal_model(library(), HUMAN, off).weights - learned().weights).max() > 0.1


def test_one_goal_or_goals_in_one_place_teach_nothing_and_that_is_no_error() -> None:
    single = library().select(lambda motion: motion.label == 0)
    for motions in (single, library()):
        places = GoalPlaces((0, 10), np.array([[0.5, 0.0, 1.0], [0.5, 0.02, 1.0]]))
        assert learn_goal_model(motions, HUMAN, places).n_motions == 0
    assert learn_goal_model(single, HUMAN).n_motions == 0
    unlabelled = [Motion(m.t_s, m.q, m.dof_names) for m in library().motions[:3]]
    assert learn_goal_model(unlabelled, HUMAN).n_motions == 0


def test_people_seen_by_motion_capture_teach_too() -> None:
    motions = []
    for seed in range(4):
        active = recording(seed).active
        back = active.q[::-1] + 0.0
        motions += [
            Motion(active.t_s, active.q, active.dof_names, 0, seed, "mocap"),
            Motion(active.t_s, back, active.dof_names, 1, seed, "mocap"),
        ]
    model = learn_goal_model(motions, MOCAP)
    assert model.n_motions == 8
    assert model.ends is not None
    with pytest.raises(HumanModelError):
        learn_goal_model(motions, HUMAN)


def test_lessons_hold_what_was_reached() -> None:
    lesson = lessons()[0]
    assert lesson.rows.shape[0] == CONFIG.n_postures
    assert (np.diff(lesson.rows[:, REACHED_M]) >= 0).all()
    with pytest.raises(ValueError, match="read-only"):
        lesson.rows[0] = 0.0


@pytest.mark.parametrize(
    "arguments",
    [
        (np.ones(3), PRIOR_UNKNOWN),
        (-np.ones(N_PARTS), PRIOR_UNKNOWN),
        (np.full(N_PARTS, np.nan), PRIOR_UNKNOWN),
        (PRIOR_WEIGHTS, np.array([1.0, 1.0])),
        (PRIOR_WEIGHTS, np.array([-1.0, -1.0])),
    ],
)
def test_impossible_models_are_refused(arguments: tuple[FloatArray, FloatArray]) -> None:
    with pytest.raises(ArrayError):
        GoalModel(*arguments)


@pytest.mark.parametrize(
    "setting", [{"unknown_prior": 0.0}, {"unknown_prior": 1.0}, {"n_postures": 1}, {"apart_m": -1.0}]
)
def test_impossible_settings_are_refused(setting: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        GoalConfig(**setting)  # type: ignore[arg-type]
