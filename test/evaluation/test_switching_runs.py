"""Made-up sequences of choices: when it was decided, wrongly or rightly, and how often back and forth."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humanpred_ros.evaluation.switching_runs import (
    VARIANTS,
    ChoiceFigures,
    Person,
    VariantRun,
    step_costs,
    steps_earlier,
    variant_figures,
)
from humanpred_ros.robot.scene import load_scene

R, B = "red", "blue"


def of(text: str, right: str = B) -> ChoiceFigures:
    return ChoiceFigures.of([{"r": R, "b": B, "g": "green", ".": None}[letter] for letter in text], right)


@pytest.mark.parametrize(
    ("choices", "settled", "decided", "first_switch", "switches", "returns"),
    [
        ("bbbb", 1, 1, None, 0, 0),
        ("rrbb", 3, 3, 3, 1, 0),
        ("rrrr", 1, None, None, 0, 0),
        ("bbrr", 3, None, 3, 1, 0),
        ("brbb", 3, 3, 2, 2, 1),
        ("rbrb", 4, 4, 2, 3, 2),
        ("rgbb", 3, 3, 2, 2, 0),  # three goals, none of them twice
        (".rr.bb", 5, 5, 5, 1, 0),  # holds choose nothing
        ("b..b", 1, 1, None, 0, 0),
        ("..b", 3, 3, None, 0, 0),
    ],
)
def test_choices(
    choices: str, settled: int, decided: int | None, first_switch: int | None, switches: int, returns: int
) -> None:
    figures = of(choices)
    assert (figures.settled, figures.decided, figures.first_switch) == (settled, decided, first_switch)
    assert (figures.switches, figures.returns) == (switches, returns)


def test_wrong_first() -> None:
    assert of("rrbb").wrong_first
    assert of("rrrr").wrong_first
    assert not of("brbb").wrong_first


def test_no_choice_at_all_is_not_right() -> None:
    figures = of("....")
    assert figures.first is figures.last is figures.decided is None
    assert not figures.right


@given(st.text("rbg.", min_size=1, max_size=20))
def test_invariants(choices: str) -> None:
    figures = of(choices)
    assert 0 <= figures.returns <= max(0, figures.switches - 1)
    assert (figures.first_switch is None) == (figures.switches == 0)
    assert 1 <= figures.settled <= len(choices)
    assert (figures.decided is not None) == figures.right
    if figures.decided is not None:
        assert set(choices[figures.decided - 1 :]) <= {"b", "."}


def test_never_counts_as_one_after_the_last_step() -> None:
    assert steps_earlier(of("rbbb"), of("rrrr"), 4) == 5 - 2
    assert steps_earlier(of("rrrr"), of("rbbb"), 4) == 2 - 5
    assert steps_earlier(of("bbbb"), of("rrrb"), 4) == 3


def person(ours: str, current: str, right: str = B, default: str = R) -> Person:
    runs = tuple(
        VariantRun(variant, 0, (), of(current if variant == "current" else ours, right)) for variant in VARIANTS
    )
    return Person("face_to_face", "3/2", right, default, runs)


def test_summary_over_persons() -> None:
    persons = [person("rbbb", "rrrb"), person("bbbb", "rrrr"), person("brbb", "rrbb"), person("rrrr", "rrbb")]
    figures = variant_figures("ours", persons, 4)
    assert [figures[key] for key in ("persons", "right", "wrong_first", "recovered")] == [4, 3, 2, 1]
    assert [figures[key] for key in ("switched", "returned", "returned_often")] == [2, 1, 0]
    assert figures["decided"][1] == pytest.approx(np.median([2, 1, 3, 5]))
    assert figures["decided_earlier"][1] == pytest.approx(np.median([2, 4, 0, -2]))
    assert figures["settled_earlier"][1] == pytest.approx(np.median([2, 0, 0, 2]))
    assert variant_figures("current", persons, 4)["decided_earlier"] == (0.0, 0.0, 0.0)


def decision(stamp_s: float, chosen: str | None, **costs: float) -> Any:
    def report(name: str, cost: float) -> Any:
        able = bool(np.isfinite(cost))
        why = "" if able else "no way"
        return SimpleNamespace(name=name, valid=able, eligible=able, obstacle_to_choice=why, selection_cost=cost)

    goals = tuple(report(name, cost) for name, cost in costs.items())
    return SimpleNamespace(stamp_s=stamp_s, chosen=chosen, goals=goals, action="replan")


def test_costs_by_step() -> None:
    decisions = [
        decision(0.05, None),
        decision(0.10, "red", red=1.0, blue=2.0),
        decision(0.15, "red"),
        decision(0.20, "red"),
        decision(0.25, "blue", red=3.0, blue=0.5),  # out of turn, in step 2
        decision(0.31, "retreat", red=np.inf, blue=4.0, retreat=0.0),
        decision(0.40, "blue", blue=0.1),
    ]
    steps = step_costs(load_scene("face_to_face"), decisions, 0.1, 5)
    assert [step.step for step in steps] == [1, 2, 3, 4]
    assert [step.chosen for step in steps] == ["red", "blue", None, "blue"]
    assert [step.t_s for step in steps] == [0.10, 0.25, 0.31, 0.40]
    assert steps[0].costs == {"red": 1.0, "blue": 2.0}
    assert np.isnan(steps[2].costs["red"])
    assert steps[2].barred == {"red": "no way"}
    assert set(steps[2].costs) == {"red", "blue"}
    assert np.isnan(steps[3].costs["red"])
