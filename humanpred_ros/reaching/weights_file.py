"""Learned weights as a file that people can read: JSON with names, scales, spread and provenance.

A weight means nothing without the feature it is of and the scale of that feature, so both are in the file, and a file
of other features is refused.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros.errors import HumanPredError, ModelFileError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, SCALES
from humanpred_ros.reaching.learner import ReachWeights

FORMAT = "humanpred_ros reach weights"
FORMAT_VERSION = 2


def save_weights(weights: ReachWeights, path: str | Path) -> None:
    """Write the weights; a reader sees the old file or the new one, never a part.

    Raises:
        ModelFileError: the file cannot be written, or the provenance cannot be said in JSON.
    """
    path = Path(path)
    known = len(weights.bootstrap) > 1
    value = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "weights": _named(weights.weights),
        "spread": _named(weights.spread) if known else None,  # for people; it follows from the bootstrap
        "scales": _named(SCALES),
        "at_upper": list(weights.at_upper),
        "provenance": dict(weights.provenance),
        "bootstrap": weights.bootstrap.tolist(),
    }
    try:
        text = json.dumps(value, indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError) as trouble:
        raise ModelFileError(
            f"weights {path}: wanted a provenance of finite numbers, text, lists and mappings, it is not ({trouble}); "
            "correct it"
        ) from trouble
    try:
        part = path.with_name(f".{path.name}.{os.getpid()}.part")  # same folder: a rename is atomic only within a disk
        try:
            part.write_text(text, encoding="utf-8")
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except (OSError, ValueError) as trouble:  # ValueError: a path without a name
        raise ModelFileError(f"weights {path}: could not be written ({trouble}); choose another place") from trouble


def load_weights(path: str | Path) -> ReachWeights:
    """Return the weights of a file; they read back as the same numbers.

    Raises:
        ModelFileError: missing, unreadable, of another format or version, or for features of other names or scales.
    """
    path = Path(path)
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ValueError, RecursionError) as trouble:
        raise ModelFileError(
            f"weights {path}: could not be read ({trouble}); check the path, or learn them again"
        ) from trouble
    if not isinstance(value, dict) or value.get("format") != FORMAT or value.get("format_version") != FORMAT_VERSION:
        came = [value.get("format"), value.get("format_version")] if isinstance(value, dict) else type(value).__name__
        raise ModelFileError(
            f"weights {path}: wanted a file of {FORMAT}, version {FORMAT_VERSION}, got {came!r:.80}; learn them again"
        )
    weights, scales = (_numbers(path, what, value.get(what)) for what in ("weights", "scales"))
    if (other := np.flatnonzero(np.abs(scales - SCALES) > 1e-12 * SCALES)).size:
        k = int(other[0])
        raise ModelFileError(
            f"weights {path}: wanted features of this version's scales, {FEATURE_NAMES[k]} has {scales[k]:g} there and "
            f"{SCALES[k]:g} here; learn them again"
        )
    try:
        bootstrap = np.array(value["bootstrap"], dtype=np.float64)
        return ReachWeights(
            weights=weights,
            bootstrap=bootstrap if bootstrap.size else np.zeros((0, N_FEATURES)),
            at_upper=tuple(str(name) for name in value["at_upper"]),
            provenance=dict(value["provenance"]),
        )
    except (HumanPredError, KeyError, TypeError, ValueError) as trouble:
        raise ModelFileError(f"weights {path}: its parts do not fit ({trouble}); learn them again") from trouble


def _named(values: FloatArray) -> dict[str, float]:
    return dict(zip(FEATURE_NAMES, values.tolist(), strict=True))


def _numbers(path: Path, what: str, named: Any) -> FloatArray:
    """Return the numbers (24,) of a mapping from features' names, whatever its order."""
    if not isinstance(named, Mapping) or set(named) != set(FEATURE_NAMES):
        names = set(named) if isinstance(named, Mapping) else set()
        lacking = [name for name in FEATURE_NAMES if name not in names]
        unknown = sorted(str(name) for name in names - set(FEATURE_NAMES))
        said = f"lacking: {', '.join(lacking) or 'none'}; unknown: {', '.join(unknown) or 'none'}"
        raise ModelFileError(
            f"weights {path}: wanted {what} of the {N_FEATURES} features of this version ({said}); learn them again"
        )
    values = [named[name] for name in FEATURE_NAMES]
    for name, value in zip(FEATURE_NAMES, values, strict=True):
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
            raise ModelFileError(
                f"weights {path}: wanted finite {what}, got {value!r:.40} for {name}; learn them again"
            )
    return np.array(values, dtype=np.float64)
