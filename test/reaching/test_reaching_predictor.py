"""Occupancy next to reaches to places that no library contains."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from paths import shared_data
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, HumanModelError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.reaching.end_postures import HAND, EndPostures
from humanpred_ros.reaching.futures import ReachFuturesSettings
from humanpred_ros.reaching.place_classifier import PlaceClassifier
from humanpred_ros.reaching.place_model import PRIOR_WEIGHTS, PlaceModel
from humanpred_ros.reaching.places import reach_ends
from humanpred_ros.reaching.reach_model import ReachModel, ReachProgress
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor, ReachingSettings, ReachKnowledge

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.2, -1.4, -0.2), 0.05, (52, 56, 44))
QUICK = ReachingSettings(futures=ReachFuturesSettings(planned=False))
APART = np.array([[0.62, -0.35, 0.66], [0.62, 0.25, 0.9], [0.3, -0.6, 1.2]])
PLACES = dict(zip((7, 3, 11), APART, strict=True))


@cache
def model() -> ReachModel:
    return ReachModel.learn(small_library(4).motions, HUMAN)


def known(reaches: ReachModel, place_model: PlaceModel | None = None) -> ReachKnowledge:
    return ReachKnowledge(reaches, place_model or PlaceModel.prior(), None, "test")


def predictor(settings: ReachingSettings = QUICK, *, onsets: bool = False) -> ReachingPredictor:
    return ReachingPredictor(known(model()), GRID, np.eye(4), PLACES, onsets=onsets, settings=settings)


def reach_to(place: FloatArray, n: int = 40) -> FloatArray:
    """Return postures (n, 12) of a smooth reach from rest to a place."""
    phase = np.linspace(0.0, 1.0, n)[:, None]
    done = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    q: FloatArray = REST + done * (model().ends.mean(REST, place) - REST)
    return q


@pytest.mark.parametrize("label", ["7", "3", "11"])
def test_the_goal_is_found_and_what_the_reach_sweeps_is_expected(label: str) -> None:
    subject = predictor()
    place = subject.places[label]
    q = reach_to(place)
    voxeliser = BodyVoxeliser(HUMAN, GRID, np.eye(4))
    subject.start()
    for k, posture in enumerate(q):
        prediction = subject.update(posture, k / 30.0)
        if k == 26:
            assert prediction.posterior is not None
            assert prediction.posterior.labels == ("7", "3", "11")
            assert prediction.posterior.labels[int(np.argmax(prediction.posterior.probability))] == label
            swept, now = voxeliser.mask(q[k:]), voxeliser.mask(posture)
            p = prediction.occupancy.probability
            assert (p[now] == 1.0).all()
            assert p[~now].max() < 1.0
            assert p[swept & ~now].mean() > 0.4
            assert ((p - swept) ** 2).sum() < 0.6 * ((now.astype(float) - swept) ** 2).sum()
    assert prediction.occupancy.t_s == pytest.approx(39 / 30.0)


def test_a_goal_added_while_reaching_is_weighed_at_once() -> None:
    subject = predictor()
    new = np.array([0.45, -0.75, 0.7])
    q = reach_to(new)
    subject.start()
    for k, posture in enumerate(q[:25]):
        before = subject.update(posture, k / 30.0)
    subject.set_places({**subject.places, "42": new})
    after = subject.update(q[25], 25 / 30.0)
    assert before.posterior is not None
    assert after.posterior is not None
    assert "42" not in before.posterior.labels
    assert after.posterior.labels[int(np.argmax(after.posterior.probability))] == "42"
    hand = GRID.flat_index(HUMAN.forward(q[-1])[HAND])
    flat_before, flat_after = (r.occupancy.probability.ravel()[hand] for r in (before, after))
    assert flat_after > flat_before + 0.2
    subject.set_places({label: place for label, place in subject.places.items() if label not in ("42", "3")})
    fewer = subject.update(q[26], 26 / 30.0)
    assert fewer.posterior is not None
    assert fewer.posterior.labels == ("7", "11")


def test_improbable_places_are_given_no_futures_and_the_others_theirs() -> None:
    q = reach_to(APART[0])
    narrow = predictor(QUICK.replaced(least_probability=0.4))
    for k, posture in enumerate(q[:30]):
        prediction = narrow.update(posture, k / 30.0)
    there = GRID.flat_index(APART[1])
    assert prediction.occupancy.probability.ravel()[there] == 0.0


def test_a_reach_to_none_of_the_places_is_expected_to_go_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    q = reach_to(APART[0])
    seen = 24

    def after(subject: ReachingPredictor) -> tuple[FloatArray, float]:
        subject.set_places({3: APART[1]})
        for k, posture in enumerate(q[:seen]):
            prediction = subject.update(posture, k / 30.0)
        assert prediction.posterior is not None
        return prediction.occupancy.probability, prediction.posterior.unknown

    p, unknown = after(predictor())
    assert unknown > 0.5
    monkeypatch.setattr(ReachingPredictor, "_elsewhere", lambda *_: (np.empty((0, 3)), 0.0))
    as_if_told, _ = after(predictor())
    voxeliser = BodyVoxeliser(HUMAN, GRID, np.eye(4))
    swept, now = voxeliser.mask(q[seen:]), voxeliser.mask(q[seen - 1])
    assert ((p - swept) ** 2).sum() < 0.5 * ((as_if_told - swept) ** 2).sum()
    assert p[now].min() == 1.0
    assert p.max() < 1.0 + 1e-6


def test_no_time_is_spent_on_what_is_improbable(monkeypatch: pytest.MonkeyPatch) -> None:
    subject, counts = predictor(), []
    each = subject._futures.towards_each

    def counted(progress: ReachProgress, places_m: FloatArray) -> FloatArray:
        counts.append(len(places_m))
        return each(progress, places_m)

    monkeypatch.setattr(subject._futures, "towards_each", counted)
    for k, posture in enumerate(reach_to(APART[0])):
        before = len(counts)
        prediction = subject.update(posture, k / 30.0)
        assert prediction.posterior is not None
        unknown = prediction.posterior.unknown
        # 16 futures from one in two on, none below one in a hundred.
        expected = min(int(np.ceil(32 * unknown)), 16) if unknown >= 0.01 else 0
        assert sum(counts[before:]) == expected
    assert counts[0] == 7


def test_somebody_at_rest_may_reach_for_any_place_and_a_reach_is_noticed() -> None:
    subject = predictor(onsets=True)
    for k in range(40):
        rest = subject.update(REST + 0.0005 * np.sin(k), k / 30.0)
    assert rest.posterior is not None
    np.testing.assert_allclose(rest.posterior.given_known, 1.0 / 3.0)
    q = reach_to(APART[1])
    for k, posture in enumerate(q):
        moving = subject.update(posture, (40 + k) / 30.0)
    assert moving.posterior is not None
    assert moving.posterior.labels[int(np.argmax(moving.posterior.probability))] == "3"


def test_at_rest_only_the_present_posture_counts() -> None:
    subject, fresh = predictor(onsets=True), predictor(onsets=True)
    here = REST.copy()
    for k in range(300):
        here[0] = 0.0002 * k
        drifted = subject.update(here, k / 30.0)
    assert drifted.posterior is not None
    assert drifted.posterior.n_frames == 0
    now = fresh.update(here, 0.0)
    np.testing.assert_array_equal(drifted.occupancy.probability, now.occupancy.probability)


def test_places_out_of_reach_are_given_no_futures() -> None:
    subject = predictor()
    subject.set_places({7: APART[0], 3: [1.1, 0.9, 4.0]})
    both = subject.update(REST, 0.0).occupancy.probability
    subject.start()
    subject.set_places({7: APART[0]})
    np.testing.assert_allclose(both, subject.update(REST, 0.0).occupancy.probability, atol=1e-6)
    subject.start()
    subject.set_places({3: [1.1, 0.9, 4.0]})
    assert set(subject.warnings(REST)) == {"place 3"}
    anything = subject.update(REST, 0.0).occupancy.probability
    assert ((anything > 0.3) & (anything < 1.0)).any(), "better a reach that way than none"


def test_a_refused_posture_changes_nothing() -> None:
    one, other = predictor(), predictor()
    q = reach_to(APART[0])
    for k, posture in enumerate(q[:20]):
        one.update(posture, k / 30.0)
        other.update(posture, k / 30.0)
    with pytest.raises(ArrayError, match="posture"):
        one.update(np.full(12, np.nan), 20 / 30.0)
    with pytest.raises(ArrayError, match="shape"):
        one.update(np.zeros(23), 20 / 30.0)
    with pytest.raises(MotionError, match="later"):
        one.update(q[20], 0.0)
    np.testing.assert_array_equal(
        one.update(q[20], 20 / 30.0).occupancy.probability, other.update(q[20], 20 / 30.0).occupancy.probability
    )


def test_without_any_places_nothing_is_predicted() -> None:
    with pytest.raises(UsageError, match="at least one place"):
        ReachingPredictor(known(model()), GRID, np.eye(4))
    with pytest.raises(UsageError, match="at least one place"):
        predictor().set_places(None)
    other = PlaceModel(PRIOR_WEIGHTS, 1, EndPostures.learn([np.zeros((2, 23))], HumanModel.mocap23()))
    with pytest.raises(HumanModelError, match="end postures of"):
        ReachingPredictor(known(model(), other), GRID, np.eye(4), PLACES)


def test_it_beats_where_the_body_is_on_a_class_of_library_b_never_seen() -> None:
    # Every other motion, so that the test is a fast one.
    library = load_library(shared_data("iros2013/library_b")).select(lambda motion: motion.index % 2 == 1)
    tested = library.of_class(2)[3]
    wrong = {end.name for end in reach_ends(library, HUMAN) if not end.tracked}
    others = [m for m in library if m.label != tested.label and m.name not in wrong]
    taught = PlaceClassifier(HUMAN).fit(library).fit_without(library, tested.name)
    assert taught.places is not None
    grid = VoxelGrid((0.4, 0.2, -0.3), 0.05, (44, 52, 48))
    knowledge = known(ReachModel.learn(others, HUMAN), taught.model)
    subject = ReachingPredictor(knowledge, grid, np.eye(4), taught.places.by_label)
    voxeliser = BodyVoxeliser(HUMAN, grid, np.eye(4))
    subject.start()
    ours, current = 0.0, 0.0
    for k in range(60):
        p = subject.update(tested.q[k], float(tested.t_s[k])).occupancy.probability
        if k in (30, 40, 59):
            swept = voxeliser.mask(tested.q[k:])
            ours += float(((p - swept) ** 2).sum())
            current += float(((voxeliser.mask(tested.q[k]).astype(float) - swept) ** 2).sum())
    assert ours < 0.5 * current


def test_it_works_with_the_23_dof_human() -> None:
    human = HumanModel.mocap23()
    recordings = load_reach_recordings(shared_data("icra2015/demos"))
    tested = recordings[3].active
    others = [r.active for k, r in enumerate(recordings) if k != 3 and not r.unfit]
    place = human.forward(tested.q[-1])[HAND]
    grid = VoxelGrid((0.8, 0.2, 0.2), 0.05, (36, 44, 36))
    places = {0: place, 1: place - [0.0, 0.5, -0.2]}
    subject = ReachingPredictor(known(ReachModel.learn(others, human)), grid, np.eye(4), places)
    voxeliser = BodyVoxeliser(human, grid, np.eye(4))
    for k in range(60):
        prediction = subject.update(tested.q[k], float(tested.t_s[k]))
        if k == 40:
            swept = voxeliser.mask(tested.q[k:])
            now = voxeliser.mask(tested.q[k])
            error = ((prediction.occupancy.probability - swept) ** 2).sum()
            assert error < 0.6 * ((now.astype(float) - swept) ** 2).sum()
    assert prediction.posterior is not None
    assert prediction.posterior.probability[0] > prediction.posterior.probability[1]
