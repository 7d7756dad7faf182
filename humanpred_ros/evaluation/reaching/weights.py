"""Learned weights side by side: P2's Table I and Fig. 10 as far as they are about weights.

All weights here belong to the same features with the same scales, and the published ones to the same bounds, so they
can be compared as they stand. What a weight means for a reach depends on how much its feature varies, though, and
costs have no unit; so every column is also given as influence: weight times the standard deviation of its feature over
samples around the demonstrations, as a share of the sum over all features.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from humanpred_ros.evaluation.reaching.learned import ALONE, IMPROVED, LEARNING, PUBLISHED, LearnedWeights
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.demonstrations import demonstrations
from humanpred_ros.reaching.features import FEATURE_NAMES, NAMED_WEIGHTS, ReachFeatures
from humanpred_ros.reaching.piirl import contrasts

#: Samples of each demonstration that say how much a feature varies.
_N_SAMPLES = 200


@dataclass(frozen=True, eq=False)
class WeightColumn:
    """One set of weights.

    Attributes:
        name, description: which.
        weights: (24,) of `FEATURE_NAMES`.
        spread: (24,) standard deviation, of what `description` says; None where it is not known.
        at_upper: names of the weights that their bound stopped.
        influence: (24,) shares that sum to 1.
    """

    name: str
    description: str
    weights: FloatArray
    spread: FloatArray | None
    at_upper: tuple[str, ...]
    influence: FloatArray


@dataclass(frozen=True, eq=False)
class LeftOutWeights:
    """P2's Fig. 10: weights learned leaving out one recording after the other.

    Attributes:
        how: one of `LEARNING`.
        recordings: which was left out.
        weights: (R, 24).
        influence: (R, 24) shares; each row sums to 1.
    """

    how: str
    recordings: tuple[str, ...]
    weights: FloatArray
    influence: FloatArray


@dataclass(frozen=True, eq=False)
class WeightFigures:
    """Everything about weights.

    Attributes:
        features: names, in the order of all arrays.
        deviation: (24,) standard deviation of each feature over samples around the demonstrations.
        upper: bound of P2's weights.
        columns: side by side.
        left_out: of each way to learn that was asked for.
        provenance: what weights from all recordings were learned from, and how, by way.
        notes: what learning had to say about the recordings, by way.
        learn_s, processor_s: time to learn from all recordings, and processor time, by way.
    """

    features: tuple[str, ...]
    deviation: FloatArray
    upper: float
    columns: tuple[WeightColumn, ...]
    left_out: tuple[LeftOutWeights, ...]
    provenance: Mapping[str, Mapping[str, Any]]
    notes: Mapping[str, tuple[str, ...]]
    learn_s: Mapping[str, float]
    processor_s: Mapping[str, float]


def weight_figures(
    learned: Mapping[str, LearnedWeights], recordings: Sequence[ReachRecording], model: HumanModel, seed: int
) -> WeightFigures:
    """Return the figures of weights that were learned, by the names of `LEARNING`, beside the published ones."""
    deviation = feature_deviation(recordings, model, seed)
    columns = []
    for how, text in (
        (PUBLISHED, "P2's way, all recordings"),
        (IMPROVED, "smoothness only, features normalised, no jumps"),
    ):
        if how in learned:
            everything = learned[how].everything
            columns.append(
                WeightColumn(
                    how, f"{text}, ± over {len(everything.bootstrap)} bootstrap draws of them",
                    everything.weights, everything.spread, everything.at_upper,
                    influence(everything.weights, deviation),
                )
            )  # fmt: skip
    if ALONE in learned:
        each = np.array(list(learned[ALONE].table.alone.values()))
        columns.append(
            WeightColumn(
                ALONE, f"P2's way, from one whole recording each; mean ± over {len(each)} recordings",
                each.mean(axis=0), each.std(axis=0), (), influence(each.mean(axis=0), deviation),
            )
        )  # fmt: skip
    for name, text in (("authors_static", "without cuts"), ("authors_dynamic", "with cuts")):
        weights = NAMED_WEIGHTS[name]
        columns.append(
            WeightColumn(
                name, f"learned by P2's authors from one of the seven each, {text}; mean", weights, None, (),
                influence(weights, deviation),
            )
        )  # fmt: skip
    return WeightFigures(
        features=FEATURE_NAMES,
        deviation=deviation,
        upper=LEARNING[PUBLISHED].piirl.upper,
        columns=tuple(columns),
        left_out=tuple(
            _left_out(how, entry, deviation) for how, entry in learned.items() if how in (PUBLISHED, IMPROVED)
        ),
        provenance={how: entry.everything.provenance for how, entry in learned.items()},
        notes={how: entry.notes for how, entry in learned.items()},
        learn_s={how: entry.learn_s for how, entry in learned.items()},
        processor_s={how: entry.processor_s for how, entry in learned.items()},
    )


def influence(weights: FloatArray, deviation: FloatArray) -> FloatArray:
    """Return how much of a cost's variation is due to each feature: shares (24,); zeros for weights of zero."""
    moved = weights * deviation
    total = float(moved.sum())
    shares: FloatArray = moved / total if total > 0.0 else np.zeros_like(moved)
    return shares


def feature_deviation(recordings: Sequence[ReachRecording], model: HumanModel, seed: int) -> FloatArray:
    """Return the standard deviation (24,) of each feature over samples around whole recordings."""
    features = ReachFeatures(model)
    sampling = LEARNING[PUBLISHED].sampling.replaced(n_samples=_N_SAMPLES)
    found = contrasts(
        demonstrations(recordings, features, keep_unfit=True), features, sampling, np.random.default_rng([seed, 2])
    )
    squares = np.mean([contrast.differences.var(axis=0) for contrast in found], axis=0)
    deviation: FloatArray = np.sqrt(squares)
    return deviation


def _left_out(how: str, entry: LearnedWeights, deviation: FloatArray) -> LeftOutWeights:
    weights = np.array(list(entry.table.left_out.values()))
    return LeftOutWeights(
        how, tuple(entry.table.left_out), weights, np.array([influence(row, deviation) for row in weights])
    )
