"""Clusters placed on measured points: exact placements, no mirror images, and shapes that outliers do not bend."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humanpred_ros.human.marker_set import groups_of, is_spread, mean_shape, misfit_m, pairwise_m, place

SHAPE = np.array([[0.0, -0.05, 0.0], [0.0, 0.05, 0.0], [-0.01, -0.05, 0.16], [-0.05, -0.01, 0.09]])


def placed(seed: int, frames: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    R = Rotation.random(frames, random_state=seed).as_matrix()
    p = rng.normal(0, 2, (frames, 3))
    return R, p, np.einsum("tij,kj->tki", R, SHAPE) + p[:, None]


@settings(max_examples=50)
@given(seed=st.integers(0, 1000), seen=st.sampled_from([[0, 1, 2, 3], [0, 1, 2], [1, 2, 3], [0, 2, 3]]))
def test_the_placement_comes_back(seed: int, seen: list[int]) -> None:
    R, p, points = placed(seed)
    found_R, found_p = place(SHAPE[seen], points[:, seen])
    np.testing.assert_allclose(found_R, R, atol=1e-9)
    np.testing.assert_allclose(found_p, p, atol=1e-9)


def test_a_mirror_image_does_not_fit() -> None:
    mirrored = SHAPE * (1, -1, 1)
    R, _ = place(SHAPE, mirrored[None])
    assert np.linalg.det(R[0]) == pytest.approx(1.0)
    assert misfit_m(SHAPE, mirrored[None]).max() > 0.01


def test_only_clusters_off_a_line_show_a_rotation() -> None:
    assert is_spread(SHAPE)
    assert is_spread(SHAPE[:3])
    assert not is_spread(SHAPE[:2])
    assert not is_spread(SHAPE[:0])
    assert not is_spread(np.outer(np.arange(4), [0.1, 0.2, 0.0]))


def test_the_mean_shape_ignores_a_minority_of_displaced_points() -> None:
    *_, points = placed(3, frames=15)
    points[[2, 9, 11], [0, 3, 1]] += 0.3
    np.testing.assert_allclose(pairwise_m(mean_shape(points)[None]), pairwise_m(SHAPE[None]), atol=1e-9)
    np.testing.assert_allclose(mean_shape(points).mean(axis=0), 0.0, atol=1e-12)


def test_the_mean_shape_averages_noise() -> None:
    *_, points = placed(4, frames=200)
    noisy = points + np.random.default_rng(0).normal(0, 0.002, points.shape)
    assert np.abs(pairwise_m(mean_shape(noisy)[None]) - pairwise_m(SHAPE[None])).max() < 0.001


def test_frames_are_grouped_by_what_they_show() -> None:
    mask = np.array([[1, 1, 0], [1, 0, 1], [1, 1, 0]], dtype=bool)
    groups = {tuple(row): frames.tolist() for row, frames in groups_of(mask)}
    assert groups == {(True, True, False): [0, 2], (True, False, True): [1]}
    assert groups_of(mask[:0]) == []
