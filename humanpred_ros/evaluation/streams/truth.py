"""When a recorded motion really begins and ends, told from all of it: what an online detector is measured against.

A detector sees the past only. Here the whole recording is known, smoothed without delay, and the answer depends on
nothing but how fast the palm moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, median_filter

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, checked


@dataclass(frozen=True)
class TruthConfig:
    """How onset and end are defined.

    Attributes:
        grid_hz: rate at which the palm is looked at, whatever the stamps.
        median_s: window of the running median that takes out single mistracked frames.
        smooth_s: standard deviation of the Gaussian that smooths the palm's path.
        speed_share: the motion begins where the speed rises above this share of its first peak, and ends where it
            falls below this share of its last one.
        least_speed_mps: but at this speed or more: a palm at rest seems to move at 0.07 m/s (library_b) or 0.1 m/s
            (library_a) on the median after this smoothing, because of the sensor's noise.
        peak_share: a peak is a greatest speed within its surroundings of at least this share of the motion's greatest.
            Not more: in mistracked motions the greatest is a jump in mid-motion.
    """

    grid_hz: float = 120.0
    median_s: float = 0.10
    smooth_s: float = 0.04
    speed_share: float = 0.10
    least_speed_mps: float = 0.10
    peak_share: float = 0.25


@dataclass(frozen=True)
class Span:
    """When something moved.

    Attributes:
        onset_s, end_s: in the motion's own stamps; the first and last stamp if it moved there already or still.
        peak_mps: greatest speed of the palm.
    """

    onset_s: float
    end_s: float
    peak_mps: float


def motion_span(t_s: FloatArray, palm_m: FloatArray, config: TruthConfig | None = None) -> Span:
    """Return when the palm moved, from its positions (T, 3) at stamps (T,), by its tangential speed.

    Before and after, it is taken to rest. Raises MotionError as `palm_speed`.
    """
    config = TruthConfig() if config is None else config
    grid, speed = _smoothed(t_s, palm_m, config)
    inner = speed[1:-1]
    is_peak = (inner >= speed[:-2]) & (inner > speed[2:]) & (inner >= config.peak_share * speed.max())
    peaks = np.flatnonzero(is_peak) + 1
    first, last = (int(peaks[0]), int(peaks[-1])) if len(peaks) else (int(speed.argmax()), int(speed.argmax()))
    slow = speed < max(config.speed_share * speed[first], config.least_speed_mps)
    before = np.flatnonzero(slow[:first])
    onset = grid[before[-1] + 1] if len(before) else grid[0]
    slow = speed < max(config.speed_share * speed[last], config.least_speed_mps)
    after = np.flatnonzero(slow[last:])
    end = grid[last + after[0]] if len(after) else grid[-1]
    bounds = np.clip([onset, end], t_s[0], t_s[-1])
    return Span(float(bounds[0]), float(bounds[1]), float(speed.max()))


def palm_speed(t_s: FloatArray, palm_m: FloatArray, config: TruthConfig | None = None) -> FloatArray:
    """Return the palm's smoothed speed (T,) at stamps (T,), from its positions (T, 3).

    Raises:
        MotionError: fewer than two frames, wrong shapes, or stamps that do not increase.
    """
    grid, speed = _smoothed(t_s, palm_m, TruthConfig() if config is None else config)
    at_frames: FloatArray = np.interp(t_s, grid, speed)
    return at_frames


def _smoothed(t_s: FloatArray, palm_m: FloatArray, config: TruthConfig) -> tuple[FloatArray, FloatArray]:
    """Return an even grid of times, a little longer than the motion on both sides, and the speed there."""
    t_s = checked("t_s", t_s, ("T",), error=MotionError)
    palm = checked("palm_m", palm_m, (len(t_s), 3), error=MotionError)
    if len(t_s) < 2 or (np.diff(t_s) <= 0).any():
        raise MotionError(
            f"span: wanted 2 frames or more with increasing stamps, got {len(t_s)} frames; check the recording"
        )
    step_s = 1.0 / config.grid_hz
    margin = 4 * round(config.smooth_s / step_s) + round(config.median_s / step_s)
    n = int(np.ceil((t_s[-1] - t_s[0]) / step_s)) + 1
    grid: FloatArray = t_s[0] + step_s * np.arange(-margin, n + margin)
    path = np.column_stack([np.interp(grid, t_s, palm[:, axis]) for axis in range(3)])
    window = 2 * round(0.5 * config.median_s / step_s) + 1
    path = median_filter(path, size=(window, 1), mode="nearest")
    path = gaussian_filter1d(path, config.smooth_s / step_s, axis=0, mode="nearest")
    speed: FloatArray = np.linalg.norm(np.gradient(path, step_s, axis=0), axis=1)
    return grid, speed
