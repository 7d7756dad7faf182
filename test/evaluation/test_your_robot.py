"""The demo does its job with every arm: those that come with the package, and one of files that a page shows."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest
from paths import REPOSITORY
from rich.console import Console

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from humanpred_ros.cli import main
from humanpred_ros.evaluation.demo import DemoSettings, run_demo

PAGE = (REPOSITORY / "docs" / "howto" / "your_robot.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```yaml (\w+\.yaml)\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL))
#: By scene; in the shelf person and arm reach between the same boards.
ROBOTS = {"shelf": "Panda", "ur5_side_by_side": "UR5", "my_table.yaml": "my arm"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with nothing but the page's files."""
    folder = tmp_path_factory.mktemp("own")
    for name, text in FILES.items():
        assert len(text.splitlines()) <= 30
        (folder / name).write_text(text)
    return folder


def test_the_files_of_the_page_are_checked(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", str(files / "my_arm.yaml")]) == 0
    assert main(["scene", "check", str(files / "my_table.yaml")]) == 0
    assert capsys.readouterr().out.count("reached") == 2


@pytest.mark.parametrize("scene", ROBOTS)
def test_the_arm_reaches_a_goal_clear_of_the_person(scene: str, files: Path, tmp_path: Path) -> None:
    path = str(files / scene) if scene in FILES else scene
    out = tmp_path / "run"
    settings = DemoSettings(scene=path, predictor="current", one_process=True, steps=8, out=str(out))
    summary = run_demo(settings, Console(file=io.StringIO()))
    assert summary.reached is not None
    assert summary.closest is not None
    assert summary.closest.distance_m > 0.0
    assert ROBOTS[scene] in (out / "report.html").read_text(encoding="utf-8")
    # What is missing is told in a note; nothing of the run may depend on the folder that the files came from.
    assert not [note for note in summary.notes if "scene" in note]
