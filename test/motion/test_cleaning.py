from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from paths import shared_data

from humanpred_ros.errors import HumanModelError, LibraryFormatError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.cleaning import DROP_REASONS, REASONS, Flag, clean_library, flag_library, goal_m
from humanpred_ros.motion.library_io import KINECT12_DOFS, load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary


def advice(name: str) -> dict[str, str]:
    """Motions listed in outliers.csv: name -> what to do with it."""
    with shared_data("iros2013/outliers.csv").open(newline="") as stream:
        return {f"{r['class']}/{r['traj_id']}": r["advice"] for r in csv.DictReader(stream) if r["set"] == name}


def reach(label: int, index: int, rng: np.random.Generator, aim: int | None = None) -> Motion:
    """A smooth reach of the right arm; labels differ in shoulder angle by a hand's breadth or more."""
    s = np.linspace(0.0, 1.0, 60)
    rise = 10 * s**3 - 15 * s**4 + 6 * s**5
    start = np.array([0.0, 0.0, 0.8, 0.3, 0.0, 0.0, 0.0, 1.3, 0.0, 0.0, 0.1, 0.4])
    change = np.zeros(12)
    change[[7, 8, 11]] = [-0.6, 0.35 * (label if aim is None else aim), 0.3]
    change[7:] += rng.normal(scale=0.02, size=5)
    q = start + rise[:, None] * change
    return Motion(s * 1.5, q, KINECT12_DOFS, label, index)


@pytest.fixture
def library() -> MotionLibrary:
    rng = np.random.default_rng(5)
    return MotionLibrary(
        "made", tuple(reach(label, index, rng) for label in range(3) for index in range(8)), {"a": "b"}
    )


def with_motion(library: MotionLibrary, motion: Motion) -> MotionLibrary:
    return replace(library, motions=tuple(motion if m.name == motion.name else m for m in library))


def edited(library: MotionLibrary, name: str, frames: slice, dof: str, add: float) -> MotionLibrary:
    motion = library.find(name)
    q = motion.q.copy()
    q[frames, motion.dof_names.index(dof)] += add
    return with_motion(library, replace(motion, q=q))


def test_a_clean_library_has_no_flags(library: MotionLibrary) -> None:
    assert flag_library(library) == ()
    cleaned = clean_library(library, drop=True)
    assert cleaned.motions == library.motions
    assert cleaned.provenance == {"a": "b", "cleaning": "unwrapped the angles of 0 motions; dropped none"}


def test_each_fault_gets_its_flag(library: MotionLibrary) -> None:
    jumped = edited(library, "1/2", slice(30, None), "rShoulderY", 0.9)
    (flag,) = (f for f in flag_library(jumped) if f.reason == "jump")
    assert (flag.motion, flag.frame, flag.dof) == ("1/2", 30, "rShoulderY")
    assert flag.value == pytest.approx(0.9 / (1.5 / 59), rel=0.1)

    (flag,) = (
        f for f in flag_library(edited(library, "1/2", slice(40, 45), "PelvisTransX", 75.0)) if f.reason == "wild"
    )
    assert (flag.motion, flag.frame, flag.dof) == ("1/2", 40, "PelvisTransX")
    assert flag.value == pytest.approx(75.0, abs=0.5)

    motion = library.find("0/3")
    late = with_motion(library, replace(motion, t_s=motion.t_s + np.where(np.arange(60) >= 20, 0.4, 0.0)))
    (flag,) = flag_library(late)
    assert (flag.motion, flag.frame, flag.reason) == ("0/3", 20, "gap")
    assert flag.value == pytest.approx(0.4 + 1.5 / 59)

    (flag,) = flag_library(edited(library, "2/7", slice(1, None), "PelvisTransY", 0.8))[-1:]
    assert (flag.motion, flag.frame, flag.reason) == ("2/7", None, "goal")

    mislabelled = with_motion(library, reach(2, 4, np.random.default_rng(1), aim=0))
    (flag,) = flag_library(mislabelled)
    assert (flag.motion, flag.reason) == ("2/4", "label")


def test_whole_turns_are_wraps_and_not_jumps(library: MotionLibrary) -> None:
    wrapped = edited(library, "1/0", slice(25, 40), "rShoulderY", 2 * np.pi)
    assert [(f.frame, f.reason) for f in flag_library(wrapped)] == [(25, "wrap"), (40, "wrap")]
    cleaned = clean_library(wrapped)
    assert flag_library(cleaned) == ()
    for old, new in zip(library, cleaned, strict=True):
        assert new.q == pytest.approx(old.q, abs=1e-12)


def test_nothing_is_dropped_unless_asked(library: MotionLibrary) -> None:
    bad = edited(library, "1/2", slice(None), "PelvisTransX", 75.0)
    assert [m.name for m in clean_library(bad)] == [m.name for m in library]
    kept = clean_library(bad, drop=True)
    assert [m.name for m in kept] == [m.name for m in library if m.name != "1/2"]
    assert "dropped 1/2 (wild)" in kept.provenance["cleaning"]
    # Jumps alone are reason to look, not to drop.
    jumped = edited(library, "1/2", slice(30, None), "TorsoZ", 0.9)
    assert len(clean_library(jumped, drop=True)) >= len(library) - 1
    assert all(flag.reason in REASONS for flag in flag_library(jumped))


def test_cleaning_twice_changes_nothing_more(library: MotionLibrary) -> None:
    once = clean_library(edited(library, "1/2", slice(None), "PelvisTransX", 75.0), drop=True)
    twice = clean_library(once, drop=True)
    assert [m.name for m in twice] == [m.name for m in once]


def test_small_classes_have_no_usual_goal() -> None:
    rng = np.random.default_rng(2)
    few = MotionLibrary("few", (reach(0, 0, rng), reach(0, 1, rng, aim=2), replace(reach(1, 0, rng), label=None)))
    assert flag_library(few) == ()


def test_other_humans_need_their_model() -> None:
    motion = Motion(np.array([0.0, 1.0]), np.zeros((2, 1)), ("elbow",), 0)
    with pytest.raises(HumanModelError, match="elbow"):
        flag_library(MotionLibrary("other", (motion,)))
    # Unwrapping alone needs none.
    assert len(clean_library(MotionLibrary("other", (motion,)))) == 1


def test_a_library_is_never_emptied() -> None:
    rng = np.random.default_rng(2)
    far = [replace(reach(0, k, rng), q=reach(0, k, rng).q + np.eye(12)[0] * 100.0 * (-1) ** k) for k in range(2)]
    with pytest.raises(LibraryFormatError, match="all 2 are flagged"):
        clean_library(MotionLibrary("far", tuple(far)), drop=True)


def test_flags_read_as_sentences() -> None:
    assert str(Flag("6/0", 3, "PelvisTransX", "wild", 73.2)) == (
        "6/0, frame 3, PelvisTransX: pelvis outside any room (73.2 m)"
    )
    assert str(Flag("5/0", None, None, "goal", 0.27)) == "5/0: goal far from those of its class (0.27 m)"


def test_goals_are_those_of_the_facts() -> None:
    # Palm at the end of a reach, and at the turning point of a reach and return (docs/papers.md, P1 library).
    human = HumanModel.kinect12()
    for name, label, goal in (("library_a", 0, (0.397, -1.478, 0.569)), ("library_b", 4, (1.673, 1.135, 0.707))):
        library = load_library(shared_data(f"iros2013/{name}"))
        goals = np.median([goal_m(motion, human) for motion in library.of_class(label)], axis=0)
        assert goals == pytest.approx(goal, abs=0.03)


@pytest.mark.parametrize("name", ["library_a", "library_b"])
def test_flags_agree_with_the_published_outliers(name: str) -> None:
    library, listed = load_library(shared_data(f"iros2013/{name}")), advice(name)
    flags = flag_library(library)
    to_drop = {flag.motion for flag in flags if flag.reason in DROP_REASONS}
    excluded = {motion for motion, what in listed.items() if what.startswith("exclude")}
    # Recall of what should be excluded, and false alarms among what is not listed at all.
    assert len(excluded & to_drop) >= 0.9 * len(excluded)
    assert len(to_drop - set(listed)) <= 0.03 * len(library)
    assert not to_drop & {motion for motion, what in listed.items() if what == "keep"}
    # Every listed motion is flagged for something: wraps and jumps are what those to keep have.
    assert set(listed) <= {flag.motion for flag in flags}


def test_the_wild_and_the_mislabelled_motion_are_named() -> None:
    b = flag_library(load_library(shared_data("iros2013/library_b")))
    assert {flag.motion for flag in b if flag.reason == "wild"} == {"6/0"}
    a = flag_library(load_library(shared_data("iros2013/library_a")))
    assert {flag.motion for flag in a if flag.reason in DROP_REASONS} == {"5/0"}
    assert {flag.reason for flag in a if flag.motion == "5/0"} == {"label"}
    jumps = {flag.motion: flag.dof for flag in a if flag.reason == "jump"}
    assert jumps["5/6"] == jumps["5/11"] == "rShoulderY"
