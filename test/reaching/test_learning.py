"""Weights come with how sure they are and where they are from, and a file holds all of it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from reaching_people import MODEL, recording

from humanpred_ros.errors import ModelFileError, MotionError, UsageError
from humanpred_ros.motion.reach_recordings import Jump
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, FeatureConfig
from humanpred_ros.reaching.learning import LearningConfig, ReachLearner, ReachWeights
from humanpred_ros.reaching.piirl import PiirlConfig
from humanpred_ros.reaching.sampling import SamplingConfig
from humanpred_ros.reaching.splitting import SplittingConfig
from humanpred_ros.reaching.weights_file import load_weights, save_weights

CONFIG = LearningConfig(
    features=FeatureConfig(n_waypoints=30),
    splitting=SplittingConfig(every_s=0.2, least_s=0.6),
    sampling=SamplingConfig(n_samples=40, deviation=5e-3),
    piirl=PiirlConfig(normalised=True, with_demonstration=True, l2=0.1),
    bootstrap=5,
)
RECORDINGS = [recording(seed) for seed in range(3)]
RECORDINGS.append(dataclasses.replace(recording(3), jumps=(Jump("active", 95, "right_wrist", 7.0),)))


@pytest.fixture(scope="module")
def learner() -> ReachLearner:
    return ReachLearner(RECORDINGS, MODEL, CONFIG)


@pytest.fixture(scope="module")
def weights(learner: ReachLearner) -> ReachWeights:
    return learner.learn()


def test_weights_are_non_negative_and_tell_their_origin(weights: ReachWeights) -> None:
    assert (weights.weights >= 0.0).all()
    assert weights.bootstrap.shape == (5, N_FEATURES)
    assert np.isfinite(weights.spread).all()
    assert weights.provenance["recordings"] == ["made_up_0", "made_up_1", "made_up_2", "made_up_3"]
    assert weights.provenance["config"]["sampling"]["n_samples"] == 40
    assert weights.provenance["demonstrations"][:3] == ["made_up_0", "made_up_0+1", "made_up_0+21"]
    assert set(weights.provenance["samples"]) == {40}


def test_a_recording_with_a_jump_is_left_out_with_a_message(learner: ReachLearner, weights: ReachWeights) -> None:
    assert learner.names == ("made_up_0", "made_up_1", "made_up_2")
    (text,) = weights.provenance["left_out"]
    assert "made_up_3" in text
    assert "frame 95" in text
    with pytest.raises(MotionError, match="at least one demonstration"):
        learner.learn(["made_up_3"])


def test_leaving_one_out_forgets_it(learner: ReachLearner, weights: ReachWeights) -> None:
    some = learner.learn(["made_up_0", "made_up_1"], bootstrap=False)
    assert not any("made_up_2" in name for name in some.provenance["demonstrations"])
    assert (some.weights != weights.weights).any()
    alone = ReachLearner(RECORDINGS[:2], MODEL, CONFIG).learn(bootstrap=False)
    np.testing.assert_allclose(some.weights, alone.weights, rtol=1e-6)
    assert np.isnan(some.spread).all()


def test_the_same_seed_gives_the_same_weights(weights: ReachWeights) -> None:
    again = ReachLearner(RECORDINGS, MODEL, CONFIG).learn()
    np.testing.assert_array_equal(again.weights, weights.weights)
    np.testing.assert_array_equal(again.bootstrap, weights.bootstrap)
    other = ReachLearner(RECORDINGS, MODEL, dataclasses.replace(CONFIG, seed=1)).learn(bootstrap=False)
    assert (other.weights != weights.weights).any()


def test_weights_at_their_bound_are_named() -> None:
    config = dataclasses.replace(CONFIG, piirl=PiirlConfig(upper=1e-3), bootstrap=0)
    found = ReachLearner(RECORDINGS[:1], MODEL, config).learn()
    assert "posture velocity" in found.at_upper


def test_unknown_recordings_are_refused(learner: ReachLearner) -> None:
    with pytest.raises(UsageError, match="got tomorrow"):
        learner.learn(["tomorrow"])


def test_a_file_reads_back_as_the_same_weights(weights: ReachWeights, tmp_path: Path) -> None:
    path = tmp_path / "weights.json"
    save_weights(weights, path)
    found = load_weights(path)
    np.testing.assert_array_equal(found.weights, weights.weights)
    np.testing.assert_array_equal(found.bootstrap, weights.bootstrap)
    assert found.at_upper == weights.at_upper
    assert dict(found.provenance) == json.loads(json.dumps(dict(weights.provenance)))
    assert [entry.name for entry in tmp_path.iterdir()] == ["weights.json"]


def test_files_of_other_content_are_refused(weights: ReachWeights, tmp_path: Path) -> None:
    path = tmp_path / "weights.json"
    with pytest.raises(ModelFileError, match="could not be read"):
        load_weights(path)
    save_weights(weights, path)
    good = json.loads(path.read_text())
    for change, text in (
        ({"format": "something else"}, "wanted a file of"),
        ({"format_version": 99}, "wanted a file of"),
        ({"weights": {"speed": 1.0}}, "24 features"),
        ({"weights": {name: None for name in FEATURE_NAMES}}, "do not fit"),
        ({"bootstrap": "many"}, "do not fit"),
    ):
        path.write_text(json.dumps({**good, **change}))
        with pytest.raises(ModelFileError, match=text):
            load_weights(path)
    path.write_text("{")
    with pytest.raises(ModelFileError, match="could not be read"):
        load_weights(path)
    with pytest.raises(ModelFileError, match="could not be written"):
        save_weights(weights, tmp_path / "nowhere" / "weights.json")
