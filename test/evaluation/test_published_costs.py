"""What the papers published is read as they print it; other files are refused by name."""

from __future__ import annotations

from pathlib import Path

import pytest
from paths import shared_data

from humanpred_ros.errors import HumanPredError, UsageError
from humanpred_ros.evaluation.interference_runs import read_table1
from humanpred_ros.evaluation.switching import read_fig9
from humanpred_ros.evaluation.switching_runs import first_switch


def test_table1_is_the_papers() -> None:
    rows = read_table1(shared_data("iros2013"))
    assert sorted(rows) == [25, 26, 27, 28, 29]
    assert [round(rows[k]["ours_mean"], 4) for k in sorted(rows)] == [0.4175, 0.4925, 0.6099, 0.4157, 0.7432]
    assert [round(rows[k]["basic_sd"], 2) for k in sorted(rows)] == [7.57, 5.35, 8.84, 5.32, 6.04]
    assert [round(rows[k]["ratio"]) for k in sorted(rows)] == [58, 44, 45, 59, 34]


def test_fig9_switches_where_the_paper_says() -> None:
    published = read_fig9(shared_data("iros2013"))
    assert published is not None
    assert published["goals"] == ["red", "blue"]
    assert published["prediction"].shape == published["current"].shape == (20, 2)
    assert first_switch(published["prediction"]) == 4
    assert first_switch(published["current"]) == 14  # 13 counted from 0


def test_what_is_not_there_is_no_error(tmp_path: Path) -> None:
    assert read_table1(tmp_path) == {}
    assert read_fig9(tmp_path) is None


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("human_traj_id,planner,run\n25,basic,1\n", "columns human_traj_id"),
        ("human_traj_id,planner,run,cost\n25,basic,1,2.0\n", "both planners"),
        ("\n", "an empty file"),
    ],
)
def test_a_wrong_table1_is_refused(tmp_path: Path, text: str, wanted: str) -> None:
    (tmp_path / "reference").mkdir()
    path = tmp_path / "reference" / "table1_runs.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HumanPredError, match=rf"table1_runs\.csv: wanted .*{wanted}"):
        read_table1(tmp_path)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("variant,step,goal,cup,cost\nprediction,1,0,red,0.1\n", "complete it"),
        ("step,cost\n1,0.1\n", "columns variant"),
    ],
)
def test_a_wrong_fig9_is_refused(tmp_path: Path, text: str, wanted: str) -> None:
    (tmp_path / "reference").mkdir()
    (tmp_path / "reference" / "fig9_costs.csv").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=wanted):
        read_fig9(tmp_path)
