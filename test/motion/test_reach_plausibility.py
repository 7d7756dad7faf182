"""Wrong units, signs and people are told before anything is learned from them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, reach

from humanpred_ros.errors import MotionError
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_plausibility import check_two_people, check_units, doubts
from humanpred_ros.motion.reach_recordings import load_reach_recordings
from humanpred_ros.motion.resampling import is_angle

T_S, ACTIVE, PASSIVE = reach(0)
ANGLES = np.array([is_angle(name) for name in MODEL.dof_names])
BONES = np.array([name.endswith("Trans") for name in MODEL.dof_names])


def scaled(columns: np.ndarray, factor: float) -> np.ndarray:
    return np.where(columns, factor * ACTIVE, ACTIVE)


@pytest.mark.parametrize(
    ("said", "t_s", "q"),
    [
        ("for PelvisRotZ; convert them, they look like degrees", T_S, scaled(ANGLES, 180.0 / np.pi)),
        ("for PelvisTransX; convert them, they look like millimetres", T_S, scaled(~ANGLES, 1e3)),
        ("for PelvisTransX; convert them, they look like centimetres", T_S, scaled(~ANGLES, 1e2)),
        ("seconds.*got 10 as the median", 1e3 * T_S, ACTIVE),
        (r"seconds.*got 1e\+07 as the median", 1e9 * T_S, ACTIVE),
        ("seconds.*got 1e-05 as the median", 1e-3 * T_S, ACTIVE),
        ("for rArmTrans; convert them, they look like centimetres", T_S, scaled(BONES, 1e2)),
        ("bone rArmTrans between.*got 3[.]5", T_S, scaled(BONES, 10.0)),
        ("bone rArmTrans between.*got -0.3", T_S, scaled(BONES, -1.0)),
        ("bone rArmTrans between.*got 0", T_S, scaled(BONES, 0.0)),
    ],
)
def test_other_units_are_refused(said: str, t_s: np.ndarray, q: np.ndarray) -> None:
    with pytest.raises(MotionError, match=f"^here: wanted .*?{said}"):
        check_units("here", t_s, q, MODEL.dof_names)


@pytest.mark.parametrize(
    "change",
    [
        lambda q: q,
        lambda q: q + 2.0 * np.pi * ANGLES,  # a turn more
        lambda q: np.where(np.arange(len(q))[:, None] == 50, 0.0, q) * BONES + q * ~BONES,  # a lost marker
        lambda q: q + 5.0 * (np.array(MODEL.dof_names) == "PelvisTransX"),  # at the other end of the room
    ],
)
def test_people_are_believed(change: Callable[[np.ndarray], np.ndarray]) -> None:
    check_units("here", T_S, change(ACTIVE), MODEL.dof_names)


def motion(q: np.ndarray) -> Motion:
    return Motion(T_S, q, MODEL.dof_names)


def test_the_reaching_hand_is_the_one_that_goes_farther() -> None:
    assert doubts(motion(ACTIVE), motion(PASSIVE), MODEL) == []
    assert "swapped" in doubts(motion(PASSIVE), motion(ACTIVE), MODEL)[0]
    still = motion(np.repeat(ACTIVE[:1], len(T_S), axis=0))
    assert "check that this is a reach" in doubts(still, still, MODEL)[0]


def test_a_reach_and_the_way_back_are_not_one_reach() -> None:
    there, partner = ACTIVE, motion(PASSIVE)
    both = motion(np.concatenate([there[::2], there[::-2]]))
    assert "cut it at the turn" in doubts(both, partner, MODEL)[0]
    # Pulling the hand back a little belongs to many reaches.
    back_a_little = motion(np.concatenate([there[20:], there[-1:-21:-1]]))
    assert doubts(back_a_little, partner, MODEL) == []


def test_a_lost_marker_of_the_partner_does_not_look_like_a_reach() -> None:
    thrown = PASSIVE.copy()
    thrown[40:45, 0] += 3.0
    assert doubts(motion(ACTIVE), motion(thrown), MODEL) == []


def test_a_copy_of_one_file_is_not_two_people() -> None:
    check_two_people("here", motion(ACTIVE), motion(PASSIVE))
    with pytest.raises(MotionError, match="here: wanted two people"):
        check_two_people("here", motion(ACTIVE), motion(ACTIVE))


@pytest.mark.parametrize("folder", ["demos", "interference_case"])
def test_p2s_recordings_raise_no_doubts(folder: str) -> None:
    for entry in load_reach_recordings(shared_data(f"icra2015/{folder}")):
        assert doubts(entry.active, entry.passive, MODEL) == []
