"""Troubles that users of comparable software reported in public: the inputs are made by ../shared/cases.

Each case is an example of a kind; what is asked for here is the right behaviour of the kind.
"""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from paths import REPOSITORY

from humanpred_ros.bags.reader import BagReader
from humanpred_ros.cli import main
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary

CASES = REPOSITORY.parent / "shared" / "cases"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """Return the folder with the inputs of all cases that are files."""
    if not CASES.is_dir():
        pytest.skip("needs ../shared/cases, which are not part of the package")
    folder = tmp_path_factory.mktemp("cases")
    argv, path = sys.argv, list(sys.path)
    try:
        for maker in sorted(CASES.glob("*/make.py")):
            sys.argv = [str(maker), str(folder)]
            runpy.run_path(str(maker), run_name="__main__")
    finally:
        sys.argv, sys.path[:] = argv, path
        sys.modules.pop("common", None)
    return folder


def run(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str]:
    """Return the status of a command, and all it said as one line."""
    status = main([str(word) for word in words])
    said = capsys.readouterr()
    return status, " ".join((said.out + said.err).split())


IMPORTED = {
    "01_reindexed_bag/empty_id": (6, ""),
    "02_qos_with_few_keys": (6, ""),
    "06_rosbag2_compression/each_message": (6, ""),
    "06_rosbag2_compression/whole_file": (6, ""),
    "06_rosbag2_compression/whole_file_no_metadata": (6, ""),
    "07_other_storage/sqlite": (6, ""),
    "07_other_storage/no_metadata": (6, ""),
    "07_other_storage/lone.db3": (6, ""),
    "07_other_storage/SESSION.MCAP": (6, ""),
    "11_header_stamps_zero/zero_stamps.mcap": (6, "log times: 540 frames have no stamp"),
    "12_stamps_repeat_or_step_back/twice.mcap": (6, "left out: 54 frames not later than those before"),
    "12_stamps_repeat_or_step_back/back.mcap": (6, "left out: 6 frames not later than those before"),
    "13_other_body_id/rxkdf.mcap": (6, ""),
    "14_ghost_frame/ghost.mcap": (6, "left out: 1 pieces too short for a motion"),
    "15_joints_in_another_order/reversed.mcap": (6, ""),
    "16_csv_habits/comment_lines": (12, ""),
    "16_csv_habits/extra_column": (12, "columns not read: confidence"),
    "16_csv_habits/lower_case": (12, ""),
    "16_csv_habits/no_stamps": (12, "stamps assumed: one frame every 0.0166666667 s (--frame-period)"),
    "16_csv_habits/quoted_header": (12, ""),
    "16_csv_habits/semicolon_comma": (12, ""),
    "16_csv_habits/semicolon_point": (12, ""),
    "16_csv_habits/tabs": (12, ""),
    "16_csv_habits/trailing_comma": (12, ""),
    "16_csv_habits/units_in_titles": (12, ""),
    "16_csv_habits/upper_extension": (12, ""),
    "24_out_of_order_across_files/seam": (6, ""),
    "26_what_people_bring/mocap23": (6, ""),
}


@pytest.mark.parametrize("source", IMPORTED)
def test_what_people_have_is_imported_and_what_was_left_out_is_told(
    source: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motions, words = IMPORTED[source]
    status, said = run(capsys, "import", made / source, "--out", tmp_path, "--dry-run")
    assert (status, list(tmp_path.iterdir())) == (0, [])
    assert f"{motions} motions" in said
    assert words in said
    assert words or "left out" not in said
    status, said = run(capsys, "import", made / source, "--out", tmp_path)
    assert status == 0, said
    (bag,) = tmp_path.iterdir()
    same_motions(load_library(bag), source, made)


def same_motions(library: MotionLibrary, source: str, made: Path) -> None:
    """Check that CSV habits change nothing, and that joints have their names."""
    if source.startswith("16") and "no_stamps" not in source:
        plain = load_library(made / "16_csv_habits" / "plain")
        assert [m.q.tolist() for m in library] == [m.q.tolist() for m in plain]
    assert library.dof_names[0] == "PelvisTransX"


@pytest.mark.parametrize(("source", "unit"), [("degrees", "deg"), ("centimetres", "cm"), ("millimetres", "mm")])
def test_other_units_are_refused_with_the_factor_and_converted_when_asked(
    source: str, unit: str, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made / "16_csv_habits" / source
    for words in (["import", folder, "--out", tmp_path], ["train", folder, "--out", tmp_path / "model.npz"]):
        status, said = run(capsys, *words)
        assert status == 2
        assert f"they look like {source}: a factor of 0.01" in said or "a factor of 0.001" in said
        assert f"--units {unit}" in said
        assert list(tmp_path.iterdir()) == []
    assert run(capsys, "import", folder, "--out", tmp_path, "--units", unit)[0] == 0
    plain = load_library(made / "16_csv_habits" / "plain")
    for motion, wanted in zip(load_library(tmp_path / source), plain, strict=True):
        assert abs(motion.q - wanted.q).max() < 1e-4


def test_a_cut_motion_costs_that_motion(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, said = run(
        capsys, "bag", "salvage", made / "23_cut_in_a_motion" / "cut_in_motion.mcap", "--out", tmp_path / "bag"
    )
    assert status == 0
    status, said = run(capsys, "import", tmp_path / "bag", "--out", tmp_path / "out", "--dry-run")
    assert (status, "left out: 1 motions cut off (motion 2/1: wanted 90 frames as announced, got 41)" in said) == (
        0,
        True,
    )
    status, said = run(capsys, "train", tmp_path / "bag", "--out", tmp_path / "model.npz", "--classifier", "gmm")
    assert status == 2
    assert "--leave-out" in said, "the class has one motion left: the advice can be followed"
    words = ["train", tmp_path / "bag", "--out", tmp_path / "model.npz", "--classifier", "gmm", "--leave-out", "2"]
    status, said = run(capsys, *words)
    assert status == 0, said


def test_two_sources_of_one_name_are_refused(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sources = [made / "29_two_sources_of_one_name" / person / "reaches" for person in ("P01", "P02")]
    status, said = run(capsys, "import", "--overwrite", *sources, "--out", tmp_path)
    assert status == 2
    assert re.search(r"P01.* and .*P02.*named reaches", said)
    assert list(tmp_path.iterdir()) == []


def test_a_bag_is_saved_with_everything_or_what_is_left_is_told(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, said = run(capsys, "bag", "salvage", made / "02_qos_with_few_keys", "--out", tmp_path / "02")
    assert (status, "quality of service cannot be read, the default is taken" in said) == (0, True)
    status, said = run(capsys, "bag", "check", made / "03_last_file_empty")
    assert (status, "recording_2.mcap: wanted an MCAP file, got 0 bytes" in said) == (1, True)
    status, said = run(capsys, "bag", "salvage", made / "03_last_file_empty", "--out", tmp_path / "03")
    assert status == 0
    assert len(load_library(tmp_path / "03")) > 1
    for name in ("with_attachment", "cut"):
        run(capsys, "bag", "salvage", made / "04_attachment" / f"{name}.mcap", "--out", tmp_path / name)
        with (tmp_path / name / f"{name}_0.mcap").open("rb") as stream:
            assert [one.name for one in make_reader(stream).iter_attachments()], "the attachment is kept"
    status, said = run(
        capsys, "bag", "salvage", made / "05_topic_with_two_types" / "merged.mcap", "--out", tmp_path / "05"
    )
    assert "topic /status: wanted one type" in said
    for topic in (bag := BagReader(tmp_path / "05")).topics:
        for message in bag.messages([topic]):
            bag.decode(message)
    status, said = run(
        capsys, "bag", "salvage", made / "06_rosbag2_compression" / "each_message", "--out", tmp_path / "06"
    )
    assert status == 0
    assert len(load_library(tmp_path / "06")) == 6
    status, said = run(capsys, "bag", "check", made / "08_spoilt_unchunked_file" / "fast_spoilt.mcap")
    assert (status, "that do not decode" in said, "not all is well" in said) == (1, True, True)
    assert run(capsys, "bag", "check", made / "08_spoilt_unchunked_file" / "fast.mcap")[0] == 0
    for name in ("no_topics", "topics_only"):
        status, said = run(capsys, "bag", "salvage", made / "09_bag_without_messages" / name, "--out", tmp_path / name)
        assert (status, "intact and holds no messages" in said) == (2, True)


def test_what_is_recognised_but_not_read_says_what_to_do(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = made / "26_what_people_bring"
    for name, words in {
        "../07_other_storage/kinetic.bag": "ROS 1 bag",
        "walk.c3d": "C3D, recordings of markers: import it with --markers",
        "02_01.bvh": "BVH", "bvh_folder": "BVH", "amass.npz": "NumPy", "library.zip": "unpack it",
    }.items():  # fmt: skip
        status, said = run(capsys, "import", folder / name, "--out", tmp_path)
        assert (status, words in said) == (2, True), said
