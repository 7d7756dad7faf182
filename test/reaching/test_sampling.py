"""Samples are smooth variations of their demonstration; impossible ones are replaced, and said so when all are."""

from __future__ import annotations

import numpy as np
import pytest
from reaching_people import MODEL, recording

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.demonstrations import demonstration
from humanpred_ros.reaching.features import ReachFeatures
from humanpred_ros.reaching.sampling import SamplingConfig, sample_around
from humanpred_ros.reaching.stencils import standard_deviation

FEATURES = ReachFeatures(MODEL)
DEMO = demonstration(recording(1), FEATURES)
HAND = MODEL.dof_names.index("rElbowZ")


def rng() -> np.random.Generator:
    return np.random.default_rng(4)


class RightHalf:
    """A wall through the demonstration."""

    def __call__(self, q: FloatArray) -> np.ndarray:
        return q[:, 50, HAND] > DEMO.q[50, HAND]

    def usual_touch(self, q: FloatArray) -> str:
        return "elbow into the wall"


class Everywhere(RightHalf):
    def __call__(self, q: FloatArray) -> np.ndarray:
        return np.ones(len(q), dtype=bool)


right_half = RightHalf()


def test_samples_scatter_about_the_demonstration_as_asked() -> None:
    config = SamplingConfig(n_samples=400)
    found = sample_around(DEMO, config, rng())
    samples = found.q
    assert found.collided == 0
    assert samples.shape == (400, 100, 23)
    off = samples - DEMO.q
    wanted = config.deviation * standard_deviation(100)
    np.testing.assert_allclose(off.std(axis=(0, 2)), wanted, rtol=0.06)
    assert wanted[50] == pytest.approx(0.112, abs=1e-3)  # rad and m, facts section 5
    assert np.abs(off[:, [0, -1]]).max() < 1e-3


def test_a_demonstration_is_smoother_than_its_samples() -> None:
    own = FEATURES.values(DEMO.q, DEMO.situation)
    others = FEATURES.values(sample_around(DEMO, SamplingConfig(n_samples=50), rng()).q, DEMO.situation)
    assert (others[:, [1, 4, 5]] > own[[1, 4, 5]]).mean() > 0.85


def test_colliding_samples_are_replaced() -> None:
    for seed in range(8):
        samples = sample_around(DEMO, SamplingConfig(n_samples=20), np.random.default_rng(seed), right_half)
        assert len(samples.q) == 20
        assert not right_half(samples.q).any()
        assert 4 < samples.collided < 60  # about half of all


def test_if_some_are_lacking_in_the_end_fewer_are_returned() -> None:
    samples = sample_around(DEMO, SamplingConfig(n_samples=60, attempts=1), rng(), right_half)
    assert 10 < len(samples.q) < 50
    assert samples.collided + len(samples.q) == 60
    assert not right_half(samples.q).any()


def test_if_all_collide_the_demonstration_is_named() -> None:
    with pytest.raises(MotionError, match=r"made_up_1.*all 3 x 20 do, most with elbow into the wall"):
        sample_around(DEMO, SamplingConfig(n_samples=20, attempts=3), rng(), Everywhere())


@pytest.mark.parametrize("bad", [{"n_samples": 0}, {"attempts": 0}, {"deviation": 0.0}, {"deviation": np.nan}])
def test_impossible_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="sampling"):
        SamplingConfig(**bad)  # type: ignore[arg-type]
