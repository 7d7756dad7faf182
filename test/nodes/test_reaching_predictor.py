"""Reaches that no library contains, predicted in the graph: places told, added and removed while the node runs."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import yaml
from mocap_library import mocap_library
from paths import REPOSITORY, shared_data
from rich.console import Console

from humanpred_ros.evaluation.demo import DemoSettings, run_demo
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.reaching.places import Places, reach_ends
from humanpred_ros.viewing.run import read_run

pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
from predictor_client import SCENE, PredictorClient, goal_texts

from humanpred_ros.nodes import conversions

SHIPPED = REPOSITORY / "bags" / "synthetic_reaches"
UNKNOWN, NEW_LABEL = "3", "33"


def some_of(library: MotionLibrary, labels: set[str], per_class: int) -> MotionLibrary:
    kept = {motion.name for label in labels for motion in library.of_class(label)[:per_class]}
    return library.select(lambda motion: motion.name in kept)


def test_a_place_that_is_told_while_the_person_is_on_the_way_is_found(tmp_path: Path) -> None:
    shipped, human = load_library(SHIPPED), HumanModel.kinect12()
    learned = some_of(shipped, set(shipped.labels) - {UNKNOWN}, 4)
    library = write_library_bag(learned, tmp_path / "learned")
    places = Places.of_ends(reach_ends(shipped, human))
    two = Places.of({label: places.by_label[label] for label in ("1", "5")})
    three = Places.of({**two.by_label, NEW_LABEL: places.by_label[UNKNOWN]})
    parameters = {"library": str(library), "places": goal_texts(two)}
    with PredictorClient(tmp_path, parameters, stop_after=20) as client:
        tracker = client.replay(SHIPPED, f"{UNKNOWN}/2")
        client.wait(lambda: len(client.posteriors) == 20, "the first answers", timeout_s=60.0)
        client.set_places(three)
        client.go_on()
        client.wait_for_end(tracker)
    motion = shipped.find(f"{UNKNOWN}/2")
    told = client.probability(NEW_LABEL)
    assert len(told) > len(motion)
    assert np.isnan(told[:20]).all(), "nobody had told it yet"
    assert np.isfinite(told[20:]).all()
    # From half of the motion on, which is a reach and the return, to its end.
    at = slice(round(0.5 * len(motion)), round(0.95 * len(motion)))
    assert np.median(told[at]) > 0.9
    assert (told[at] > 0.5).mean() > 0.95
    labels, last_places = client.posteriors[max(client.posteriors)]
    assert tuple(labels) == three.labels
    np.testing.assert_allclose(last_places, three.moved(SCENE.T_world_human).places_m, atol=1e-6)
    for cloud in client.occupancies.values():
        occupancy = conversions.occupancy_from_cloud(cloud, SCENE.grid, 0.0).probability
        assert occupancy.max() == 1.0, "the body is where it is"
        assert ((occupancy > 0.0) & (occupancy < 1.0)).any(), "and will be somewhere else"


def test_places_are_changed_refused_and_warned_about(tmp_path: Path) -> None:
    shipped = load_library(SHIPPED)
    learned = some_of(shipped, {0, 4}, 3)
    library = write_library_bag(learned, tmp_path / "learned")
    own = Places.of_ends(reach_ends(learned, HumanModel.kinect12()))
    with PredictorClient(tmp_path, {"library": str(library)}, stop_after=1) as client:
        tracker = client.replay(SHIPPED, "4/5")
        client.wait(lambda: bool(client.posteriors), "an answer", timeout_s=60.0)
        first, places = client.posteriors[max(client.posteriors)]
        assert tuple(first) == ("0", "4"), "the library's classes, until somebody says otherwise"
        np.testing.assert_allclose(places, own.moved(SCENE.T_world_human).places_m, atol=1e-6)
        for entry in ("3 0.1 0.2", "cup 0.1 0.2 far"):
            done, reason = client.set_parameter("places", [entry])
            assert not done
            assert "wanted 'label x y z'" in reason
            assert entry in reason
        assert not client.set_parameter("reaching.weights", "baseline_0")[0], "all else is read-only"
        client.set_places(Places.of({**own.by_label, "9": [6.0, 0.0, 1.0]}))
        client.go_on(5)
        client.wait(lambda: "warning/place 9" in client.diagnostics[1], "the warning")
        assert client.diagnostics[0] == "predicting"
        assert "out of reach" in client.diagnostics[1]["warning/place 9"]
        done, _ = client.set_parameter("places", [""])
        assert done
        client.go_on()
        client.wait(lambda: "warning/place 9" not in client.diagnostics[1], "the warning's end")
        client.wait_for_end(tracker)
        assert tuple(client.posteriors[max(client.posteriors)][0]) == ("0", "4")
    log = client.process.log.read_text(encoding="utf-8")
    assert log.count("place 9 is ") == 1, "logged once"


def test_the_23_dof_human_reaches_for_a_place_of_no_library(tmp_path: Path) -> None:
    captured = mocap_library(4, 4)
    places = Places.of_ends(reach_ends(captured, HumanModel.mocap23()))
    learned = write_library_bag(some_of(captured, {0, 2, 3}, 4), tmp_path / "learned")
    played = mocap_library(4, 1, seed=9)
    bag = write_library_bag(played, tmp_path / "played")
    parameters = {"library": str(learned), "human": "mocap23", "places": goal_texts(places)}
    with PredictorClient(tmp_path, parameters) as client:
        client.wait_for_end(client.replay(bag, "1/0"))
    told = client.probability("1")
    motion = played.find("1/0")
    assert np.median(told[round(0.5 * len(motion)) : len(motion)]) > 0.8
    occupancy = client.occupancies[min(client.occupancies)]
    assert conversions.occupancy_from_cloud(occupancy, SCENE.grid, 0.0).probability.max() == 1.0


def test_recordings_of_two_people_suffice_where_places_are_told(tmp_path: Path) -> None:
    demos = shared_data("icra2015/demos")
    recorded, human = load_library(demos), HumanModel.mocap23()
    motion = recorded.find("1")
    ends = human.forward(np.array([m.q[-1] for m in recorded]))["right_palm"]
    goals = Places(("1", "2"), np.array([ends[1], ends[1] + [0.5, -0.5, 0.0]]))
    # The two stood elsewhere than the people of the shipped scenes: the lattice goes to where they were.
    scene = yaml.safe_load((REPOSITORY / "config" / "scenes" / f"{SCENE.name}.yaml").read_text(encoding="utf-8"))
    scene["grid"]["origin_m"] = [0.0, -1.0, -0.4]
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene), encoding="utf-8")
    parameters = {"library": str(demos), "human": "mocap23", "places": goal_texts(goals), "detect_onsets": False}
    with PredictorClient(tmp_path, {**parameters, "scene": str(tmp_path / "scene.yaml")}) as client:
        client.wait_for_end(client.replay(demos, "1"))
    assert client.probability("1")[len(motion) - 1] > 0.8


def test_the_demo_runs_with_it_and_with_the_23_dof_human(tmp_path: Path) -> None:
    library = write_library_bag(mocap_library(4, 4, 40), tmp_path / "captured")
    options = DemoSettings(
        library=str(library), trajectory="1/3", predictor="reaching", hold_out=1, out=str(tmp_path / "run")
    )
    summary = run_demo(options, Console(file=io.StringIO()))
    assert summary.missed == 0
    run = read_run(tmp_path / "run")
    assert run.facts["predictor"] == "reaching"
    assert run.facts["classifier"] == ""
    assert run.posterior.labels == ("0", "1", "2", "3")
    assert run.posterior.probability[-1].argmax() == 1
    assert HumanModel(run.human_urdf).signature == HumanModel.mocap23().signature
    assert (tmp_path / "run" / "report.html").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"human": "alien"}, "wanted one of kinect12, mocap23, got 'alien'"),
        ({"human": "mocap23"}, "wanted its 23 DoFs in its order, got 12 names"),
        ({"places": ["3 0 0"]}, "wanted 'label x y z'"),
        ({"places": ["3 0 0 1"], "predictor": "forecast"}, "wanted the predictor reaching, got forecast"),
        ({"reaching.weights": "heavy"}, "wanted one of baseline_0"),
        (
            {"reaching.weight": "baseline_0"},
            "reaching.weight: reaching has no setting of that name; did you mean weights?",
        ),
    ],
)
def test_what_cannot_be_used_is_said_in_one_line(tmp_path: Path, parameters: dict[str, object], words: str) -> None:
    with pytest.raises(AssertionError, match="has ended") as caught, PredictorClient(tmp_path, parameters):
        pass
    assert words in str(caught.value)
