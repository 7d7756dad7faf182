"""Long streams made of left-out motions: what was put into them is found again, and counted honestly."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import HumanPredError, LibraryFormatError
from humanpred_ros.evaluation.framework import present
from humanpred_ros.evaluation.streams import StreamSettings, check_rounds, evaluate_streams, measure
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import MotionLibrary


def resting_first(n_motions: int = 4) -> MotionLibrary:
    """Return reaches that begin and end with rest, as recordings do."""
    library = small_library(3, n_motions, 90, there_and_back=True)
    rng = np.random.default_rng(0)
    motions = []
    for motion in library:
        before = motion.q[0] + rng.normal(0.0, 0.002, (25, 12))
        after = motion.q[-1] + rng.normal(0.0, 0.002, (15, 12))
        q = np.vstack([before, motion.q, after])
        motions.append(type(motion)(np.arange(len(q)) / 60, q, motion.dof_names, motion.label, motion.index, "lab"))
    return MotionLibrary("small", tuple(motions), {})


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_library_bag(resting_first(3), tmp_path_factory.mktemp("data") / "library")


def test_streams_are_evaluated_written_and_drawn(library: Path, tmp_path: Path, in_this_process: None) -> None:
    out, plot, text = tmp_path / "streams.json", tmp_path / "plot.svg", io.StringIO()
    settings = StreamSettings(library=str(library), standing=1.0, json=out, plot=plot)
    assert present(settings, Console(file=text, width=120), measure) == 0
    found = json.loads(out.read_text(encoding="utf-8"))
    recorded = found["variants"][0]
    assert recorded["groups"]["all"]["n_motions"] == len(found["motions"]) == 9
    assert f"{100 * recorded['groups']['all']['in_time']:.1f} %" in text.getvalue()
    assert f"{recorded['false_starts_per_ten_minutes']:.2f}" in text.getvalue()
    assert found["recognition"]["n_motions"]["all"] == 9
    assert recorded["standing_s"] == pytest.approx(60.0, rel=0.1)
    assert plot.stat().st_size > 0


def test_without_a_classifier_only_onsets_and_ends_are_looked_at(in_this_process: None) -> None:
    found = evaluate_streams(resting_first(3), StreamSettings(library="", classifier="none", standing=0.1))
    assert found["recognition"] is None
    assert found["stream_us"] is None
    assert list(found["variants"][0]["groups"]) == ["all"]


def test_what_cannot_be_left_out_is_refused() -> None:
    with pytest.raises(LibraryFormatError, match=r"3 recording rounds.*got 2"):
        check_rounds(resting_first(2))
    motions = resting_first(3).motions
    with pytest.raises(LibraryFormatError, match="-/0"):
        check_rounds(MotionLibrary("mixed", (*motions, replace(motions[0], label=None))))


@pytest.mark.parametrize(
    ("name", "value"), [("classifier", "oracle"), ("standing", 0.0), ("tolerance", float("nan")), ("seed", -1)]
)
def test_impossible_settings_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(HumanPredError, match=name):
        StreamSettings(**{"library": "", name: value})
