"""Long streams made of left-out motions: what was put into them is found again, and counted honestly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from small_library import small_library

from humanpred_ros.cli import main, parse
from humanpred_ros.evaluation.streams import command as stream_command
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import MotionLibrary


def resting_first(n_motions: int = 4) -> MotionLibrary:
    """Return reaches that begin and end with rest, as recordings do."""
    library = small_library(3, n_motions, 90, there_and_back=True)
    rng = np.random.default_rng(0)
    motions = []
    for motion in library:
        before = motion.q[0] + rng.normal(0.0, 0.002, (25, 12))
        after = motion.q[-1] + rng.normal(0.0, 0.002, (15, 12))
        q = np.vstack([before, motion.q, after])
        motions.append(type(motion)(np.arange(len(q)) / 60, q, motion.dof_names, motion.label, motion.index, "lab"))
    return MotionLibrary("small", tuple(motions), {})


def test_streams_are_evaluated_and_written(tmp_path: Path) -> None:
    library, out = write_library_bag(resting_first(), tmp_path / "library"), tmp_path / "streams.json"
    words = ["evaluate", "streams", "--library", str(library), "--classifier", "forest", "--json", str(out)]
    _, options = parse([*words, "--jobs", "1"])
    with (tmp_path / "printed").open("w") as printed:
        assert stream_command.run(options, Console(file=printed, width=120)) == 0
    text = (tmp_path / "printed").read_text()
    assert "within" in text
    assert json.loads(out.read_text())


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    library = write_library_bag(resting_first(3), tmp_path / "library")
    words = ["evaluate", "streams", "--library", str(library), "--jobs", "1"]
    for more, said in ((["--classifier", "oracle"], "oracle"), (["--json", str(tmp_path / "no" / "f.json")], "no")):
        assert main([*words, *more]) == 2
        error = capsys.readouterr().err.strip()
        assert error.startswith("humanpred: ")
        assert said in error
