"""Means and ratios on made-up runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from humanpred_ros.evaluation.interference_runs import method_figures
from humanpred_ros.evaluation.run_figures import Contact, RunFigures

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
    ours, basic = method_figures("ours", runs), method_figures("basic", runs)
    assert (ours["runs"], ours["reached"], ours["contacts"]) == (2, 1, 1)
    assert ours["cost_mean"] == pytest.approx(0.2)
    assert ours["cost_sd"] == pytest.approx(0.1 * np.sqrt(2.0))  # n - 1, as the published
    assert ours["ratio"] == pytest.approx(100.0)
    assert ours["ratio_swept"] == pytest.approx(10.0)
    assert basic["ratio"] == pytest.approx(1.0)
    assert ours["least_distance_m"] == -0.02
    assert ours["median_distance_m"] == pytest.approx(0.09)
    assert ours["time_to_goal_s"] == np.inf


def test_who_stops_on_the_way_is_no_cheaper_for_it() -> None:
    runs = [
        replace(RUN, cost=0.2),
        replace(RUN, cost=0.0, seed=1, goal=None),
        replace(RUN, method="basic", cost=4.0),
        replace(RUN, method="basic", cost=100.0, seed=1),
    ]
    assert method_figures("ours", runs)["ratio_reached"] == pytest.approx(20.0)
    assert method_figures("ours", runs)["ratio"] > 500.0


def test_a_minority_that_never_arrives_does_not_hide_the_median() -> None:
    runs = [replace(RUN, seed=k, time_to_goal_s=t) for k, t in enumerate([2.0, 3.0, np.inf])]
    assert method_figures("ours", runs)["time_to_goal_s"] == 3.0
