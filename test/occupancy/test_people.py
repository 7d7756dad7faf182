"""Several people: each is predicted for as if alone, and what all occupy is joined as of independent people."""

from __future__ import annotations

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import placed, turn_and_shift
from humanpred_ros.occupancy.people import PeoplePredictor, joined
from humanpred_ros.occupancy.predictor import PredictorRequest, make_predictor
from humanpred_ros.recognition.training import train_model
from humanpred_ros.robot.scene import load_scene

HUMAN = HumanModel.kinect12()
LIBRARY = load_library(REPOSITORY / "bags" / "synthetic_reaches")
SCENE = load_scene("four_places", check=False)


def test_each_is_predicted_for_as_if_alone_and_comes_and_goes_alone() -> None:
    model = train_model(LIBRARY, HUMAN, {"forest": None})
    request = PredictorRequest(HUMAN, SCENE.grid, SCENE.T_world_human, model, onsets=True)
    pattern = make_predictor("forecast", request)
    motions = LIBRARY.find("0/1"), placed(LIBRARY.find("5/2"), turn_and_shift(0.1, (0.0, -0.5, 0.0)))
    alone = [make_predictor("forecast", request) for _ in motions]
    people = PeoplePredictor(pattern)
    for k in range(0, 60, 3):
        t_s = k / 30
        postures = {name: (motion.q[k], t_s) for name, motion in zip("ab", motions, strict=True)}
        if k == 30:  # one is lost, and is somebody else under the same name
            people.forget("b")
            alone[1] = make_predictor("forecast", request)
            with pytest.raises(UsageError, match="b"):
                people.occupancy("ab", t_s)
        if k in (12, 15):  # what cannot be predicted from costs only whom it is of
            postures["b"] = np.full(12, np.nan), t_s
        troubles = people.update(postures)
        for name, predictor in zip("ab", alone, strict=True):
            if name in troubles:
                assert k in (12, 15)
                assert name == "b"
                continue
            expected = predictor.update(*postures[name])
            np.testing.assert_array_equal(
                people.predictions[name].occupancy.probability, expected.occupancy.probability
            )
            np.testing.assert_array_equal(
                people.predictions[name].posterior.probability, expected.posterior.probability
            )
        if not troubles:
            a, b = (people.predictions[name].occupancy.probability.astype(np.float64) for name in "ab")
            both = people.occupancy("ab", t_s)
            assert both.t_s == t_s
            np.testing.assert_allclose(both.probability, 1.0 - (1.0 - a) * (1.0 - b), atol=1e-3)
            np.testing.assert_array_equal(both.probability == 1.0, (a == 1.0) | (b == 1.0))
    assert people.predictions["a"].posterior.labels == LIBRARY.labels


def test_nobody_more_than_four_is_predicted_for_and_nobody_is_no_occupancy() -> None:
    grid = VoxelGrid((-1.0, -1.0, 0.0), 0.1, (20, 20, 20))
    people = PeoplePredictor(make_predictor("current", PredictorRequest(HUMAN, grid, np.eye(4))))
    q = LIBRARY.motions[0].q[0]
    troubles = people.update({name: (q, 0.0) for name in "abcde"})
    assert [*troubles] == ["e"]
    assert str(troubles["e"]).startswith("too many people")
    for names in ("", "ae"):
        with pytest.raises(UsageError, match="occupancy"):
            people.occupancy(names, 0.0)
    people.forget("b")
    assert not people.update({"e": (q, 0.1)})


def test_likely_of_several_is_never_certain() -> None:
    grid = VoxelGrid((0.0, 0.0, 0.0), 0.1, (2, 1, 1))
    near = Occupancy(grid, np.array([0.999, 1.0], dtype=np.float32).reshape(2, 1, 1))
    together = joined(near, near, near, t_s=2.0).probability.ravel()
    assert 0.999 <= together[0] < 1.0
    assert together[1] == 1.0
