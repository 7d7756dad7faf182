"""A library of one's own people: `humanpred record`, from a recording and from the running tracker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from paths import REPOSITORY

from humanpred_ros.cli import main
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.nodes.record import RecordSettings, Session

SHIPPED = load_library(REPOSITORY / "bags" / "synthetic_reaches")
RATE_HZ = 30.0


def stream(order: str) -> Motion:
    """Return one long recording: reaches to the classes named in `order`, with rest and ways between them."""
    used: dict[str, int] = {}
    parts: list[np.ndarray] = []
    for label in order:
        motion = SHIPPED.of_class(label)[used.setdefault(label, 0)]
        used[label] += 1
        stamps = np.arange(0.0, motion.duration_s, 1.0 / RATE_HZ)
        q = np.stack([np.interp(stamps, motion.t_s, column) for column in motion.q.T], axis=1)
        if parts:  # an arm goes back to where the next reach begins
            share = (0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 30)))[:, None]
            parts.append(parts[-1][-1] + share * (q[0] - parts[-1][-1]))
        parts += [np.repeat(q[:1], 60, axis=0), q, np.repeat(q[-1:], 30, axis=0)]
    postures = np.concatenate(parts) + np.random.default_rng(0).normal(0.0, 5e-4, (sum(map(len, parts)), 12))
    return Motion(np.arange(len(postures)) / RATE_HZ, postures, SHIPPED.dof_names, frame_id=SHIPPED.frame_id)


def test_a_recording_becomes_a_library_that_a_model_is_trained_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    order = "1551155115"
    source = write_library_bag(MotionLibrary("day", (stream(order),)), tmp_path / "day")
    out = tmp_path / "mine"
    assert main(["record", "--from", str(source), "--labels", "screws,housing", "--count", "4", "--out", str(out)]) == 0
    library = load_library(out)
    assert library.labels == ("housing", "screws")
    assert {label: len(library.of_class(label)) for label in library.labels} == {"housing": 4, "screws": 4}
    # Named in the order in which they are first reached for: the first reach was to class 1.
    human = HumanModel.kinect12()
    first = library.of_class("screws")[0]
    palm = human.forward(first.q)["right_palm"]
    apex = palm[np.linalg.norm(palm - palm[0], axis=1).argmax()]
    theirs = human.forward(SHIPPED.of_class("1")[0].q)["right_palm"]
    assert np.linalg.norm(theirs - apex, axis=1).min() < 0.1
    assert main(["train", str(out), "--out", str(tmp_path / "model.npz")]) == 0
    assert "left out" in capsys.readouterr().out  # the fifth of each
    assert main(["record", "--from", str(source), "--labels", "a,b", "--out", str(out)]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_live_reaches_are_counted_in_turns_and_mistracked_ones_refused(tmp_path: Path) -> None:
    settings = RecordSettings(out=tmp_path / "mine", labels=("screws", "housing"), count=1)
    session = Session(settings, ["screws", "housing"], HumanModel.kinect12())
    recorded = stream("115")
    q, said = np.array(recorded.q), []
    q[100:104, 7] += 2.5  # an arm that is taken for another for four frames of the first reach
    for posture, t_s in zip(q, recorded.t_s.tolist(), strict=True):
        asked = session.next_label
        if text := session.take(posture, t_s, "kinect"):
            said.append((asked, text))
    assert session.next_label is None
    assert said[0][0] == "screws"
    assert said[0][1].startswith("screws: refused, one-frame step faster than a human")
    assert [text for _, text in said if "refused" not in text] == ["screws: 1 of 1", "housing: 1 of 1"]
    assert load_library(tmp_path / "mine").labels == ("housing", "screws")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--labels", "a,a"], "wanted different ones"),
        (["--labels", "a/b"], "label: wanted a text"),
        ([], "--labels: wanted what is reached for"),
        (["--labels", "a", "--from", "/nonexistent"], "nothing of that name"),
        (["--labels", "mug", "--scene", "four_places"], "wanted a scene with places"),
    ],
)
def test_what_cannot_be_recorded_is_one_line(
    given: list[str], said: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", "--out", str(tmp_path / "out"), *given]) == 2
    error = capfd.readouterr().err.strip()
    assert said in error
    assert "\n" not in error
