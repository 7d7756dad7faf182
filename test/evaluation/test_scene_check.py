"""`humanpred scene check` plans each task with nobody there and says of each why it cannot be done."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

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


WRONG: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "no tasks": (lambda s: s.update(goals=[]), "wanted at least one goal, got none"),
    "two tasks of one name": (lambda s: s["goals"][1].update(name="red"), "different goal names, got red twice"),
    "a lattice elsewhere": (lambda s: s["grid"].update(origin_m=[20, -3, 0]), "grid: wanted voxels around the arm"),
    "voxels in millimetres": (lambda s: s["grid"].update(resolution_m=50), "grid: resolution_m: .* got 50"),
    "a mesh of another kind": (
        lambda s: s.update(obstacles=[{"name": "a", "position_m": [0, 0, 0], "mesh": "wrong.yaml"}]),
        r"obstacle a: wanted a readable mesh \(STL, OBJ, DAE\), got .*wrong\.yaml",
    ),
    "a start in an obstacle": (
        lambda s: s.update(obstacles=[{"name": "post", "position_m": [-0.1, -0.15, 1.3], "sphere_m": 0.3}]),
        "start of scene .* m deep in post; move",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_with_more_than_a_task_is_one_line(
    wrong: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    change, words = WRONG[wrong]
    content = yaml.safe_load(share_file("config", "scenes", "panda_face_to_face.yaml").read_text())
    change(content)
    (tmp_path / "wrong.yaml").write_text(yaml.safe_dump(content))
    assert main(["scene", "check", str(tmp_path / "wrong.yaml")]) == 2
    said = capsys.readouterr()
    assert re.fullmatch(f"humanpred: .*{words}.*\n", said.err), said.err
    assert not said.out


def test_a_scene_without_obstacles_is_planned_in(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = yaml.safe_load(share_file("config", "scenes", "panda_face_to_face.yaml").read_text())
    del content["table"], content["objects"]
    (tmp_path / "empty.yaml").write_text(yaml.safe_dump(content))
    assert main(["scene", "check", str(tmp_path / "empty.yaml")]) == 0
    assert capsys.readouterr().out.count("reached") == 2


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
