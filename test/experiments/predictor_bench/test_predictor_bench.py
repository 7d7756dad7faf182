"""The bench measures every classifier and predictor there is, and says what it changed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console
from small_library import small_library

from humanpred_ros.cli import command_parser
from humanpred_ros.errors import UsageError
from humanpred_ros.experiments.predictor_bench import bench as predictor_bench
from humanpred_ros.experiments.predictor_bench import command as predictor_bench_command
from humanpred_ros.experiments.predictor_bench.bench import Timing
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.predictors.factory import PREDICTORS
from humanpred_ros.recognition.registry import CLASSIFIERS


def test_timings_are_microseconds() -> None:
    timing = Timing.of([0.001, 0.002, 0.003])
    assert (timing.median_us, timing.n) == (pytest.approx(2000.0), 3)
    with pytest.raises(UsageError, match="at least one call"):
        Timing.of([])


def test_everything_is_measured_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predictor_bench, "_FRAMES_SEEN", (20, 40))
    monkeypatch.setattr(predictor_bench, "_GOALS", (1, 3))
    library = write_library_bag(small_library(2, 4, 40), tmp_path / "library")
    out = tmp_path / "bench.json"
    words = ["bench", "predictor", "--library", str(library), "--json", str(out), "--motions", "1", "--no-node"]
    options = command_parser().parse_args(words)
    with (tmp_path / "printed").open("w") as printed:
        assert predictor_bench_command.run(options, Console(file=printed)) == 0
    bench = json.loads(out.read_text())
    assert set(bench["recognition"]) == set(CLASSIFIERS)
    assert set(bench["update"]) == set(PREDICTORS)
    assert all(timing["n"] == 40 and timing["median_us"] > 0 for timing in bench["update"].values())
    assert {row["what"]: row["size"] for row in bench["growth"]} == {
        "classes": 4, "voxels": 2457600, "frames seen": 40, "goals": 3,
    }  # fmt: skip
    assert bench["node"] is None
    assert bench["machine"]["usable_cores"] >= 1


def test_impossible_options_are_refused(tmp_path: Path) -> None:
    options = command_parser().parse_args(["bench", "predictor", "--motions", "0"])
    with pytest.raises(UsageError, match="--motions"):
        predictor_bench_command.run(options, Console())
