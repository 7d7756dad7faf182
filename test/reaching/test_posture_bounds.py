"""Bounds are those of the demonstrations with P2's margins, and never exclude the reach itself."""

from __future__ import annotations

import numpy as np
import pytest
from paths import shared_data
from reaching_people import GOAL, MODEL, START, recording

from humanpred_ros.errors import MotionError
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.reaching.posture_bounds import BoundsConfig, PostureBounds

RECORDINGS = [recording(seed) for seed in range(3)]
COLUMN = MODEL.dof_index


def test_margins_are_those_of_p2() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    q = np.concatenate([r.active.q for r in RECORDINGS])
    for name, margin in (("PelvisTransX", 0.02), ("rForeArmTrans", 0.02), ("rShoulderTransZ", 0.02),
                         ("PelvisRotZ", 0.05), ("PelvisRotX", 0.05)):  # fmt: skip
        k = COLUMN[name]
        assert not bounds.free[k]
        assert bounds.lower[k] == pytest.approx(q[:, k].min() - margin)
        assert bounds.upper[k] == pytest.approx(q[:, k].max() + margin)
    assert [name for name, free in zip(MODEL.dof_names, bounds.free, strict=True) if free] == [
        "TorsoX", "TorsoZ", "TorsoY", "rShoulderY1", "rShoulderX", "rShoulderY2", "rElbowZ", "rElbowX", "rElbowY",
        "rWristZ", "rWristX", "rWristY",
    ]  # fmt: skip


def test_free_rotations_may_go_half_a_turn_from_the_reach_wherever_that_is() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    k = COLUMN["rElbowZ"]
    start, goal = START.copy(), GOAL.copy()
    start[k] += 2.0 * np.pi
    goal[k] += 2.0 * np.pi
    lower, upper = bounds.around(START, GOAL)
    shifted_lower, shifted_upper = bounds.around(start, goal)
    assert shifted_lower[k] == pytest.approx(lower[k] + 2.0 * np.pi)
    assert shifted_upper[k] == pytest.approx(upper[k] + 2.0 * np.pi)
    assert upper[k] - lower[k] >= 2.0 * np.pi


def test_a_reach_beyond_the_demonstrations_widens_its_bounds() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL)
    goal = GOAL.copy()
    goal[0] = 3.0
    lower, upper = bounds.around(START, goal)
    assert upper[0] == 3.0
    assert lower[0] == bounds.lower[0]
    assert (lower <= START).all()
    assert (upper >= goal).all()


def test_all_rotations_may_be_bounded() -> None:
    bounds = PostureBounds.from_recordings(RECORDINGS, MODEL, BoundsConfig(rotation_rad=0.1))
    k = COLUMN["TorsoX"]
    q = np.concatenate([r.active.q for r in RECORDINGS])
    assert not bounds.free.any()
    assert bounds.upper[k] == pytest.approx(q[:, k].max() + 0.1)


def test_bounds_of_p2s_recordings() -> None:
    bounds = PostureBounds.from_recordings(load_reach_recordings(shared_data("icra2015/demos")), MODEL)
    # Facts section 3, less and plus the margins.
    for name, low, high, margin in (("PelvisTransX", 1.9657, 2.1621, 0.02), ("PelvisRotZ", 1.8006, 2.3606, 0.05),
                                    ("rForeArmTrans", 0.1881, 0.2509, 0.02)):  # fmt: skip
        k = COLUMN[name]
        assert bounds.lower[k] == pytest.approx(low - margin, abs=1e-4)
        assert bounds.upper[k] == pytest.approx(high + margin, abs=1e-4)


def test_bad_input_is_refused() -> None:
    with pytest.raises(MotionError, match="at least one"):
        PostureBounds.from_recordings([], MODEL)
    with pytest.raises(MotionError, match="lower < upper"):
        PostureBounds(np.ones(3), np.zeros(3), np.zeros(3, dtype=np.bool_))
