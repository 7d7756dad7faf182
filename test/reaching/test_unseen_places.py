"""Goals of the papers' libraries that nobody was seen to reach for are inferred; the command evaluates all of them."""

from __future__ import annotations

import numpy as np
import pytest
from paths import shared_data

from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.reaching.excess_cost import chosen_postures
from humanpred_ros.reaching.place_classifier import PlaceClassifier
from humanpred_ros.reaching.place_model import PlaceSettings, fit_place_model, reach_lessons
from humanpred_ros.reaching.places import Places

HUMAN = HumanModel.kinect12()
#: The class left out whole.
UNSEEN = 6


@pytest.mark.parametrize("name", ["library_a", "library_b"])
def test_reaches_to_a_goal_never_learned_are_understood_at_60_percent(name: str) -> None:
    library = load_library(shared_data(f"iros2013/{name}"))
    # Learned from every other motion, so that the test is a fast one.
    some = library.select(lambda motion: motion.index % 2 == 0)
    config = PlaceSettings(n_postures=10)
    model = fit_place_model(reach_lessons(some, HUMAN, config), HUMAN, config, without=(UNSEEN,))
    assert model.n_motions < len(some)
    goals = Places.of_library(some, HUMAN)
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
