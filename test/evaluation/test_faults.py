"""The bench of faults can tell a graph that fails closed from one that does not, and the real graph does."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from faults.bench import GAP_RAD, Row, page
from faults.catalogue import FAULTS, SHORT
from faults.trials import GOES_ON, HOLDS, OPEN, Bounds, Command, Heard, TimedText, Trial, judged
from paths import REPOSITORY
from rich.console import Console

from humanpred_ros.cli import parse
from humanpred_ros.errors import UsageError

BEGAN, ENDED, BACK = 10.0, 11.5, 12.0
_HOW_SOON = ("rested after", "a trajectory began")
BOUNDS = Bounds(HOLDS, ("stale",), rest_s=0.7, data_age_s=None, gap_rad=0.1)


def heard(
    rests_at: float = 10.6,
    reason: str = "stale human data",
    gap_rad: float = 0.0,
    level: float = 1.0,
) -> Heard:
    """Return what comes of a fault at 10 s: the arm moves at 0.2 rad/s until it rests, and again from 12 s on."""
    found = Heard()
    for t_s in np.arange(9.0, 12.5, 0.01):
        found.see_arm(float(t_s), np.full(2, t_s), 0.2 if t_s < rests_at or t_s > BACK else 0.0, float(t_s))
        if round(t_s * 100) % 3 == 0 and (t_s < BEGAN or t_s > ENDED):
            found.decisions.append(TimedText(float(t_s), "keep", "no replanning step is due", 0.02))
    found.decisions.append(TimedText(10.5, "hold", reason, 0.5))
    found.decisions.sort()
    found.diagnostics.append(TimedText(11.2, "stomp_planner", f"holding: {reason}", level))
    found.commands.append(Command(10.5, np.full(2, 10.5) + gap_rad, 10.5, 1.0))
    return found


def verdict(of: Heard, bounds: Bounds = BOUNDS, recovered_s: float | None = BACK) -> Trial:
    return judged(of, bounds, BEGAN, ENDED, recovered_s)


def test_times_count_from_the_fault_and_from_its_end() -> None:
    trial = verdict(heard())
    assert trial.problems == ()
    assert trial.hold_s == pytest.approx(0.5)
    assert trial.rest_s == pytest.approx(0.6, abs=0.011)
    assert trial.recovered_s == pytest.approx(0.5)
    assert trial.reason == "stale human data"


@pytest.mark.parametrize(
    ("of", "problem"),
    [
        (heard(reason="no path can be executed: x"), "wanted a hold that says stale, got no path can be executed"),
        (heard(rests_at=11.0), "rested after 1.00 s"),
        (heard(rests_at=13.0), "did not come to rest"),
        (heard(gap_rad=0.2), "began 0.200 rad from the arm"),
        (heard(level=0.0), "diagnostics were OK while it held"),
    ],
)
def test_what_must_not_be_is_told(of: Heard, problem: str) -> None:
    assert any(problem in text for text in verdict(of).problems)


def test_an_arm_that_does_not_work_again_is_told() -> None:
    assert verdict(heard(), recovered_s=None).problems == ("the arm did not work again",)


def test_an_arm_that_moves_on_old_data_is_told() -> None:
    bounds = replace(BOUNDS, outcome=GOES_ON, reasons=(), rest_s=None, data_age_s=0.5)
    assert verdict(heard(rests_at=10.3), bounds).problems == ()
    (problem,) = verdict(heard(rests_at=11.0), bounds).problems
    assert problem.startswith("the arm moved on data 1.0")


def test_what_nothing_can_stop_yet_is_open_and_not_passed() -> None:
    fault = replace(FAULTS[0], outcome=OPEN)
    trial = verdict(heard(rests_at=13.0), replace(BOUNDS, outcome=OPEN))
    assert Row(fault, (trial, trial)).verdict == "open"
    assert Row(FAULTS[0], (trial, verdict(heard(rests_at=13.0)))).verdict == "failed"
    assert Row(FAULTS[0], (verdict(heard()), verdict(heard()))).verdict == "passed"


def test_names_are_told_apart_and_unknown_ones_refused(tmp_path: Path) -> None:
    names = [fault.name for fault in FAULTS]
    assert len(set(names)) == len(names)
    assert set(SHORT) <= set(names)
    command, settings = parse(["bench", "faults", "--only", "no such fault", "--page", str(tmp_path / "faults.md")])
    with pytest.raises(UsageError, match="no such fault"):
        command(settings, Console(file=io.StringIO()))


def test_the_page_is_that_of_the_faults_there_are() -> None:
    lines = (REPOSITORY / "docs" / "faults.md").read_text(encoding="utf-8").splitlines()
    table = [line.split(" | ") for line in lines if line.startswith("| ")]
    assert [(row[0].removeprefix("| "), row[1]) for row in table[1:]] == [(f.name, f.expected) for f in FAULTS]
    trial = verdict(heard())
    head = page([Row(FAULTS[0], (trial, trial))], ()).splitlines()
    assert " | ".join(table[0]) in head


def test_the_real_graph_fails_closed(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    out = tmp_path / "faults.json"
    command, settings = parse(["bench", "faults", "--short", "--json", str(out), "--keep", str(tmp_path / "kept")])
    command(settings, Console(file=io.StringIO()))
    rows = json.loads(out.read_text())["faults"]
    assert [row["fault"] for row in rows] == list(SHORT)
    for row in rows:
        assert len(row["trials"]) == 2
        for trial in row["trials"]:
            # How soon depends on the machine: `humanpred bench faults` tells. One that notices late lets the arm lag
            # further behind; a trajectory that begins where the arm should be would begin farther away by far.
            timely = [text for text in trial["problems"] if not any(what in text for what in _HOW_SOON)]
            assert not timely, row
            assert trial["gap_rad"] < 2.0 * GAP_RAD, row
            assert trial["reason"], row
