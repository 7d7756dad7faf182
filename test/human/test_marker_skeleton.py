"""Markers to the 23 DoFs: exact without noise, bounded with it, and wrong or missing markers told by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_centres import joint_centres
from paths import shared_data

from humanpred_ros.errors import ArrayError, HumanModelError, MotionError
from humanpred_ros.human.marker_set import UPPER_BODY, Marker, MarkerSet, pairwise_m
from humanpred_ros.human.marker_skeleton import MarkerSkeleton, fill_markers, measure_shapes
from humanpred_ros.human.model import HumanModel

skeleton = MarkerSkeleton()
recorded_skeleton = MarkerSkeleton(upright_pelvis=True)
COLUMN = skeleton.markers.index
DOF = skeleton.model.dof_index
ANGLES = [i for name, i in DOF.items() if "Trans" not in name]
STANDING = np.array([
    2.1, 0.8, 1.14, 0.02, -0.03, 1.9, -0.05, -0.1, 0.05, 0.08, 0.21, 0.14,
    -0.4, -0.6, 1.9, 0.40, -0.9, -0.9, 0.4, 0.245, 0.2, 0.1, 0.05,
])  # fmt: skip
REACHING = np.array([
    2.0, 0.85, 1.12, 0.05, 0.04, 2.3, -0.1, -0.5, 0.2, 0.06, 0.25, 0.09,
    0.8, -1.3, 1.2, 0.38, -2.4, -1.2, -1.2, 0.243, 0.4, -0.3, -0.2,
])  # fmt: skip


def reach(frames: int = 80) -> tuple[np.ndarray, np.ndarray]:
    s = np.linspace(0, 1, frames)
    share = 10 * s**3 - 15 * s**4 + 6 * s**5
    return s, STANDING + share[:, None] * (REACHING - STANDING)


def recordings() -> list[tuple[str, np.ndarray, np.ndarray]]:
    tables = {f.stem: np.loadtxt(f, delimiter=",", skiprows=1) for f in sorted(shared_data("icra2015").glob("*/*.csv"))}
    return [(name, table[:, 0], table[:, 1:]) for name, table in tables.items()]


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    gap = a - b
    gap[..., ANGLES] = (gap[..., ANGLES] + np.pi) % (2 * np.pi) - np.pi
    return np.abs(gap)


def centre_error_m(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    found, wanted = joint_centres(skeleton.model, a), joint_centres(skeleton.model, b)
    return np.array([np.linalg.norm(found[name] - wanted[name], axis=1).max() for name in found])


def hide(points: np.ndarray, frames: slice, *names: str) -> np.ndarray:
    hidden = points.copy()
    hidden[frames, [COLUMN[name] for name in names]] = np.nan
    return hidden


def exchange(points: np.ndarray, frames: slice, a: str, b: str) -> np.ndarray:
    swapped = points.copy()
    swapped[frames, COLUMN[a]], swapped[frames, COLUMN[b]] = points[frames, COLUMN[b]], points[frames, COLUMN[a]]
    return swapped


def test_recorded_postures_come_back_exactly() -> None:
    for name, t, q in recordings():
        found = skeleton.postures(skeleton.points(q), t)
        assert difference(found.require_complete(name), q).max() < 1e-9, name
        assert not found.markers.misplaced.any()
        assert np.abs(np.diff(found.q[:, ANGLES], axis=0)).max() < np.pi  # unwrapped


def test_recorded_postures_come_back_from_noisy_markers() -> None:
    for k, (name, t, q) in enumerate(recordings()):
        points = skeleton.points(q) + np.random.default_rng(k).normal(0, 0.002, (len(q), len(COLUMN), 3))
        found = recorded_skeleton.postures(points, t).require_complete(name)
        assert centre_error_m(found, q).max() < 0.012, name
        error = difference(found, q)
        assert (found[:, [DOF["PelvisRotX"], DOF["PelvisRotY"]]] == 0).all()
        assert error[:, [DOF["rArmTrans"], DOF["rForeArmTrans"]]].max() < 0.012
        assert error[:, [DOF["PelvisRotZ"], DOF["TorsoX"], DOF["TorsoZ"], DOF["TorsoY"]]].max() < 0.08
        # elsewhere the elbow comes near to +-90 degrees, where its other two angles are hardly seen apart
        assert np.median(error, axis=0).max() < 0.08, name


@settings(max_examples=100)
@given(seed=st.integers(0, 10_000))
def test_random_postures_come_back_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(
        [-3, -3, 0.5, -0.8, -0.8, -3.1, -1.4, -1.4, -0.9, -0.05, 0.15, 0.05, -3.1, -3.1, -3.1, 0.25, -3.1, -1.5, -3.1,
         0.18, -3.1, -1.5, -3.1],
        [3, 3, 1.5, 0.8, 0.8, 3.1, 1.4, 1.4, 0.9, 0.12, 0.3, 0.2, 3.1, -0.05, 3.1, 0.5, 3.1, 1.5, 3.1, 0.5, 3.1, 1.5,
         3.1],
    )[None]  # fmt: skip
    q[:, 3:9] *= 0.5  # waist and torso upright enough to be told from upside down
    found = skeleton.postures(skeleton.points(q), [0.0])
    assert found.complete.all()
    assert difference(found.q, q).max() < 1e-9


@pytest.mark.parametrize("hidden", [marker.name for marker in UPPER_BODY])
def test_one_hidden_marker_of_a_segment_changes_nothing(hidden: str) -> None:
    t, q = reach()
    found = skeleton.postures(hide(skeleton.points(q), slice(20, None), hidden), t)
    assert difference(found.require_complete(), q).max() < 1e-9
    assert found.markers.restored[20:, COLUMN[hidden]].all()
    assert found.markers.restored.sum() == 60
    assert not found.markers.interpolated.any()


def test_a_calibrated_skeleton_knows_markers_never_seen_in_the_recording() -> None:
    t, q = reach()
    everywhere = slice(None)
    points = hide(skeleton.points(q), everywhere, "REM", "RUS", "RSB", "C7", "RH5", "RPSI")
    with pytest.raises(MotionError, match="calibrate on a trial"):
        skeleton.postures(points, t)
    calibrated = skeleton.calibrated(skeleton.points(STANDING[None]))
    assert difference(calibrated.postures(points, t).require_complete(), q).max() < 1e-9
    with pytest.raises(MotionError, match=r"all markers of the hand \(RH2, RH5, RHD, RHT\), got none"):
        skeleton.calibrated(hide(skeleton.points(q), everywhere, "RHT"))


def test_a_short_gap_of_a_whole_segment_is_bridged_and_told() -> None:
    t, q = reach()
    hand = ("RH2", "RH5", "RHD", "RHT")
    points = hide(skeleton.points(q), slice(30, 38), *hand)
    found = skeleton.postures(points, t)
    assert found.markers.interpolated[30:38, [COLUMN[name] for name in hand]].all()
    assert found.markers.interpolated.sum() == 32
    assert centre_error_m(found.require_complete(), q).max() < 0.005
    assert difference(found.q, q)[:, : DOF["rWristZ"]].max() < 1e-9


def test_a_long_gap_stays_open_and_harms_only_what_depends_on_it() -> None:
    t, q = reach()
    points = hide(skeleton.points(q), slice(30, 50), "RRS", "RUS")
    found = skeleton.postures(points, t)
    wanted = np.ones_like(q, dtype=bool)
    wanted[30:50, DOF["rElbowZ"] :] = False
    np.testing.assert_array_equal(np.isfinite(found.q), wanted)
    assert difference(found.q, q)[wanted].max() < 1e-9
    assert not found.complete[30:50].any()
    assert found.complete.sum() == 60
    with pytest.raises(MotionError, match=r"take 7: .*forearm \(RRS, RUS, RFA, RFB\) in 20 frames from 30 to 49"):
        found.require_complete("take 7")
    patient = MarkerSkeleton(longest_gap_s=0.5)
    assert patient.postures(points, t).complete.all()


def test_noise_and_gaps_together_stay_bounded() -> None:
    t, q = reach(150)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        points = skeleton.points(q) + rng.normal(0, 0.002, (150, len(COLUMN), 3))
        points[1:-1][rng.uniform(size=(148, len(COLUMN))) < 0.05] = np.nan  # nothing bridges a gap at the ends
        found = skeleton.postures(points, t).require_complete()
        assert centre_error_m(found, q).max() < 0.02


def test_a_single_wrong_detection_is_left_out_and_told() -> None:
    t, q = reach()
    points = skeleton.points(q)
    points[40, COLUMN["RRS"]] += (0.07, 0.0, 0.05)  # as in the recordings: a jump of 7 m/s
    found = skeleton.postures(points, t)
    assert list(np.argwhere(found.markers.misplaced)[0]) == [40, COLUMN["RRS"]]
    assert found.markers.misplaced.sum() == 1
    assert difference(found.require_complete(), q).max() < 1e-9


def test_a_displaced_marker_moves_its_joint_centre_by_less_than_half_of_it() -> None:
    t, q = reach()
    points = skeleton.points(q)
    points[40, COLUMN["RRS"]] += (0.0, 0.0, 0.008)
    assert centre_error_m(skeleton.postures(points, t).require_complete(), q)[4] < 0.004


SWAPS = [
    ("REL", "REM"),
    ("RUA", "REL"),
    ("RH2", "RH5"),
    ("RRS", "RUS"),
    ("PX", "T8"),
    ("LASI", "RASI"),
    ("LASI", "LPSI"),
]


@pytest.mark.parametrize(("a", "b"), SWAPS)
@pytest.mark.parametrize("frames", [slice(30, 40), slice(None)], ids=["some frames", "all frames"])
def test_labels_swapped_within_a_segment_are_named(a: str, b: str, frames: slice) -> None:
    t, q = reach()
    with pytest.raises(MotionError, match=f"({a}|{b}) and ({a}|{b}) exchanged; the labels are swapped"):
        skeleton.postures(exchange(skeleton.points(q), frames, a, b), t)


def test_labels_swapped_between_segments_are_named() -> None:
    t, q = reach()
    with pytest.raises(MotionError, match=r"of the (forearm|upper_arm) are .* m apart, the marker set has"):
        skeleton.postures(exchange(skeleton.points(q), slice(None), "REL", "RRS"), t)
    # for a while only, they count as false detections, which the segments' other markers replace
    found = skeleton.postures(exchange(skeleton.points(q), slice(30, 40), "REL", "RRS"), t)
    assert found.markers.misplaced.sum() == 20
    assert difference(found.require_complete(), q).max() < 1e-9


def test_front_and_back_of_the_shoulder_swapped_is_named() -> None:
    t, q = reach()
    with pytest.raises(MotionError, match="RSF and RSB exchanged"):
        skeleton.postures(exchange(skeleton.points(q), slice(None), "RSF", "RSB"), t)


def test_left_and_right_of_the_waist_swapped_is_named() -> None:
    t, q = reach()
    points = exchange(exchange(skeleton.points(q), slice(None), "LASI", "RASI"), slice(None), "LPSI", "RPSI")
    with pytest.raises(MotionError, match="labels of left and right"):
        skeleton.postures(points, t)


def test_lengths_in_millimetres_are_noticed() -> None:
    t, q = reach()
    with pytest.raises(MotionError, match="wrong labels, or lengths not in metres"):
        skeleton.postures(1000 * skeleton.points(q), t)


def test_too_few_markers_are_named() -> None:
    t, q = reach()
    points = hide(skeleton.points(q), slice(None), "RH2", "RHT")
    with pytest.raises(MotionError, match=r"determines the hand: .*3 of 4 markers \(RH2, RH5, RHD, RHT\).* at most 2"):
        skeleton.postures(points, t)
    with pytest.raises(MotionError, match="no frame determines the waist"):
        skeleton.postures(np.full_like(points, np.nan), t)


def test_other_bad_input_is_named() -> None:
    t, q = reach(5)
    points = skeleton.points(q)
    with pytest.raises(ArrayError, match="points_m"):
        skeleton.postures(points[:, :-1], t)
    with pytest.raises(ArrayError, match="t_s"):
        skeleton.postures(points, t[:-1])
    with pytest.raises(ArrayError, match="t_s"):
        skeleton.postures(points, t * np.nan)
    with pytest.raises(MotionError, match="rising stamps"):
        skeleton.postures(points, t[::-1])
    with pytest.raises(MotionError, match="at least one frame"):
        skeleton.postures(points[:0], t[:0])
    with pytest.raises(HumanModelError, match="wanted its 12 DoFs"):
        MarkerSkeleton(HumanModel.kinect12())
    with pytest.raises(HumanModelError, match="lacks the links right_hand"):
        MarkerSkeleton(HumanModel(skeleton.model.urdf.replace('"right_hand"', '"right_mitten"')))


@pytest.mark.parametrize(
    ("markers", "said"),
    [
        ((*UPPER_BODY, UPPER_BODY[0]), "names given twice: LASI"),
        ((*UPPER_BODY, Marker("LKN", "left_leg", (0, 0, 0))), "unknown segments: left_leg"),
        (UPPER_BODY[1:], "markers lacking: LASI"),
        ((Marker("LASI", "torso", (0, 0, 0)), *UPPER_BODY[1:]), "another segment than theirs: LASI"),
    ],
)
def test_unusable_marker_sets_are_refused(markers: tuple[Marker, ...], said: str) -> None:
    with pytest.raises(HumanModelError, match=said):
        MarkerSet(markers)


def test_postures_do_not_depend_on_where_the_plates_are_put() -> None:
    rng = np.random.default_rng(3)
    plates = {"RUA", "RUB", "RFA", "RFB", "RHD", "RHT"}
    moved = MarkerSet(
        [Marker(m.name, m.segment, tuple(np.add(m.local_m, rng.normal(0, 0.01, 3) * (m.name in plates))))
         for m in UPPER_BODY]
    )  # fmt: skip
    t, q = reach()
    assert difference(skeleton.postures(moved.places(skeleton.model, q), t).require_complete(), q).max() < 1e-9


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
