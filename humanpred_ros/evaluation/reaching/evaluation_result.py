"""The whole evaluation of predicted reaches: sets of recordings, weights, recovery of known weights, times, targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from humanpred_ros.evaluation.outputs import plain
from humanpred_ros.evaluation.reaching.recovery import RecoveryFigures
from humanpred_ros.evaluation.reaching.result import ReachingSet
from humanpred_ros.evaluation.reaching.timing import PredictionTime
from humanpred_ros.evaluation.reaching.weights import WeightFigures
from humanpred_ros.evaluation.target import Target


@dataclass(frozen=True)
class ReachingEvaluation:
    """The whole evaluation.

    Attributes:
        settings: everything the figures depend on.
        machine: what the times depend on.
        sets: the demonstrations, predicted leaving one out, and the interference case if it is there.
        table1: P2's Table I by recording, joint and task as coded.
        weights: learned ones, beside the published; None if nothing was learned.
        recovery: of known weights; None if it was left out.
        times: of one prediction, by itself.
        elapsed_s: from recordings to figures.
        targets: side by side.
    """

    settings: Mapping[str, Any]
    machine: Mapping[str, Any]
    sets: tuple[ReachingSet, ...]
    table1: Mapping[str, tuple[float, float]]
    weights: WeightFigures | None
    recovery: RecoveryFigures | None
    times: tuple[PredictionTime, ...]
    elapsed_s: float
    targets: tuple[Target, ...]

    def to_json(self) -> dict[str, Any]:
        """Return everything but the paths as plain values."""
        value: dict[str, Any] = plain(self)
        for entry in value["sets"]:
            del entry["wrist_m"]
            for predictor in entry["predictors"]:
                for recording in predictor["recordings"]:
                    del recording["wrist_m"]
        return value
