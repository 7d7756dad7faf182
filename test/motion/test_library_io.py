from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_libraries import write_csv_library
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from paths import shared_data
from small_library import small_library

from humanpred_ros.errors import BagError, LibraryFormatError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import KINECT12_DOFS, load_library, read_csv_library
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
        assert (got.dof_names, got.frame_id, got.labels) == (wanted.dof_names, "mocap", ("3",))
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


HEADER = "traj_id,frame," + ",".join(KINECT12_DOFS)
ROW = ",".join(["0.5"] * 12)
GOOD = [HEADER, *(f"0,{frame},{ROW}" for frame in range(3)), *(f"1,{frame},{ROW}" for frame in range(3))]


def folder_with(tmp_path: Path, lines: list[str], name: str = "class_0.csv") -> Path:
    (tmp_path / name).write_text("\n".join(lines) + "\n")
    return tmp_path


@pytest.mark.parametrize("name", ["library_a", "library_b"])
def test_the_papers_libraries_are_read_completely(name: str) -> None:
    path = shared_data(f"iros2013/{name}")
    library = read_csv_library(path)
    assert library.name == name
    assert library.labels == tuple("01234567")
    assert len(library) == (201 if name == "library_b" else 200)  # class 6 of library_b has 26
    assert {len(motion) for motion in library} == {100}
    assert library.dof_names == KINECT12_DOFS
    assert "assumed" in library.provenance["stamps"]
    # With a sixtieth of a second per frame, motion 77 lasts as long as its recording did (P1 library).
    assert library.find("3/2").duration_s == pytest.approx(1.65, abs=1e-9)


def test_recorded_stamps_are_used() -> None:
    library = read_csv_library(shared_data("iros2013/library_a_raw_timed"))
    assert library.provenance["stamps"] == "recorded"
    durations = np.loadtxt(
        shared_data("iros2013/library_a_raw_timed/durations.csv"), delimiter=",", skiprows=1, usecols=(3, 4)
    )
    assert [len(motion) for motion in library] == durations[:, 0].tolist()
    assert [motion.duration_s for motion in library] == pytest.approx(durations[:, 1].tolist(), abs=1e-4)


def test_compound_files_have_no_header_and_restart_at_frame_zero(tmp_path: Path) -> None:
    rows = [f"{frame},{index + 0.25}," + ",".join(["1e-3"] * 11) for index in range(3) for frame in range(4)]
    (tmp_path / "compound.csv").write_text("something else")
    library = read_csv_library(folder_with(tmp_path, rows, "compound_6.csv"))
    assert [motion.name for motion in library] == ["6/0", "6/1", "6/2"]
    assert [motion.q[0, 0] for motion in library] == [0.25, 1.25, 2.25]


def test_columns_are_found_by_name(tmp_path: Path) -> None:
    columns = list(reversed(KINECT12_DOFS))
    rows = [f"0,{frame}," + ",".join(str(KINECT12_DOFS.index(name)) for name in columns) for frame in range(2)]
    library = read_csv_library(folder_with(tmp_path, ["traj_id,frame," + ",".join(columns), *rows]))
    assert library.motions[0].q[0].tolist() == list(range(12))


def test_skipped_frames_leave_their_time(tmp_path: Path) -> None:
    lines = [HEADER, *(f"0,{frame},{ROW}" for frame in (3, 4, 8))]
    motion = read_csv_library(folder_with(tmp_path, lines), frame_period_s=0.1).motions[0]
    assert motion.t_s.tolist() == pytest.approx([0.0, 0.1, 0.5])


def changed(line: int, new: str | None) -> list[str]:
    lines = list(GOOD)
    if new is None:
        del lines[line - 1]
    else:
        lines[line - 1] = new
    return lines


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (changed(1, HEADER.replace("TorsoX", "TorsoQ")), r"class_0\.csv:1: columns missing: TorsoX"),
        (changed(1, HEADER.replace(",TorsoX", "")), r"class_0\.csv:1: columns missing: TorsoX"),
        (changed(1, HEADER + ",TorsoX"), r"class_0\.csv:1: columns twice: TorsoX"),
        (changed(1, HEADER.replace("traj_id", "index")), r"class_0\.csv:1: columns missing: traj_id"),
        (changed(3, "0,1," + ROW.replace("0.5", "nan", 1)), r"class_0\.csv:3: column PelvisTransX: .*nan"),
        (changed(4, "0,2," + ROW[:-3] + "-inf"), r"class_0\.csv:4: column rElbowZ: .*-inf"),
        (changed(3, "0,1," + ROW.replace("0.5", "wide", 1)), r"class_0\.csv:3: column PelvisTransX: .*'wide'"),
        (changed(3, "0,1," + ROW + ",0.5"), r"class_0\.csv:3: wanted 14 fields, got 15"),
        (changed(5, "1,0," + ROW[4:]), r"class_0\.csv:5: wanted 14 fields, got 13"),
        (changed(4, "0,1," + ROW), r"class_0\.csv:4: frame: wanted values that increase .* 1 after 1"),
        (changed(2, "1,7," + ROW), r"class_0\.csv:2: trajectory 1: wanted at least 2 frames"),
        (changed(7, "0,9," + ROW), r"class_0\.csv:7: trajectory 0 appears twice"),
        (changed(2, "0.5,0," + ROW), r"class_0\.csv:2: traj_id: wanted a whole number"),
        ([HEADER], r"class_0\.csv: wanted rows of numbers below the header"),
        ([""], r"class_0\.csv: .*empty"),
    ],
)
def test_errors_name_file_and_line(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(LibraryFormatError, match=message):
        read_csv_library(folder_with(tmp_path, lines))


def test_blank_lines_do_not_shift_the_line_numbers(tmp_path: Path) -> None:
    lines = [HEADER, "", "", *GOOD[1:4], "", "0,nonsense," + ROW]
    with pytest.raises(LibraryFormatError, match=r":8: column frame"):
        read_csv_library(folder_with(tmp_path, lines))


def test_stamps_must_increase(tmp_path: Path) -> None:
    header = "traj_id,raw_frame,t_s," + ",".join(KINECT12_DOFS)
    rows = [f"0,{k},{t},{ROW}" for k, t in enumerate((0.0, 0.02, 0.0200000001, 0.06))]
    with pytest.raises(LibraryFormatError, match=r":4: t_s: wanted values that increase"):
        read_csv_library(folder_with(tmp_path, [header, *rows]))


def test_folders_that_are_no_library(tmp_path: Path) -> None:
    with pytest.raises(LibraryFormatError, match="no such folder"):
        read_csv_library(tmp_path / "absent")
    (tmp_path / "durations.csv").write_text("a,b\n")
    with pytest.raises(LibraryFormatError, match=r"class_<k>\.csv"):
        read_csv_library(tmp_path)
    for name in ("class_3.csv", "compound_3.csv"):
        (tmp_path / name).write_text("")
    with pytest.raises(LibraryFormatError, match="one file per class"):
        read_csv_library(tmp_path)
    with pytest.raises(LibraryFormatError, match="frame period"):
        read_csv_library(tmp_path, frame_period_s=0.0)


@settings(max_examples=40)
@given(data=st.data())
def test_what_is_written_reads_back_bit_for_bit(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    numbers = st.floats(-1e6, 1e6, allow_nan=False)
    motions = []
    for label in data.draw(st.lists(st.integers(0, 99), min_size=1, max_size=3, unique=True).map(sorted)):
        for index in range(data.draw(st.integers(1, 2))):
            ticks = np.cumsum([0, *data.draw(st.lists(st.integers(1, 10**10), min_size=1, max_size=5))])
            q = data.draw(hnp.arrays(np.float64, (len(ticks), 2), elements=numbers))
            motions.append(Motion(ticks * 1e-9, q, ("slide", "turn"), label, index))
    folder = tmp_path_factory.mktemp("csv") / "out"
    write_csv_library(MotionLibrary("out", tuple(motions)), folder)
    for old, new in zip(motions, read_csv_library(folder, dof_names=("slide", "turn")), strict=True):
        assert (new.name, new.t_s.tobytes(), new.q.tobytes()) == (old.name, old.t_s.tobytes(), old.q.tobytes())


def test_csv_files_as_people_write_them_are_reaches(tmp_path: Path) -> None:
    library = small_library(2, 2, 12)
    titles = ",".join(library.dof_names)

    def rows(motion: Motion, *more: str) -> list[str]:
        frames = zip(motion.t_s, motion.q, strict=True)
        return [",".join([*more, f"{t:.6f}", *map(repr, q.tolist())]) for t, q in frames]

    names = {"0": "große Schraube", "10": "screws"}
    long = [f"Label,Rep,Time [s],{titles}"]
    for motion in library:
        long += rows(motion, names[str(motion.label)], str(motion.index))
    (tmp_path / "day.csv").write_text("\n".join(long), encoding="utf-8")
    for motion in library:
        folder = tmp_path / "by_label" / names[str(motion.label)]
        folder.mkdir(parents=True, exist_ok=True)
        lines = [f"time,{titles}", *rows(motion)]
        lines.insert(5, lines[4])  # a row that was written twice costs itself
        (folder / f"take_{motion.index}.CSV").write_text("\n".join(lines))
    for path, said in ((tmp_path / "day.csv", None), (tmp_path / "by_label", "4 rows at a time that was told")):
        found = load_library(path)
        assert [motion.name for motion in found] == [f"{names[str(m.label)]}/{m.index}" for m in library]
        assert found.provenance.get("left out") == said
        for got, wanted in zip(found, library, strict=True):
            np.testing.assert_array_equal(got.q, wanted.q)
            np.testing.assert_allclose(got.t_s, wanted.t_s, atol=1e-5)
    (tmp_path / "bad.csv").write_text("label,time\na/b,0\n")
    with pytest.raises(LibraryFormatError, match="columns missing: PelvisTransX"):
        load_library(tmp_path / "bad.csv")
