"""What is learned makes true goals probable, knows nothing of what was left out, and needs few motions."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL as MOCAP
from reaching_people import recording
from small_library import small_library

from humanpred_ros.errors import ArrayError, HumanModelError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.reaching.excess_cost import N_PARTS, PARTS, REACHED_M, chosen_postures, excess_costs
from humanpred_ros.reaching.place_classifier import PlaceClassifier
from humanpred_ros.reaching.place_model import (
    PRIOR_WEIGHTS,
    PlaceModel,
    PlaceSettings,
    ReachLesson,
    _fit_weights,
    fit_place_model,
    reach_lessons,
    unknown_probability,
)
from humanpred_ros.reaching.places import Places, reach_ends

HUMAN = HumanModel.kinect12()
CONFIG = PlaceSettings()


@cache
def library() -> MotionLibrary:
    return small_library(4, 6, 50, there_and_back=True)


@cache
def lessons() -> tuple[ReachLesson, ...]:
    return reach_lessons(library(), HUMAN, CONFIG)


@cache
def learned() -> PlaceModel:
    return fit_place_model(lessons(), HUMAN, CONFIG)


def made_up_choices(weights: FloatArray, n_motions: int, seed: int, n_places: int = 5) -> list[FloatArray]:
    """Return motions, of one posture each, whose goals were chosen with just these weights."""
    rng = np.random.default_rng(seed)
    choices = []
    for _ in range(n_motions):
        costs = rng.exponential(0.1, (1, n_places, N_PARTS))
        p = np.exp(-costs[0] @ weights)
        k = rng.choice(n_places, p=p / p.sum())
        costs[:, [0, k]] = costs[:, [k, 0]]
        choices.append(costs)
    return choices


def test_the_weights_by_which_goals_were_chosen_are_found_again() -> None:
    true = np.array([5.0, 20.0, 1.0, 3.0, 0.0, 25.0, 12.0])
    found = _fit_weights(made_up_choices(true, 6000, 0))
    np.testing.assert_allclose(found, true, atol=2.0)
    assert (found >= 0).all()


def test_without_motions_weights_are_the_prior_ones_and_a_few_move_them_little() -> None:
    true = np.array([5.0, 30.0, 1.0, 3.0, 0.0, 25.0, 12.0])
    nothing = fit_place_model([], HUMAN, CONFIG)
    assert nothing.n_motions == 0
    np.testing.assert_array_equal(nothing.weights, PRIOR_WEIGHTS)
    few, many = (_fit_weights(made_up_choices(true, n, 1)) for n in (5, 3000))
    assert np.abs(few - PRIOR_WEIGHTS).max() < 0.5 * np.abs(many - PRIOR_WEIGHTS).max()


def test_posteriors_are_calibrated_when_people_choose_as_the_model_says() -> None:
    true = np.array([5.0, 20.0, 1.0, 3.0, 0.0, 25.0, 12.0])
    model = PlaceModel(_fit_weights(made_up_choices(true, 3000, 2)))
    costs = np.concatenate(made_up_choices(true, 3000, 3))
    likelihood = np.exp(-(costs @ model.weights))
    p = likelihood / likelihood.sum(axis=1, keepdims=True)
    confidence, right = p.max(axis=1), p.argmax(axis=1) == 0
    for low in np.arange(0.3, 1.0, 0.1):
        held = (confidence >= low) & (confidence < low + 0.1)
        if held.sum() > 100:
            assert right[held].mean() == pytest.approx(confidence[held].mean(), abs=0.07)


def test_none_of_the_places_is_as_probable_as_other_places_explain_the_reach_better() -> None:
    def of(told: list[float], untold: list[float], prior: float) -> float:
        """Of likelihoods, all places equally probable beforehand."""
        shared = [np.log(likelihood) - np.log(len(likelihood)) for likelihood in (told, untold)]
        return unknown_probability(shared[0], shared[1], prior)

    spread = np.exp(np.linspace(-6.0, -0.1, 40)).tolist()
    assert of([0.9, 0.05, 0.02], spread, 0.2) < 0.2 < of([0.1, 0.05, 0.02], spread, 0.2)
    # Nothing seen: the prior. Bayes: odds are the prior ones times the ratio of the means.
    assert of([1.0] * 3, [1.0] * 40, 0.3) == pytest.approx(0.3)
    assert of([0.1, 0.3], [0.6, 0.2], 0.5) == pytest.approx(0.4 / 0.6)
    # Whatever comes it stays a probability, less than 1 and more than 0; with no other places it is none of them.
    assert 0.0 < unknown_probability(np.zeros(2), np.empty(0), 0.2) < 1e-6
    assert 1.0 - 1e-6 < unknown_probability(np.full(2, -1e4), np.zeros(3), 0.2) < 1.0


def test_true_goals_are_more_probable_than_by_the_prior_weights() -> None:
    def log_loss(model: PlaceModel) -> float:
        places = Places.of_ends([lesson.end for lesson in lessons()])
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
    hand_only = PlaceModel(np.where(np.array(PARTS) == "body", 0.0, model.weights))
    assert log_loss(hand_only) < log_loss(PlaceModel.prior()) + 0.02
    assert model.ends is not None


def test_nothing_is_learned_of_a_label_left_out() -> None:
    rest = library().select(lambda motion: motion.label != "10")
    without = fit_place_model(lessons(), HUMAN, CONFIG, without=("10",))
    anew = fit_place_model(reach_lessons(rest, HUMAN, CONFIG), HUMAN, CONFIG)
    np.testing.assert_allclose(without.weights, anew.weights, rtol=1e-6)
    assert without.ends is not None
    assert anew.ends is not None
    np.testing.assert_allclose(without.ends.seen, anew.ends.seen)
    assert without.n_motions == 18
    assert np.abs(without.weights - learned().weights).max() > 1e-3


def test_one_class_or_no_labels_teach_nothing_and_that_is_no_error() -> None:
    unlabelled = [Motion(m.t_s, m.q, m.dof_names, None, k) for k, m in enumerate(library().motions[:3])]
    for some in (library().select(lambda motion: motion.label == "0"), MotionLibrary("some", tuple(unlabelled))):
        assert fit_place_model(reach_lessons(some, HUMAN, CONFIG), HUMAN, CONFIG).n_motions == 0


def test_people_seen_by_motion_capture_teach_too() -> None:
    motions = []
    for seed in range(4):
        active = recording(seed).active
        back = active.q[::-1] + 0.0
        motions += [
            Motion(active.t_s, active.q, active.dof_names, 0, seed, "mocap"),
            Motion(active.t_s, back, active.dof_names, 1, seed, "mocap"),
        ]
    captured = MotionLibrary("captured", tuple(motions))
    model = fit_place_model(reach_lessons(captured, MOCAP, CONFIG), MOCAP, CONFIG)
    assert model.n_motions == 8
    assert model.ends is not None
    with pytest.raises(HumanModelError):
        reach_lessons(captured, HUMAN, CONFIG)


def test_lessons_hold_what_was_reached() -> None:
    lesson = lessons()[0]
    assert lesson.rows.shape[0] == CONFIG.n_postures
    assert (np.diff(lesson.rows[:, REACHED_M]) >= 0).all()


@pytest.mark.parametrize("weights", [np.ones(3), -np.ones(N_PARTS), np.full(N_PARTS, np.nan)])
def test_impossible_models_are_refused(weights: FloatArray) -> None:
    with pytest.raises(ArrayError):
        PlaceModel(weights)


@pytest.mark.parametrize(
    "setting", [{"unknown_prior": 0.0}, {"unknown_prior": 1.0}, {"n_postures": 1}, {"apart_m": -1.0}]
)
def test_impossible_settings_are_refused(setting: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(setting))):
        PlaceSettings(**setting)  # type: ignore[arg-type]


#: The class left out whole.
UNSEEN = "6"


@pytest.mark.parametrize("name", ["library_a", "library_b"])
def test_reaches_to_a_goal_never_learned_are_understood_at_60_percent(name: str) -> None:
    library = load_library(shared_data(f"iros2013/{name}"))
    # Learned from every other motion, so that the test is a fast one.
    some = library.select(lambda motion: motion.index % 2 == 0)
    config = PlaceSettings(n_postures=10)
    model = fit_place_model(reach_lessons(some, HUMAN, config), HUMAN, config, without=(UNSEEN,))
    assert model.n_motions < len(some)
    goals = Places.of_ends(reach_ends(some, HUMAN))
    classifier = PlaceClassifier(HUMAN, model=model, places=goals)
    right, unknown = [], {True: [], False: []}
    for motion in library.of_class(UNSEEN)[1::2]:
        for given in (True, False):
            classifier.start()
            classifier.set_places(
                goals
                if given
                else Places.of({label: place for label, place in goals.by_label.items() if label != UNSEEN})
            )
            until = chosen_postures(len(motion), 10)[5] + 1
            for q, t_s in zip(motion.q[:until], motion.t_s[:until].tolist(), strict=True):
                posterior = classifier.update(q, t_s)
            unknown[given].append(posterior.unknown)
            if given:
                right.append(posterior.best == UNSEEN)
    assert np.mean(right) >= 0.75  # twelve motions; two or three of library_b's are mistracked
    assert np.mean(unknown[False]) > np.mean(unknown[True])
