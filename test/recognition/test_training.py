"""The offline stage: what it derives from the mixtures, and that it can be repeated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.errors import ArrayError, HumanModelError, LibraryFormatError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.recognition.training import train_model

CONFIG = GmmSettings(n_components=8, max_iterations=30)
HUMAN = HumanModel.kinect12()


def palm_m(q: np.ndarray) -> np.ndarray:
    return HUMAN.forward(q)["right_palm"]


def test_regressed_motions_follow_their_class() -> None:
    library = small_library()
    model = train_model(library, HUMAN, CONFIG)
    for label in model.labels:
        motion = model.regressed_motion(label)
        assert (motion.label, motion.frame_id, len(motion)) == (label, "lab", 100)
        assert motion.duration_s == pytest.approx(1.5)
        own = np.mean([palm_m(m.q[-1]) for m in library.of_class(label)], axis=0)
        assert np.linalg.norm(palm_m(motion.q[-1]) - own) < 0.03


def test_goal_of_a_reach_is_its_end_and_of_a_return_its_turning_point() -> None:
    for there_and_back in (False, True):
        library = small_library(there_and_back=there_and_back)
        model = train_model(library, HUMAN, CONFIG)
        middle_or_end = 19 if there_and_back else -1
        for label, goal in zip(model.labels, model.goals_m, strict=True):
            reached = np.mean([palm_m(m.q[middle_or_end]) for m in library.of_class(label)], axis=0)
            assert np.linalg.norm(goal - reached) < 0.04


def test_a_classifier_without_phase_still_has_regressed_motions() -> None:
    library = small_library()
    without = train_model(library, HUMAN, CONFIG.replaced(phase_feature=False))
    np.testing.assert_array_equal(without.regressed_q, train_model(library, HUMAN, CONFIG).regressed_q)
    assert not without.classes.has_phase
    assert without.gmm_classifier(HUMAN).posteriors(library.motions[0]).shape == (40, 3)


def test_the_same_library_and_seed_give_the_same_model() -> None:
    first, again = (train_model(small_library(), HUMAN, CONFIG) for _ in range(2))
    np.testing.assert_array_equal(first.regressed_q, again.regressed_q)
    np.testing.assert_array_equal(first.goals_m, again.goals_m)
    assert first.training_motions == again.training_motions == tuple(m.name for m in small_library())


def test_classifiers_of_a_model_do_not_share_what_they_saw() -> None:
    model = train_model(small_library(), HUMAN, CONFIG)
    one, other = (model.classifier("gmm", HUMAN, evidence="mean") for _ in range(2))
    motion = small_library().motions[0]
    one.update(motion.q[0], 0.0)
    assert other.update(motion.q[1], 5.0).n_frames == 1
    with pytest.raises(UsageError, match="wanted one of forest, gmm"):
        model.classifier("svm", HUMAN)


def test_what_does_not_fit_is_refused() -> None:
    library = small_library()
    with pytest.raises(LibraryFormatError):
        train_model(library.select(lambda m: m.label == 0), HUMAN, CONFIG)
    renamed = replace(library, motions=tuple(replace(m, dof_names=("elbow", *m.dof_names[1:])) for m in library))
    with pytest.raises(HumanModelError, match="elbow"):
        train_model(renamed, HUMAN, CONFIG)
    model = train_model(library, HUMAN, CONFIG)
    with pytest.raises(UsageError, match="wanted one of the classes"):
        model.regressed_motion(5)
    for change in (
        {"goals_m": np.zeros((2, 3))},
        {"regressed_q": model.regressed_q[:, :50]},
        {"config": CONFIG.replaced(n_components=9)},
        {"config": CONFIG.replaced(phase_feature=False)},
    ):
        with pytest.raises(ArrayError):
            replace(model, **change)
