"""The command prints, writes and draws what was measured, from CSV folders and bags alike, or says what is wrong."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csv_libraries import write_csv_library
from paths import shared_data
from rich.console import Console
from small_library import small_library

from humanpred_ros.errors import HumanPredError, LibraryFormatError
from humanpred_ros.evaluation.framework import present
from humanpred_ros.evaluation.recognition import RecognitionSettings, measure
from humanpred_ros.evaluation.recognition_scores import advice_beside, read_reference, reference_beside
from humanpred_ros.motion.bag_library import write_library_bag

CURVE = "phase_percent,recognition_rate\n" + "".join(f"{p},{p / 100}\n" for p in range(1, 101))
ADVICE = (
    "set,class,traj_id,reason,advice\nlib,0,1,gone wild,exclude or relabel\nlib,1,2,odd,suspect\nother,1,0,x,exclude\n"
)
pytestmark = pytest.mark.usefixtures("in_this_process")
GMM = {"classifier": ("gmm",), "components": 2, "jobs": 1}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "lib"
    write_csv_library(small_library(n_classes=3, n_motions=3, n_frames=20), folder)
    return folder


def evaluate(library: Path | str, **settings: Any) -> str:
    text = io.StringIO()
    given = RecognitionSettings(**{"library": str(library), **settings})
    assert present(given, Console(file=text, width=120), measure) == 0
    return text.getvalue()


def test_everything_printed_is_in_the_json(library: Path, tmp_path: Path) -> None:
    (library.parent / "reference").mkdir(exist_ok=True)
    (library.parent / "reference" / "authors_fig6_curve.csv").write_text(CURVE, encoding="utf-8")
    (library.parent / "outliers.csv").write_text(ADVICE, encoding="utf-8")
    json_file, plot_file = tmp_path / "figures.json", tmp_path / "figures.png"
    printed = evaluate(library, **GMM, speeds=(1, 1.3), seed=5, json=json_file, plot=plot_file)
    found: dict[str, Any] = json.loads(json_file.read_text(encoding="utf-8"))
    (gmm,) = found["classifiers"]
    assert f"{100 * gmm['figures']['rate_at_60']:.1f} %" in printed
    assert f"{gmm['log_loss']['1e-15']:.3f}" in printed
    assert f"{gmm['log_loss']['0.001']:.3f}" in printed
    assert f"{gmm['reference_rms']:.3f}" in printed
    assert "published" in printed
    assert "AUROC" not in printed, "says nothing about unknown motions"
    assert "gmm, excluded only (1)" in printed
    assert found["settings"]["seed"] == gmm["settings"]["seed"] == 5
    assert found["settings"]["speeds"] == [1.0, 1.3]
    assert found["library"]["name"] == "lib"
    assert found["library"]["n_motions"] == 9
    assert found["machine"]["usable_cores"] >= 1
    assert found["reference"]["figures"]["first_50_percent"] == 50
    assert len(gmm["rate"]) == len(gmm["speeds"][0]["rate"]) == 100
    assert np.shape(gmm["unknown_quartiles"]) == (3, 100)
    assert np.sum(gmm["confusion_at_60"]) == 9
    assert plot_file.read_bytes().startswith(b"\x89PNG")


def test_a_bag_gives_the_same_figures_as_the_csv_folder(library: Path, tmp_path: Path) -> None:
    bag = write_library_bag(small_library(n_classes=3, n_motions=3, n_frames=20), tmp_path / "lib")
    files = [tmp_path / "csv.json", tmp_path / "bag.json"]
    for path, file in zip((library, bag), files, strict=True):
        evaluate(path, **GMM, speeds=(1,), unknown=False, reference="none", json=file)
    one, two = (json.loads(file.read_text(encoding="utf-8"))["classifiers"][0] for file in files)
    assert one["rate"] == two["rate"]
    assert one["log_loss"] == pytest.approx(two["log_loss"])


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"classifier": ("oracle",)}, r"wanted .*gmm.*got oracle"),
        ({"reference": "nothing.csv"}, "nothing.csv.*could not be read"),
        ({"components": 0}, "components.*from 1"),
        ({"evidence": "product"}, "evidence.*'sum' or 'mean'.*product"),
        ({"library": "nowhere"}, "nowhere.*neither a path that exists"),
    ],
)
def test_bad_settings_are_one_clear_line(library: Path, settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(HumanPredError, match=complaint) as caught:
        evaluate(**{"library": library, "jobs": 1, **settings})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "percent,rate\n1,0.5\n",
        CURVE.replace("50,0.5", "50,half"),
        CURVE.replace("50,0.5\n", ""),
        CURVE.replace("50,0.5\n", "50,5.0\n"),
        CURVE.replace("50,0.5\n", "50,nan\n"),
        CURVE.replace("50,0.5\n", "50\n"),
        "phase_percent,recognition_rate\n\x00\n",
    ],
)
def test_a_garbled_reference_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HumanPredError, match=r"curve\.csv"):
        read_reference(path)


def test_a_reference_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(HumanPredError, match="could not be read"):
        read_reference(path)


def test_advice_concerns_the_library_of_that_name_only(tmp_path: Path) -> None:
    assert advice_beside(tmp_path / "lib", "lib") == {}
    assert reference_beside(tmp_path / "lib") is None
    (tmp_path / "outliers.csv").write_text(ADVICE, encoding="utf-8")
    assert advice_beside(tmp_path / "lib", "lib") == {"0/1": "exclude", "1/2": "suspect"}
    assert advice_beside(tmp_path / "lib", "third") == {}


def test_the_published_curve_has_the_published_figures() -> None:
    published = reference_beside(shared_data("iros2013/library_b"))
    assert published is not None
    assert published["figures"]["first_50_percent"] == 43  # P1 Fig. 6
    assert published["rate"][[59, 79, 86]] == pytest.approx([0.84, 0.89, 0.92], abs=0.016)


def test_of_two_classes_the_unknown_motions_are_left_out_and_that_is_said(tmp_path: Path) -> None:
    write_csv_library(small_library(2, 2, 30, there_and_back=True), tmp_path / "small")
    json_file, plot_file = tmp_path / "figures.json", tmp_path / "figures.png"
    settings = {"classifier": ("reaching",), "jobs": 1, "speeds": (1,)}
    printed = evaluate(tmp_path / "small", **settings, json=json_file, plot=plot_file)
    found = json.loads(json_file.read_text(encoding="utf-8"))
    assert found["unknown_left_out"] in " ".join(printed.split())
    assert "takes at least 3" in found["unknown_left_out"]
    assert found["classifiers"][0]["unknown"] is None
    assert np.sum(found["classifiers"][0]["confusion_at_60"]) == 4
    assert "its place only" in printed
    assert "reaching has seen no motion of the class" in " ".join(printed.split())
    assert plot_file.read_bytes().startswith(b"\x89PNG")
    assert "Without unknown motions" not in evaluate(tmp_path / "small", **settings, unknown=False)


def test_who_cannot_learn_from_a_small_library_is_named_with_the_option_to_go_on(tmp_path: Path) -> None:
    write_csv_library(small_library(2, 2, 30), tmp_path / "small")
    with pytest.raises(LibraryFormatError, match=r"for forest and gmm .* class 0 has 2.* --classifier reaching$"):
        evaluate(tmp_path / "small", jobs=1)
