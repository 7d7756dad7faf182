"""A package of somebody else's is installed; its classifier, predictor and cost term are used like our own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from paths import REPOSITORY
from small_library import small_library

import humanpred_ros as hp

PACKAGE = Path(__file__).with_name("plugin_package")
MODULES = ("own_classifier", "own_predictor", "own_cost_term")


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The package, built as pip does it and installed into a folder; returns what makes Python see that folder."""
    folder = tmp_path_factory.mktemp("plugins")
    source = Path(shutil.copytree(PACKAGE, folder / "source"))
    for module in MODULES:
        shutil.copy(REPOSITORY / "examples" / f"{module}.py", source)
    build = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", build, str(folder)], cwd=source, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(folder / "site")
    return {**os.environ, "PYTHONPATH": str(folder / "site")}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return hp.write_library(small_library(), tmp_path_factory.mktemp("library") / "small")


def humanpred(environment: dict[str, str], folder: Path, *words: str, status: int = 0) -> str:
    """Run a command in a folder; return what it prints, errors included."""
    done = subprocess.run(
        [sys.executable, "-m", "humanpred_ros.cli", *words],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=300.0,
    )  # fmt: skip
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_the_classifier_is_trained_and_evaluated(environment: dict[str, str], library: Path, tmp_path: Path) -> None:
    train = ("train", str(library), "--out", "model.npz", "--classifier", "nearest_reach")
    humanpred(environment, tmp_path, *train, "--set", "nearest_reach.scale_m=0.05")
    assert (tmp_path / "model.npz").exists()
    said = humanpred(environment, tmp_path, *train, "--set", "nearest_reach.scale_m=-1", status=2)
    assert "nearest_reach.scale_m: wanted a number of at least 0.01, got -1" in said
    said = humanpred(environment, tmp_path, *train, "--set", "nearest_reach.scale=1", status=2)
    assert "did you mean scale_m?" in said
    said = humanpred(environment, tmp_path, *train, "--set", "gmm.evidence=mean", status=2)
    assert "wanted a setting of what is used (nearest_reach)" in said
    evaluate = ("evaluate", "recognition", "--library", str(library), "--no-unknown", "--speeds", "1", "--jobs", "1")
    humanpred(environment, tmp_path, *evaluate, "--classifier", "nearest_reach", "--json", "figures.json")
    assert "nearest_reach" in json.dumps(json.loads((tmp_path / "figures.json").read_text()))


def test_the_predictor_is_evaluated(environment: dict[str, str], library: Path, tmp_path: Path) -> None:
    evaluate = ("evaluate", "occupancy", "--library", str(library), "--jobs", "1", "--json", "figures.json")
    humanpred(environment, tmp_path, *evaluate, "--predictor", "palm_ball", "current")
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert {"palm_ball", "current"} == {predictor["name"] for predictor in figures["predictors"]}


def test_without_the_package_its_names_are_unknown(library: Path, tmp_path: Path) -> None:
    words = ("train", str(library), "--out", "model.npz", "--classifier", "nearest_reach")
    said = humanpred({**os.environ, "PYTHONPATH": ""}, tmp_path, *words, status=2)
    assert "classifier: wanted one of forest, gmm, got 'nearest_reach'" in said


def test_the_nodes_use_all_three(environment: dict[str, str], tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    humanpred(
        environment, tmp_path, "demo", "--out", "run", "--steps", "4", "--hold-last-s", "0.5",
        "--classifier", "nearest_reach", "--predictor", "palm_ball",
        "--cost-terms", "obstacle", "human", "smoothness", "raised_elbow",
        "--set", "palm_ball.radius_m=0.2", "nearest_reach.scale_m=0.1", "--set", "raised_elbow.highest_rad=-0.5",
    )  # fmt: skip
    run = hp.read_run(tmp_path / "run")
    steps = [step for step in run.steps if step.goals]
    assert steps
    assert all(goal.terms.keys() >= {"obstacle", "human", "smoothness", "raised_elbow"} for goal in steps[0].goals)
    assert any(goal.terms["raised_elbow"] > 0.0 for goal in steps[0].goals)
    # A ball of 0.2 m holds 268 voxels of 0.05 m, give or take its surface; one of 0.15 m, the default, 113.
    occupied = run.occupancy.n_voxels
    assert len(occupied)
    assert ((occupied > 200) & (occupied < 340)).all()
    slower = (tmp_path / "run" / "logs" / "stomp_planner.log").read_text().count("evaluated one by one")
    assert slower == 1
    said = humanpred(environment, tmp_path, "replay", "run")
    assert "reproduced bit for bit" in said
