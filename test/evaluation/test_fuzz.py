"""A thousand damaged files are accepted or refused by name; what is neither is found, kept and can be done again."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation import fuzz_files, hostile_files
from humanpred_ros.evaluation.fuzz_files import FuzzSettings, fuzz


def quiet(what: str, total: int) -> Callable[[int], None]:
    return lambda done: None


def test_a_thousand_damaged_files_are_accepted_or_refused_by_name(tmp_path: Path) -> None:
    report = fuzz(FuzzSettings(files=1000, seed=20261129, keep=tmp_path / "kept"), quiet)
    assert report.figures["failures"] == []
    told = {kind["kind"]: kind for kind in report.figures["files"]}
    assert set(told) == set(hostile_files.KINDS)
    assert all(kind["accepted"] and kind["refused"] for kind in told.values()), "damage must be neither all nor nothing"
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize("trouble", [MemoryError(), HumanPredError("refused")])
def test_a_refusal_that_took_all_memory_is_a_failure(
    trouble: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def greedy(folder: Path, out: Path, number: int) -> None:
        raise trouble from MemoryError()

    monkeypatch.setitem(hostile_files.KINDS, "weights", greedy)
    assert hostile_files.outcome("weights", tmp_path, tmp_path / "out", 0).startswith("failed")


def test_a_file_is_known_by_seed_and_number(tmp_path: Path) -> None:
    sample = tmp_path / "sample"
    sample.mkdir()
    (sample / "w.json").write_text('{"a": [1, 2, {"b": "c"}], "d": 0.5}')
    made = []
    for k, number in enumerate((0, 0, 1)):
        hostile_files.damaged(sample, tmp_path / str(k), np.random.default_rng([7, number]))
        made.append((tmp_path / str(k) / "w.json").read_bytes())
    assert made[0] == made[1] != made[2]


def test_a_worker_that_dies_is_found_and_its_file_kept(tmp_path: Path) -> None:
    worker = fuzz_files._Worker(tmp_path, "worker")
    (worker.folder / "input").mkdir(parents=True)
    (worker.folder / "input" / "w.json").write_text("the killer")
    worker._connection, theirs = multiprocessing.Pipe()
    worker._process = multiprocessing.get_context("spawn").Process(target=os._exit, args=(11,))
    worker._process.start()
    theirs.close()
    case = worker.case(3, FuzzSettings(kinds=("weights",), seed=5, keep=tmp_path / "kept"))
    assert case.outcome == "failed: it ended the process with status 11"
    assert (tmp_path / "kept" / "5_3_weights" / "w.json").read_text() == "the killer"
