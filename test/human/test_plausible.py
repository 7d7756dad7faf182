"""Postures that no person can have are refused by name; those that people have are believed."""

from __future__ import annotations

import numpy as np
import pytest
from paths import REPOSITORY, shared_data

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.plausible import PlausibilityCheck, PlausibilitySettings
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.robot.scene import load_scene

HUMAN = HumanModel.kinect12()
LIBRARY = load_library(REPOSITORY / "bags" / "synthetic_reaches")
SCENE = load_scene("face_to_face")
MOTION = LIBRARY.find("3/2")
SLIDES = [k for k, name in enumerate(HUMAN.dof_names) if "Trans" in name]
TURNS = [k for k in range(len(HUMAN.dof_names)) if k not in SLIDES]


def made(**settings: float) -> PlausibilityCheck:
    return PlausibilityCheck(HUMAN, SCENE.grid, SCENE.T_world_human, PlausibilitySettings(**settings))


def kinds(postures: FloatArray, t_s: FloatArray | None = None, check: PlausibilityCheck | None = None) -> list[str]:
    """Return the kind of refusal of each posture, "" where it is believed."""
    check = check or made()
    times = np.arange(len(postures)) / 30.0 if t_s is None else t_s
    found = [check.refusal(q, float(t)) for q, t in zip(postures, times, strict=True)]
    return ["" if refusal is None else refusal.kind for refusal in found]


def test_recorded_reaches_are_believed() -> None:
    for motion in LIBRARY.motions[::5]:
        assert set(kinds(motion.q, motion.t_s)) == {""}


def test_what_a_depth_camera_saw_of_real_people_is_believed() -> None:
    for motion in load_library(shared_data("iros2013/library_a")).motions[::10]:
        assert set(kinds(motion.q, motion.t_s)) == {""}


def test_whole_turns_of_an_angle_are_the_same_posture() -> None:
    q = MOTION.q.copy()
    q[20:, HUMAN.dof_names.index("PelvisRotZ")] += 2.0 * np.pi
    assert set(kinds(q)) == {""}


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [(SLIDES, 1000.0, "millimetres"), (SLIDES, 100.0, "centimetres"), (TURNS, 180.0 / np.pi, "degrees")],
)
def test_other_units_are_named(columns: list[int], factor: float, said: str) -> None:
    q = MOTION.q[0].copy()
    q[columns] *= factor
    refusal = made().refusal(q, 0.0)
    assert refusal is not None
    assert (refusal.kind, said in refusal.detail) == ("units", True)


@pytest.mark.parametrize("value", [1e308, -1e308, 1e6, 100.0])
@pytest.mark.parametrize("dof", ["PelvisTransX", "TorsoX", "rArmTrans", "rElbowZ"])
def test_values_that_no_joint_has_are_refused(dof: str, value: float) -> None:
    q = MOTION.q[0].copy()
    q[HUMAN.dof_names.index(dof)] = value
    refusal = made().refusal(q, 0.0)
    assert refusal is not None
    assert dof in refusal.detail or refusal.kind == "outside the lattice"


def test_a_pelvis_outside_the_lattice_is_refused() -> None:
    q = MOTION.q.copy()
    q[:, HUMAN.dof_names.index("PelvisTransY")] -= 2.5
    assert set(kinds(q)) == {"outside the lattice"}


def test_one_ghost_frame_costs_the_time_to_settle_and_no_more() -> None:
    q = MOTION.q.copy()
    q[10, :3] += (0.0, 1.0, 0.0)
    found = kinds(q[:40])
    assert found[:10] == [""] * 10
    assert found[10:12] == ["jump", "jump"]
    assert set(found[12:19]) == {"jump"}
    assert set(found[21:]) == {""}


def test_two_people_on_one_topic_are_never_believed() -> None:
    q = MOTION.q[:60].copy()
    q[1::2, 0] += 0.6
    assert set(kinds(q)[1:]) == {"jump"}


@pytest.mark.parametrize("apart_m", [0.1, 0.2])
@pytest.mark.parametrize("pattern", [(0, 1), (0, 0, 1, 1), (0, 1, 2)])
def test_two_people_who_stand_close_are_not_believed_either(pattern: tuple[int, ...], apart_m: float) -> None:
    q = MOTION.q[:90].copy()
    q[:, 0] += apart_m * np.resize(pattern, len(q))
    assert "" not in kinds(q)[20:]


def test_a_person_found_elsewhere_is_believed_again() -> None:
    q = MOTION.q[:60].copy()
    q[20:, 0] += 0.6
    assert set(kinds(q)[35:]) == {""}


def test_a_posture_that_never_changes_is_a_tracker_that_has_stopped() -> None:
    q = np.tile(MOTION.q[0], (60, 1))
    found = kinds(q)
    assert found[:15] == [""] * 15
    assert set(found[16:]) == {"frozen"}
    noisy = q + np.random.default_rng(0).normal(0.0, 1e-4, q.shape)
    assert set(kinds(noisy)) == {""}
    check = made()
    assert {check.refusal(posture, k / 30.0, held=True) for k, posture in enumerate(q)} == {None}


def test_postures_that_repeat_in_turns_are_of_a_tracker_that_has_stopped() -> None:
    found = kinds(np.resize(MOTION.q[:3], (60, MOTION.q.shape[1])))
    assert found[:15] == [""] * 15
    assert set(found[20:]) == {"frozen"}


def test_an_arm_that_the_tracker_has_lost_is_found_while_the_rest_moves() -> None:
    q = MOTION.q[0] + np.random.default_rng(0).normal(0.0, 1e-3, (90, MOTION.q.shape[1]))
    arm = [k for k, name in enumerate(HUMAN.dof_names) if name.startswith("r")]
    never = q.copy()
    never[:, arm[:2]] = never[0, arm[:2]]
    assert set(kinds(never)) == {""}, "joints that a tracker does not see"
    q[40:70, arm] = q[40, arm]
    check = made()
    found = kinds(q, check=check)
    assert set(found[:54]) == {""}
    assert set(found[57:70]) == {"frozen"}
    assert found[-1] == ""


def test_what_follows_a_posture_that_could_not_be_read_is_believed_after_a_while() -> None:
    check, q = made(), MOTION.q
    assert check.refusal(q[0], 0.0) is None
    check.unread(0.1, "not finite")
    assert [getattr(check.refusal(q[k], k / 30), "kind", "") for k in (4, 8, 13)] == ["not finite", "not finite", ""]


def test_every_fault_is_caught_again_after_it_has_gone() -> None:
    check, rng = made(), np.random.default_rng(1)
    still = MOTION.q[0] + rng.normal(0.0, 1e-4, (600, len(HUMAN.dof_names)))
    bad = still.copy()
    for begin in (60, 240, 420):
        bad[begin : begin + 30] = still[begin]  # frozen
        bad[begin + 60, 1] += 1.0  # jump
        bad[begin + 90, 1] *= 1000.0  # millimetres
    found = kinds(bad, check=check)
    for begin in (60, 240, 420):
        assert found[begin + 20] == "frozen"
        assert found[begin + 60] == "jump"
        assert found[begin + 90] in ("units", "joint limit", "outside the lattice")
        assert set(found[begin + 110 : begin + 170]) == {""}
