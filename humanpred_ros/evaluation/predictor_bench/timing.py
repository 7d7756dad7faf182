"""How updates are timed: single calls, one after the other, of whatever takes postures."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import Motion
from humanpred_ros.occupancy.predictor import Predictor
from humanpred_ros.recognition.classifier import Classifier

#: Postures fed before anything is timed: caches and the processor's clock settle.
_WARM_UP = 30


@dataclass(frozen=True)
class Timing:
    """Median and 99th percentile of `n` calls, microseconds."""

    median_us: float
    p99_us: float
    n: int

    @classmethod
    def of(cls, seconds: Sequence[float]) -> Timing:
        """Return the figures of durations in seconds (UsageError if there are none)."""
        if not len(seconds):
            raise UsageError("bench: wanted at least one call timed, got none; play more motions")
        median, p99 = np.quantile(np.asarray(seconds) * 1e6, (0.5, 0.99))
        return cls(float(median), float(p99), len(seconds))


def update_seconds(
    subject: Predictor | Classifier, motions: Sequence[Motion], n_frames: int | None = None
) -> list[float]:
    """Return how long each `update` took, in seconds, over motions that are each started anew.

    Args:
        subject: what is timed.
        motions: at least one.
        n_frames: only so many first postures of each; None for all.
    """
    for q, t_s in _postures(motions[0], _WARM_UP):
        subject.update(q, t_s)
    seconds = []
    gc.collect()
    for motion in motions:
        subject.start()
        for q, t_s in _postures(motion, n_frames):
            begin = time.perf_counter()
            subject.update(q, t_s)
            seconds.append(time.perf_counter() - begin)
    return seconds


def _postures(motion: Motion, n_frames: int | None) -> Iterable[tuple[FloatArray, float]]:
    return zip(motion.q[:n_frames], motion.t_s[:n_frames].tolist(), strict=True)
