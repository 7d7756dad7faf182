"""Bad input ends with one line on stderr and status 2, and leaves nothing half-written behind."""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import yaml
from csv_libraries import write_csv_library
from paths import REPOSITORY, shared_data

from humanpred_ros.bags.messages import string
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.cli import COMMANDS, add_flags, main
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.settings import Settings, setting


def small_library(n_classes: int = 2, n_motions: int = 3) -> MotionLibrary:
    """Return smooth motions whose classes differ in the shoulder angle reached."""
    rng = np.random.default_rng(5)
    t_s = np.linspace(0.0, 1.0, 40)
    rest = np.array([-0.17, -1.82, 0.76, 1.3, 0.1, 0.0, 0.0, 1.3, -0.2, -0.3, 0.12, 0.4])
    motions = []
    for index in range(n_motions):
        for label in range(n_classes):
            reach = np.zeros(12)
            reach[[7, 8]] = (-0.5, 0.3 * label)
            wobble = rng.normal(scale=0.01, size=(1, 12)) + rng.normal(scale=0.003, size=(len(t_s), 12))
            q = rest + np.sin(np.pi * t_s / 2)[:, None] ** 2 * reach + wobble
            motions.append(Motion(t_s, q, KINECT12_DOFS, label, index))
    return MotionLibrary("small", tuple(motions), {"source": "test"})


@pytest.fixture
def library(tmp_path: Path) -> Path:
    return write_library_bag(small_library(), tmp_path / "library")


def expect_refusal(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("humanpred: ")
    assert "\n" not in error
    assert words in error


def truncate(bag: Path, kept: float = 0.5) -> None:
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * kept)])


def without_joint_states(bag: Path) -> None:
    shutil.rmtree(bag)
    with BagWriter(bag) as writer:
        writer.write_message("/chatter", 1, string("hello"))


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (shutil.rmtree, "neither a path that exists"),
        (truncate, "salvage"),
        (without_joint_states, "joint"),
    ],
)
def test_unusable_bags(
    spoil: Callable[[Path], None], words: str, library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(library)
    expect_refusal(["train", str(library), "--out", str(tmp_path / "model.npz")], words, capsys)
    assert not (tmp_path / "model.npz").exists()


def csv_of(tmp_path: Path) -> Path:
    write_csv_library(small_library(), tmp_path / "csv")
    return tmp_path / "csv"


@pytest.mark.parametrize(
    ("row", "column", "value", "words"),
    [
        (0, "rElbowZ", "leftKnee", "leftKnee"),
        (0, "rElbowZ", "", "rElbowZ"),
        (7, "rElbowZ", "nan", "nan"),
        (7, "TorsoX", "inf", "inf"),
        (7, "t_s", "-1.0", "increas"),
        (7, "TorsoX", "much", "much"),
    ],
)
def test_unusable_csv(
    row: int, column: str, value: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = csv_of(tmp_path)
    file = folder / "class_0.csv"
    rows = [line.split(",") for line in file.read_text(encoding="utf-8").splitlines()]
    rows[row][rows[0].index(column)] = value
    file.write_text("\n".join(",".join(cells) for cells in rows) + "\n", encoding="utf-8")
    expect_refusal(["import", str(folder), "--out", str(tmp_path / "bags")], words, capsys)
    assert not (tmp_path / "bags" / "csv").exists()


@pytest.mark.parametrize(("n_classes", "n_motions", "words"), [(1, 3, "two classes"), (2, 1, "two motions")])
def test_libraries_too_small_to_learn_from(
    n_classes: int, n_motions: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_library_bag(small_library(n_classes, n_motions), tmp_path / "few")
    expect_refusal(["train", str(bag), "--out", str(tmp_path / "model.npz")], words, capsys)
    assert list(tmp_path.glob("*.npz")) == []


def scene_with(tmp_path: Path, change: Callable[[dict[str, object]], None]) -> str:
    scene = yaml.safe_load((REPOSITORY / "config" / "scenes" / "face_to_face.yaml").read_text(encoding="utf-8"))
    change(scene)
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump(scene), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda scene: scene.update(tabel=1), "tabel"),
        (lambda scene: scene["goals"][0]["configuration_deg"].__setitem__(1, 120.0), "r_shoulder_lift_joint"),
        (lambda scene: scene["table"]["top_centre_m"].__setitem__(2, 0.95), "deep in"),
        (lambda scene: scene["goals"].clear(), "goal"),
    ],
)
def test_unusable_scenes(
    change: Callable[[dict[str, object]], None],
    words: str,
    library: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    scene = scene_with(tmp_path, change)
    out = tmp_path / "run"
    motions = ["--library", str(library), "--trajectory", "0/0", "--hold-out", "1"]
    expect_refusal(["demo", "--scene", scene, *motions, "--out", str(out)], words, capsys)
    assert not out.exists()


def test_a_model_made_for_another_human(
    library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = tmp_path / "model.npz"
    assert main(["train", str(library), "--out", str(model), "--set", "gmm.n_components=3"]) == 0
    longer_arm = HumanModel.kinect12().urdf.replace("0 -0.15 0", "0 -0.18 0")
    other = HumanModel(longer_arm)
    assert other.signature != HumanModel.kinect12().signature
    monkeypatch.setattr(HumanModel, "kinect12", classmethod(lambda cls: other))
    out = tmp_path / "run"
    expect_refusal(
        ["demo", "--library", str(library), "--trajectory", "0/0", "--model", str(model), "--out", str(out)],
        "another human",
        capsys,
    )
    assert not out.exists()


def test_a_damaged_model(library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "model.npz"
    assert main(["train", str(library), "--out", str(model), "--set", "gmm.n_components=3"]) == 0
    model.write_bytes(model.read_bytes()[:-2000])
    expect_refusal(
        [
            "demo",
            "--library",
            str(library),
            "--trajectory",
            "0/0",
            "--model",
            str(model),
            "--out",
            str(tmp_path / "run"),
        ],
        "model.npz",
        capsys,
    )


def test_unknown_names_list_the_valid_ones(library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    expect_refusal(["demo", "--library", "no_such_library"], "synthetic_reaches", capsys)
    expect_refusal(["demo", "--scene", "no_such_scene"], "side_by_side", capsys)
    expect_refusal(["demo", "--library", str(library), "--trajectory", "9/9"], "9/9", capsys)


def test_a_run_folder_is_never_written_over(library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "precious").write_text("data", encoding="utf-8")
    expect_refusal(
        ["demo", "--library", str(library), "--trajectory", "0/0", "--out", str(tmp_path / "run")], "not empty", capsys
    )
    assert (tmp_path / "run" / "precious").read_text(encoding="utf-8") == "data"


def test_import_reads_back_identical(tmp_path: Path) -> None:
    source = shared_data("iros2013/library_a_raw_timed")
    assert main(["import", str(source), "--out", str(tmp_path)]) == 0
    before, after = load_library(source), load_library(tmp_path / "library_a_raw_timed")
    assert len(before) == len(after) == 200
    for a, b in zip(before, after, strict=True):
        assert (a.name, a.dof_names, a.frame_id) == (b.name, b.dof_names, b.frame_id)
        assert np.array_equal(a.t_s, b.t_s)
        assert np.array_equal(a.q, b.q)


def test_a_truncated_bag_can_be_salvaged(library: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bag", "check", str(library)]) == 0
    truncate(library, kept=0.95)
    assert main(["bag", "check", str(library)]) == 1
    assert main(["bag", "salvage", str(library), "--out", str(tmp_path / "saved")]) == 0
    assert main(["bag", "check", str(tmp_path / "saved")]) == 0
    assert "all is well" in capsys.readouterr().out


class Sizes(Settings):
    """Settings of an invented command."""

    place: Path = setting(..., "where", positional=True)
    counts: tuple[int, ...] = setting((1, 2), "how many", low=0)
    kind: Literal["round", "square"] = setting("round", "shape")
    rate: float | None = setting(None, "times the speed", bare=1.0)
    smooth: bool = setting(True, "smooth it")
    loud: bool = setting(False, "say more")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("here", {}),
        ("here --counts 3 4 --kind square", {"counts": (3, 4), "kind": "square"}),
        ("here --counts 3,4,5", {"counts": (3, 4, 5)}),
        ("here --rate", {"rate": 1.0}),
        ("here --rate 2.5 --no-smooth --loud", {"rate": 2.5, "smooth": False, "loud": True}),
    ],
)
def test_flags_come_from_the_fields_of_settings(words: str, expected: dict[str, object]) -> None:
    parser = argparse.ArgumentParser()
    add_flags(parser, Sizes)
    assert Sizes(**vars(parser.parse_args(words.split()))) == Sizes(place=Path("here"), **expected)


def test_help_shows_defaults_and_units(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["demo", "--help"])
    assert end.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "--scene SCENE" in shown
    assert "(default: four_places)" in shown
    assert "--hold-last-s S" in shown
    assert "--real-time [N]" in shown
    assert shown.index("The main job") < shown.index("Five processes") < shown.index("--scene SCENE scene name")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("", "demo"),
        ("dmo", "dmo"),
        ("evaluate", "recognition"),
        ("bench planer", "planer"),
        ("demo --frob", "--frob"),
        ("demo --hold-out -1", "--hold-out"),
        ("demo --hold-out few", "--hold-out"),
        ("train", "--out"),
        ("bag check", "BAG"),
    ],
)
def test_what_cannot_be_understood_is_refused_in_one_line(
    words: str, named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    expect_refusal(words.split(), named, capsys)


@pytest.mark.parametrize("words", [["--help"], ["evaluate", "--help"]])
def test_the_commands_are_listed_without_importing_them(words: list[str]) -> None:
    code = f"import sys; from humanpred_ros.cli import main; main({words}); print(*sys.modules)"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "evaluate recognition" in shown
    assert "numba" not in shown
    assert "scipy" not in shown


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_its_function(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([*name.split(), "--help"])
    assert f"usage: humanpred {name}" in capsys.readouterr().out
