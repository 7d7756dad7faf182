"""Goal inference is evaluated beside the classifiers, and the table says what each of them knew."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path

import pytest
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.recognition.classifiers import EVALUATED, REACHING, make_evaluated
from humanpred_ros.evaluation.recognition.command import add_arguments, run
from humanpred_ros.evaluation.recognition.runs import ClassifierChoice, LeftOutClass, LeftOutMotion, LeftOutRuns
from humanpred_ros.motion.csv_library import write_csv_library
from humanpred_ros.reaching.place_classifier import GoalClassifier
from humanpred_ros.reaching.place_model import GoalConfig
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.recognition.registry import CLASSIFIERS

LIBRARY = small_library(3, 4, 30, there_and_back=True)


def test_every_classifier_can_be_evaluated_and_the_default_is_the_first() -> None:
    assert list(EVALUATED) == [*CLASSIFIERS, REACHING]
    for name in EVALUATED:
        assert type(make_evaluated(name)).__name__.lower().startswith(name.replace(REACHING, "goal"))
    made = make_evaluated(REACHING, GoalConfig(n_postures=7))
    assert isinstance(made, GoalClassifier)
    assert made.config.n_postures == 7


@pytest.mark.parametrize(
    ("name", "config"), [(REACHING, GmmConfig()), ("forest", GoalConfig()), ("gmm", ForestConfig()), ("none", None)]
)
def test_unknown_names_and_foreign_settings_are_refused(name: str, config: GmmConfig | GoalConfig | None) -> None:
    with pytest.raises(UsageError, match=r"wanted (its own settings|one of forest, gmm, reaching)"):
        make_evaluated(name, config)


def test_a_left_out_motion_is_judged_with_its_place_and_a_left_out_class_without() -> None:
    runs = LeftOutRuns(ClassifierChoice(REACHING), LIBRARY, (1.4,))
    traces = runs(LeftOutMotion("10/1")).traces
    assert [trace.known.shape for trace in traces] == [(100, 3)] * 2
    assert traces[0].known[65].argmax() == 1
    assert {trace.known.shape for trace in runs(LeftOutClass(10)).traces} == {(100, 2)}


def test_the_table_says_that_no_motion_of_the_class_was_seen_and_judges_the_target(tmp_path: Path) -> None:
    write_csv_library(LIBRARY, tmp_path / "lib")
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    figures = tmp_path / "figures.json"
    options = (
        "--classifier",
        "gmm,reaching",
        "--components",
        "2",
        "--jobs",
        "1",
        "--speeds",
        "1",
        "--json",
        str(figures),
    )
    text = io.StringIO()
    run(parser.parse_args(["--library", str(tmp_path / "lib"), *options]), Console(file=text, width=140))
    printed = " ".join(text.getvalue().split())
    assert "its motions its place only" in printed
    assert "reaching never saw any motion of the class" in printed
    found = json.loads(figures.read_text(encoding="utf-8"))
    gmm, reaching = found["classifiers"]
    assert gmm["learned_of_class"] == "its motions"
    assert reaching["learned_of_class"] == "its place only"
    assert reaching["unknown"]["says_something"]
    (target,) = found["targets"]
    assert target["met"] == (reaching["figures"]["rate_at_60"] >= 0.85)
    assert f"reaching: right goal at 60 %, no motion of its class seen at least 85 % {target['reached']}" in printed
