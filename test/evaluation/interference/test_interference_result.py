"""Means, ratios and verdicts on made-up runs; the published table as the paper prints it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paths import shared_data

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.interference.avoidance import Avoidance
from humanpred_ros.evaluation.interference.measures import Contact, RunFigures
from humanpred_ros.evaluation.interference.reference import PublishedRow, read_table1, table1_beside
from humanpred_ros.evaluation.interference.result import (
    Comparison,
    ContactReport,
    MethodFigures,
    TableRow,
)
from humanpred_ros.evaluation.interference.targets import targets_of
from humanpred_ros.evaluation.target import Target

CONTACT = Contact(0.5, -0.02, 0.01, "r_forearm_link", "right_hand", 0.03, 0.0, "human")
RUN = RunFigures(
    scene="side_by_side", motion="1/0", method="ours", seed=0, cost=0.1, cost_swept=0.2, length=1.0, goal="red",
    time_to_goal_s=3.0, execution_s=2.8, clearance_m=0.05, clearance_to="table", least_distance_m=0.2,
    least_distance_s=1.0, contact=None, steps=20, replans=3, switches=0, holds=0, evasions=0,
    ended="arrived: at red", step_ms=10.0,
)  # fmt: skip


def test_figures_of_a_method() -> None:
    runs = [
        replace(RUN, cost=0.1),
        replace(RUN, cost=0.3, seed=1, least_distance_m=-0.02, contact=CONTACT, goal=None, time_to_goal_s=np.inf),
        replace(RUN, method="basic", cost=10.0, cost_swept=1.0),
        replace(RUN, method="basic", cost=30.0, cost_swept=3.0, seed=1),
    ]
    ours, basic = MethodFigures.of("ours", runs), MethodFigures.of("basic", runs)
    assert (ours.runs, ours.reached, ours.contacts) == (2, 1, 1)
    assert ours.cost_mean == pytest.approx(0.2)
    assert ours.cost_sd == pytest.approx(0.1 * np.sqrt(2.0))  # n - 1, as the published
    assert ours.ratio == pytest.approx(100.0)
    assert ours.ratio_swept == pytest.approx(10.0)
    assert basic.ratio == pytest.approx(1.0)
    assert ours.least_distance_m == -0.02
    assert ours.median_distance_m == pytest.approx(0.09)
    assert ours.time_to_goal_s == np.inf


def test_who_stops_on_the_way_is_no_cheaper_for_it() -> None:
    runs = [
        replace(RUN, cost=0.2),
        replace(RUN, cost=0.0, seed=1, goal=None),
        replace(RUN, method="basic", cost=4.0),
        replace(RUN, method="basic", cost=100.0, seed=1),
    ]
    assert MethodFigures.of("ours", runs).ratio_reached == pytest.approx(20.0)
    assert MethodFigures.of("ours", runs).ratio > 500.0


def test_a_minority_that_never_arrives_does_not_hide_the_median() -> None:
    runs = [replace(RUN, seed=k, time_to_goal_s=t) for k, t in enumerate([2.0, 3.0, np.inf])]
    assert MethodFigures.of("ours", runs).time_to_goal_s == 3.0


def comparison(ours: RunFigures, basic: RunFigures) -> Comparison:
    return Comparison.of("all scenes", ("ours", "basic"), [([ours, replace(basic, method="basic")], 0.4)])


def verdict(targets: tuple[Target, ...], what: str) -> Target:
    (found,) = (target for target in targets if what in target.what)
    return found


def test_targets_of_the_comparison() -> None:
    close = replace(RUN, least_distance_m=0.05, time_to_goal_s=2.5)
    targets = targets_of([], [comparison(RUN, close)], [])
    assert all(target.met for target in targets)
    assert "0.400 m is possible" in verdict(targets, "least distance").reached
    late = replace(RUN, time_to_goal_s=3.3)
    assert not verdict(targets_of([], [comparison(late, close)], []), "time to goal").met
    near = replace(RUN, least_distance_m=0.09)
    assert not verdict(targets_of([], [comparison(near, close)], []), "least distance").met


def test_twice_a_negative_distance_is_not_enough() -> None:
    inside = replace(RUN, least_distance_m=-0.05)
    within = replace(RUN, least_distance_m=-0.01)
    assert not verdict(targets_of([], [comparison(within, inside)], []), "least distance").met


@pytest.mark.parametrize(("policy", "met"), [("stay at the start", False), ("", True)])
def test_only_contacts_that_could_be_avoided_count(policy: str, met: bool) -> None:
    report = ContactReport("side_by_side", "1/0", "ours", 0, CONTACT, Avoidance(policy, 0.1, 0.02, 7))
    found = verdict(targets_of([], [comparison(RUN, RUN)], [report]), "contact")
    assert found.met is met
    others = ContactReport("side_by_side", "1/0", "basic", 0, CONTACT, None)
    assert verdict(targets_of([], [comparison(RUN, RUN)], [others]), "contact").met


def test_targets_of_table1_need_every_trajectory() -> None:
    def row(cost: float) -> TableRow:
        runs = [replace(RUN, cost=cost), replace(RUN, method="basic", cost=10.0)]
        return TableRow(
            25, "1/0", {m: MethodFigures.of(m, runs) for m in ("ours", "basic")}, PublishedRow(0.5, 0.1, 20.0, 1.0)
        )

    good = targets_of([row(0.1), row(0.15)], [], [])
    assert all(target.met for target in good)
    assert verdict(good, "ratio").published == "40 40"
    assert not verdict(targets_of([row(0.1), row(0.2)], [], []), "ratio").met


def test_published_table_is_the_papers() -> None:
    rows = table1_beside(shared_data("iros2013/library_a"))
    assert sorted(rows) == [25, 26, 27, 28, 29]
    assert [round(rows[k].ours_mean, 4) for k in sorted(rows)] == [0.4175, 0.4925, 0.6099, 0.4157, 0.7432]
    assert [round(rows[k].basic_sd, 2) for k in sorted(rows)] == [7.57, 5.35, 8.84, 5.32, 6.04]
    assert [round(rows[k].ratio) for k in sorted(rows)] == [58, 44, 45, 59, 34]


def test_no_published_table_is_no_error_and_a_wrong_one_is(tmp_path: Path) -> None:
    library = tmp_path / "library"
    library.mkdir()
    assert table1_beside(library) == {}
    path = tmp_path / "table.csv"
    path.write_text("human_traj_id,planner,run\n25,basic,1\n", encoding="utf-8")
    with pytest.raises(UsageError, match="columns human_traj_id"):
        read_table1(path)
    path.write_text("human_traj_id,planner,run,cost\n25,basic,1,2.0\n", encoding="utf-8")
    with pytest.raises(UsageError, match="correct or remove"):
        read_table1(path)
