"""Learned weights of the features, and the JSON file that holds them with names, scales, spread and provenance.

A weight means nothing without its feature and the scale of that feature, so both are in the file, and a file of other
features is refused.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from humanpred_ros.errors import HumanPredError, ModelFileError, MotionError, UsageError
from humanpred_ros.files import read_json
from humanpred_ros.geometry.checks import FloatArray, checked, frozen
from humanpred_ros.reaching.features import FEATURE_NAMES, N_FEATURES, NAMED_WEIGHTS, SCALES
from humanpred_ros.resources import replacing

FORMAT, FORMAT_VERSION = "humanpred_ros reach weights", 2


@dataclass(frozen=True, eq=False)
class ReachWeights:
    """Learned weights of the features: immutable.

    Raises:
        MotionError: arrays of another shape, or negative weights.
    """

    weights: FloatArray  #: (24,) of `FEATURE_NAMES`
    #: (B, 24) weights learned from recordings drawn with replacement; their scatter says how certain a weight is. B is
    #: 0 if there was only one recording.
    bootstrap: FloatArray
    at_upper: tuple[str, ...]  #: names of the weights that were stopped by their bound; the data ask for larger ones
    provenance: Mapping[str, Any]  #: what was learned from, how, and by which version

    def __post_init__(self) -> None:
        weights = checked("weights", self.weights, (N_FEATURES,), error=MotionError)
        bootstrap = checked("bootstrap", self.bootstrap, ("B", N_FEATURES), error=MotionError)
        if (weights < 0.0).any() or (bootstrap < 0.0).any():
            raise MotionError(f"weights: wanted 0 or more, got {min(weights.min(), bootstrap.min(initial=0.0))}")
        if unknown := sorted(set(self.at_upper) - set(FEATURE_NAMES)):
            raise MotionError(f"weights at their bound: wanted names of features, got {', '.join(unknown)}")
        object.__setattr__(self, "weights", frozen(weights))
        object.__setattr__(self, "bootstrap", frozen(bootstrap))
        object.__setattr__(self, "at_upper", tuple(self.at_upper))
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @property
    def spread(self) -> FloatArray:
        """(24,) standard deviation over the bootstrap; NaN with fewer than two."""
        if len(self.bootstrap) < 2:
            return np.full(N_FEATURES, np.nan)
        spread: FloatArray = self.bootstrap.std(axis=0, ddof=1)
        return spread


def reach_weights(name_or_file: str) -> FloatArray:
    """Return (24,) weights of P2's cost: of a name in `NAMED_WEIGHTS`, or from a file of learned weights.

    Raises:
        UsageError: no such name, and no JSON file either.
        ModelFileError: a file that cannot be used.
    """
    if name_or_file in NAMED_WEIGHTS:
        return NAMED_WEIGHTS[name_or_file]
    if name_or_file.endswith(".json"):
        return load_weights(name_or_file).weights
    raise UsageError(
        f"reach weights: wanted one of {', '.join(NAMED_WEIGHTS)}, or a .json file of learned weights, "
        f"got {name_or_file!r}"
    )


class _WeightsFile(BaseModel):
    """What a file holds; weights, spread and scales by feature."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    format: Literal["humanpred_ros reach weights"]
    format_version: Literal[2]
    weights: dict[str, float]
    # For people; it follows from the bootstrap.
    spread: dict[str, float] | None
    scales: dict[str, float]
    at_upper: list[str]
    provenance: dict[str, Any]
    bootstrap: list[list[float]]


def save_weights(weights: ReachWeights, path: str | Path) -> None:
    """Write the weights; a reader sees the old file or the new one, never a part.

    Raises:
        ModelFileError: the file cannot be written, or the provenance cannot be written as JSON.
    """
    path = Path(path)
    named = [dict(zip(FEATURE_NAMES, row.tolist(), strict=True)) for row in (weights.weights, weights.spread, SCALES)]
    value = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "weights": named[0],
        "spread": named[1] if len(weights.bootstrap) > 1 else None,
        "scales": named[2],
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
    with replacing(path, ModelFileError) as part:
        part.write_text(text, encoding="utf-8")


def load_weights(path: str | Path) -> ReachWeights:
    """Return the weights of a file; they read back as the same numbers.

    Raises:
        ModelFileError: missing, unreadable, of another format or version, or for features of other names or scales.
    """
    path = Path(path)
    try:
        value = read_json(path, ModelFileError)
    except ModelFileError as trouble:
        raise ModelFileError(f"weights {trouble}; check the path, or learn them again") from trouble
    try:
        file = _WeightsFile.model_validate(value)
        weights, scales = (
            _in_order(what, named) for what, named in (("weights", file.weights), ("scales", file.scales))
        )
        if (other := np.flatnonzero(np.abs(scales - SCALES) > 1e-12 * SCALES)).size:
            k = int(other[0])
            raise ModelFileError(
                f"wanted features of this version's scales, {FEATURE_NAMES[k]} has {scales[k]:g} there and "
                f"{SCALES[k]:g} here"
            )
        bootstrap = np.array(file.bootstrap) if file.bootstrap else np.zeros((0, N_FEATURES))
        return ReachWeights(weights, bootstrap, tuple(file.at_upper), file.provenance)
    except ValidationError as trouble:
        first = trouble.errors()[0]
        where = " ".join(map(str, first["loc"]))
        raise ModelFileError(
            f"weights {path}: wanted a file of {FORMAT}, version {FORMAT_VERSION}; {where}: {first['msg']}, got "
            f"{first['input']!r:.80}; learn them again"
        ) from trouble
    except (HumanPredError, ValueError) as trouble:
        raise ModelFileError(f"weights {path}: {trouble}; learn them again") from trouble


def _in_order(what: str, named: Mapping[str, float]) -> FloatArray:
    """Return the numbers (24,) of a mapping from features' names, whatever its order."""
    if set(named) != set(FEATURE_NAMES):
        lacking = [name for name in FEATURE_NAMES if name not in named]
        raise ModelFileError(
            f"wanted {what} of the {N_FEATURES} features of this version (lacking: {', '.join(lacking) or 'none'}; "
            f"unknown: {', '.join(sorted(set(named) - set(FEATURE_NAMES))) or 'none'})"
        )
    return np.array([named[name] for name in FEATURE_NAMES], dtype=np.float64)
