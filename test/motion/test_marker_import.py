"""Marker recordings: postures come back from C3D, TRC and CSV files; what cannot be right is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from joint_centres import joint_centres
from reaching_people import MODEL, reach
from rich.console import Console

from humanpred_ros.cli import main, parse
from humanpred_ros.errors import HumanPredError, LibraryFormatError, MotionError, SettingsError, UsageError
from humanpred_ros.human.marker_skeleton import MarkerSkeleton
from humanpred_ros.motion.commands import ImportSettings, import_libraries
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.marker_files import read_marker_file
from humanpred_ros.motion.reach_recordings import load_reach_recordings

SKELETON = MarkerSkeleton()
NAMES = SKELETON.markers.names
INDEX = SKELETON.markers.index
RATE_HZ = 100.0


def markers(seed: int, person: int = 1, n_frames: int = 60) -> np.ndarray:
    """Return the markers (T, 22, 3) of the reaching person (1) or the partner (2), metres, z up."""
    return SKELETON.points(reach(seed, n_frames)[person])


def write_c3d(path: Path, points: np.ndarray, names: tuple[str, ...] = NAMES, unit: str = "m") -> Path:
    ezc3d = pytest.importorskip("ezc3d")
    content: Any = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [RATE_HZ]
    content["parameters"]["POINT"]["LABELS"]["value"] = tuple(names)
    content["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    content["data"]["points"] = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2).transpose(2, 1, 0)
    content.write(str(path))
    return path


def number(value: float) -> str:
    return "" if np.isnan(value) else repr(float(value))


def write_trc(path: Path, points: np.ndarray, names: tuple[str, ...] = NAMES, unit: str = "mm") -> Path:
    facts = [str(RATE_HZ), str(RATE_HZ), str(len(points)), str(len(names)), unit, str(RATE_HZ), "1", str(len(points))]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        "\t".join(facts),
        "Frame#\tTime\t" + "\t\t\t".join(names) + "\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(names) + 1)),
        "",
    ]
    lines += ["\t".join([str(k + 1), f"{k / RATE_HZ:.6f}", *map(number, frame.ravel())])
              for k, frame in enumerate(points)]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")
    return path


def write_csv(path: Path, points: np.ndarray, names: tuple[str, ...] = NAMES, times: bool = True) -> Path:
    titles = [f"{name}_{axis}" for name in names for axis in "xyz"]
    rows = [[*([k / RATE_HZ] if times else []), *frame.ravel()] for k, frame in enumerate(points)]
    lines = [",".join([*(["time"] if times else []), *titles]), *(",".join(map(number, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_nexus(path: Path, points: np.ndarray) -> Path:
    lines = [
        "Trajectories",
        f"{RATE_HZ:g}",
        ",," + ",,,".join(f"Ann:{name}" for name in NAMES) + ",,",
        "Frame,Sub Frame," + ",".join(["X,Y,Z"] * len(NAMES)),
        ",," + ",".join(["mm"] * 3 * len(NAMES)),
    ]
    lines += [f"{k + 1},0," + ",".join(map(number, frame.ravel())) for k, frame in enumerate(1000 * points)]
    path.write_text("\n".join(lines) + "\n")
    return path


def names_file(folder: Path, **content: object) -> Path:
    path = folder / "session.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def run(folder: Path, *sources: Path, expect: str = "", **settings: object) -> Path:
    """Import; return the library's folder."""
    settings = {"markers": folder / "session.yaml", "out": folder / "out", **settings}
    import_libraries(ImportSettings(source=tuple(map(str, sources)), **settings), Console(quiet=True))
    return folder / "out" / "session"


def error_of(found: np.ndarray, wanted: np.ndarray) -> float:
    gap = found - wanted
    angles = ["Trans" not in name for name in MODEL.dof_names]
    gap[:, angles] = (gap[:, angles] + np.pi) % (2 * np.pi) - np.pi
    return float(np.abs(gap).max())


def test_postures_come_back_from_every_format(tmp_path: Path) -> None:
    points, q = markers(3), reach(3, 60)[1]
    named = tuple(f"Ann:{name}" for name in NAMES)
    write_c3d(tmp_path / "one.c3d", 1000 * points, named, "mm").rename(tmp_path / "one.C3D")
    write_trc(tmp_path / "two.trc", 1000 * points, named)
    write_csv(tmp_path / "three.csv", points, named)
    write_nexus(tmp_path / "four.csv", points)
    names_file(tmp_path, prefix="Ann:", classes={"o*": 2, "t*": 0})
    library = load_library(
        run(tmp_path, tmp_path / "one.C3D", *(tmp_path / f for f in ("two.trc", "three.csv", "four.csv")))
    )
    assert (library.name, library.frame_id, library.dof_names) == ("session", "mocap", MODEL.dof_names)
    assert [motion.name for motion in library] == ["2/0", "0/0", "0/1", "-/0"]
    assert library.provenance["takes"] == "2/0 is one; 0/0 is two; 0/1 is three; -/0 is four"
    for motion in library:
        np.testing.assert_allclose(motion.t_s, np.arange(60) / RATE_HZ, atol=1e-9)
        assert error_of(motion.q, q) < 1e-4  # C3D holds float32


def test_a_folder_of_takes_through_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    takes = tmp_path / "takes"
    takes.mkdir()
    for seed, name in enumerate(("left_1", "left_2", "right_1")):
        write_csv(takes / f"{name}.csv", markers(seed), times=False)
    (takes / "notes.txt").write_text("not a take")
    names = names_file(tmp_path, rate_hz=RATE_HZ, classes={"left*": 0, "right*": 1})
    words = ["import", str(takes), "--markers", str(names), "--out", str(tmp_path / "out"), "--name", "reaches"]
    assert main(words) == 0
    assert "left_2 is 0/1: 60 frames" in capsys.readouterr().out
    assert [motion.name for motion in load_library(tmp_path / "out" / "reaches")] == ["0/0", "0/1", "1/0"]
    assert main(words) == 2
    assert "exists" in capsys.readouterr().err
    assert main([*words, "--overwrite"]) == 0


def test_other_axes_units_and_labels(tmp_path: Path) -> None:
    points = markers(4)
    labels = tuple({"C7": "Neck", "RH2": "Index"}.get(name, name) for name in NAMES)
    write_csv(tmp_path / "take.csv", 100 * points[:, :, [1, 2, 0]], labels)  # x to the left, y up, z forward
    names_file(tmp_path, units="cm", axes=["z", "x", "y"], markers={"C7": "Neck", "RH2": "Index"})
    (motion,) = load_library(run(tmp_path, tmp_path / "take.csv"))
    assert error_of(motion.q, reach(4, 60)[1]) < 1e-6


def test_two_people_in_one_recording(tmp_path: Path) -> None:
    both = np.concatenate([markers(5), markers(5, person=2)], axis=1)
    both[:3, INDEX["RH2"]] = both[:3, INDEX["RH5"]] = np.nan  # who reaches is seen whole from frame 3
    labels = (*(f"A:{name}" for name in NAMES), *(f"B:{name}" for name in NAMES))
    source = write_c3d(tmp_path / "0001.c3d", both, labels)
    names_file(tmp_path, persons={"active": {"prefix": "A:"}, "passive": {"prefix": "B:"}})
    with pytest.raises(MotionError, match=r"0001\.c3d.*hand \(RH2, RH5.*3 frames from 0 to 2"):
        run(tmp_path, source)
    assert list((tmp_path / "out").iterdir()) == []
    (recording,) = load_reach_recordings(run(tmp_path, source, trim=True))
    _, active, passive = reach(5, 60)
    assert (recording.name, len(recording.active)) == ("0001", 57)
    assert error_of(recording.active.q, active[3:]) < 1e-4
    assert error_of(recording.passive.q, passive[3:]) < 1e-4
    with pytest.raises(UsageError, match=r"0001_active\.csv.*exists"):
        run(tmp_path, source, trim=True)
    beside = tmp_path / "out" / "session" / "beside.txt"
    beside.write_text("kept")
    run(tmp_path, source, trim=True, overwrite=True)
    assert beside.exists()


def test_unlabelled_markers_are_labelled_by_shape_and_distance(tmp_path: Path) -> None:
    points, rng = markers(6), np.random.default_rng(0)
    order = rng.permutation(len(NAMES))
    shuffled = np.stack([frame[order] for frame in points])
    source = write_c3d(tmp_path / "take.c3d", shuffled, tuple(f"*{k}" for k in range(len(NAMES))))
    names_file(tmp_path, labels="shape")
    (motion,) = load_library(run(tmp_path, source))
    assert error_of(motion.q, reach(6, 60)[1]) < 1e-3
    write_c3d(source, np.delete(shuffled, [np.flatnonzero(order == INDEX[n])[0] for n in ("RH2", "RH5")], axis=1),
              tuple(f"*{k}" for k in range(len(NAMES) - 2)))  # fmt: skip
    with pytest.raises(MotionError, match=r"take\.c3d: .*hand \(RH2, RH5, RHD, RHT\)"):
        run(tmp_path, source, overwrite=True)


def test_gaps_are_filled_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = markers(7)
    points[10:40, INDEX["REM"]] = 0.0  # hidden, as many programs write it
    points[20:26, [INDEX[name] for name in ("RH2", "RH5", "RHD", "RHT")]] = np.nan
    source = write_csv(tmp_path / "take.csv", points)
    names = names_file(tmp_path)
    words = ["import", str(source), "--markers", str(names), "--out", str(tmp_path / "out")]
    assert main([*words, "--longest-gap", "0.02"]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in ("take.csv", "hand (RH2", "6 frames from 20 to 25", "longest"))
    assert main(words) == 0
    assert "4.1 % of the markers hidden" in capsys.readouterr().out
    (motion,) = load_library(tmp_path / "out" / "session")
    found, wanted = joint_centres(MODEL, motion.q), joint_centres(MODEL, reach(7, 60)[1])
    assert max(np.linalg.norm(found[name] - wanted[name], axis=1).max() for name in found) < 0.005


def test_a_calibration_tells_markers_that_a_take_never_shows(tmp_path: Path) -> None:
    write_csv(tmp_path / "static.csv", markers(8))
    hidden = markers(8)
    hidden[:, INDEX["REM"]] = np.nan
    source = write_csv(tmp_path / "take.csv", hidden)
    names_file(tmp_path)
    with pytest.raises(MotionError, match=r"take\.csv: .*upper_arm"):
        run(tmp_path, source)
    names_file(tmp_path, calibration="static.csv")
    (motion,) = load_library(run(tmp_path, source))
    assert error_of(motion.q, reach(8, 60)[1]) < 1e-6


def test_markers_of_ones_own_and_fewer_than_packaged(tmp_path: Path) -> None:
    kept = tuple(name for name in NAMES if name not in ("RUB", "RFB", "RHT", "RHD"))
    points = markers(9)[:, [INDEX[name] for name in kept]]
    source = write_csv(tmp_path / "take.csv", points, kept)
    names_file(tmp_path)
    (motion,) = load_library(run(tmp_path, source))
    assert error_of(motion.q, reach(9, 60)[1]) < 1e-6
    names_file(tmp_path, extra={"RFX": {"segment": "forearm", "place_m": [0.0, -0.04, 0.1]}})
    with pytest.raises(LibraryFormatError, match=r"take\.csv: wanted the markers RFX \(as 'RFX'\)"):
        run(tmp_path, source, overwrite=True)


def exchanged(points: np.ndarray, a: str, b: str) -> np.ndarray:
    points = points.copy()
    points[:, [INDEX[a], INDEX[b]]] = points[:, [INDEX[b], INDEX[a]]]
    return points


@pytest.mark.parametrize(
    ("points", "labels", "error", "said"),
    [
        (exchanged(markers(1), "REL", "RUA"), NAMES, MotionError, r"take\.csv: .*REL and RUA exchanged"),
        (exchanged(exchanged(markers(1), "LASI", "RASI"), "LPSI", "RPSI"), NAMES, MotionError, r"take\.csv: .*left"),
        (1000 * markers(1), NAMES, MotionError, r"take\.csv: .*not in metres"),
        (markers(1), ("Chest", *NAMES[1:]), LibraryFormatError, r"take\.csv: .*LASI \(as 'LASI'\).*'Chest'"),
        (markers(1), (*NAMES[:-1], "RHD"), LibraryFormatError, r"take\.csv:1: columns twice: RHD_x"),
        (markers(1)[:1], NAMES, LibraryFormatError, r"take\.csv: .*at least 2 frames"),
        (np.full((9, 22, 3), np.nan), NAMES, MotionError, r"take\.csv: .*no frame determines the waist"),
    ],
)  # fmt: skip
def test_recordings_that_cannot_be_right_are_refused(
    tmp_path: Path, points: np.ndarray, labels: tuple[str, ...], error: type[HumanPredError], said: str
) -> None:
    source = write_csv(tmp_path / "take.csv", points, labels)
    names_file(tmp_path)
    with pytest.raises(error, match=said):
        run(tmp_path, source)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"unit": "mm"}, "no setting unit"),
        ({"units": "inch"}, "units"),
        ({"axes": ["x", "y", "y"]}, "axes: .*right-handed"),
        ({"axes": ["x", "z", "y"]}, "axes: .*right-handed"),
        ({"axes": ["x", "up", "y"]}, "axes: .*-z"),
        ({"persons": {"ann": {}}}, "persons: wanted active .* got ann"),
        ({"persons": {"active": {}, "passive": {}}, "labels": "shape"}, "shapes do not distinguish two people"),
        ({"markers": {"C8": "Neck"}}, "got C8"),
        ({"markers": {"C7": 7}}, "markers.C7"),
        ({"classes": {"*": "a/b"}}, "label: wanted a text"),
        ({"classes": {"t*": 1, "*e": 2}}, r"one class for take.*\['1', '2'\]"),
        ({"rate_hz": -1.0}, "rate_hz"),
        ({"calibration": "absent.csv"}, r"absent\.csv"),
        (["C7"], "wanted entries"),
    ],
)  # fmt: skip
def test_names_that_cannot_be_used_are_refused(tmp_path: Path, content: Any, said: str) -> None:
    source = write_csv(tmp_path / "take.csv", markers(1))
    (tmp_path / "session.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises((SettingsError, LibraryFormatError), match=said):
        run(tmp_path, source)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("take.bvh", "HIERARCHY", r"ends with \.c3d, \.trc, \.csv"),
        ("take.c3d", "not a C3D file" * 50, "it cannot be read"),
        ("take.trc", "PathFileType\t4\n", "labels above a row of X, Y, Z"),
        ("take.csv", "", "empty"),
        ("take.csv", "a,b\n1,2\n", "labels above a row of X, Y, Z"),
        ("take.csv", "t,A_x,A_y\n0,1,2\n", "x, y and z of each marker, .* A"),
        ("take.csv", "A_x,A_y,A_z\n0,1,2\n1,1,2\n", "state rate_hz"),
        ("take.csv", "t,A_x,A_y,A_z\n0,1,2,3\n0,1,2,3\n", "rising times"),
        ("take.csv", "t,A_x,A_y,A_z\n0,1,2,3\n,1,2,3\n", "rising times"),
        ("take.csv", "t,A_x,A_y,A_z\n0,1,2,3\n1,1,two,3\n", r":3: column A_y: wanted a number, got 'two'"),
        ("take.csv", ",,A,,\nFrame,Sub Frame,X,Y,Z\n1,0,1,2,3\n2,0,1,two,3\n", ":4: column 4: .*'two'"),
    ],
)  # fmt: skip
def test_files_that_cannot_be_read_are_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(LibraryFormatError, match=said):
        read_marker_file(tmp_path / name)


def test_c3d_files_need_their_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "take.c3d").write_bytes(b"")
    monkeypatch.setitem(__import__("sys").modules, "ezc3d", None)
    with pytest.raises(UsageError, match=r"humanpred_ros\[markers\]"):
        read_marker_file(tmp_path / "take.c3d")


def test_names_of_libraries_stay_in_the_folder_meant_for_them(tmp_path: Path) -> None:
    source = write_csv(tmp_path / "take.csv", markers(1))
    names_file(tmp_path)
    for name in ("..", "/tmp/elsewhere", "a/b", ".hidden", "a\nb"):
        with pytest.raises(LibraryFormatError, match="library name"):
            run(tmp_path, source, name=name)
    assert not (tmp_path / "out").exists()


def test_two_takes_of_one_name_are_refused(tmp_path: Path) -> None:
    sources = [
        write_csv(tmp_path / folder / "take.csv", markers(1))
        for folder in ("a", "b")
        if not (tmp_path / folder).mkdir()
    ]
    names_file(tmp_path)
    with pytest.raises(UsageError, match="both are named take"):
        run(tmp_path, *sources)
    assert parse(["import", "x", "--out", "y"])
