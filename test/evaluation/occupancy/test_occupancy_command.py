"""The command prints, writes and draws what was measured, or says in one line what is wrong before it starts."""

from __future__ import annotations

import argparse
import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from csv_libraries import write_csv_library
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation.occupancy.command import add_arguments, run
from humanpred_ros.motion.bag_library import write_library_bag

OPTIONS = ("--predictor", "current,swept_volume", "--components", "2", "--jobs", "1", "--every", "4")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "lib"
    write_csv_library(small_library(n_classes=2, n_motions=4, n_frames=20), folder)
    return folder


def evaluate(library: Path, *options: str) -> str:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    text = io.StringIO()
    assert run(parser.parse_args(["--library", str(library), *options]), Console(file=text, width=120)) == 0
    return text.getvalue()


def test_everything_printed_is_in_the_json(library: Path, tmp_path: Path) -> None:
    json_file, plot_file = tmp_path / "figures.json", tmp_path / "figures.png"
    printed = evaluate(library, *OPTIONS, "--seed", "3", "--json", str(json_file), "--plot", str(plot_file))
    found: dict[str, Any] = json.loads(json_file.read_text(encoding="utf-8"))
    assert [predictor["name"] for predictor in found["predictors"]] == ["current", "swept_volume"]
    for predictor in found["predictors"]:
        average = predictor["average"]
        for text in (
            f"{1e3 * average['brier']:.2f}",
            f"{1e3 * average['log_loss']:.1f}",
            f"{average['average_precision']:.3f}",
            f"{100 * average['missed']:.1f} %",
            f"{predictor['calibration']['error_predicted']:.3f}",
        ):
            assert text in printed
        for value in predictor["at_percent"]["missed"]:
            assert f"{100 * value:.1f} %" in printed
        assert len(predictor["calibration"]["count"]) == 11
        assert "picture" not in predictor
    assert found["settings"]["seed"] == 3
    assert found["settings"]["grid"]["shape"] == [80, 80, 48]
    assert found["settings"]["until"] == "end"
    assert found["library"]["n_motions"] == 8
    assert found["tested"] == ["0/0", "10/0"]
    assert found["percents"] == list(range(10, 100, 10))
    assert found["machine"]["usable_cores"] >= 1
    assert plot_file.read_bytes().startswith(b"\x89PNG")


def test_bags_and_shifts(library: Path, tmp_path: Path) -> None:
    bag = write_library_bag(small_library(n_classes=2, n_motions=4, n_frames=20), tmp_path / "lib")
    json_file = tmp_path / "figures.json"
    evaluate(bag, "--predictor", "current", "--every", "4", "--shift", "0.3,-0.1,20", "--json", str(json_file))
    settings = json.loads(json_file.read_text(encoding="utf-8"))["settings"]
    assert settings["shift_m"] == [0.3, -0.1]
    assert settings["turn_rad"] == pytest.approx(math.radians(20))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--json", "{}/no/where.json"), "there is no"),
        (("--plot", "{}/plot.svg"), "ends with .png"),
        (("--shift", "0.3"), "DX,DY,YAW_DEG"),
        (("--predictor", "current,crystal_ball"), "crystal_ball"),
        (("--jobs", "0"), "jobs"),
        (("--until", "noon"), "apex"),
        (("--resolution", "0"), "voxels"),
        (("--library", "nowhere"), "nowhere"),
    ],
)
def test_what_is_wrong_is_said_and_nothing_is_left_behind(
    library: Path, tmp_path: Path, options: tuple[str, str], text: str
) -> None:
    given = [option.format(tmp_path) for option in options]
    with pytest.raises(HumanPredError, match=text):
        evaluate(library, *OPTIONS, *given)
    assert not list(tmp_path.iterdir())
