"""Points of any tracker become postures: every shipped skeleton, missing points, exchanged sides, who comes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.errors import ArrayError, UsageError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.skeleton_tracker import SkeletonTracker, TrackedPeople
from humanpred_ros.human.skeletons import POINTS, load_skeleton, person_points
from humanpred_ros.motion.library_io import load_library

SHIPPED = sorted(path.stem for path in (REPOSITORY / "config" / "skeletons").glob("*.yaml"))
HUMAN = HumanModel.kinect12()
MOTION = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0]
Q = MOTION.q
PERSON = person_points(HUMAN, Q)
PALM = POINTS.index("right_hand")
AT = {name: k for k, name in enumerate(POINTS)}


def palm_error_m(q: np.ndarray, frame: int) -> float:
    return float(np.linalg.norm(HUMAN.forward(q)["right_palm"] - PERSON[frame, PALM]))


def tracked(
    points: np.ndarray, skeleton: str = "openni15", tracker: SkeletonTracker | None = None, first_s: float = 0.0
):  # type: ignore[no-untyped-def]
    """Return the postures of a person's points (T, 18, 3) as this tracker shows them."""
    tracker = tracker or SkeletonTracker(skeleton)
    shown = tracker.skeleton.shown(points)
    return [tracker.update(frame, first_s + t) for frame, t in zip(shown, MOTION.t_s, strict=False)]


@pytest.mark.parametrize("name", SHIPPED)
def test_every_skeleton_gives_the_posture_back(name: str) -> None:
    skeleton = load_skeleton(name)
    tracker = SkeletonTracker(skeleton, np.eye(4))
    # Of points the tracker does not have, as a neck, only the proportions are known.
    for frame, points in enumerate(skeleton.shown(PERSON)):
        found = tracker.update(points, MOTION.t_s[frame])
        assert found.refusal == ""
        assert found.q is not None
        assert not found.lost
        assert palm_error_m(found.q, frame) < 0.04, frame
        elbow = HUMAN.forward(found.q)["right_elbow"]
        assert np.linalg.norm(elbow - PERSON[frame, AT["right_elbow"]]) < 0.02


def test_points_by_name_in_another_place_and_below_the_confidence() -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], (1.0, 2.0, 0.5)
    skeleton = load_skeleton("openni15")
    moved = PERSON[0] @ T[:3, :3].T + T[:3, 3]
    points = dict(zip(skeleton.names, skeleton.shown(PERSON[0]), strict=True))
    found = SkeletonTracker(skeleton, T).update(points, 0.0)
    assert found.q is not None
    np.testing.assert_allclose(HUMAN.forward(found.q)["right_palm"], moved[PALM], atol=0.02)
    sure = dict.fromkeys(skeleton.names, 1.0) | {"right_hand": 0.2}
    assert "right_hand" in SkeletonTracker(skeleton).update(points, 0.0, sure).lost
    with pytest.raises(ArrayError, match="right_paw"):
        SkeletonTracker(skeleton).update({"right_paw": (0, 0, 0)}, 0.0)
    with pytest.raises(ArrayError, match=r"wanted shape \(15, 3\), got \(14, 3\)"):
        SkeletonTracker(skeleton).update(np.zeros((14, 3)), 0.0)


@pytest.mark.parametrize(
    "missing", ["neck", "torso", "left_shoulder", "right_shoulder", "left_hip", "right_hip", "left_hip right_hip"]
)
def test_what_the_body_shows_otherwise_is_bridged(missing: str) -> None:
    points = PERSON.copy()
    points[10:, [AT[name] for name in (*missing.split(), "pelvis")]] = np.nan
    for frame, found in enumerate(tracked(points)[10:], start=10):
        assert found.q is not None, found.refusal
        assert set(missing.split()) <= set(found.bridged)
        assert palm_error_m(found.q, frame) < 0.08
        assert np.abs(HUMAN.forward(found.q)["neck"] - PERSON[frame, AT["neck"]]).max() < 0.08


def test_a_lost_hand_is_marked_and_then_no_posture() -> None:
    points = PERSON.copy()
    points[20:, [PALM, AT["right_wrist"]]] = np.nan
    found = tracked(points)
    assert [one.lost for one in found[19:21]] == [(), ("right_hand",)]
    assert {"rElbowZ", "rShoulderY"} <= set(found[20].held)
    late = [one for one in found[20:] if one.t_s - found[19].t_s > 0.25]
    assert {(one.q is None, one.refusal.split(":")[0]) for one in late} == {(True, "lost hand")}
    shown = [one for one in found[20:] if one.q is not None]
    assert shown[-1].q[HUMAN.dof_index["rElbowZ"]] == found[19].q[HUMAN.dof_index["rElbowZ"]]


@pytest.mark.parametrize("parts", ["shoulder elbow wrist hand hip knee foot", "elbow wrist hand", "hip"])
def test_sides_that_are_exchanged_for_some_frames_are_found(parts: str) -> None:
    points = PERSON.copy()
    left, right = ([AT[f"{side}_{part}"] for part in parts.split()] for side in ("left", "right"))
    points[15:22, left + right] = points[15:22, right + left]
    found = tracked(points)
    assert all(one.swapped for one in found[15:22])
    assert not any(one.swapped for one in (*found[:15], *found[22:]))
    for frame, one in enumerate(found):
        assert one.q is not None
        assert palm_error_m(one.q, frame) < 0.02


def test_who_is_shown_exchanged_for_long_turned_round() -> None:
    points = np.tile(PERSON[:1], (120, 1, 1)) + 1e-4 * np.random.default_rng(0).standard_normal((120, 18, 3))
    left, right = ([k for name, k in AT.items() if name.startswith(side)] for side in ("left", "right"))
    points[30:, left + right] = points[30:, right + left]
    tracker = SkeletonTracker("openni15")
    found = [tracker.update(tracker.skeleton.shown(frame), k / 30) for k, frame in enumerate(points)]
    assert [bool(found[k].swapped) for k in (31, 75, -1)] == [True, False, False]


def test_limbs_keep_the_lengths_of_the_first_seconds() -> None:
    rng = np.random.default_rng(1)
    points = np.tile(PERSON[:1], (150, 1, 1)) + 0.01 * rng.standard_normal((150, 18, 3))
    points[120, PALM] += 0.9 * (points[120, PALM] - points[120, AT["right_elbow"]])  # a flying pixel
    tracker = SkeletonTracker("openni15")
    found = [tracker.update(tracker.skeleton.shown(frame), k / 30) for k, frame in enumerate(points)]
    wanted = np.linalg.norm(PERSON[0, AT["right_elbow"]] - PERSON[0, AT["right_shoulder"]])
    assert tracker.lengths_m["right", "shoulder"] == pytest.approx(wanted, abs=0.01)
    lengths = [
        np.linalg.norm(one.points_m[AT["right_elbow"]] - one.points_m[AT["right_shoulder"]]) for one in found[70:]
    ]
    np.testing.assert_allclose(lengths, tracker.lengths_m["right", "shoulder"], atol=1e-9)
    assert found[120].lost == ("right_hand",)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: 1000.0 * p, ["units: wanted lengths in m", "mm, perhaps", "0.001"]),
        (lambda p: 100.0 * p, ["units", "cm, perhaps", "0.01"]),
        (lambda p: 39.37 * p, ["units", "inches"]),
        (lambda p: 3.0 * p, ["units", "times a person's"]),
        (lambda p: p @ np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], dtype=float), ["not upright", "-y", "optical"]),
        (lambda p: p * (1, 1, -1), ["not upright", "-z"]),
        (lambda p: np.full_like(p, np.nan), ["no points"]),
        (lambda p: np.zeros_like(p), ["no points"]),
    ],
)
def test_what_is_no_person_is_named(change, words: list[str]) -> None:  # type: ignore[no-untyped-def]
    found = tracked(change(PERSON[:3]))
    assert all(one.q is None for one in found)
    for word in words:
        assert word in found[-1].refusal


def test_a_jump_and_a_stamp_that_steps_back_are_refused_and_a_pause_is_not() -> None:
    tracker = SkeletonTracker("openni15")
    points = PERSON[:20].copy()
    points[10] += (2.0, 0.0, 0.0)
    found = tracked(points, tracker=tracker)
    assert found[9].q is not None
    assert found[10].refusal.startswith("jump: ")
    assert tracker.update(PERSON[5, :15], 0.1).refusal.startswith("stamp back: ")
    later = tracked(PERSON[:5] + np.array([2.0, 0.0, 0.0]), tracker=tracker, first_s=60.0)
    assert all(one.q is not None for one in later)


def test_people_keep_their_names_when_ids_change_and_get_them_back() -> None:
    people = TrackedPeople("openni15", most=2)
    here, there = PERSON[:, :15], PERSON[:, :15] + (0.0, 2.0, 0.0)

    def names(t_s: float, **bodies: np.ndarray) -> dict[str, str]:
        named = {}
        for name, posture in people.update({theirs: (points, None) for theirs, points in bodies.items()}, t_s):
            named[next(k for k, v in bodies.items() if np.allclose(v, posture.points_m, atol=0.05))] = name
        return named

    assert names(0.0, a=here[0]) == {"a": "body_0"}
    assert names(0.1, a=here[0], b=there[0]) == {"a": "body_0", "b": "body_1"}
    assert names(0.2, b=there[1]) == {"b": "body_1"}
    assert names(1.0, b=there[2], c=here[3]) == {"b": "body_1", "c": "body_0"}, "who stands there is who stood there"
    assert names(1.1, b=there[3], c=here[4], d=here[4] + (3.0, 0.0, 0.0)) == {"b": "body_1", "c": "body_0", "d": ""}
    assert names(9.0, e=here[0] + (5.0, 0.0, 0.0)) == {"e": "body_0"}, "a name that is free"


def test_bodies_that_are_only_listed_are_told_by_where_they_stand() -> None:
    people = TrackedPeople("openni15")
    shown = [PERSON[:, :15], PERSON[:, :15] + np.array([0.0, 2.0, 0.0])]
    for k in range(10):
        order = (0, 1) if k < 5 else (1, 0)  # the list is in another order
        bodies = {f"#{place}": (shown[who][k], None) for place, who in enumerate(order)}
        for name, posture in people.update(bodies, k / 30):
            who = ("body_0", "body_1").index(name)
            assert posture.q is not None, posture.refusal
            np.testing.assert_allclose(posture.points_m, shown[who][k], atol=0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"points": {"right_hand": "PAW"}}, ["right_hand", "PAW"]),
        ({"points": {"right_paw": "HAND_RIGHT"}}, ["right_paw", "right_hand"]),
        ({"points": {"head": "HEAD"}}, ["left_shoulder"]),
        ({"axes": ["right", "left", "up"]}, ["axes", "right, left, up"]),
        ({"unit": "furlong"}, ["unit", "'m'"]),
        ({"colour": "red"}, ["colour"]),
        ({"like": "nobody"}, ["nobody", "azure_kinect"]),
    ],
)
def test_a_skeleton_file_that_cannot_be_used_is_refused_with_what_is_wrong(
    change: dict[str, object], words: list[str], tmp_path: Path
) -> None:
    import yaml

    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump({"like": "azure_kinect", **change}))
    with pytest.raises(UsageError) as caught:
        load_skeleton(path)
    for word in words:
        assert word in str(caught.value)


def test_a_centred_skeleton_needs_a_place() -> None:
    with pytest.raises(UsageError, match="where the person stands"):
        SkeletonTracker("mediapipe33")
