"""The offline stage hands the online stage one file: written whole or not at all, refused unless it fits.

Format: a NumPy .npz archive without pickled objects, stored uncompressed (every member has a CRC). `metadata` is
JSON in UTF-8 bytes; the other members are arrays, classes first: `weights` (C, K), `means` (C, K, F), `covariances`
(C, K, F, F), `regressed_q` (C, N, D), `goals_m` (C, 3). Those of the reach forest begin with `forest_` and are named
after the attributes they hold (`forest_file`). The same model gives the same bytes.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import HumanPredError, ModelFileError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.recognition.class_mixtures import ClassMixtures
from humanpred_ros.recognition.forest_file import forest_arrays, forest_metadata, read_forest
from humanpred_ros.recognition.gmm_config import GmmSettings
from humanpred_ros.recognition.mixture import GaussianMixture
from humanpred_ros.recognition.training import TrainedModel, train_model

__all__ = ["FORMAT_VERSION", "TrainedModel", "load_model", "save_model", "train_model"]

FORMAT = "humanpred_ros trained model"
#: Raised whenever a reader of the old version would misread the new.
FORMAT_VERSION = 2

#: Whatever zipfile and NumPy raise on bytes that are not an archive they wrote.
_UNREADABLE = (
    OSError, EOFError, KeyError, TypeError, ValueError, RuntimeError, NotImplementedError, OverflowError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def save_model(model: TrainedModel, path: str | Path) -> None:
    """Write a model file; a reader sees the old file or the new one, never a part.

    Raises:
        ModelFileError: the file cannot be written.
    """
    path = Path(path)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # same folder: a rename is atomic only within a disk
    mixtures = model.classes.mixtures
    arrays: dict[str, NDArray[Any]] = {
        "metadata": np.frombuffer(json.dumps(_metadata(model), indent=1).encode(), dtype=np.uint8),
        "weights": np.stack([mixture.weights for mixture in mixtures]),
        "means": np.stack([mixture.means for mixture in mixtures]),
        "covariances": np.stack([mixture.covariances for mixture in mixtures]),
        "regressed_q": model.regressed_q,
        "goals_m": model.goals_m,
        **forest_arrays(model.forest),
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with part.open("wb") as file:
                np.savez(file, allow_pickle=False, **arrays)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as trouble:
        raise ModelFileError(f"model file {path}: could not be written ({trouble}); choose another place") from trouble


def load_model(path: str | Path, human: HumanModel) -> TrainedModel:
    """Read a model file for a human.

    Raises:
        ModelFileError: missing, unreadable, damaged, of another format version, or made for another human.
    """
    path = Path(path)
    metadata, arrays = _read(path)
    if metadata.get("format") != FORMAT:
        raise ModelFileError(
            f"model file {path}: wanted a {FORMAT}, got {metadata.get('format')!r}; make one with `humanpred train`"
        )
    if metadata.get("format_version") != FORMAT_VERSION:
        raise ModelFileError(
            f"model file {path}: wanted format version {FORMAT_VERSION}, got {metadata.get('format_version')} written "
            f"by version {metadata.get('package_version')} of this package; train the model again"
        )
    try:
        model = _model(metadata, arrays)
    except (HumanPredError, KeyError, TypeError, ValueError, AttributeError) as trouble:
        raise ModelFileError(f"model file {path}: its parts do not fit ({trouble}); train the model again") from trouble
    if model.human_signature != human.signature:
        raise ModelFileError(
            f"model file {path}: made for another human (signature {model.human_signature[:12]}), wanted {human.name} "
            f"({human.signature[:12]}); use the human it was made for, or train the model again"
        )
    try:
        human.check_dofs(model.dof_names)
    except HumanPredError as trouble:
        raise ModelFileError(f"model file {path}: its DoFs do not fit ({trouble})") from trouble
    return model


def _metadata(model: TrainedModel) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "package_version": model.package_version,
        "config": model.config.model_dump(),
        "forest": forest_metadata(model.forest),
        "labels": model.labels,
        "motions_per_class": model.classes.motions_per_class,
        "dof_names": model.dof_names,
        "nominal_duration_s": model.classes.nominal_duration_s,
        "frame_id": model.frame_id,
        "human_signature": model.human_signature,
        "library_name": model.library_name,
        "library_provenance": dict(model.library_provenance),
        "training_motions": model.training_motions,
    }


def _read(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    try:
        data = path.read_bytes()
    except OSError as trouble:
        raise ModelFileError(
            f"model file {path}: could not be read ({trouble}); make one with `humanpred train`"
        ) from trouble
    try:
        # All checksums first: NumPy believes an array's header before it has seen the array.
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            damaged = archive.testzip()
        if damaged is not None:
            raise ValueError(f"checksum of {damaged} is wrong")
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        metadata = json.loads(arrays.pop("metadata").tobytes().decode())
        if not isinstance(metadata, dict):
            raise ValueError("metadata is no JSON object")
    except _UNREADABLE as trouble:
        raise ModelFileError(
            f"model file {path}: not a model file, or damaged ({trouble}); make one with `humanpred train`"
        ) from trouble
    return metadata, arrays


def _model(metadata: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> TrainedModel:
    classes = ClassMixtures(
        tuple(int(label) for label in metadata["labels"]),
        tuple(
            GaussianMixture(*parts)
            for parts in zip(arrays["weights"], arrays["means"], arrays["covariances"], strict=True)
        ),
        tuple(int(n) for n in metadata["motions_per_class"]),
        tuple(str(name) for name in metadata["dof_names"]),
        float(metadata["nominal_duration_s"]),
    )
    return TrainedModel(
        GmmSettings(**metadata["config"]),
        classes,
        arrays["regressed_q"],
        arrays["goals_m"],
        str(metadata["frame_id"]),
        str(metadata["human_signature"]),
        str(metadata["library_name"]),
        read_forest(metadata["forest"], arrays),
        {str(key): str(value) for key, value in metadata["library_provenance"].items()},
        tuple(str(name) for name in metadata["training_motions"]),
        str(metadata["package_version"]),
    )
