"""Recordings of two people are read as they are, mended where that is safe, marked where not, refused by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from paths import shared_data
from reaching_people import MODEL, reach, write_csv, write_recording

from humanpred_ros.errors import HumanPredError, LibraryFormatError, MotionError
from humanpred_ros.motion.motion import Motion, is_angle
from humanpred_ros.motion.reach_recordings import ReachRecording, check_units, doubts, load_reach_recordings


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_recording(tmp_path, "b", 1)
    write_recording(tmp_path, "a", 2, n_frames=60)
    (tmp_path / "notes.txt").write_text("not a recording")
    return tmp_path


def rewrite(folder: Path, name: str, role: str, **changes: object) -> None:
    """Write one person of recording `name` (seed 1, 100 frames) again, with other stamps, postures or columns."""
    t_s, active, passive = reach(1)
    q = active if role == "active" else passive
    write_csv(
        folder / f"{name}_{role}.csv",
        changes.get("t_s", t_s),
        changes.get("q", q),
        changes.get("names", MODEL.dof_names),
    )  # type: ignore[arg-type]


def one(folder: Path, name: str = "b") -> ReachRecording:
    return next(entry for entry in load_reach_recordings(folder) if entry.name == name)


def test_recordings_are_read_by_name_with_the_numbers_of_the_files(folder: Path) -> None:
    found = load_reach_recordings(folder)
    assert [entry.name for entry in found] == ["a", "b"]
    assert [len(entry.active) for entry in found] == [60, 100]
    t_s, active, passive = reach(1)
    np.testing.assert_allclose(found[1].active.t_s, t_s, atol=1e-9)
    np.testing.assert_array_equal(found[1].active.q, active)
    np.testing.assert_array_equal(found[1].passive.q, passive)
    assert found[1].active.dof_names == MODEL.dof_names
    assert all(not entry.unfit and not entry.notes for entry in found)


def test_columns_may_stand_in_another_order(folder: Path) -> None:
    t_s, active, _ = reach(1)
    order = np.random.default_rng(0).permutation(23)
    write_csv(folder / "b_active.csv", t_s, active[:, order], tuple(MODEL.dof_names[k] for k in order))
    np.testing.assert_array_equal(one(folder).active.q, active)


def test_angles_that_wrap_are_unwrapped_and_noted(folder: Path) -> None:
    _, active, _ = reach(1)
    wrapped = active.copy()
    column = MODEL.dof_names.index("rElbowY")
    wrapped[40:, column] += 2.0 * np.pi
    rewrite(folder, "b", "active", q=wrapped)
    found = one(folder)
    np.testing.assert_allclose(found.active.q, active, atol=1e-12)
    assert any("rElbowY" in note and "40" in note for note in found.notes)
    assert not found.unfit


def test_angles_a_whole_turn_away_are_taken_for_what_they_are(folder: Path) -> None:
    _, active, _ = reach(1)
    column = MODEL.dof_names.index("PelvisRotZ")
    for turns in (-2, 1):
        turned = active.copy()
        turned[:, column] += 2.0 * np.pi * turns
        rewrite(folder, "b", "active", q=turned)
        found = one(folder)
        np.testing.assert_allclose(found.active.q, active, atol=1e-12)
        (note,) = found.notes
        assert note.startswith("active: PelvisRotZ begins at ")
        assert not found.unfit


@pytest.mark.parametrize("dof", ["rForeArmTrans", "rWristX"])
def test_a_jump_is_marked_kept_and_not_learned_from(folder: Path, dof: str) -> None:
    _, active, _ = reach(1)
    jumping = active.copy()
    jumping[70, MODEL.dof_names.index(dof)] += 0.1 if "Trans" in dof else 1.0  # one frame: there and back
    rewrite(folder, "b", "active", q=jumping)
    found = one(folder)
    assert [(jump.role, jump.frame) for jump in found.jumps] == [("active", 70), ("active", 71)]
    assert found.unfit
    assert found.unfit is not None
    assert found.unfit.startswith("b: ")
    assert "frame 70" in found.unfit
    assert "1 more" in found.unfit
    assert any(note.startswith("active: ") and "frame 70" in note for note in found.notes)
    np.testing.assert_array_equal(found.active.q, jumping)


def test_a_jump_of_the_partner_is_marked_only(folder: Path) -> None:
    _, _, passive = reach(1)
    passive[70:, MODEL.dof_names.index("rForeArmTrans")] += 0.1
    rewrite(folder, "b", "passive", q=passive)
    found = one(folder)
    assert [(jump.role, jump.frame) for jump in found.jumps] == [("passive", 70)]
    assert not found.unfit


def test_a_hand_that_spins_for_one_frame_is_a_jump_though_no_link_moves(folder: Path) -> None:
    """The palm lies on the axis of rWristY."""
    _, active, _ = reach(1)
    active[70, MODEL.dof_names.index("rWristY")] += 1.2
    rewrite(folder, "b", "active", q=active)
    found = one(folder)
    assert [(jump.frame, jump.what, jump.unit) for jump in found.jumps] == [
        (70, "rWristY", "rad/s"), (71, "rWristY", "rad/s"),
    ]  # fmt: skip
    assert found.unfit


def test_angles_that_flip_to_others_of_the_same_posture_are_a_jump(folder: Path) -> None:
    """Two sets of three angles say one rotation; unwrapping by whole turns does not mend that."""
    _, active, _ = reach(1)
    flipped = active.copy()
    first = MODEL.dof_names.index("rShoulderY1")
    flipped[50:, first] += np.pi - 0.01
    flipped[50:, first + 1] *= -1.0
    flipped[50:, first + 2] += np.pi - 0.01
    same, other = (MODEL.forward(q)["right_wrist"][60] for q in (active, flipped))
    assert np.linalg.norm(same - other) < 0.02
    rewrite(folder, "b", "active", q=flipped)
    found = one(folder)
    assert {(jump.frame, jump.unit) for jump in found.jumps} == {(50, "rad/s")}
    assert found.unfit


@pytest.mark.parametrize(("frame", "count"), [(1, 2), (50, 2), (99, 1)])
def test_glitches_at_the_ends_are_found_as_well(folder: Path, frame: int, count: int) -> None:
    _, active, _ = reach(1)
    active[frame, MODEL.dof_names.index("rForeArmTrans")] += 0.07  # 7 m/s
    rewrite(folder, "b", "active", q=active)
    found = one(folder)
    assert len(found.jumps) == count
    assert found.jumps[0].frame == frame
    assert found.jumps[0].speed == pytest.approx(7.0, abs=1.5)


def test_a_fast_person_is_not_a_jump(folder: Path) -> None:
    t_s, _, _ = reach(1)
    for role in ("active", "passive"):
        rewrite(folder, "b", role, t_s=t_s / 8.0)  # hand at up to 10 m/s, evenly
    found = one(folder)
    speed = np.linalg.norm(np.diff(MODEL.forward(found.active.q)["right_wrist"], axis=0), axis=1) / 0.00125
    assert speed.max() > 5.0
    assert not found.jumps


def test_a_short_reach_is_kept_and_not_learned_from(tmp_path: Path) -> None:
    write_recording(tmp_path, "brief", 3, n_frames=6)
    found = one(tmp_path, "brief")
    assert len(found.active) == 6
    assert found.unfit is not None
    assert "brief: 6 frames" in found.unfit


def test_a_gap_in_time_is_noted(folder: Path) -> None:
    t_s, _, _ = reach(1)
    t_s[50:] += 0.2
    for role in ("active", "passive"):
        rewrite(folder, "b", role, t_s=t_s)
    assert any("210 ms" in note and "frame 50" in note for note in one(folder).notes)


def test_small_differences_of_the_clocks_are_taken_for_none(folder: Path) -> None:
    t_s, _, _ = reach(1)
    rewrite(folder, "b", "passive", t_s=t_s + 0.002)
    found = one(folder)
    np.testing.assert_array_equal(found.active.t_s, found.passive.t_s)


T_S, _, PASSIVE = reach(1)
NAN = PASSIVE.copy()
NAN[7, 4] = np.nan


@pytest.mark.parametrize(
    ("error", "text", "changes"),
    [
        (MotionError, "recording b: wanted as many frames.*90 passive", {"t_s": T_S[:90], "q": PASSIVE[:90]}),
        (MotionError, "recording b: .*same times, at frame 0", {"t_s": T_S + 0.05}),
        (LibraryFormatError, "b, passive.*missing: rWristY", {"q": PASSIVE[:, :22], "names": MODEL.dof_names[:22]}),
        (LibraryFormatError, "recording b, passive.*:9: column PelvisRotY", {"q": NAN}),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_by_name(
    folder: Path, error: type[HumanPredError], text: str, changes: dict[str, object]
) -> None:
    rewrite(folder, "b", "passive", **changes)
    with pytest.raises(error, match=text):
        load_reach_recordings(folder)


def test_times_must_increase(folder: Path) -> None:
    t_s, _, _ = reach(1)
    t_s[30] = t_s[29]
    for role in ("active", "passive"):
        rewrite(folder, "b", role, t_s=t_s)
    with pytest.raises(MotionError, match=r"recording b, active: wanted increasing stamps.*frame 30"):
        load_reach_recordings(folder)


def test_both_people_are_needed(folder: Path) -> None:
    (folder / "a_passive.csv").unlink()
    with pytest.raises(LibraryFormatError, match="a, got active without passive"):
        load_reach_recordings(folder)


@pytest.mark.parametrize("text", ["", "t\n0.0\n", "t,PelvisTransX\n0.0,x\n"])
def test_files_of_other_content_are_refused(folder: Path, text: str) -> None:
    (folder / "b_active.csv").write_text(text)
    with pytest.raises(LibraryFormatError, match="recording b, active"):
        load_reach_recordings(folder)


def test_rows_of_words_and_single_frames_are_refused(folder: Path) -> None:
    lines = (folder / "b_active.csv").read_text().splitlines()
    (folder / "b_active.csv").write_text("\n".join([*lines[:3], lines[3].replace("0.02,", "soon,", 1), *lines[4:]]))
    with pytest.raises(LibraryFormatError, match=r"_active\.csv:4: column t"):
        load_reach_recordings(folder)
    (folder / "b_active.csv").write_text("\n".join(lines[:2]))
    with pytest.raises(LibraryFormatError, match="at least 2 frames"):
        load_reach_recordings(folder)


def test_one_person_recorded_as_two_is_refused(folder: Path) -> None:
    (folder / "b_passive.csv").write_text((folder / "b_active.csv").read_text())
    with pytest.raises(MotionError, match="recording b: wanted two people"):
        load_reach_recordings(folder)


def test_swapped_people_are_noted(folder: Path) -> None:
    files = [folder / f"b_{role}.csv" for role in ("active", "passive")]
    texts = [file.read_text() for file in files]
    for file, text in zip(files, reversed(texts), strict=True):
        file.write_text(text)
    (note,) = one(folder).notes
    assert "swapped" in note
    assert one(folder, "a").notes == ()


def test_somebody_who_does_not_reach_is_noted(folder: Path) -> None:
    t_s, active, passive = reach(1)
    for role, q in (("active", active), ("passive", passive)):
        rewrite(folder, "b", role, q=np.repeat(q[:1], len(t_s), axis=0))
    assert any("goes only 0.00 m" in note for note in one(folder).notes)


def test_units_are_checked_in_both_files(folder: Path) -> None:
    _, _, passive = reach(1)
    angles = np.array(["Trans" not in name for name in MODEL.dof_names])
    rewrite(folder, "b", "passive", q=np.where(angles, np.rad2deg(passive), passive))
    with pytest.raises(MotionError, match=r"recording b, passive: .*degrees"):
        load_reach_recordings(folder)


def test_a_recording_without_a_name_is_refused(folder: Path) -> None:
    write_recording(folder, "", 3)
    with pytest.raises(LibraryFormatError, match="without a name"):
        load_reach_recordings(folder)


@pytest.mark.parametrize("step_s", [-0.01, 0.0])
def test_stamps_of_both_people_must_increase_from_the_first_frame(folder: Path, step_s: float) -> None:
    t_s = step_s * np.arange(100)
    for role in ("active", "passive"):
        rewrite(folder, "b", role, t_s=t_s)
    with pytest.raises(MotionError, match=r"recording b, active: wanted increasing stamps.*frame 1"):
        load_reach_recordings(folder)


def test_the_partners_stamps_must_increase_too(folder: Path) -> None:
    """Within the tolerance of synchrony, but going back."""
    t_s, _, _ = reach(1)
    t_s *= 0.1  # 1 ms apart
    rewrite(folder, "b", "active", t_s=t_s)
    swapped = t_s.copy()
    swapped[[50, 51]] = swapped[[51, 50]]
    rewrite(folder, "b", "passive", t_s=swapped)
    with pytest.raises(MotionError, match=r"recording b, passive: wanted increasing stamps.*frame 51"):
        load_reach_recordings(folder)


def test_stamps_may_count_from_anywhere(folder: Path) -> None:
    t_s, _, _ = reach(1)
    for role in ("active", "passive"):
        rewrite(folder, "b", role, t_s=1.7e9 + t_s)
    np.testing.assert_allclose(one(folder).active.t_s, t_s, atol=1e-6)


def test_people_who_drift_apart_in_time_are_refused(folder: Path) -> None:
    t_s, _, _ = reach(1)
    rewrite(folder, "b", "passive", t_s=1.01 * t_s)
    with pytest.raises(MotionError, match=r"recording b: .*same times, at frame 31"):
        load_reach_recordings(folder)


def test_empty_and_missing_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LibraryFormatError, match="found none"):
        load_reach_recordings(tmp_path)
    with pytest.raises(LibraryFormatError, match="no such folder"):
        load_reach_recordings(tmp_path / "nowhere")


def test_the_papers_recordings_are_read_and_the_glitch_is_found() -> None:
    found = load_reach_recordings(shared_data("icra2015/demos"))
    assert [len(entry.active) for entry in found] == [141, 132, 100, 132, 91, 71, 112]
    assert [entry.active.duration_s for entry in found] == pytest.approx(
        [1.40, 1.31, 0.99, 1.31, 0.90, 0.70, 1.11], abs=1e-3
    )
    assert [entry.name for entry in found if entry.unfit] == ["0444-0585"]
    (jump,) = (jump for entry in found for jump in entry.jumps if jump.role == "active")
    assert (jump.frame, jump.what, jump.unit) == (130, "right_wrist", "m/s")
    assert jump.speed == pytest.approx(7.0, abs=0.1)
    fast = [jump.speed for entry in found for jump in entry.jumps if jump.unit == "m/s"]
    assert min(fast) > 3.5
    assert not any("swapped" in note for entry in found for note in entry.notes)
    partners = {entry.name for entry in found if any(jump.role == "passive" for jump in entry.jumps)}
    assert partners == {"0446-0578", "0525-0657", "2711-2823"}


STAMPS, ACTIVE_Q, PASSIVE_Q = reach(0)
ANGLES = np.array([is_angle(name) for name in MODEL.dof_names])
BONES = np.array([name.endswith("Trans") for name in MODEL.dof_names])


def scaled(columns: np.ndarray, factor: float) -> np.ndarray:
    return np.where(columns, factor * ACTIVE_Q, ACTIVE_Q)


@pytest.mark.parametrize(
    ("said", "t_s", "q"),
    [
        ("for PelvisRotZ; convert them, they look like degrees", STAMPS, scaled(ANGLES, 180.0 / np.pi)),
        ("for PelvisTransX; convert them, they look like millimetres", STAMPS, scaled(~ANGLES, 1e3)),
        ("for PelvisTransX; convert them, they look like centimetres", STAMPS, scaled(~ANGLES, 1e2)),
        ("seconds.*got 10 as the median", 1e3 * STAMPS, ACTIVE_Q),
        (r"seconds.*got 1e\+07 as the median", 1e9 * STAMPS, ACTIVE_Q),
        ("seconds.*got 1e-05 as the median", 1e-3 * STAMPS, ACTIVE_Q),
        ("for rArmTrans; convert them, they look like centimetres", STAMPS, scaled(BONES, 1e2)),
        ("bone rArmTrans between.*got 3[.]5", STAMPS, scaled(BONES, 10.0)),
        ("bone rArmTrans between.*got -0.3", STAMPS, scaled(BONES, -1.0)),
        ("bone rArmTrans between.*got 0", STAMPS, scaled(BONES, 0.0)),
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
    check_units("here", STAMPS, change(ACTIVE_Q), MODEL.dof_names)


def motion(q: np.ndarray) -> Motion:
    return Motion(STAMPS, q, MODEL.dof_names)


def test_the_reaching_hand_is_the_one_that_goes_farther() -> None:
    assert doubts(motion(ACTIVE_Q), motion(PASSIVE_Q), MODEL) == []
    assert "swapped" in doubts(motion(PASSIVE_Q), motion(ACTIVE_Q), MODEL)[0]
    still = motion(np.repeat(ACTIVE_Q[:1], len(STAMPS), axis=0))
    assert "check that this is a reach" in doubts(still, still, MODEL)[0]


def test_a_reach_and_the_way_back_are_not_one_reach() -> None:
    there, partner = ACTIVE_Q, motion(PASSIVE_Q)
    both = motion(np.concatenate([there[::2], there[::-2]]))
    assert "cut it at the turn" in doubts(both, partner, MODEL)[0]
    # Pulling the hand back a little belongs to many reaches.
    back_a_little = motion(np.concatenate([there[20:], there[-1:-21:-1]]))
    assert doubts(back_a_little, partner, MODEL) == []


def test_a_lost_marker_of_the_partner_does_not_look_like_a_reach() -> None:
    thrown = PASSIVE_Q.copy()
    thrown[40:45, 0] += 3.0
    assert doubts(motion(ACTIVE_Q), motion(thrown), MODEL) == []


@pytest.mark.parametrize("folder", ["demos", "interference_case"])
def test_p2s_recordings_raise_no_doubts(folder: str) -> None:
    for entry in load_reach_recordings(shared_data(f"icra2015/{folder}")):
        assert doubts(entry.active, entry.passive, MODEL) == []
