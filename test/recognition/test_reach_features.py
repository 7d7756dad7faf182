"""Features of a reach know neither time nor speed, forgive one wild posture, and move with the person."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import HumanModelError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.recognition.reach_features import (
    DISTANCES,
    FAR,
    HEADINGS,
    N_FEATURES,
    REACHED,
    ROPES,
    in_library_frame,
    motion_features,
    point_links,
)

START = np.array([[0.1, -0.2, 0.9], [0.0, -0.3, 1.1], [0.0, -0.3, 1.4], [0.0, 0.0, 1.5]])
GOAL = np.array([[0.6, -0.1, 1.0], [0.3, -0.25, 1.15], [0.05, -0.28, 1.4], [0.03, 0.0, 1.5]])


def reach(n_frames: int, there_and_back: bool = True) -> np.ndarray:
    """Return (T, 4, 3) points on a smooth reach, standing still for the first tenth."""
    phase = np.clip((np.linspace(0.0, 1.0, n_frames) - 0.1) / 0.9, 0.0, 1.0)
    share = np.sin(np.pi * phase) ** 2 if there_and_back else phase**3 * (10 - 15 * phase + 6 * phase**2)
    return START + share[:, None, None] * (GOAL - START)


@pytest.mark.parametrize("faster", [0.5, 0.7, 1.4, 2.0])
def test_the_speed_leaves_no_trace(faster: float) -> None:
    usual, other = motion_features(reach(200)), motion_features(reach(round(200 / faster)))
    at = np.linspace(0.15, 1.0, 12)
    a, b = usual[np.round(at * 199).astype(int)], other[np.round(at * (len(other) - 1)).astype(int)]
    # Frames do not fall on the same postures, and the median of three lags by one of them.
    assert np.abs(a - b)[:, :HEADINGS].max() < 0.03
    assert np.abs(a - b)[:, DISTANCES:].max() < 0.08
    long_ropes = [HEADINGS + 3 * i + k for i, (point, length) in enumerate(ROPES) if length > 0.1 for k in range(3)]
    assert np.abs(a - b)[:, long_ropes].max() < 0.15


def test_on_the_way_back_the_farthest_point_is_remembered() -> None:
    features = motion_features(reach(100))
    np.testing.assert_allclose(features[-1, FAR : FAR + 12].reshape(4, 3), GOAL, atol=2e-3)
    np.testing.assert_allclose(features[-1, :12].reshape(4, 3), START, atol=2e-3)
    far = np.linalg.norm(GOAL[0] - START[0])
    assert features[-1, REACHED] == pytest.approx(far, abs=2e-3)
    assert features[-1, DISTANCES] == pytest.approx(0.0, abs=2e-3)


def test_headings_point_where_the_palm_goes() -> None:
    features = motion_features(reach(100, there_and_back=False))
    direction = (GOAL[0] - START[0]) / np.linalg.norm(GOAL[0] - START[0])
    for rope, (point, _) in enumerate(ROPES):
        if point == 0:
            heading = features[60, HEADINGS + 3 * rope : HEADINGS + 3 * rope + 3]
            np.testing.assert_allclose(heading, direction, atol=1e-6)


def test_noise_shorter_than_a_rope_does_not_drag_it() -> None:
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 4, 3))
    points = START + 0.009 * noise / np.linalg.norm(noise, axis=-1, keepdims=True)
    features = motion_features(points)
    lengths = np.linalg.norm(features[:, HEADINGS:DISTANCES].reshape(300, len(ROPES), 3), axis=-1)
    assert (lengths <= 1.0 + 1e-9).all()
    assert (lengths[:, 1] < 0.4).all()  # the 5 cm rope of the palm: 18 mm at most


def test_one_wild_posture_is_forgiven() -> None:
    calm = reach(100)
    wild = calm.copy()
    wild[40] += 5.0
    difference = np.abs(motion_features(wild) - motion_features(calm))
    assert difference[43:, :FAR].max() == 0.0
    assert difference[:, :FAR].max() < 0.03  # the median stays among the neighbours
    assert difference[43:, REACHED].max() < 0.02


@settings(max_examples=25)
@given(
    yaw=st.floats(-np.pi, np.pi),
    shift=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    seed=st.integers(0, 100),
)
def test_a_moved_reach_has_moved_features(yaw: float, shift: tuple[float, float, float], seed: int) -> None:
    points = reach(60) + np.random.default_rng(seed).normal(0.0, 0.01, (60, 4, 3))
    c, s = np.cos(yaw), np.sin(yaw)
    R, p = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array(shift)
    # The median per axis is not rotated exactly with the points, so quarter turns are exact and others near.
    moved = in_library_frame(motion_features(points), R, p)
    np.testing.assert_allclose(motion_features(points @ R.T + p)[-1, :FAR], moved[-1, :FAR], atol=0.03)


def test_quarter_turns_and_shifts_are_exact() -> None:
    points = reach(60) + np.random.default_rng(3).normal(0.0, 0.01, (60, 4, 3))
    R, p = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([0.5, -0.25, 0.0])
    moved = in_library_frame(motion_features(points), R, p)
    np.testing.assert_allclose(motion_features(points @ R.T + p), moved, atol=1e-5)


def test_a_human_without_the_links_is_refused() -> None:
    human = HumanModel(HumanModel.kinect12().urdf.replace('"neck"', '"throat"'))
    with pytest.raises(HumanModelError, match="neck missing"):
        point_links(human)
    assert len(motion_features(reach(10))[0]) == N_FEATURES
