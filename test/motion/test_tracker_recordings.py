"""Bags of trackers' points become motions; frames that cannot be used are counted by reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.cli import main
from humanpred_ros.human.model import HumanModel
from humanpred_ros.human.skeletons import load_skeleton, person_points
from humanpred_ros.motion.library_io import load_library

HUMAN = HumanModel.kinect12()
MOTION = load_library(REPOSITORY / "bags" / "synthetic_reaches").motions[0]
COCO = load_skeleton("coco17").shown(person_points(HUMAN, MOTION.q))
S = 1_000_000_000


def poses(points: np.ndarray, stamp_ns: int, frame_id: str = "camera") -> Any:
    types = ros.typestore().types
    none = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    point, pose = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Pose"]
    stamp = types["builtin_interfaces/msg/Time"](stamp_ns // S, stamp_ns % S)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)
    return types["geometry_msgs/msg/PoseArray"](header, [pose(point(*map(float, xyz)), none) for xyz in points])


def write(path: Path, frames: list[tuple[int, np.ndarray]], topic: str = "/people", stamped: bool = True) -> Path:
    with BagWriter(path) as bag:
        for log_ns, points in frames:
            bag.write_message(topic, log_ns, poses(points, log_ns if stamped else 0))
    return path


def frames_of(points: np.ndarray, first_s: float) -> list[tuple[int, np.ndarray]]:
    return [(round((first_s + t) * S), frame) for t, frame in zip(MOTION.t_s, points, strict=True)]


def test_points_in_a_bag_become_motions_cut_at_pauses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    second = COCO.copy()
    second[20] *= 1000.0
    second[40] = np.nan
    both = np.concatenate([COCO, COCO + np.array([0.0, 1.5, 0.0])], axis=1)
    frames = [*frames_of(COCO, 10.0), *frames_of(second, 20.0), *frames_of(both, 30.0)]
    write(tmp_path / "camera", frames)
    assert main(["import", str(tmp_path / "camera"), "--skeleton", "coco17", "--out", str(tmp_path / "out")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "1 frames refused: units" in said
    assert "people: body_0: 3 motions; body_1: 1 motions" in said
    library = load_library(tmp_path / "out" / "camera")
    assert len(library) == 4
    assert [len(m) for m in library.motions[::2]] == [len(MOTION), len(MOTION)]
    palm = HUMAN.forward(library.motions[0].q)["right_palm"] - HUMAN.forward(MOTION.q)["right_palm"]
    assert np.linalg.norm(palm, axis=1).max() < 0.05


def test_points_without_stamps_have_their_log_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "camera", frames_of(COCO, 10.0), stamped=False)
    words = ["import", str(tmp_path / "camera"), "--skeleton", "coco17", "--out", str(tmp_path / "out"), "--dry-run"]
    assert main(words) == 0
    assert f"log times: {len(MOTION)} frames have no stamp" in " ".join(capsys.readouterr().out.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "extra", "words"),
    [
        (1000.0, [], ["no posture", "frames refused: units"]),
        (np.nan, [], ["no posture", "nobody is seen"]),
        (1.0, ["--topic", "/other"], ["/other", "/people"]),
        (1.0, ["--skeleton", "azure_kinect"], ["no posture", "messages: poses"]),
        (1.0, ["--tracker-pose", "1 2"], ["six numbers"]),
    ],
)
def test_what_cannot_be_used_is_one_line(
    change: float, extra: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "camera", frames_of(COCO * change, 10.0))
    skeleton = [] if "--skeleton" in extra else ["--skeleton", "coco17"]
    assert main(["import", str(tmp_path / "camera"), *skeleton, *extra, "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    for word in words:
        assert word in line
