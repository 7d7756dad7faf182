"""The command prints, writes and draws what was measured, or says in one line what is wrong before it starts."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from reaching_people import write_recording
from rich.console import Console

from humanpred_ros.cli import parse
from humanpred_ros.errors import HumanPredError
from humanpred_ros.evaluation.reaching import draw_reaching
from humanpred_ros.evaluation.reaching_runs import DISTANCES, PublishedRow
from humanpred_ros.evaluation.reaching_weights import STATISTICS


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
    run, settings = parse(["evaluate", "reaching", "--demos", str(demos), "--jobs", "1", *options])
    text = io.StringIO()
    assert run(settings, Console(file=text, width=150)) == 0
    return text.getvalue()


def test_everything_printed_is_in_the_json(demos: Path, tmp_path: Path) -> None:
    json_file, plot_file = tmp_path / "figures.json", tmp_path / "figures.png"
    some = "hold,line,baseline_0"  # learning takes its time
    printed = evaluate(
        demos, "--predictor", some, "--runs", "2", "--json", str(json_file), "--plot", str(plot_file), "--seed", "3"
    )
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
    assert found["settings"]["seed"] == 3
    assert found["machine"]["usable_cores"] >= 1
    assert plot_file.read_bytes().startswith(b"\x89PNG")


def test_parts_can_be_left_out(demos: Path, tmp_path: Path) -> None:
    json_file = tmp_path / "figures.json"
    printed = evaluate(demos, "--interference", "none", "--predictor", "line, time_profile", "--json", str(json_file))
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
        (("--plot", "{}/plot.bmp"), "ends with .png"),
        (("--predictor", "line,crystal_ball"), "crystal_ball"),
        (("--runs", "0"), "runs.*0"),
        (("--jobs", "0"), "jobs.*0"),
        (("--samples", "30,10"), "ascending"),
        (("--samples", "0,10"), "at least 1"),
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


def scores(name: str, value: float, spread: float = 0.1) -> dict[str, Any]:
    values = dict(zip(STATISTICS, (value, spread, value * (1.0 - spread), value * (1.0 + spread)), strict=True))
    average = dict.fromkeys(DISTANCES, values)
    each = [{"recording": "r", "figures": average}]
    return {"name": name, "group": "nothing learned", "runs": 2, "recordings": each, "average": average}


def drawn(*found: dict[str, Any], published: tuple[PublishedRow, ...] = (), recovery: Any = None) -> Figure:
    facts = [{"name": "r", "unfit": None, "notes": []}]
    rows = [row._asdict() for row in published]
    entry = {"title": "some", "recordings": facts, "predictors": list(found), "published": rows}
    path = np.cumsum(np.ones((30, 3)), axis=0)
    paths = {(name, "r"): path for name in ("itself", *(each["name"] for each in found))}
    return draw_reaching({"sets": [entry], "weights": None, "recovery": recovery}, paths)


def distance_panels(figure: Figure) -> list[Any]:
    return [axes for axes in figure.axes if "task" in axes.get_title() or "joint" in axes.get_title()]


def test_published_figures_are_marked_where_there_are_some() -> None:
    row = PublishedRow("b", "", "P2 Table II", 2.5, 3.5)
    panels = distance_panels(drawn(scores("a", 2.0), scores("b", 3.0), published=(row,)))
    marked = [[float(line.get_xdata()[0]) for line in axes.lines if line.get_marker() == "D"] for axes in panels]
    assert marked == [[2.5], [3.5], []]


def test_one_that_would_dwarf_all_others_is_cut_off_but_told() -> None:
    found = [scores(f"p{k}", value) for k, value in enumerate((20.0, 22.0, 120.0))]
    panel = distance_panels(drawn(*found))[0]
    assert panel.get_xlim()[1] < 60.0
    assert "120.0" in [text.get_text().strip() for text in panel.texts]


def test_parts_that_were_not_run_say_so() -> None:
    one = dict.fromkeys(STATISTICS, 1.5)
    recovery = {"samples": [3, 10], "learned": {"published": [one, one]}, "best_sample": [one, one], "line": one}
    figure = drawn(scores("a", 2.0), recovery=recovery)
    titles = {axes.get_title(): axes for axes in figure.axes}
    assert not titles["known weights learned again (P2 Fig. 7)"].texts
    (said,) = titles["weights leaving one out (P2 Fig. 10)"].texts
    assert "nothing was learned" in said.get_text()
