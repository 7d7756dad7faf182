"""Model files: what was written comes back to the bit, and nothing else is ever taken for a model."""

from __future__ import annotations

import io
import json
import os
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
from humanpred_ros.recognition import training
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.forest_classifier import ForestClassifier
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.recognition.training import TrainedModel, load_model, model_of, save_model, train_model

pytestmark = pytest.mark.core

HUMAN = HumanModel.kinect12()


@cache
def trained() -> TrainedModel:
    gmm = GmmSettings(n_components=3, max_iterations=10, evidence="mean", window_frames=12, nominal_duration_s=1.4)
    return train_model(small_library(2, 3), HUMAN, {"forest": ForestSettings(n_trees=7), "gmm": gmm})


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "model.npz"
    save_model(trained(), path)
    return path


def rewritten(path: Path, out: Path, **changes: object) -> Path:
    """Copy a model file with some members, entries of the metadata, or entries of its library replaced.

    A slash in a name is written as two underscores.
    """
    with np.load(path) as archive:
        members = dict(archive)
    metadata = json.loads(members["metadata"].tobytes())
    for key, value in changes.items():
        name = key.replace("__", "/")
        if name in members:
            members[name] = np.asarray(value)
        elif name.startswith("library/"):
            metadata["library"][name.removeprefix("library/")] = value
        else:
            metadata[name] = value
    members["metadata"] = np.frombuffer(json.dumps(metadata).encode(), dtype=np.uint8)
    np.savez(out, **members)
    return out


def assert_same(a: TrainedModel, b: TrainedModel) -> None:
    assert (a.human.signature, a.package_version) == (b.human.signature, b.package_version)
    assert (a.library.name, dict(a.library.provenance)) == (b.library.name, dict(b.library.provenance))
    for one, other in zip(a.library, b.library, strict=True):
        assert (one.name, one.label, one.frame_id, one.dof_names) == (
            other.name,
            other.label,
            other.frame_id,
            other.dof_names,
        )
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.t_s, other.t_s)
    assert a.classifiers.keys() == b.classifiers.keys()
    for name, classifier in a.classifiers.items():
        assert classifier.settings == b.classifiers[name].settings
        state, other_state = classifier.state(), b.classifiers[name].state()
        assert state.keys() == other_state.keys()
        for key, array in state.items():
            assert array.dtype == other_state[key].dtype
            np.testing.assert_array_equal(array, other_state[key])


def test_round_trip_to_the_bit(saved: Path) -> None:
    loaded = load_model(saved, HUMAN)
    assert_same(loaded, trained())
    motion = small_library(2, 1, seed=5).motions[1]
    for name in ("forest", "gmm"):
        read, kept = loaded.classifier(name), trained().classifier(name)
        for q, t_s in zip(motion.q, motion.t_s, strict=True):
            one, other = read.update(q, t_s), kept.update(q, t_s)
            np.testing.assert_array_equal(one.probability, other.probability)
            assert one.unknown == other.unknown
        if isinstance(read, ForestClassifier) and isinstance(kept, ForestClassifier):
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
        with pytest.raises(ModelFileError, match="not an archive of arrays, or damaged"):
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
    path = rewritten(saved, tmp_path / "model.npz", gmm__weights=np.array([{"code": "run me"}], dtype=object))
    with pytest.raises(ModelFileError, match="gmm/weights"):
        load_model(path, HUMAN)
    with zipfile.ZipFile(saved) as archive:
        for name in archive.namelist():
            np.load(io.BytesIO(archive.read(name)), allow_pickle=False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "something else"}, "wanted a humanpred_ros trained model"),
        ({"format_version": 1}, "wanted format version 3, got 1"),
        ({"human_signature": "0" * 64}, "made for another human"),
        ({"library__dof_names": [f"joint{i}" for i in range(12)]}, "parts do not fit"),
        ({"library__dof_names": ["PelvisTransX"]}, "parts do not fit"),
        ({"library__labels": "ab"}, "parts do not fit"),
        ({"library__provenance": 3}, "parts do not fit"),
        ({"library__q": np.zeros((7, 12))}, "parts do not fit"),
        ({"library__first": np.zeros(7, dtype=np.int64)}, "parts do not fit"),
        ({"library": []}, "parts do not fit"),
        ({"classifiers": {"gmm": {"n_components": 3, "no_such_setting": 1}}}, "no_such_setting"),
        ({"classifiers": {"gmm": {"n_components": 4}}}, "wanted 4 components"),
        ({"classifiers": {"gmm": {"n_components": 3, "window_frames": 10**9}}}, "window_frames"),
        ({"classifiers": {"forest": {"n_trees": 10**9}}}, "n_trees"),
        ({"classifiers": {"forest": {}}}, "wanted 100 trees"),
        ({"classifiers": {"svm": {}}}, "wanted one of forest, gmm.*svm"),
        ({"classifiers": 3}, "parts do not fit"),
        ({"gmm__labels": np.zeros(2, dtype=np.int64)}, "parts do not fit"),
        ({"gmm__weights": np.ones((2, 3))}, "parts do not fit"),
        ({"gmm__covariances": np.zeros((2, 3, 13, 13))}, "parts do not fit"),
        ({"gmm__expected_q": np.zeros((2, 99, 12))}, "expected motions"),
        ({"gmm__nominal_duration_s": np.zeros(3)}, "parts do not fit"),
        ({"gmm__means": np.full((2, 3, 13), np.nan)}, "gmm/means.*finite"),
        ({"gmm__means": np.full((2, 3, 13), 1e200)}, "gmm/means.*up to 1e"),
        ({"forest__calibration": np.zeros(4)}, "parts do not fit"),
        ({"forest__novelty": np.zeros(5)}, "novelty"),
        ({"forest__place_spread": np.zeros(3)}, "parts do not fit"),
        ({"forest__label": np.zeros(6, dtype=np.int64)}, "parts do not fit"),
        ({"forest__label": np.full(6, -1)}, "parts do not fit"),
        ({"forest__first": np.arange(7)}, "parts do not fit"),
        ({"forest__q": np.zeros((240, 11))}, "exemplars"),
        ({"forest__n_nodes": np.array([3])}, "parts do not fit"),
        ({"forest__n_nodes": np.full(7, -3)}, "parts do not fit"),
        ({"forest__node_left": np.zeros(10, dtype=np.int32)}, "parts do not fit"),
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

    monkeypatch.setattr(training.np, "savez", disk_full)
    other = replace(trained(), library=small_library(2, 2))
    with pytest.raises(ModelFileError, match="no space left"):
        save_model(other, path)
    assert path.read_bytes() == saved.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["model.npz"]


def test_folders_are_made_and_impossible_places_named(tmp_path: Path) -> None:
    save_model(trained(), tmp_path / "new" / "folder" / "model.npz")
    assert load_model(tmp_path / "new" / "folder" / "model.npz", HUMAN).library.labels == ("0", "10")
    (tmp_path / "file").write_text("")
    with pytest.raises(ModelFileError, match="cannot be made"):
        save_model(trained(), tmp_path / "file" / "model.npz")


def test_loading_stays_light(saved: Path) -> None:
    """A node that loads a model starts without the plotting and learning packages."""
    code = (
        "import sys; from humanpred_ros.human.model import HumanModel; "
        "from humanpred_ros.recognition.training import load_model; "
        "from humanpred_ros.occupancy.predictor import predictor_type; predictor_type('forecast'); "
        f"load_model({str(saved)!r}, HumanModel.kinect12()); "
        "print([m for m in ('sklearn', 'matplotlib') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=REPOSITORY, check=False)
    assert (result.returncode, result.stdout.strip()) == (0, "[]"), result.stderr


@pytest.mark.parametrize(("node", "to"), [("left", 0), ("right", 10**6), ("feature", 48)])
def test_trees_that_lead_nowhere_or_in_circles_are_refused(tmp_path: Path, saved: Path, node: str, to: int) -> None:
    with np.load(saved) as archive:
        array = archive[f"forest/node_{node}"].copy()
        array[int(np.argmax(archive["forest/node_feature"] >= 0))] = to
    with pytest.raises(ModelFileError, match="parts do not fit"):
        load_model(rewritten(saved, tmp_path / "model.npz", **{f"forest__node_{node}": array}), HUMAN)


@pytest.mark.parametrize("shape", ["(1000000000000,)", "(2, 4)", "(-1, 3)"])
def test_an_array_that_declares_more_than_the_file_holds_is_refused(saved: Path, tmp_path: Path, shape: str) -> None:
    path = tmp_path / "model.npz"
    with zipfile.ZipFile(saved) as old, zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "gmm/weights.npy":
                data = data.replace(b"'shape': (2, 3), ", f"'shape': {shape}, ".encode().ljust(17), 1)
            new.writestr(name, data)
    with pytest.raises(ModelFileError, match="gmm/weights"):
        load_model(path, HUMAN)


def test_a_compressed_archive_is_refused(saved: Path, tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    with zipfile.ZipFile(saved) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    with pytest.raises(ModelFileError, match="uncompressed"):
        load_model(path, HUMAN)


class Odd(ForestClassifier):
    def state(self) -> dict[str, np.ndarray]:
        return {"when": np.array(["2024-01-01"], dtype="datetime64[s]")}


def test_what_a_file_cannot_hold_is_refused_when_it_is_written(tmp_path: Path) -> None:
    with pytest.raises(ModelFileError, match=r"classifier odd, when: wanted .* got datetime64"):
        save_model(replace(trained(), classifiers={"odd": Odd(HUMAN)}), tmp_path / "model.npz")
    assert not list(tmp_path.iterdir())


def test_a_model_is_found_again_by_what_it_was_trained_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library, forest = small_library(2, 3), {"forest": ForestSettings(n_trees=5)}
    first = model_of(library, HUMAN, forest, folder=tmp_path)
    assert_same(load_model(first, HUMAN), train_model(library, HUMAN, forest))
    with monkeypatch.context() as patched:
        patched.setattr(training, "train_model", None)  # not trained again
        assert model_of(small_library(2, 3), HUMAN, forest, folder=tmp_path) == first
    others = [
        model_of(library.select(lambda m: m.name != "0/1"), HUMAN, forest, folder=tmp_path),
        model_of(library, HUMAN, {"forest": ForestSettings(n_trees=6)}, folder=tmp_path),
        model_of(library, HUMAN, {}, folder=tmp_path),
    ]
    assert len({first, *others}) == 4
    first.write_bytes(b"damaged")
    assert load_model(model_of(library, HUMAN, forest, folder=tmp_path), HUMAN).library.labels == ("0", "10")


def test_only_the_latest_models_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "_KEPT_MODELS", 2)
    paths = []
    for k in range(3):
        paths.append(model_of(small_library(2, 2, seed=k), HUMAN, {}, folder=tmp_path))
        os.utime(paths[-1], (1000.0 + k, 1000.0 + k))
    model_of(small_library(2, 2, seed=1), HUMAN, {}, folder=tmp_path)  # used again
    model_of(small_library(2, 2, seed=5), HUMAN, {}, folder=tmp_path)
    assert paths[1].exists()
    assert not paths[0].exists()
    assert not paths[2].exists()
