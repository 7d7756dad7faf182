"""Learned weights as a file that people can read: JSON with names, spread and provenance."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from humanpred_ros.errors import HumanPredError, ModelFileError
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES
from humanpred_ros.reaching.learning import ReachWeights

FORMAT = "humanpred_ros reach weights"
FORMAT_VERSION = 1


def save_weights(weights: ReachWeights, path: str | Path) -> None:
    """Write the weights; a reader sees the old file or the new one, never a part.

    Raises:
        ModelFileError: the file cannot be written.
    """
    path = Path(path)
    value = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "weights": dict(zip(FEATURE_NAMES, weights.weights.tolist(), strict=True)),
        "bootstrap": weights.bootstrap.tolist(),
        "at_upper": list(weights.at_upper),
        "provenance": dict(weights.provenance),
    }
    part = path.with_name(f".{path.name}.{os.getpid()}.part")  # same folder: a rename is atomic only within a disk
    try:
        try:
            part.write_text(json.dumps(value, indent=1, allow_nan=False) + "\n", encoding="utf-8")
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as trouble:
        raise ModelFileError(f"weights {path}: could not be written ({trouble}); choose another place") from trouble


def load_weights(path: str | Path) -> ReachWeights:
    """Return the weights of a file; they read back as the same numbers.

    Raises:
        ModelFileError: missing, unreadable, of another format or version, or for other features.
    """
    path = Path(path)
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError) as trouble:
        raise ModelFileError(f"weights {path}: could not be read ({trouble}); learn them again") from trouble
    if not isinstance(value, dict) or value.get("format") != FORMAT or value.get("format_version") != FORMAT_VERSION:
        raise ModelFileError(f"weights {path}: wanted a file of {FORMAT}, version {FORMAT_VERSION}; learn them again")
    named = value.get("weights")
    if not isinstance(named, dict) or tuple(named) != FEATURE_NAMES:
        raise ModelFileError(f"weights {path}: wanted weights of the {N_FEATURES} features of this version, got others")
    try:
        return ReachWeights(
            weights=np.array([named[name] for name in FEATURE_NAMES], dtype=np.float64),
            bootstrap=np.array(value["bootstrap"], dtype=np.float64).reshape(-1, N_FEATURES),
            at_upper=tuple(str(name) for name in value["at_upper"]),
            provenance=dict(value["provenance"]),
        )
    except (HumanPredError, KeyError, TypeError, ValueError) as trouble:
        raise ModelFileError(f"weights {path}: its parts do not fit ({trouble}); learn them again") from trouble
