"""A motion begins when the hand leaves its rest for good and ends when it is back, whatever rate and noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humanpred_ros.errors import ArrayError, MotionError
from humanpred_ros.recognition.onset import MotionState, OnsetConfig, OnsetDetector

REST = np.array([[0.1, -0.25, -0.2], [0.0, -0.3, 0.1], [0.0, 0.0, 0.5]])
GOAL = np.array([[0.6, -0.1, 0.1], [0.3, -0.25, 0.25], [0.05, 0.0, 0.5]])


def stream(
    *, rate_hz: float = 60.0, rest_s: float = 3.0, reach_s: float = 1.6, dwell_s: float = 0.3, noise_m: float = 0.003,
    seed: int = 0, back: bool = True,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Return stamps and points (T, 3, 3): rest, reach, dwell, back, rest."""
    half = reach_s / 2
    end = rest_s + half + dwell_s
    t = np.arange(0.0, end + half + rest_s, 1.0 / rate_hz)

    def smooth(x: np.ndarray) -> np.ndarray:
        x = np.clip(x, 0.0, 1.0)
        return x**3 * (10 - 15 * x + 6 * x**2)

    share = smooth((t - rest_s) / half) - (smooth((t - end) / half) if back else 0.0)
    points = REST + share[:, None, None] * (GOAL - REST)
    return t, points + np.random.default_rng(seed).normal(0.0, noise_m, points.shape)


def states(t: np.ndarray, points: np.ndarray, detector: OnsetDetector | None = None) -> list[MotionState]:
    detector = OnsetDetector() if detector is None else detector
    return [detector.update(x, float(stamp)) for x, stamp in zip(points, t, strict=True)]


@settings(max_examples=25)
@given(
    rate_hz=st.sampled_from([30.0, 60.0, 100.0]),
    reach_s=st.floats(1.0, 3.0),
    dwell_s=st.floats(0.0, 0.8),
    seed=st.integers(0, 1000),
)
def test_out_and_back_is_one_motion_found_in_time(rate_hz: float, reach_s: float, dwell_s: float, seed: int) -> None:
    t, points = stream(rate_hz=rate_hz, reach_s=reach_s, dwell_s=dwell_s, seed=seed)
    found = states(t, points)
    moving = np.array([state.moving for state in found])
    assert found[-1].n_motions == 1
    begun = t[np.argmax(moving)]
    # A tenth of the way out is where anybody would say that it has begun.
    tenth = t[np.argmax(np.linalg.norm(points[:, 0] - REST[0], axis=1) > 0.06)]
    assert 3.0 <= begun <= tenth + 0.2
    assert not moving[-1]
    assert t[len(moving) - 1 - np.argmax(moving[::-1])] <= 3.0 + reach_s + dwell_s + 0.8
    assert abs(found[np.argmax(moving)].since_s - 3.0) < 0.25 * reach_s


def test_standing_with_noise_is_no_motion() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 120.0, 1 / 30)
    sway = 0.02 * np.sin(2 * np.pi * t / 20.0)[:, None, None]
    assert states(t, REST + sway + rng.normal(0.0, 0.004, (len(t), 3, 3)))[-1].n_motions == 0


def test_one_mistracked_frame_starts_nothing() -> None:
    t, points = stream()
    points[100] += 3.0
    assert not any(state.moving for state, stamp in zip(states(t, points), t, strict=True) if stamp < 3.0)


def test_who_stays_at_the_goal_rests_there_after_a_while() -> None:
    t, points = stream(rest_s=4.0, back=False)
    found = states(t, points)
    moving = np.array([state.moving for state in found])
    assert found[-1].n_motions == 1
    assert not moving[-1]
    ended = t[len(moving) - 1 - np.argmax(moving[::-1])]
    assert 4.8 + 1.0 < ended < 4.8 + OnsetConfig().far_s + 0.5


def test_a_gap_ends_what_was() -> None:
    t, points = stream()
    k = int(np.argmax(t > 3.6))
    detector = OnsetDetector()
    assert states(t[:k], points[:k], detector)[-1].moving
    assert not detector.update(points[k], float(t[k]) + OnsetConfig().gap_s + 0.1).moving


@pytest.mark.parametrize(
    ("points", "t_s", "error"),
    [
        (np.full((3, 3), np.nan), 5.0, ArrayError),
        (np.zeros((2, 3)), 5.0, ArrayError),
        (REST, float("nan"), MotionError),
        (REST, 0.0, MotionError),
    ],
)
def test_what_cannot_be_used_changes_nothing(points: np.ndarray, t_s: float, error: type[Exception]) -> None:
    t, good = stream()
    with_bad, without = OnsetDetector(), OnsetDetector()
    for k, (x, stamp) in enumerate(zip(good, t, strict=True)):
        assert with_bad.update(x, float(stamp)) == without.update(x, float(stamp))
        if k % 50 == 49:
            with pytest.raises(error):
                with_bad.update(points, t_s if t_s != 5.0 else float(stamp) + 0.001)
