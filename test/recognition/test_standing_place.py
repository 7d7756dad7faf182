"""A person elsewhere is brought to the library's place; one who merely stands a little differently is not."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.errors import ArrayError
from humanpred_ros.recognition.standing_place import PlaceTracker, StandingPlace, start_pose

PLACE = StandingPlace(np.array([1.0, 2.0, 3.1]), np.array([0.03, 0.04, 0.08]))


def pelvis(x: float, y: float, yaw: float) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = x, y, 0.9
    return T


def observed(tracker: PlaceTracker, x: float, y: float, yaw: float) -> None:
    tracker.start()
    for _ in range(5):
        tracker.update(pelvis(x, y, yaw))


def test_within_the_spread_nothing_is_moved() -> None:
    tracker = PlaceTracker(PLACE)
    observed(tracker, 1.1, 1.9, 3.1 + 0.25)
    assert not tracker.elsewhere
    np.testing.assert_array_equal(tracker.R, np.eye(3))
    observed(tracker, 1.0, 2.0, 3.1 - 2 * np.pi)  # angles wrap
    assert not tracker.elsewhere


@pytest.mark.parametrize("pose", [(1.3, 2.0, 3.1), (1.0, 2.0, 2.7), (-4.0, 7.0, -1.0)])
def test_elsewhere_the_start_is_brought_to_the_place(pose: tuple[float, float, float]) -> None:
    tracker = PlaceTracker(PLACE)
    observed(tracker, *pose)
    assert tracker.elsewhere
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = tracker.R, tracker.p
    np.testing.assert_allclose(T @ pelvis(*pose), pelvis(*PLACE.pose), atol=1e-12)


def test_several_motions_from_one_place_sharpen_the_estimate() -> None:
    rng = np.random.default_rng(0)
    errors: list[list[float]] = []
    for _ in range(40):
        tracker = PlaceTracker(PLACE)
        for n in range(12):
            x, y, yaw = np.array([3.0, 0.0, 0.5]) + rng.normal(size=3) * PLACE.spread
            observed(tracker, x, y, yaw)
            goal = tracker.R @ np.array([3.0 + 0.8, 0.0, 0.7]) + tracker.p
            R, p = PLACE.alignment(np.array([3.0, 0.0, 0.5]))
            errors.append([n, float(np.linalg.norm(goal - (R @ np.array([3.8, 0.0, 0.7]) + p)))])
    n, error = np.array(errors).T
    assert error[n >= 9].mean() < 0.5 * error[n == 0].mean()


def test_whoever_walks_on_is_not_mixed_with_where_he_was() -> None:
    tracker = PlaceTracker(PLACE)
    for _ in range(5):
        observed(tracker, 3.0, 0.0, 0.5)
    observed(tracker, 5.0, 0.0, 0.5)
    R, p = PLACE.alignment(np.array([5.0, 0.0, 0.5]))
    np.testing.assert_allclose(tracker.p, p, atol=1e-12)
    np.testing.assert_allclose(tracker.R, R, atol=1e-12)


def test_postures_at_rest_do_not_crowd_out_motions() -> None:
    tracker = PlaceTracker(PLACE)
    for _ in range(10):
        observed(tracker, 3.0, 0.0, 0.5)
    for _ in range(200):
        tracker.start()
        tracker.update(pelvis(3.1, 0.1, 0.6))
    observed(tracker, 3.0, 0.0, 0.5)
    np.testing.assert_allclose(tracker.p, PLACE.alignment(np.array([3.0, 0.0, 0.5]))[1], atol=1e-12)


def test_only_the_first_postures_count() -> None:
    tracker = PlaceTracker(PLACE)
    observed(tracker, 1.0, 2.0, 3.1)
    for _ in range(50):
        tracker.update(pelvis(9.0, 9.0, 0.0))
    assert not tracker.elsewhere


def test_the_place_of_a_library_ignores_what_is_mistracked() -> None:
    rng = np.random.default_rng(1)
    poses = np.array([1.0, -2.0, np.pi]) + rng.normal(size=(200, 3)) * [0.03, 0.05, 0.1]
    poses[:, 2] = (poses[:, 2] + np.pi) % (2 * np.pi) - np.pi  # half of them just above -pi
    poses[7] = 75.0, 3.0, 0.0
    place = StandingPlace.of_starts(poses)
    np.testing.assert_allclose(place.pose[:2], [1.0, -2.0], atol=0.01)
    assert abs(abs(place.pose[2]) - np.pi) < 0.03
    np.testing.assert_allclose(place.spread, [0.03, 0.05, 0.1], rtol=0.25)


def test_a_start_is_the_median_of_the_first_postures() -> None:
    first = [pelvis(1.0, 2.0, 3.14), pelvis(1.0, 2.0, -3.14), pelvis(50.0, 2.0, 3.14)]
    x, y, yaw = start_pose(np.stack([*first, *[pelvis(1.0, 2.0, 3.14)] * 9]))
    assert (x, y) == (1.0, 2.0)
    assert abs(np.cos(yaw) + 1.0) < 1e-4


def test_impossible_places_are_refused() -> None:
    with pytest.raises(ArrayError, match="positive spreads"):
        StandingPlace(np.zeros(3), np.array([0.1, 0.0, 0.1]))
