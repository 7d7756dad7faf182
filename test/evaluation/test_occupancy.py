"""The evaluation scores what is really swept, shows the predictors nothing of it, and does not depend on processes."""

from __future__ import annotations

import io
import json
import pickle
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mocap_library import mocap_library
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import ArrayError, HumanPredError, LibraryFormatError
from humanpred_ros.evaluation import occupancy as occupancy_module
from humanpred_ros.evaluation.framework import present, print_report
from humanpred_ros.evaluation.leave_one_out import LeaveOneOut
from humanpred_ros.evaluation.occupancy import LeftOutMotions, OccupancySettings, evaluate_occupancy, measure, until_end
from humanpred_ros.evaluation.occupancy_report import report_of
from humanpred_ros.evaluation.occupancy_scores import Played, grid_around, swept_region
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import Occupancy, VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import MotionLibrary, placed, start_pelvis_m, turn_and_shift
from humanpred_ros.occupancy.predictor import Prediction, Predictor, PredictorRequest
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser
from humanpred_ros.reaching.reaching_predictor import ReachingPredictor
from humanpred_ros.recognition.gmm_classifier import GmmSettings

HUMAN = HumanModel.kinect12()
GMM = GmmSettings(n_components=3, max_iterations=10)
NONE = np.eye(4)


@cache
def library() -> MotionLibrary:
    return small_library(3, 4, 30, there_and_back=True)


def runs_of(*predictors: str, **changes: Any) -> LeftOutMotions:
    grid = grid_around(library(), HUMAN)
    region = swept_region(library(), BodyVoxeliser(HUMAN, grid, NONE), 2).ravel()
    settings = OccupancySettings(library="", predictor=predictors, percents=changes.pop("percents", (10, 40, 90)))
    runs = LeftOutMotions(settings, library(), library(), HUMAN, grid, NONE, NONE, region, ("10/1", 40))
    return replace(runs, **changes)


class Told(Predictor):
    """Predicts what a function of the posture's number says, and notes what it was shown."""

    def __init__(self, grid: VoxelGrid, predict: Any) -> None:
        self.grid, self._predict, self.shown = grid, predict, []

    @classmethod
    def from_request(cls, request: PredictorRequest) -> Told:
        raise NotImplementedError

    def start(self) -> None:
        self.shown = []

    def update(self, q: FloatArray, t_s: float) -> Prediction:
        self.shown.append((q, t_s))
        return Prediction(Occupancy(self.grid, self._predict(len(self.shown) - 1), t_s), None)


def run_told(monkeypatch: pytest.MonkeyPatch, predict: Any, name: str, runs: LeftOutMotions) -> tuple[Played, Told]:
    told = Told(runs.grid, predict)
    monkeypatch.setattr(LeaveOneOut, "without", lambda self, name: told)
    ((played, unlisted, _),) = runs(name)
    assert unlisted is None
    return played, told


def test_who_knows_the_rest_of_the_motion_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    s = runs_of("current")
    motion = library().find("10/1")
    voxeliser = BodyVoxeliser(HUMAN, s.grid, NONE)
    outcome, told = run_told(monkeypatch, lambda k: voxeliser.mask(motion.q[k:]).astype(np.float32), "10/1", s)
    assert [score["brier"] for score in outcome.scores] == [0.0, 0.0, 0.0]
    assert [score["missed"] for score in outcome.scores] == [0.0, 0.0, 0.0]
    # It was shown 90 % of the motion as a sensor would show it, and nothing more.
    assert len(told.shown) == 27
    for k, (q, t_s) in enumerate(told.shown):
        np.testing.assert_array_equal(q, motion.q[k])
        assert t_s == motion.t_s[k]
    assert outcome.picture is not None
    assert outcome.picture.shape == (2, 80, 80)
    np.testing.assert_array_equal(*outcome.picture)


def test_who_predicts_nothing_is_wrong_by_as_many_voxels_as_are_swept(monkeypatch: pytest.MonkeyPatch) -> None:
    s = runs_of("current")
    outcome, _ = run_told(monkeypatch, lambda k: np.zeros(s.grid.shape, dtype=np.float32), "0/2", s)
    swept = [score["n_swept"] for score in outcome.scores]
    assert swept[0] >= swept[1] > swept[2] > 0
    assert [score["squared_error"] for score in outcome.scores] == swept
    assert [score["missed"] for score in outcome.scores] == [1.0, 1.0, 1.0]
    assert outcome.picture is None


def test_a_refused_posture_leaves_the_prediction_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    s = runs_of("current")
    voxeliser = BodyVoxeliser(HUMAN, s.grid, NONE)
    motion = library().find("10/1")

    def predict(k: int) -> np.ndarray:
        if k % 2 or k < 4:
            raise ArrayError("a glitch")
        return voxeliser.mask(motion.q[k]).astype(np.float32)

    outcome, _ = run_told(monkeypatch, predict, "10/1", s)
    assert outcome.log.refused == 4 + 11
    assert outcome.scores[0]["missed"] == 1.0  # none was accepted yet at 10 %
    assert outcome.scores[1]["missed"] < 1.0
    assert outcome.scores[1]["n_predicted"] == voxeliser.mask(motion.q[10]).sum()


def test_the_apex_is_where_the_palm_turns_back() -> None:
    motion = library().find("10/1")
    q, t_s = until_end(motion, HUMAN, "apex")
    assert len(q) == len(t_s)
    assert 0.4 < len(q) / len(motion) < 0.6
    np.testing.assert_array_equal(q, motion.q[: len(q)])
    assert len(until_end(motion, HUMAN, "end")[0]) == len(motion)


def test_somebody_elsewhere_is_shown_elsewhere_and_sweeps_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    T = turn_and_shift(np.deg2rad(20.0), (0.3, 0.0, 0.0), start_pelvis_m(library()))
    motion = placed(library().find("10/1"), T)
    s = runs_of("current", T_shift=T)
    voxeliser = BodyVoxeliser(HUMAN, s.grid, NONE)
    outcome, told = run_told(monkeypatch, lambda k: voxeliser.mask(motion.q[k:]).astype(np.float32), "10/1", s)
    assert [score["brier"] for score in outcome.scores] == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(told.shown[3][0], motion.q[3])


SETTINGS = OccupancySettings(
    library="", predictor=("current", "constant_velocity", "swept_volume"), components=3, every=3, jobs=1
)


def evaluated(motions: MotionLibrary | None = None, **changes: Any) -> dict[str, Any]:
    figures, _ = evaluate_occupancy(motions or library(), SETTINGS.replaced(**changes))
    return figures


def printed(figures: dict[str, Any]) -> str:
    text = io.StringIO()
    print_report(report_of(figures, None), Console(file=text, width=200))
    return text.getvalue()


def test_what_is_sent_to_other_processes_finds_the_same_there() -> None:
    here = runs_of("constant_velocity", "swept_volume")
    there = pickle.loads(pickle.dumps(here))
    for (a, _, _), (b, _, _) in zip(here("0/2"), there("0/2"), strict=True):
        assert a.scores == b.scores
        np.testing.assert_array_equal(a.table, b.table)


@pytest.mark.usefixtures("in_this_process")
def test_every_figure_is_there_and_hangs_together() -> None:
    evaluation = evaluated()
    assert evaluation["tested"] == ("0/0", "0/3", "10/2", "20/1")
    current, moving, p1 = evaluation["predictors"]
    for result in (current, moving, p1):
        assert len(result["at_percent"]) == 7
        for name, values in result["at_percent"].items():
            assert values.shape == (9,)
            assert result["average"][name] == pytest.approx(values.mean())
        np.testing.assert_allclose(
            result["at_percent"]["brier"] * evaluation["region_voxels"], result["at_percent"]["squared_error"]
        )
        assert result["average"]["brier"] == pytest.approx(np.mean([m["brier"] for m in result["motions"].values()]))
        assert set(result["motions"]) == set(evaluation["tested"])
        assert result["without_mistracked"] is None
        # All voxels of the region, each motion and percent; more where something else is predicted.
        assert result["calibration"]["count"].sum() >= evaluation["region_voxels"] * 4 * 9
    np.testing.assert_array_equal(current["at_percent"]["n_swept"], p1["at_percent"]["n_swept"])
    # The body is part of what it sweeps, so who predicts only that is never wrong, and misses all the rest.
    assert current["calibration"]["error_predicted"] == 0.0
    np.testing.assert_allclose(
        current["at_percent"]["squared_error"], current["at_percent"]["n_swept"] - current["at_percent"]["n_predicted"]
    )
    assert (moving["at_percent"]["missed"] <= current["at_percent"]["missed"] + 1e-12).all()
    assert p1["average"]["missed"] < current["average"]["missed"]


@pytest.mark.usefixtures("in_this_process")
def test_somebody_elsewhere_breaks_p1_and_not_the_baselines() -> None:
    here, there = evaluated(), evaluated(shift=(0.3, 0.0, 20.0))
    for k in (0, 1):
        assert float(there["predictors"][k]["average"]["brier"] * there["region_voxels"]) == pytest.approx(
            float(here["predictors"][k]["average"]["brier"] * here["region_voxels"]), rel=0.1
        )
    assert there["predictors"][2]["average"]["missed"] > 2 * here["predictors"][2]["average"]["missed"]


@pytest.mark.usefixtures("in_this_process")
def test_who_never_saw_the_class_stands_beside_who_learned_it() -> None:
    evaluation = evaluated(predictor=("current", "swept_volume", "reaching"), every=5)
    assert [result["learned_from_class"] for result in evaluation["predictors"]] == ["–", "yes", "no"]
    _, p1, unseen = evaluation["predictors"]
    ratio = unseen["average"]["brier"] / p1["average"]["brier"]
    assert evaluation["unseen_beside_seen"] == ratio
    assert ratio < 1.0, "P2 is no worse than P1, which was trained with the class"
    assert f"Its Brier score is {ratio:.2f} times that of swept_volume" in " ".join(printed(evaluation).split())
    assert evaluated(predictor=("current",), every=12)["unseen_beside_seen"] is None


@pytest.mark.usefixtures("in_this_process")
def test_who_is_told_places_is_also_judged_without_having_been_told() -> None:
    evaluation = evaluated(predictor=("current", "reaching"), every=5, percents=(50, 80))
    now, told = evaluation["predictors"]
    assert now["unlisted"] is None
    assert now["unlisted_at_percent"] is None
    assert told["unlisted"] is not None
    assert told["unlisted_at_percent"] is not None
    np.testing.assert_array_equal(told["unlisted_at_percent"]["n_swept"], told["at_percent"]["n_swept"])
    assert told["unlisted"]["brier"] == pytest.approx(told["unlisted_at_percent"]["brier"].mean())
    # Its place is worth knowing; a reach that goes elsewhere is still better than none.
    assert told["average"]["brier"] < told["unlisted"]["brier"] < now["average"]["brier"]
    text = printed(evaluation)
    assert f"{1e3 * told['unlisted']['brier']:.2f}" in text
    assert text.count("place not listed ") == 4  # two rows of averages, two along the motion
    assert "not listed" not in printed(evaluated(predictor=("current",), every=12))


def test_the_place_that_is_not_told_is_the_tested_motions_own(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[tuple[int, ...]] = []
    answers = occupancy_module.answers

    def noted(predictor: ReachingPredictor, *rest: Any) -> Iterator[Any]:
        shown.append(tuple(predictor.places))
        return answers(predictor, *rest)

    monkeypatch.setattr(occupancy_module, "answers", noted)
    runs = runs_of("reaching", percents=(10, 40))
    found = [*runs("10/1"), *runs("20/1")]
    assert shown == [("0", "10", "20"), ("0", "20"), ("0", "10", "20"), ("0", "10")]
    for listed, unlisted, _ in found:
        assert unlisted is not None
        assert [score["n_swept"] for score in unlisted.scores] == [score["n_swept"] for score in listed.scores]
        assert [score["brier"] for score in unlisted.scores] != [score["brier"] for score in listed.scores]


@pytest.mark.usefixtures("in_this_process")
def test_the_human_is_the_one_whose_dofs_the_library_has() -> None:
    evaluation = evaluated(mocap_library(3, 3, 25), predictor=("current", "reaching"), every=4, percents=(30, 60))
    now, unseen = evaluation["predictors"]
    assert unseen["refused_postures"] == 0
    assert unseen["average"]["missed"] < 0.5 * now["average"]["missed"]


@pytest.mark.usefixtures("in_this_process")
def test_two_motions_to_each_of_two_places_are_enough_to_learn_how_people_reach() -> None:
    few = small_library(2, 2, 30, there_and_back=True)
    now, told = evaluated(few, predictor=("current", "reaching"), percents=(30, 60), every=1)["predictors"]
    assert len(told["motions"]) == 4
    assert told["unlisted"] is not None
    assert told["average"]["brier"] < now["average"]["brier"]


@pytest.mark.usefixtures("in_this_process")
def test_a_motion_that_is_there_twice_is_refused_by_who_learns() -> None:
    first, second, *others = small_library(2, 3, 20).motions
    twice = MotionLibrary("twice", (first, second.with_postures(first.q), *others))
    with pytest.raises(LibraryFormatError, match="every motion once"):
        evaluate_occupancy(twice, SETTINGS.replaced(predictor=("reaching",)))


@pytest.mark.usefixtures("in_this_process")
def test_until_the_apex_there_is_less_to_sweep() -> None:
    whole, reach = evaluated(predictor=("current",)), evaluated(predictor=("current",), until="apex")
    assert reach["predictors"][0]["average"]["n_swept"] < whole["predictors"][0]["average"]["n_swept"]


@pytest.mark.usefixtures("in_this_process")
def test_a_scene_gives_grid_and_placement() -> None:
    evaluation = evaluated(predictor=("current",), scene="four_places", every=12)
    assert evaluation["lattice"].origin_m == (-2.0, -3.0, -0.4)
    assert evaluation["T_world_human"][0, 3] == 0.10
    assert evaluation["predictors"][0]["average"]["n_swept"] > 1000


@pytest.mark.usefixtures("in_this_process")
def test_mistracked_motions_are_tested_and_told_apart() -> None:
    wild = library().find("10/2")
    motions = tuple(
        m.with_postures(m.q + 40.0 * (np.arange(30) > 15)[:, None] * (np.arange(12) == 0)) if m is wild else m
        for m in library()
    )
    spoilt = MotionLibrary("spoilt", motions)
    with_all = evaluated(spoilt, predictor=("current", "swept_volume"))
    cleaned = evaluated(spoilt, predictor=("current", "swept_volume"), clean_training=True)
    for evaluation in (with_all, cleaned):
        assert "10/2" in evaluation["tested"]
        assert evaluation["mistracked"] == ("10/2",)
        assert evaluation["predictors"][0]["without_mistracked"] is not None
        assert evaluation["picture"] != "10/2"
    assert cleaned["predictors"][1]["average"]["brier"] < with_all["predictors"][1]["average"]["brier"]
    assert cleaned["predictors"][0]["average"]["brier"] == with_all["predictors"][0]["average"]["brier"]


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"predictor": ("current", "crystal_ball")}, "crystal_ball"),
        ({"predictor": ()}, "none"),
        ({"until": "never"}, "until.*'end' or 'apex'"),
        ({"percents": (0,)}, "percents.*from 1"),
        ({"every": 0}, "every"),
        ({"resolution": 0.0}, "resolution"),
        ({"resolution": 3.0}, "voxels"),
        ({"shift": (np.nan, 0.0, 0.0)}, "shift.*finite"),
        ({"shift": (0.3,)}, "shift"),
        ({"shift": (30.0, 0.0, 0.0)}, "outside"),
        ({"picture": "0/1"}, "tested motions"),
        ({"classifier": "svm"}, "svm"),
        ({"scene": "moon"}, "moon"),
    ],
)
def test_impossible_settings_are_refused_by_name(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(HumanPredError, match=text):
        evaluated(**changes)


@pytest.mark.usefixtures("in_this_process")
def test_a_class_too_small_is_named_before_any_work() -> None:
    small = small_library(2, 2, 20)
    with pytest.raises(LibraryFormatError, match=r"for swept_volume at least 3 .* --predictor current,reaching$"):
        evaluate_occupancy(small, SETTINGS.replaced(predictor=("current", "swept_volume", "reaching")))
    with pytest.raises(LibraryFormatError, match=r"for reaching at least 2 motions in every class"):
        evaluate_occupancy(small_library(3, 1, 20), SETTINGS.replaced(predictor=("reaching",)))
    # The baselines learn nothing.
    assert evaluated(small_library(1, 1, 20), predictor=("current",))["tested"] == ("0/0",)


@pytest.mark.usefixtures("in_this_process")
def test_everything_printed_is_in_the_json(tmp_path: Path) -> None:
    bag = write_library_bag(small_library(n_classes=2, n_motions=4, n_frames=20), tmp_path / "lib")
    json_file, plot_file, text = tmp_path / "figures.json", tmp_path / "figures.png", io.StringIO()
    settings = SETTINGS.replaced(
        library=str(bag), predictor=("current", "swept_volume"), every=4, seed=3, shift=(0.3, -0.1, 20.0),
        json=json_file, plot=plot_file,
    )  # fmt: skip
    assert present(settings, Console(file=text, width=120), measure) == 0
    found: dict[str, Any] = json.loads(json_file.read_text(encoding="utf-8"))
    assert [predictor["name"] for predictor in found["predictors"]] == ["current", "swept_volume"]
    for predictor in found["predictors"]:
        average = predictor["average"]
        for shown in (
            f"{1e3 * average['brier']:.2f}",
            f"{1e3 * average['log_loss']:.1f}",
            f"{average['average_precision']:.3f}",
            f"{100 * average['missed']:.1f} %",
            f"{predictor['calibration']['error_predicted']:.3f}",
            *(f"{100 * value:.1f} %" for value in predictor["at_percent"]["missed"]),
        ):
            assert shown in text.getvalue()
        assert len(predictor["calibration"]["count"]) == 11
        assert "picture" not in predictor
    assert found["settings"]["seed"] == 3
    assert found["settings"]["shift"] == [0.3, -0.1, 20.0]
    assert found["lattice"]["shape"] == [80, 80, 48]
    assert found["library"]["n_motions"] == 8
    assert found["tested"] == ["0/0", "10/0"]
    assert found["percents"] == list(range(10, 100, 10))
    assert plot_file.read_bytes().startswith(b"\x89PNG")
