"""`humanpred scene check` plans each task with nobody there and says of each why it cannot be done."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from humanpred_ros.cli import main
from humanpred_ros.resources import share_file


@pytest.mark.parametrize("robot", ["panda", "ur5"])
def test_every_task_of_the_mirrored_scenes_is_reached(robot: str, capsys: pytest.CaptureFixture[str]) -> None:
    for place, tasks in (("face_to_face", ("red", "blue")), ("side_by_side", ("red",))):
        assert main(["scene", "check", f"{robot}_{place}"]) == 0
        said = capsys.readouterr().out
        assert said.count("reached") == len(tasks)
        assert all(task in said for task in tasks)


def test_a_task_out_of_reach_is_told_with_its_reason_and_the_others_are_planned(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = yaml.safe_load(share_file("config", "scenes", "panda_face_to_face.yaml").read_text())
    content["goals"][0]["tool_pose"]["position_m"] = [0.0, -2.5, 0.9]
    (tmp_path / "far.yaml").write_text(yaml.safe_dump(content))
    plot = tmp_path / "far.png"
    assert main(["scene", "check", str(tmp_path / "far.yaml"), "--plot", str(plot)]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "no configuration within the joint limits" in said
    assert said.count("reached") == 1
    assert plot.read_bytes()[:4] == b"\x89PNG"


def test_the_schema_is_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scene", "schema"]) == 0
    assert "obstacles" in json.loads(capsys.readouterr().out)["properties"]


def test_a_robot_is_shown_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", "ur5", "--configurations", "20", "--plot", str(tmp_path / "ur5.png")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for words in (
        "wrist_3_joint",
        "forearm_link",
        "0 of them called free",
        "acceleration_limit: none; the manufacturer's",
    ):
        assert words in said
    assert (tmp_path / "ur5.png").stat().st_size > 10_000
