"""The doctor says what a machine has, tries DDS between two processes, and says what to do about what lacks."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

from humanpred_ros import __version__, cli
from humanpred_ros.nodes import doctor

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")


def test_a_machine_that_can_run_the_tests_has_what_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"DDS +ok +two participants met", said)
    found = set(re.findall(r"^ (\w+) +ok", said, re.MULTILINE))
    assert {"Python", "libraries", "cache", "disk", "robots", "scenes"} <= found


def test_what_lacks_is_said_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/nowhere")  # nobody can write there
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setitem(doctor._LIBRARIES, "no_such_module", "no-such-library")
    monkeypatch.setattr(doctor, "_CHECKS", {"libraries": doctor._libraries, "cache": doctor._cache})
    assert cli.main(["doctor"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(r"libraries +! +no-such-library cannot be imported .*pip install", said)
    assert re.search(r"cache +! +/proc/nowhere/humanpred_ros cannot be written .*set XDG_CACHE_HOME", said)
    assert "2 to mend" in said


def test_the_version_names_those_that_results_depend_on(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--version"]) == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == f"humanpred_ros {__version__}"
    assert re.search(r"numpy \d.*pin \d.*ROS 2", " ".join(rest))


def test_bash_completes_commands_and_flags(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["completion"]) == 0
    script = tmp_path / "humanpred"
    script.write_text(capsys.readouterr().out, encoding="utf-8")
    for words, wanted in (("eval", "evaluate"), ("evaluate reco", "recognition"), ("demo --predic", "--predictor")):
        last = len(words.split())
        line = (
            f'source {script}; COMP_WORDS=(humanpred {words}) COMP_CWORD={last}; _humanpred; echo "${{COMPREPLY[@]}}"'
        )
        done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True, cwd=tmp_path)
        assert done.stdout.split() == [wanted], done.stderr


def test_the_site_is_written_whole(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="needs the `docs` extra")
    assert cli.main(["docs", "--out", str(tmp_path / "site")]) == 0
    page = (tmp_path / "site" / "how" / "planning.html").read_text(encoding="utf-8")
    assert "<math" in page
    assert not re.search(r'(?:src|<link[^>]*href)="https?://', page)  # nothing comes from a network
