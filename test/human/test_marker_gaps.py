"""Filling: what a rigid segment tells is exact, what time tells is bounded and short, and everything filled is told."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import MotionError
from humanpred_ros.human.marker_set import MarkerSet, pairwise_m
from humanpred_ros.human.marker_skeleton import fill_markers, measure_shapes
from humanpred_ros.human.model import HumanModel

HUMAN, SET = HumanModel.mocap23(), MarkerSet()
T_S = np.arange(60) * 0.01


def moving(frames: int = 60) -> np.ndarray:
    s = np.linspace(0, 1, frames)[:, None]
    q = np.zeros((frames, 23)) + 0.3 * np.sin(2 * s + np.arange(23))
    q[:, [9, 10, 11, 15, 19]] = (0.06, 0.22, 0.12, 0.38, 0.25)
    return SET.places(HUMAN, q)


def hidden(points: np.ndarray, *where: tuple[int, int, str]) -> np.ndarray:
    points = points.copy()
    for first, last, name in where:
        points[first : last + 1, SET.index[name]] = np.nan
    return points


def test_shapes_are_measured_in_spite_of_gaps() -> None:
    points = moving()
    gappy = hidden(points, (0, 57, "RH2"), (10, 20, "C7"), (0, 40, "RSF"))
    shapes = measure_shapes(SET, gappy)
    assert list(shapes) == list(SET.of_segment)
    for segment, shape in shapes.items():
        wanted = SET.local_m[SET.of_segment[segment]]
        np.testing.assert_allclose(pairwise_m(shape[None]), pairwise_m(wanted[None]), atol=1e-9)
    np.testing.assert_allclose(shapes["shoulder"], SET.local_m[SET.of_segment["shoulder"]], atol=1e-9)
    assert "hand" not in measure_shapes(SET, hidden(points, (0, 59, "RH2")))


def test_nothing_hidden_nothing_changed() -> None:
    points = moving()
    filled = fill_markers(SET, points, T_S, measure_shapes(SET, points))
    np.testing.assert_allclose(filled.points_m, points, atol=1e-12)
    assert not (filled.restored | filled.interpolated | filled.misplaced).any()


def test_three_markers_tell_the_fourth_and_one_of_the_shoulder_the_other() -> None:
    points = moving()
    gappy = hidden(points, (0, 59, "RH2"), (5, 50, "T8"), (5, 50, "IJ"), (20, 59, "RSB"), (0, 2, "RSF"))
    shapes = measure_shapes(SET, points)
    filled = fill_markers(SET, gappy, T_S, shapes)
    two_of_torso = np.zeros(60, dtype=bool)
    two_of_torso[5:51] = True
    assert np.isnan(filled.points_m[two_of_torso][:, [SET.index["T8"], SET.index["IJ"]]]).all()
    # without the torso's orientation nothing tells the other shoulder marker
    assert np.isnan(filled.points_m[20:51, SET.index["RSB"]]).all()
    rest = np.isfinite(filled.points_m)
    np.testing.assert_allclose(filled.points_m[rest], points[rest], atol=1e-9)
    assert filled.restored[51:, SET.index["RSB"]].all()
    assert filled.restored[:, SET.index["RH2"]].all()


@pytest.mark.parametrize(("frames", "bridged"), [(1, True), (10, True), (11, True), (12, False)])
def test_only_short_gaps_are_bridged(frames: int, bridged: bool) -> None:
    points = moving()
    gappy = hidden(points, *((20, 19 + frames, name) for name in ("RH2", "RH5", "RHD")))
    filled = fill_markers(SET, gappy, T_S, measure_shapes(SET, points), 0.1001)
    assert filled.interpolated.sum() == 3 * frames * bridged
    assert np.isfinite(filled.points_m).all() == bridged
    if bridged:
        np.testing.assert_allclose(filled.points_m, points, atol=5e-4)


def test_nothing_is_extrapolated() -> None:
    points = moving()
    gappy = hidden(points, *((first, last, name) for name in ("RH2", "RH5") for first, last in ((0, 3), (57, 59))))
    filled = fill_markers(SET, gappy, T_S, measure_shapes(SET, points))
    assert not filled.interpolated.any()
    assert np.isnan(filled.points_m[[0, 3, 57, 59]][:, SET.index["RH2"]]).all()


def test_a_bridge_over_noise_stays_near() -> None:
    points, names = moving(), ("RH2", "RH5", "RHD")
    for seed in range(10):
        noisy = points + np.random.default_rng(seed).normal(0, 0.002, points.shape)
        gappy = hidden(noisy, *((20, 27, name) for name in names))
        filled = fill_markers(SET, gappy, T_S, measure_shapes(SET, noisy))
        columns = [SET.index[name] for name in names]
        assert np.abs(filled.points_m[20:28, columns] - points[20:28, columns]).max() < 0.01


def test_stray_frames_next_to_a_gap_do_not_lead_it_astray() -> None:
    points = moving()
    alone = np.full(60, np.nan)
    alone[[10, 30, 36, 59]] = 1.0  # four single sights of the hand, two of them near enough to each other
    gappy = points.copy()
    own = SET.of_segment["hand"]
    gappy[:, own] *= alone[:, None, None]
    filled = fill_markers(SET, gappy, T_S, measure_shapes(SET, points))
    seen = np.isfinite(filled.points_m[:, own[0]]).all(axis=1)
    assert np.flatnonzero(seen).tolist() == [10, *range(30, 37), 59]
    np.testing.assert_allclose(filled.points_m[30:37, own], points[30:37, own], atol=0.005)


def test_a_misplaced_marker_is_replaced_and_two_of_a_segment_hide_it() -> None:
    points = moving()
    shapes = measure_shapes(SET, points)
    wrong = points.copy()
    wrong[30, SET.index["RUA"]] += 0.1
    filled = fill_markers(SET, wrong, T_S, shapes)
    np.testing.assert_allclose(filled.points_m, points, atol=1e-9)
    assert np.argwhere(filled.misplaced).tolist() == [[30, SET.index["RUA"]]]
    wrong[30, SET.index["REL"]] -= 0.2
    filled = fill_markers(SET, wrong, T_S, shapes)
    own = SET.of_segment["upper_arm"]
    assert filled.misplaced[30, own].all()
    assert filled.interpolated[30, own].all()
    np.testing.assert_allclose(filled.points_m, points, atol=1e-4)


def test_skin_moving_on_a_segment_is_no_misplacement() -> None:
    points = moving()
    shapes = measure_shapes(SET, points)
    soft = points + 0.008 * np.sin(np.arange(60)[:, None, None] / 9 + np.arange(22)[None, :, None])
    assert not fill_markers(SET, soft, T_S, shapes).misplaced.any()


def test_an_exchange_is_an_error_with_frame_and_names() -> None:
    points = moving()
    wrong = points.copy()
    a, b = SET.index["RH2"], SET.index["RHT"]
    wrong[30:, [a, b]] = points[30:, [b, a]]
    with pytest.raises(MotionError, match="in frame 30 the hand keeps its shape only with RH2 and RHT exchanged"):
        fill_markers(SET, wrong, T_S, measure_shapes(SET, points))
