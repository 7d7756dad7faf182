"""When a recorded motion really begins and ends, and what a standing person looks like to the tracker.

The true onset and end are found from the whole recording, smoothed without delay; they depend on nothing but the speed
of the palm. An online detector, which sees the past only, is measured against them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, median_filter

from humanpred_ros.errors import LibraryFormatError, MotionError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, unwrap_angles

PALM = "right_palm"
#: Rate at which the palm is looked at, whatever the stamps.
_GRID_HZ = 120.0
#: Window of the running median that takes out single mistracked frames, and standard deviation of the Gaussian that
#: smooths the palm's path.
_MEDIAN_S, _SMOOTH_S = 0.10, 0.04
#: A motion begins where the speed rises above this share of its first peak, and ends where it falls below this share of
#: its last one; but at this speed or more: a palm at rest seems to move at 0.07 m/s (library_b) or 0.1 m/s (library_a)
#: on the median after this smoothing, because of the sensor's noise.
_SPEED_SHARE, _LEAST_SPEED_MPS = 0.10, 0.10
#: A peak is a greatest speed within its surroundings of at least this share of the motion's greatest. Not more: in
#: mistracked motions the greatest is a jump in mid-motion.
_PEAK_SHARE = 0.25
#: Noise is taken from this much of each motion's beginning at most, and not from later than this before its onset.
REST_S, MARGIN_S = 0.30, 0.10
#: Shorter rests are not used, nor those in which the palm's smoothed speed exceeds this: there the person still moves
#: from before the recording. Frames that the tracker got wrong do not show in it, and stay.
_LEAST_FRAMES, _STILL_MPS = 5, 0.20
#: The noise of one round is drawn from so many rests at least.
_LEAST_RESTS = 6
#: Standard deviations of the slow wandering and turning of the pelvis, in metres and radians, and its frequencies. Own
#: judgement, about twice what a person in quiet standing shows: recorded rests are too short to hold it.
_SWAY = {"PelvisTransX": 0.010, "PelvisTransY": 0.010, "PelvisRotZ": 0.02}
_SWAY_HZ = (0.05, 0.5)


@dataclass(frozen=True)
class Span:
    """When something moved."""

    onset_s: float  #: in the motion's own stamps; the first and last stamp if it moved there already or still
    end_s: float
    peak_mps: float  #: greatest speed of the palm


def motion_span(t_s: FloatArray, palm_m: FloatArray) -> Span:
    """Return when the palm moved, from its positions (T, 3) at stamps (T,), by its tangential speed.

    Before and after, it is taken to rest. Raises MotionError as `palm_speed`.
    """
    grid, speed = _smoothed(t_s, palm_m)
    inner = speed[1:-1]
    is_peak = (inner >= speed[:-2]) & (inner > speed[2:]) & (inner >= _PEAK_SHARE * speed.max())
    peaks = np.flatnonzero(is_peak) + 1
    first, last = (int(peaks[0]), int(peaks[-1])) if len(peaks) else (int(speed.argmax()), int(speed.argmax()))
    slow = speed < max(_SPEED_SHARE * speed[first], _LEAST_SPEED_MPS)
    before = np.flatnonzero(slow[:first])
    onset = grid[before[-1] + 1] if len(before) else grid[0]
    slow = speed < max(_SPEED_SHARE * speed[last], _LEAST_SPEED_MPS)
    after = np.flatnonzero(slow[last:])
    end = grid[last + after[0]] if len(after) else grid[-1]
    bounds = np.clip([onset, end], t_s[0], t_s[-1])
    return Span(float(bounds[0]), float(bounds[1]), float(speed.max()))


def palm_speed(t_s: FloatArray, palm_m: FloatArray) -> FloatArray:
    """Return the palm's smoothed speed (T,) at stamps (T,), from its positions (T, 3).

    Raises:
        MotionError: fewer than two frames, wrong shapes, or stamps that do not increase.
    """
    grid, speed = _smoothed(t_s, palm_m)
    at_frames: FloatArray = np.interp(t_s, grid, speed)
    return at_frames


def _smoothed(t_s: FloatArray, palm_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an even grid of times, a little longer than the motion on both sides, and the speed there."""
    t_s = checked("t_s", t_s, ("T",), error=MotionError)
    palm = checked("palm_m", palm_m, (len(t_s), 3), error=MotionError)
    if len(t_s) < 2 or (np.diff(t_s) <= 0).any():
        raise MotionError(
            f"span: wanted 2 frames or more with increasing stamps, got {len(t_s)} frames; check the recording"
        )
    step_s = 1.0 / _GRID_HZ
    margin = 4 * round(_SMOOTH_S / step_s) + round(_MEDIAN_S / step_s)
    n = int(np.ceil((t_s[-1] - t_s[0]) / step_s)) + 1
    grid: FloatArray = t_s[0] + step_s * np.arange(-margin, n + margin)
    path = np.column_stack([np.interp(grid, t_s, palm[:, axis]) for axis in range(3)])
    window = 2 * round(0.5 * _MEDIAN_S / step_s) + 1
    path = median_filter(path, size=(window, 1), mode="nearest")
    path = gaussian_filter1d(path, _SMOOTH_S / step_s, axis=0, mode="nearest")
    speed: FloatArray = np.linalg.norm(np.gradient(path, step_s, axis=0), axis=1)
    return grid, speed


@dataclass(frozen=True)
class Rest:
    """A stretch of a recording in which the person stood still."""

    index: int  #: number of the motion within its class: in libraries recorded round by round, the round
    step_s: FloatArray  #: (n,) time from the frame before to each frame
    deviation: FloatArray  #: (n, D) postures less the straight line through them: their drift is part of the sway


@dataclass(frozen=True)
class StandingNoise:
    """Draws the deviations of a standing person from the posture that the person stands in.

    A block bootstrap: whole recorded rests follow each other in random order, forwards or backwards, with their
    mistracked frames and at their own stamps. Where two of them meet, the deviation jumps as much as the noise does
    (that is harder on a detector than the real thing). Slow sway of the whole body is added.
    """

    rests: tuple[Rest, ...]  #: from which noise is drawn
    dof_names: tuple[str, ...]  #: of the postures' columns
    sway: float = 1.0  #: factor of the sway

    def near(self, index: int) -> StandingNoise:
        """Return the noise of one recording round: its own rests, or, until there are enough, the nearest rounds'.

        What a sensor gets wrong depends on who stands where, so a stream should not mix rounds.
        """
        away = sorted({abs(rest.index - index) for rest in self.rests})
        for reach in away:
            rests = tuple(rest for rest in self.rests if abs(rest.index - index) <= reach)
            if len(rests) >= _LEAST_RESTS:
                break
        return replace(self, rests=rests)

    def draw(self, duration_s: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return stamps (n,) that start one step after 0 and end before `duration_s`, and deviations (n, D)."""
        steps, deviations, reached_s = [], [], 0.0
        while reached_s < duration_s:
            rest = self.rests[int(rng.integers(len(self.rests)))]
            way = 1 if rng.random() < 0.5 else -1
            steps.append(rest.step_s[::way])
            deviations.append(rest.deviation[::way])
            reached_s += float(rest.step_s.sum())
        t_s = np.cumsum(np.concatenate(steps))
        within = t_s < duration_s
        t_s = t_s[within]
        return t_s, np.concatenate(deviations)[within] + self._sway(t_s, duration_s, rng)

    def _sway(self, t_s: FloatArray, duration_s: float, rng: np.random.Generator) -> FloatArray:
        """Return (n, D) slow movements of the pelvis that fade in and out, so that the ends fit what surrounds them."""
        fade_s = min(1.0, 0.5 * duration_s)
        fade = np.clip(np.minimum(t_s, duration_s - t_s) / fade_s, 0.0, 1.0)
        fade = fade**2 * (3.0 - 2.0 * fade)
        sway = np.zeros((len(t_s), len(self.dof_names)))
        n_waves = 5
        for d, name in enumerate(self.dof_names):
            if name in _SWAY:
                hz = rng.uniform(*_SWAY_HZ, size=n_waves)
                phase = rng.uniform(0.0, 2.0 * np.pi, size=n_waves)
                waves = np.sin(2.0 * np.pi * hz * t_s[:, None] + phase).sum(axis=1)
                sway[:, d] = self.sway * _SWAY[name] * np.sqrt(2.0 / n_waves) * fade * waves
        return sway


def standing_noise(motions: Sequence[Motion], human: HumanModel) -> StandingNoise:
    """Return the noise of the rests with which motions begin.

    Raises:
        LibraryFormatError: no motion begins with a rest long enough.
    """
    rests = []
    for motion in motions:
        unwrapped = unwrap_angles(motion)
        palm = human.forward(unwrapped.q)["right_palm"]
        until_s = min(motion_span(motion.t_s, palm).onset_s - MARGIN_S, motion.t_s[0] + REST_S)
        n = int(np.searchsorted(motion.t_s, until_s))
        if n >= _LEAST_FRAMES and palm_speed(motion.t_s, palm)[:n].max() < _STILL_MPS:
            t_s, q = motion.t_s[:n], unwrapped.q[:n]
            line = median_slope(t_s, q) * (t_s - t_s[0])[:, None]
            steps = np.diff(t_s)
            rests.append(Rest(motion.index, np.append(steps, np.median(steps)), q - line - np.median(q - line, axis=0)))
    if not rests:
        raise LibraryFormatError(
            f"standing: wanted motions that begin with a rest of {_LEAST_FRAMES} frames or more, none of "
            f"{len(motions)} does; record from before the motion begins"
        )
    return StandingNoise(tuple(rests), motions[0].dof_names)


def median_slope(t_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return the median (D,) of the slopes between all pairs of rows (T, D): a few bad frames do not change it."""
    a, b = np.triu_indices(len(t_s), k=1)
    slope: FloatArray = np.median((values[b] - values[a]) / (t_s[b] - t_s[a])[:, None], axis=0)
    return slope
