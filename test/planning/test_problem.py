"""Cost terms are chosen by name, also those of other packages; what is not compiled is planned with all the same."""

from __future__ import annotations

import logging
from typing import ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray
from planning_worlds import free_space, nobody, planar_arm, somebody_at

from humanpred_ros import plugins
from humanpred_ros.errors import PlanningError, SettingsError, UsageError
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.robot.goals import Goal
from humanpred_ros.stomp.config import StompConfig
from humanpred_ros.stomp.costs import CostTerm, CostTermRequest

ARM = planar_arm()
START, LEFT = np.array([0.0, 0.3, 0.3]), np.array([1.2, 0.3, 0.3])
CONFIG = ReplannerConfig(threads=1, human_margin_m=0.0, stomp=StompConfig(waypoints=40, iterations=15, noise_std=0.01))
DEFAULT = ("obstacle", "human", "smoothness")


class Stretched(CostTerm):
    """Charges for an elbow that is bent less than it could be; a term of another package."""

    built: ClassVar[list[CostTermRequest]] = []

    @classmethod
    def build(cls, request: CostTermRequest) -> Stretched:
        cls.built.append(request)
        return cls("stretched", 50.0, request.chain.n_joints)

    def evaluate(self, q: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        return np.maximum(np.float32(1.0) - q[..., 1], np.float32(0.0)), None


class OfThePerson(Stretched):
    """One that is made anew for every occupancy."""

    per_occupancy = True


class Misshapen(Stretched):
    """Returns one cost a trajectory instead of one a waypoint."""

    def evaluate(self, q: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        return super().evaluate(q)[0].sum(axis=1), None


@pytest.fixture
def other_package(monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that offers the terms above."""
    load = plugins.load
    mine = {"stretched": Stretched, "of_the_person": OfThePerson, "misshapen": Misshapen}
    monkeypatch.setattr(plugins, "load", lambda group, name, base: mine.get(name) or load(group, name, base))
    Stretched.built = []


def replanner(*terms: str) -> Replanner:
    subject = Replanner(ARM, (Goal("left", LEFT),), free_space(), CONFIG.replaced(cost_terms=terms))
    subject.start(START, 0.0)
    return subject


def test_the_built_in_terms_are_entry_points_too() -> None:
    assert {*DEFAULT, "joint_limits"} <= set(plugins.names(plugins.COST_TERMS))
    assert ReplannerConfig().cost_terms == DEFAULT


def test_the_default_terms_run_compiled_in_any_order(caplog: pytest.LogCaptureFixture) -> None:
    for order in (DEFAULT, DEFAULT[::-1]):
        assert replanner(*order).problem.planner(nobody())[0].compiled_terms is not None
    assert not caplog.records


@pytest.mark.usefixtures("other_package")
def test_a_term_of_another_package_changes_the_path_and_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        subject = replanner(*DEFAULT, "stretched")
        decisions = [subject.plan(nobody(t_s)) for t_s in (0.0, 0.1)]
    with_it = decisions[0].report("left")
    without = replanner(*DEFAULT).plan(nobody()).report("left")
    assert set(with_it.cost) == {*DEFAULT, "stretched"}
    assert with_it.path[1:-1, 1].mean() > without.path[1:-1, 1].mean() + 0.05
    assert len(caplog.records) == 1
    assert "stretched" in caplog.text
    assert len(Stretched.built) == 1
    assert Stretched.built[0].occupancy is None


@pytest.mark.usefixtures("other_package")
def test_a_term_about_the_person_is_made_anew_for_every_occupancy() -> None:
    subject = replanner(*DEFAULT, "of_the_person")
    for t_s in (0.0, 0.1):
        subject.commit(subject.plan(somebody_at(-0.6, 0.0, t_s)))
    assert [request.occupancy is not None for request in Stretched.built] == [True, True]


def test_a_term_left_out_charges_nothing() -> None:
    report = replanner("obstacle", "smoothness").plan(somebody_at(0.3, 0.6)).report("left")
    assert set(report.cost) == {"obstacle", "smoothness"}
    assert report.human > 0.0  # goals are compared by it all the same


@pytest.mark.usefixtures("other_package")
def test_what_cannot_be_planned_with_is_refused() -> None:
    with pytest.raises(UsageError, match=r"cost term.*smoothness.*'soft'"):
        replanner(*DEFAULT, "soft")
    with pytest.raises(SettingsError, match="cost_terms"):
        CONFIG.replaced(cost_terms=())
    with pytest.raises(SettingsError, match="cost_terms"):
        CONFIG.replaced(cost_terms=("human", "human"))
    with pytest.raises(PlanningError, match="stretched"):
        replanner("misshapen").plan(nobody())
