"""The simulated depth camera spoils a skeleton in the ways it says, and in no other."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import ArrayError, SettingsError
from humanpred_ros.human.kinect import KinectSkeleton
from humanpred_ros.motion.motion import SKELETON_POINTS
from humanpred_ros.motion.synthetic import DepthCameraConfig, Observed, ReachGeneratorConfig, observe

POINTS = KinectSkeleton().points(np.array(ReachGeneratorConfig().rest_q))
LIMBS = np.array([name.endswith(("elbow", "hand", "knee", "foot")) for name in SKELETON_POINTS])
#: Sees perfectly.
CLEAR = DepthCameraConfig(
    stamp_jitter_s=0.0, noise_m=0.0, wander_m=0.0, frame_loss=0.0, losses_per_s=0.0, leg_losses_per_s=0.0, smoothing=0.0
)


def watch(config: DepthCameraConfig, seconds: float = 60.0, seed: int = 0) -> Observed:
    """Watch somebody who stands still."""
    t = np.arange(int(seconds * 30) + 1) / 30
    return observe(t, np.tile(POINTS, (len(t), 1, 1)), config, np.random.default_rng(seed))


def test_a_clear_camera_changes_nothing_but_the_last_digits() -> None:
    seen = watch(CLEAR, 2.0)
    assert len(seen.t_s) == 61
    np.testing.assert_allclose(np.diff(seen.t_s), 1 / 30)
    assert np.abs(seen.points_m - POINTS).max() <= CLEAR.step_m / 2
    np.testing.assert_array_equal(seen.points_m / CLEAR.step_m, np.round(seen.points_m / CLEAR.step_m))


def test_noise_is_larger_along_the_line_of_sight_and_on_limbs() -> None:
    error = watch(CLEAR.replaced(noise_m=0.01, limb_factor=2.0)).points_m - POINTS
    sight = POINTS - np.array(CLEAR.position_m)
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    along = np.einsum("tpi,pi->tp", error, sight)
    across = np.linalg.norm(error - along[..., None] * sight, axis=-1)
    np.testing.assert_allclose(across[:, LIMBS].std(), 0.02 * 0.655, rtol=0.1)  # Rayleigh: sqrt(2 - pi/2)
    np.testing.assert_allclose(along[:, LIMBS].std(), 2 * 0.02, rtol=0.1)
    torso = SKELETON_POINTS.index("torso")
    np.testing.assert_allclose(along[:, torso].std(), 2 * 0.01, rtol=0.1)


def test_the_trunk_trembles_as_one_piece() -> None:
    def sway(play: float) -> float:
        seen = watch(CLEAR.replaced(noise_m=0.01, depth_factor=1.0, trunk_play=play)).points_m
        left, right = (SKELETON_POINTS.index(f"{side}_shoulder") for side in ("left", "right"))
        return float(np.linalg.norm(seen[:, left] - seen[:, right], axis=1).std())

    assert sway(0.0) < 0.002 < sway(1.0)


def test_smoothing_halves_noise_and_lags() -> None:
    rough, smooth = (watch(CLEAR.replaced(noise_m=0.01, smoothing=s)).points_m - POINTS for s in (0.0, 0.6))
    # An exponential filter with factor s leaves sqrt((1 - s) / (1 + s)) of white noise.
    assert smooth.std() / rough.std() == pytest.approx(0.5, abs=0.03)
    assert smooth[0].std() / rough.std() == pytest.approx(0.5, abs=0.15)  # settled before the first frame
    t = np.arange(31) / 30
    walk = POINTS + t[:, None, None] * np.array([1.0, 0.0, 0.0])
    behind = (walk - observe(t, walk, CLEAR.replaced(smoothing=0.6), np.random.default_rng(0)).points_m)[-1, :, 0]
    np.testing.assert_allclose(behind, 0.6 / 0.4 / 30, atol=1e-3)  # s / (1 - s) frames at 1 m/s


def test_points_get_lost_for_a_while_and_come_back() -> None:
    config = CLEAR.replaced(losses_per_s=0.5, leg_losses_per_s=0.0, loss_s=0.2, smoothing=0.6)
    seen = watch(config, 200.0)
    lost = np.isnan(seen.points_m)
    assert (lost.all(axis=-1) == lost.any(axis=-1)).all()
    gone = lost[:, SKELETON_POINTS.index("neck"), 0]
    assert gone.mean() == pytest.approx(0.5 * 0.2 / (1 + 0.5 * 0.2), abs=0.03)
    assert not lost[:, SKELETON_POINTS.index("left_knee")].any()
    assert np.nanmax(np.abs(seen.points_m - POINTS)) <= CLEAR.step_m  # nothing is filled in or carried over


def test_frames_get_lost_and_stamps_stay_in_order() -> None:
    seen = watch(CLEAR.replaced(frame_loss=0.2, stamp_jitter_s=1.0), 100.0)
    assert len(seen.t_s) == pytest.approx(0.8 * 3001, rel=0.05)
    assert (np.diff(seen.t_s) > 0).all()
    assert np.diff(seen.t_s).std() > 0.01


def test_the_same_seed_sees_the_same() -> None:
    first, again, other = (watch(DepthCameraConfig(), 3.0, seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.points_m, again.points_m)
    np.testing.assert_array_equal(first.t_s, again.t_s)
    assert first.points_m.shape != other.points_m.shape or not np.array_equal(first.points_m, other.points_m)


@pytest.mark.parametrize(
    "bad", [{"rate_hz": 0.0}, {"smoothing": 1.0}, {"frame_loss": -0.1}, {"noise_m": float("nan")}, {"step_m": 0.0}]
)
def test_impossible_settings_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match=next(iter(bad))):
        DepthCameraConfig(**bad)


def test_what_is_watched_must_be_known() -> None:
    with pytest.raises(ArrayError, match="points_m"):
        observe(np.zeros(2), np.full((2, 15, 3), np.nan), CLEAR, np.random.default_rng(0))
