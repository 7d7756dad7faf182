"""`humanpred import` writes into the folder meant for it, and nothing before everything can be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_libraries import write_csv_library
from mocap_library import mocap_library
from rich.console import Console

from humanpred_ros.cli import main
from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.commands import ImportSettings, import_libraries
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary, require_plain_name


def library(name: str, value: float = 0.1) -> MotionLibrary:
    return MotionLibrary(name, (Motion(np.arange(4) * 0.02, np.full((4, 12), value), KINECT12_DOFS, 0),))


def run(out: Path, *sources: Path, **settings: object) -> None:
    import_libraries(ImportSettings(source=tuple(map(str, sources)), out=out, **settings), Console(quiet=True))


@pytest.mark.parametrize("name", ["..", "../elsewhere", "/elsewhere", "a\\b", ".hidden", " a", "a\n"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_bag_s_own_name_cannot_leave_the_folder(tmp_path: Path, name: str, overwrite: bool) -> None:
    (tmp_path / "elsewhere").mkdir()
    bag = write_library_bag(library(name), tmp_path / "bag")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(LibraryFormatError, match="library name"):
        run(tmp_path / "out", bag, overwrite=overwrite)
    assert sorted(tmp_path.rglob("*")) == before
    assert require_plain_name("here", "reaches of Ann, 2") == "reaches of Ann, 2"


def test_two_sources_of_one_name_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    for person, value in (("P01", 0.1), ("P02", 0.2)):
        (tmp_path / person).mkdir()
        write_csv_library(library("reaches", value), tmp_path / person / "reaches")
    with pytest.raises(UsageError, match=r"P01.* and .*P02.*named reaches"):
        run(tmp_path / "out", tmp_path / "P01" / "reaches", tmp_path / "P02" / "reaches", overwrite=True)
    assert not (tmp_path / "out").exists()


def test_the_23_dof_human_is_imported_like_the_other(tmp_path: Path) -> None:
    write_csv_library(mocap_library(2, 2), tmp_path / "captured")
    words = ["import", str(tmp_path / "captured"), "--out", str(tmp_path / "out"), "--clean"]
    assert main(words) == 0
    assert len(load_library(tmp_path / "out" / "captured")) == 4
