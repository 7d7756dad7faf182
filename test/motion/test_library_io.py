from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_libraries import write_csv_library
from paths import shared_data

from humanpred_ros.errors import BagError, LibraryFormatError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import KINECT12_DOFS, load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary


def import_library(source: Path, out: Path, *, overwrite: bool = False) -> Path:
    library = load_library(source)
    return write_library_bag(library, out / library.name, overwrite=overwrite)


@pytest.fixture
def csv_folder(tmp_path: Path) -> Path:
    t_s = np.arange(5) * 0.02
    motions = [
        Motion(t_s, np.full((5, 12), 0.1 * label + 0.01 * index), KINECT12_DOFS, label, index)
        for label in (0, 4)
        for index in range(3)
    ]
    write_csv_library(MotionLibrary("reaches", tuple(motions)), tmp_path / "reaches")
    return tmp_path / "reaches"


def test_every_form_gives_the_same_library(csv_folder: Path, tmp_path: Path) -> None:
    folder = import_library(csv_folder, tmp_path / "bags")
    assert folder == tmp_path / "bags" / "reaches"
    wanted = load_library(csv_folder)
    for path in (folder, folder / "reaches_0.mcap", str(folder)):
        got = load_library(path)
        assert (got.name, dict(got.provenance)) == (wanted.name, dict(wanted.provenance))
        for a, b in zip(wanted, got, strict=True):
            assert (a.name, a.t_s.tobytes(), a.q.tobytes()) == (b.name, b.t_s.tobytes(), b.q.tobytes())


def test_a_bag_can_be_imported_again(csv_folder: Path, tmp_path: Path) -> None:
    folder = import_library(csv_folder, tmp_path / "bags")
    with pytest.raises(BagError, match="exists"):
        import_library(csv_folder, tmp_path / "bags")
    assert import_library(folder, tmp_path / "bags", overwrite=True) == folder
    assert len(load_library(folder)) == 6


def test_the_frame_period_reaches_the_stamps(tmp_path: Path) -> None:
    rows = [f"{frame}," + ",".join(["0.0"] * 12) for frame in range(4)]
    (tmp_path / "compound_0.csv").write_text("\n".join(rows))
    assert load_library(tmp_path, frame_period_s=0.5).motions[0].duration_s == 1.5
    assert load_library(tmp_path).motions[0].duration_s == pytest.approx(3 / 60)


def test_an_import_that_fails_leaves_nothing(csv_folder: Path, tmp_path: Path) -> None:
    (csv_folder / "class_4.csv").write_text("broken")
    with pytest.raises(LibraryFormatError):
        import_library(csv_folder, tmp_path / "bags")
    assert not (tmp_path / "bags").exists()


def test_what_is_no_library_is_said_to_be_none(tmp_path: Path) -> None:
    with pytest.raises(LibraryFormatError, match="nothing of that name"):
        load_library(tmp_path / "absent")
    (tmp_path / "notes.txt").write_text("notes")
    for path in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(LibraryFormatError, match="none of these"):
            load_library(path)
    (tmp_path / "x.mcap").write_text("not a bag")
    for path in (tmp_path, tmp_path / "x.mcap"):
        with pytest.raises(BagError, match="wanted"):
            load_library(path)


def people(n_motions: int, label: int | None, n_frames: int = 12) -> MotionLibrary:
    """Return motions of the 23-DoF human, drawn from a seed."""
    human, rng = HumanModel.mocap23(), np.random.default_rng(5)
    stand = 0.5 * (np.maximum(human.lower, -0.5) + np.minimum(human.upper, 0.5))
    path = stand + np.cumsum(rng.normal(0.0, 1e-3, (n_motions, n_frames, len(stand))), axis=1)
    t_s = np.arange(n_frames) * 0.01
    return MotionLibrary(
        "people", tuple(Motion(t_s, q, human.dof_names, label, k, "mocap") for k, q in enumerate(path))
    )


def test_a_library_of_the_23_dof_human_goes_through_csv_and_bag(tmp_path: Path) -> None:
    wanted = people(2, 3)
    write_csv_library(wanted, tmp_path / "people")
    for path in (tmp_path / "people", import_library(tmp_path / "people", tmp_path / "bags")):
        got = load_library(path)
        assert (got.dof_names, got.frame_id, got.labels) == (wanted.dof_names, "mocap", (3,))
        assert all(a.q.tobytes() == b.q.tobytes() for a, b in zip(wanted, got, strict=True))


def test_recordings_of_two_people_are_a_library_of_who_reaches(tmp_path: Path) -> None:
    reaching, beside = people(2, None).motions
    header = ",".join(("t", *reaching.dof_names))
    for name in ("0010-0022", "0007-0019"):
        for role, motion in (("active", reaching), ("passive", beside)):
            rows = [
                f"{t!r}," + ",".join(repr(float(x)) for x in q)
                for t, q in zip(motion.t_s.tolist(), motion.q, strict=True)
            ]
            (tmp_path / f"{name}_{role}.csv").write_text("\n".join([header, *rows]))
    library = load_library(tmp_path)
    assert [motion.name for motion in library] == ["-/0", "-/1"]
    assert library.provenance["recordings"] == "-/0 is 0007-0019; -/1 is 0010-0022"
    np.testing.assert_array_equal(library.motions[1].q, reaching.q)
    # As a bag it is the same library, and its motions can be replayed by their running numbers.
    again = load_library(import_library(tmp_path, tmp_path / "bags"))
    np.testing.assert_array_equal(again.find("1").q, reaching.q)
    assert again.find("1").label is None


def test_the_recordings_of_p2_are_a_library() -> None:
    library = load_library(shared_data("icra2015/demos"))
    assert len(library) == 7
    assert library.dof_names == HumanModel.mocap23().dof_names
    assert "jumps" in library.provenance["doubtful"]
