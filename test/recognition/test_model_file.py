"""Model files: what was written comes back to the bit, and nothing else is ever taken for a model."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import zipfile
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import REPOSITORY
from small_library import small_library

from humanpred_ros.errors import ModelFileError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.recognition import model_file
from humanpred_ros.recognition.forest_config import ForestSettings
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.recognition.model_file import TrainedModel, load_model, save_model, train_model

HUMAN = HumanModel.kinect12()


@cache
def trained() -> TrainedModel:
    config = GmmSettings(n_components=3, max_iterations=10, evidence="mean", window_frames=12, nominal_duration_s=1.4)
    return train_model(small_library(2, 3), HUMAN, config, ForestSettings(n_trees=7))


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "model.npz"
    save_model(trained(), path)
    return path


def rewritten(path: Path, out: Path, **changes: object) -> Path:
    """Copy a model file with some members or metadata entries replaced."""
    with np.load(path) as archive:
        members = dict(archive)
    metadata = json.loads(members["metadata"].tobytes())
    for name, value in changes.items():
        if name in members:
            members[name] = np.asarray(value)
        else:
            metadata[name] = value
    members["metadata"] = np.frombuffer(json.dumps(metadata).encode(), dtype=np.uint8)
    np.savez(out, **members)
    return out


def assert_same(a: TrainedModel, b: TrainedModel) -> None:
    assert a.config == b.config
    for name in ("labels", "dof_names", "frame_id", "human_signature", "nominal_duration_s", "library_name",
                 "training_motions", "package_version"):  # fmt: skip
        assert getattr(a, name) == getattr(b, name)
    assert dict(a.library_provenance) == dict(b.library_provenance)
    assert a.classes.motions_per_class == b.classes.motions_per_class
    np.testing.assert_array_equal(a.regressed_q, b.regressed_q)
    np.testing.assert_array_equal(a.goals_m, b.goals_m)
    for one, other in zip(a.classes.mixtures, b.classes.mixtures, strict=True):
        for name in ("weights", "means", "covariances", "whitening", "log_scale"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_round_trip_to_the_bit(saved: Path) -> None:
    loaded = load_model(saved, HUMAN)
    assert_same(loaded, trained())
    motion = small_library(2, 1, seed=5).motions[1]
    np.testing.assert_array_equal(
        loaded.gmm_classifier(HUMAN).posteriors(motion), trained().gmm_classifier(HUMAN).posteriors(motion)
    )
    read, kept = loaded.forest_classifier(HUMAN), trained().forest_classifier(HUMAN)
    for q, t_s in zip(motion.q, motion.t_s, strict=True):
        one, other = read.update(q, t_s), kept.update(q, t_s)
        np.testing.assert_array_equal(one.probability, other.probability)
        assert one.unknown == other.unknown
        np.testing.assert_array_equal(read.exemplar_weights(), kept.exemplar_weights())


def test_the_same_model_gives_the_same_bytes(saved: Path, tmp_path: Path) -> None:
    save_model(load_model(saved, HUMAN), tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == saved.read_bytes()


@settings(max_examples=60)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_truncated_file_is_refused(saved: Path, share: float) -> None:
    data = saved.read_bytes()
    cut = saved.with_name("cut.npz")
    cut.write_bytes(data[: int(share * len(data))])
    with pytest.raises(ModelFileError, match=r"cut\.npz"):
        load_model(cut, HUMAN)


@settings(max_examples=200)
@given(share=st.floats(0.0, 1.0, exclude_max=True), flip=st.integers(1, 255))
def test_a_damaged_byte_is_noticed_or_without_effect(saved: Path, share: float, flip: int) -> None:
    data = bytearray(saved.read_bytes())
    data[int(share * len(data))] ^= flip
    damaged = saved.with_name("damaged.npz")
    damaged.write_bytes(data)
    try:
        loaded = load_model(damaged, HUMAN)
    except ModelFileError:
        return
    assert_same(loaded, trained())


def test_files_of_another_kind_are_refused(tmp_path: Path, saved: Path) -> None:
    path = tmp_path / "model.npz"
    with pytest.raises(ModelFileError, match="humanpred train"):
        load_model(path, HUMAN)
    for data in (b"", b"not a model", saved.read_bytes()[::-1]):
        path.write_bytes(data)
        with pytest.raises(ModelFileError, match="not a model file, or damaged"):
            load_model(path, HUMAN)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(ModelFileError):
        load_model(path, HUMAN)
    np.savez(path, a=np.zeros(3))
    with pytest.raises(ModelFileError):
        load_model(path, HUMAN)
    with pytest.raises(ModelFileError, match="could not be read"):
        load_model(tmp_path, HUMAN)


def test_pickled_objects_are_never_loaded(tmp_path: Path, saved: Path) -> None:
    path = rewritten(saved, tmp_path / "model.npz", goals_m=np.array([{"code": "run me"}], dtype=object))
    with pytest.raises(ModelFileError, match="pickle"):
        load_model(path, HUMAN)
    with zipfile.ZipFile(saved) as archive:
        for name in archive.namelist():
            np.load(io.BytesIO(archive.read(name)), allow_pickle=False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "something else"}, "wanted a humanpred_ros trained model"),
        ({"format_version": 1}, "wanted format version 2, got 1"),
        ({"human_signature": "0" * 64}, "made for another human"),
        ({"dof_names": [f"joint{i}" for i in range(12)]}, "DoFs do not fit"),
        ({"dof_names": ["PelvisTransX"]}, "parts do not fit"),
        ({"labels": [0, 0]}, "parts do not fit"),
        ({"labels": "ab"}, "parts do not fit"),
        ({"config": {"n_components": 3, "no_such_setting": 1}}, "parts do not fit"),
        ({"library_provenance": 3}, "parts do not fit"),
        ({"weights": np.ones((2, 3))}, "parts do not fit"),
        ({"covariances": np.zeros((2, 3, 13, 13))}, "parts do not fit"),
        ({"goals_m": np.full((2, 3), np.nan)}, "parts do not fit"),
        ({"forest": {}}, "parts do not fit"),
        ({"forest_calibration": np.zeros(4)}, "parts do not fit"),
        ({"forest_place_spread": np.zeros(3)}, "parts do not fit"),
        ({"forest_exemplar_label": np.zeros(6, dtype=np.int64)}, "parts do not fit"),
        ({"forest_exemplar_first": np.arange(7)}, "parts do not fit"),
        ({"forest_n_nodes": np.array([3])}, "parts do not fit"),
        ({"forest_left": np.zeros(10, dtype=np.int32)}, "parts do not fit"),
    ],
)
def test_files_that_do_not_fit_are_refused(
    tmp_path: Path, saved: Path, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(ModelFileError, match=message):
        load_model(rewritten(saved, tmp_path / "model.npz", **changes), HUMAN)


def test_another_human_is_refused(saved: Path) -> None:
    bigger_head = HumanModel(HUMAN.urdf.replace('<sphere radius="0.13"', '<sphere radius="0.14"'))
    assert bigger_head.signature != HUMAN.signature
    with pytest.raises(ModelFileError, match="another human"):
        load_model(saved, bigger_head)


def test_an_interrupted_write_leaves_the_old_file(saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "model.npz"
    path.write_bytes(saved.read_bytes())

    def disk_full(file: io.BytesIO, **_: object) -> None:
        file.write(b"half of")
        raise OSError("no space left")

    monkeypatch.setattr(model_file.np, "savez", disk_full)
    other = replace(trained(), library_name="other")
    with pytest.raises(ModelFileError, match="no space left"):
        save_model(other, path)
    assert path.read_bytes() == saved.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["model.npz"]


def test_folders_are_made_and_impossible_places_named(tmp_path: Path) -> None:
    save_model(trained(), tmp_path / "new" / "folder" / "model.npz")
    assert load_model(tmp_path / "new" / "folder" / "model.npz", HUMAN).labels == (0, 10)
    (tmp_path / "file").write_text("")
    with pytest.raises(ModelFileError, match="could not be written"):
        save_model(trained(), tmp_path / "file" / "model.npz")


def test_loading_stays_light(saved: Path) -> None:
    """A node that loads a model starts without the plotting and learning packages."""
    code = (
        "import sys; from humanpred_ros.human.model import HumanModel; "
        "from humanpred_ros.recognition.model_file import load_model; "
        "from humanpred_ros.occupancy.predictor import predictor_type; predictor_type('forecast'); "
        f"load_model({str(saved)!r}, HumanModel.kinect12()); "
        "print([m for m in ('sklearn', 'matplotlib') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=REPOSITORY, check=False)
    assert (result.returncode, result.stdout.strip()) == (0, "[]"), result.stderr


@pytest.mark.parametrize(("node", "to"), [("forest_left", 0), ("forest_right", 10**6), ("forest_feature", 48)])
def test_trees_that_lead_nowhere_or_in_circles_are_refused(tmp_path: Path, saved: Path, node: str, to: int) -> None:
    with np.load(saved) as archive:
        array = archive[node].copy()
        array[int(np.argmax(archive["forest_feature"] >= 0))] = to
    with pytest.raises(ModelFileError, match="parts do not fit"):
        load_model(rewritten(saved, tmp_path / "model.npz", **{node: array}), HUMAN)
