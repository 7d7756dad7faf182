"""The command prints, writes and draws what was measured, or says in one line what is wrong before it starts."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path
from typing import Any

import pytest
from reaching_people import write_recording
from rich.console import Console

from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation.reaching.command import add_arguments, run


@pytest.fixture(scope="module")
def demos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "demos"
    folder.mkdir()
    for seed in range(3):
        write_recording(folder, f"m{seed}", seed, n_frames=40)
    beside = folder.parent / "interference_case"
    beside.mkdir()
    write_recording(beside, "beside", 9, n_frames=50)
    return folder


def evaluate(demos: Path, *options: str) -> str:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    text = io.StringIO()
    assert run(parser.parse_args(["--demos", str(demos), *options]), Console(file=text, width=150)) == 0
    return text.getvalue()


def test_everything_printed_is_in_the_json(demos: Path, tmp_path: Path) -> None:
    json_file, plot_file = tmp_path / "figures.json", tmp_path / "figures.png"
    some = "hold,line,bow,baseline_0"  # learning takes its time
    printed = evaluate(
        demos, "--predictor", some, "--runs", "2", "--json", str(json_file), "--plot", str(plot_file), "--seed", "3",
        "--jobs", "1",
    )  # fmt: skip
    found: dict[str, Any] = json.loads(json_file.read_text(encoding="utf-8"))
    assert [entry["title"] for entry in found["sets"]] == [
        "each predicted from the others",
        "partner in the way, predicted from all the demonstrations",
    ]
    for entry in found["sets"]:
        for predictor in entry["predictors"]:
            for distance in ("joint_m", "task_as_coded_m", "task_m"):
                assert f"{predictor['average'][distance]['mean']:.2f}" in printed
                for recording in predictor["recordings"] if len(predictor["recordings"]) > 1 else ():
                    assert f"{recording['figures'][distance]['mean']:.2f}" in printed
    assert [facts["name"] for facts in found["sets"][0]["recordings"]] == ["m0", "m1", "m2"]
    assert found["settings"]["config"]["seed"] == 3
    assert found["machine"]["usable_cores"] >= 1
    assert plot_file.read_bytes().startswith(b"\x89PNG")


def test_parts_can_be_left_out(demos: Path, tmp_path: Path) -> None:
    json_file = tmp_path / "figures.json"
    printed = evaluate(
        demos, "--interference", "none", "--predictor", "line, time_profile", "--json", str(json_file), "--jobs", "1"
    )
    found = json.loads(json_file.read_text(encoding="utf-8"))
    assert len(found["sets"]) == 1
    assert [p["name"] for p in found["sets"][0]["predictors"]] == ["line", "time_profile", "itself"]
    assert "partner in the way" not in printed
    assert found["weights"] is None  # nothing needed any
    assert found["recovery"] is None
    assert "Fig. 7" not in printed


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--json", "{}/no/where.json"), "there is no"),
        (("--plot", "{}/plot.svg"), "ends with .png"),
        (("--predictor", "line,crystal_ball"), "crystal_ball"),
        (("--runs", "0"), "at least one run"),
        (("--jobs", "0"), "at least one process"),
        (("--samples", "30,10"), "ascending"),
        (("--samples", "many"), "whole numbers"),
        (("--demos", "{}"), "found none"),
        (("--interference", "{}/nowhere"), "no such folder"),
    ],
)
def test_what_is_wrong_is_said_and_nothing_is_left_behind(
    demos: Path, tmp_path: Path, options: tuple[str, str], text: str
) -> None:
    with pytest.raises(HumanPredError, match=text):
        evaluate(demos, *(option.format(tmp_path) for option in options))
    assert not list(tmp_path.iterdir())
