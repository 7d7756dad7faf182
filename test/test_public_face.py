"""The public face has the names it documents, loads nothing it need not, and the examples run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from paths import REPOSITORY

import humanpred_ros as hp

EXAMPLES = REPOSITORY / "examples"
PROGRAMS = sorted(path.name for path in EXAMPLES.glob("*.py"))
#: What each program prints, besides what it needs to be told.
PRINTED = {
    "own_classifier.py": r"class 3, p = 0\.\d\d\n",
    "own_cost_term.py": r"smoothness: .*\nsmoothness, raised_elbow: ",
    "own_library.py": r"my_reaches: 12 motions; motion 0/0 is taken for class 0",
    "own_predictor.py": r"3\.\d\d s: \d+ voxels, class 3\n",
    "own_scene.py": r"chosen: place \d",
    "own_tracker.py": r"the hand is at \(1\.5\d, 0\.2\d, .*bridged: neck, torso\nlost hand: ",
    "whole_chain.py": r"class 3  goal place",
}


def test_every_documented_name_is_there_and_every_name_is_documented() -> None:
    documented = set(re.findall(r"`(\w+)`", (hp.__doc__ or "").split("|---|---|")[1].split("\n\n")[0]))
    assert documented == set(hp.__all__)
    for name in hp.__all__:
        assert getattr(hp, name) is not None
        assert name in dir(hp)
    with pytest.raises(AttributeError, match="load_libary"):
        _ = hp.load_libary


def test_importing_the_package_loads_nothing_else() -> None:
    program = (
        "import sys, humanpred_ros; print(sorted(m for m in sys.modules if m.startswith(('humanpred_ros.', 'numpy'))))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_whole_chain_is_short() -> None:
    lines = (EXAMPLES / "whole_chain.py").read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if line.strip() and not line.strip().startswith(("#", '"""'))]) <= 25


def test_all_examples_are_run() -> None:
    assert {*PRINTED, "read_run.py"} == set(PROGRAMS)  # that one reads a run: see test/viewing/test_run.py
    assert len(PROGRAMS) >= 6


@pytest.mark.parametrize("program", sorted(PRINTED))
def test_example(program: str, tmp_path: Path) -> None:
    arguments = [str(tmp_path)] if program == "own_library.py" else []
    assert re.search(PRINTED[program], run(program, arguments, tmp_path))


def run(program: str, arguments: list[str], folder: Path) -> str:
    """Run an example from another folder, as a user would; return what it prints."""
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / program), *arguments],
        cwd=folder, env=os.environ | {"PYTHONWARNINGS": "error::DeprecationWarning:humanpred_ros"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout
