"""The offline stage: what a model holds, which classifiers it gives, and that it can be repeated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.errors import HumanModelError, LibraryFormatError, SettingsError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import placed, turn_and_shift
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.gmm_classifier import GmmClassifier, GmmSettings
from humanpred_ros.recognition.training import TrainedModel, classifier_settings, train_model

GMM = {"gmm": GmmSettings(n_components=8, max_iterations=30)}
HUMAN = HumanModel.kinect12()


@cache
def trained() -> TrainedModel:
    return train_model(small_library(), HUMAN, GMM)


def palm_m(q: np.ndarray) -> np.ndarray:
    return HUMAN.forward(q)["right_palm"]


@pytest.mark.parametrize("there_and_back", [False, True])
def test_the_place_of_a_reach_is_its_end_and_of_a_return_its_turning_point(there_and_back: bool) -> None:
    library = small_library(there_and_back=there_and_back)
    model = train_model(library, HUMAN, {})
    assert tuple(model.places) == library.labels
    for label, place in model.places.items():
        reached = np.mean([palm_m(m.q[19 if there_and_back else -1]) for m in library.of_class(label)], axis=0)
        assert np.linalg.norm(place - reached) < 0.04


def test_the_same_library_and_seed_give_the_same_model() -> None:
    again = train_model(small_library(), HUMAN, GMM)
    states = [model.classifiers["gmm"].state() for model in (trained(), again)]
    for name, array in states[0].items():
        np.testing.assert_array_equal(array, states[1][name])


def test_those_asked_for_are_trained_and_no_others() -> None:
    model = train_model(small_library(2, 3), HUMAN, {"forest": ForestSettings(n_trees=5)})
    assert list(model.classifiers) == ["forest"]
    assert isinstance(model.classifier("forest"), ForestClassifier)
    with pytest.raises(UsageError, match="wanted one with the classifier gmm, got one with forest; train it"):
        model.classifier("gmm")
    with pytest.raises(UsageError, match="wanted one of forest, gmm"):
        model.classifier("svm")
    with pytest.raises(UsageError, match="wanted one of forest, gmm"):
        train_model(small_library(2, 3), HUMAN, {"svm": None})
    with pytest.raises(UsageError, match="settings of the class GmmSettings, got ForestSettings"):
        train_model(small_library(2, 3), HUMAN, {"gmm": ForestSettings()})


def test_a_model_of_the_library_alone_needs_no_classes() -> None:
    unlabelled = replace(
        small_library(), motions=tuple(replace(m, label=None, index=k) for k, m in enumerate(small_library()))
    )
    model = train_model(unlabelled, HUMAN, {})
    assert (len(model.library), dict(model.places), dict(model.classifiers)) == (len(unlabelled), {}, {})


def test_classifiers_of_a_model_do_not_share_what_they_saw() -> None:
    one, other = (trained().classifier("gmm", evidence="mean") for _ in range(2))
    motion = small_library().motions[0]
    one.update(motion.q[0], 0.0)
    assert other.update(motion.q[1], 5.0).n_frames == 1
    assert isinstance(one, GmmClassifier)
    assert one.settings.evidence == "mean"


def test_only_online_settings_change_after_training() -> None:
    with pytest.raises(UsageError, match=r"gmm: a trained one cannot change n_components, seed; .*evidence"):
        trained().classifier("gmm", seed=3, n_components=3, evidence="mean")
    with pytest.raises(SettingsError, match="window_frames"):
        trained().classifier("gmm", window_frames=0)


def test_a_seed_goes_to_those_that_draw() -> None:
    assert classifier_settings("forest", 7) == ForestSettings(seed=7)
    assert classifier_settings("gmm", 7) == GmmSettings(seed=7)


def test_what_does_not_suffice_is_refused() -> None:
    library = small_library()
    for name in ("forest", "gmm"):
        with pytest.raises(LibraryFormatError, match="two classes"):
            train_model(library.select(lambda m: m.label == "0"), HUMAN, {name: None})
    renamed = replace(library, motions=tuple(replace(m, dof_names=("elbow", *m.dof_names[1:])) for m in library))
    with pytest.raises(HumanModelError, match="elbow"):
        train_model(renamed, HUMAN, GMM)


def test_a_motion_that_was_learned_from_is_known_also_at_another_place() -> None:
    model, seen = train_model(small_library(2), HUMAN, {}), small_library(2).motions[3]
    for T in (np.eye(4), turn_and_shift(0.7, (0.3, -0.2, 0.0))):
        assert model.learned_from(placed(seen, T)) == seen.name
    assert model.learned_from(seen.with_postures(seen.q + 1e-3)) == ""
