"""The bench measures every classifier and predictor there is, both humans, and says what it changed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from mocap_library import mocap_library
from rich.console import Console
from small_library import small_library

from humanpred_ros import plugins
from humanpred_ros.cli import parse
from humanpred_ros.errors import HumanModelError, SettingsError, UsageError
from humanpred_ros.evaluation import predictor_bench
from humanpred_ros.evaluation.predictor_bench import People, update_us
from humanpred_ros.evaluation.timing import MachineLoad, Spread
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import MotionLibrary


def demos() -> MotionLibrary:
    """Return six reaches of the 23-DoF human without classes, as P2's recordings are."""
    drawn = mocap_library(3, 2, 40)
    return replace(drawn, motions=tuple(replace(motion, label=None, index=k) for k, motion in enumerate(drawn)))


def run(*words: str, printed: Path) -> int:
    command, settings = parse(["bench", "predictor", "--motions", "1", "--no-node", *words])
    with printed.open("w") as file:
        return command(settings, Console(file=file, width=120))


class Noting:
    """Notes what is done with it."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def start(self) -> None:
        self.notes.append("start")

    def update(self, q: Sequence[float], t_s: float) -> None:
        self.notes.append(f"{t_s:.1f}")


def test_figures_of_measurements() -> None:
    spread = Spread.of([3.0, 1.0, 2.0, 10.0])
    assert (spread.median, spread.least, spread.most, spread.n) == (2.5, 1.0, 10.0, 4)
    assert 9.0 < spread.p99 < 10.0
    nothing = Spread.of([])
    assert nothing.n == 0
    assert np.isnan(nothing.median)


def test_what_others_use_is_never_negative() -> None:
    cores = MachineLoad().other_cores()
    assert cores is None or cores >= 0.0


@pytest.mark.parametrize(("n_frames", "stamps"), [(None, ["0.0", "0.5", "1.0", "1.5"]), (1, ["0.0"])])
def test_every_motion_is_started_anew_after_a_warm_up(n_frames: int | None, stamps: list[str]) -> None:
    subject, motions = Noting(), small_library(1, 2, 4).motions
    durations = update_us(cast(Any, subject), motions, n_frames)
    begin = subject.notes.index("start")
    assert begin > 0
    assert subject.notes[begin:] == ["start", *stamps] * 2
    assert len(durations) == 2 * len(stamps)


def test_nobody_learns_from_what_is_played() -> None:
    for library, n_played in ((small_library(2, 4, 40), 2), (demos(), 3)):
        people = People.of(library, 9 if library.labels == () else 2)
        assert len(people.played) == n_played
        assert {m.name for m in people.played} | {m.name for m in people.training} == {m.name for m in library}
        assert len(people.played) + len(people.training) == len(library)


@pytest.mark.parametrize("library", [small_library(2, 3, 40), demos()], ids=["with classes", "without"])
def test_any_number_of_places_can_be_told(library: MotionLibrary) -> None:
    people = People.of(library, 1)
    for count in (1, 8, 16):
        places = people.places(count)
        assert places.labels == tuple(map(str, range(count)))
        apart = np.linalg.norm(places.places_m[:, None] - places.places_m, axis=-1) + np.eye(count)
        assert apart.min() > 0.001
        assert not places.out_of_reach(people.human, people.played[0].q[0])


def test_everything_is_measured_and_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predictor_bench, "_FRAMES_SEEN", (20, 40))
    monkeypatch.setattr(predictor_bench, "_PLACES", (1, 3))
    library = write_library_bag(small_library(2, 4, 40), tmp_path / "library")
    recorded = write_library_bag(demos(), tmp_path / "demos")
    out, plot, printed = tmp_path / "bench.json", tmp_path / "bench.svg", tmp_path / "printed"
    words = ("--library", str(library), "--demos", str(recorded), "--json", str(out), "--plot", str(plot))
    assert run(*words, printed=printed) == 0
    bench = json.loads(out.read_text())
    assert set(bench["recognition_us"]) == set(plugins.names(plugins.CLASSIFIERS))
    assert set(bench["update_us"]) == set(plugins.names(plugins.PREDICTORS))
    assert all(spread["n"] == 40 and spread["median"] > 0 for spread in bench["update_us"].values())
    assert {row["what"]: row["size"] for row in bench["growth"]} == {
        "classes": 4, "voxels": 2457600, "frames seen": 40, "people": 4, "places": 3,
    }  # fmt: skip
    assert [(row["name"].split(", ")[1:], row["size"]) for row in bench["growth"] if row["what"] == "places"] == [
        ([human, "16 futures for each"], size) for size in (1, 3) for human in ("kinect12", "mocap23")
    ]
    assert "update of reaching, mocap23, 16 futures for each, 3 places" in printed.read_text()
    assert bench["nodes"] == []
    assert "<svg" in plot.read_text()
    assert bench["machine"]["usable_cores"] >= 1


def test_impossible_options_are_refused(tmp_path: Path) -> None:
    printed = tmp_path / "printed"
    with pytest.raises(SettingsError, match="--motions"):
        run("--motions", "0", printed=printed)
    kinect = str(write_library_bag(small_library(2, 3, 40), tmp_path / "kinect"))
    with pytest.raises(HumanModelError, match="23 DoFs"):
        run("--library", kinect, "--demos", kinect, printed=printed)
    without_classes = str(write_library_bag(demos(), tmp_path / "demos"))
    with pytest.raises(UsageError, match="wanted a library with classes, captured has none"):
        run("--library", without_classes, printed=printed)
