"""How a standing person looks to the tracker: the noise of recorded rests, drawn anew for as long as one likes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.evaluation.streams.truth import motion_span, palm_speed
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, unwrap_angles


@dataclass(frozen=True)
class StandingConfig:
    """Where noise comes from and how a body sways.

    Attributes:
        rest_s: noise is taken from this much of each motion's beginning at most,
        margin_s: and not from later than this before its onset.
        least_frames: shorter rests are not used,
        still_mps: nor those in which the palm's smoothed speed (`palm_speed`) exceeds this: there the person still
            moves from before the recording. Frames that the tracker got wrong do not show in it, and stay.
        least_rests: one round's noise is drawn from so many rests at least.
        sway_m, sway_rad: standard deviation of the pelvis's slow wandering in x and y, and of its turning. Own
            judgement, about twice what a person in quiet standing shows: recorded rests are too short to hold it.
        sway_hz: sway is made of sinusoids with frequencies in this range.
    """

    rest_s: float = 0.30
    margin_s: float = 0.10
    least_frames: int = 5
    still_mps: float = 0.20
    least_rests: int = 6
    sway_m: float = 0.010
    sway_rad: float = 0.02
    sway_hz: tuple[float, float] = (0.05, 0.5)


@dataclass(frozen=True)
class Rest:
    """A stretch of a recording in which the person stood still.

    Attributes:
        index: number of the motion within its class: in libraries recorded round by round, the round.
        step_s: (n,) time from the frame before to each frame.
        deviation: (n, D) postures less the straight line through them: their drift is part of the sway.
    """

    index: int
    step_s: FloatArray
    deviation: FloatArray


@dataclass(frozen=True)
class StandingNoise:
    """Draws the deviations of a standing person from the posture that the person stands in.

    A block bootstrap: whole recorded rests follow each other in random order, forwards or backwards, with their
    mistracked frames and at their own stamps. Where two of them meet, the deviation jumps as much as the noise does
    (that is harder on a detector than the real thing). Slow sway of the whole body is added.
    """

    rests: tuple[Rest, ...]
    dof_names: tuple[str, ...]
    config: StandingConfig

    def near(self, index: int) -> StandingNoise:
        """Return the noise of one recording round: its own rests, or, until there are enough, the nearest rounds'.

        What a sensor gets wrong depends on who stands where, so a stream should not mix rounds.
        """
        away = sorted({abs(rest.index - index) for rest in self.rests})
        for reach in away:
            rests = tuple(rest for rest in self.rests if abs(rest.index - index) <= reach)
            if len(rests) >= self.config.least_rests:
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
        sizes = {"PelvisTransX": self.config.sway_m, "PelvisTransY": self.config.sway_m,
                 "PelvisRotZ": self.config.sway_rad}  # fmt: skip
        sway = np.zeros((len(t_s), len(self.dof_names)))
        n_waves = 5
        for d, name in enumerate(self.dof_names):
            if name in sizes:
                hz = rng.uniform(*self.config.sway_hz, size=n_waves)
                phase = rng.uniform(0.0, 2.0 * np.pi, size=n_waves)
                waves = np.sin(2.0 * np.pi * hz * t_s[:, None] + phase).sum(axis=1)
                sway[:, d] = sizes[name] * np.sqrt(2.0 / n_waves) * fade * waves
        return sway


def standing_noise(motions: Sequence[Motion], human: HumanModel, config: StandingConfig | None = None) -> StandingNoise:
    """Return the noise of the rests with which motions begin.

    Raises:
        LibraryFormatError: no motion begins with a rest long enough.
    """
    config = StandingConfig() if config is None else config
    rests = []
    for motion in motions:
        unwrapped = unwrap_angles(motion)
        palm = human.forward(unwrapped.q)["right_palm"]
        until_s = min(motion_span(motion.t_s, palm).onset_s - config.margin_s, motion.t_s[0] + config.rest_s)
        n = int(np.searchsorted(motion.t_s, until_s))
        if n >= config.least_frames and palm_speed(motion.t_s, palm)[:n].max() < config.still_mps:
            t_s, q = motion.t_s[:n], unwrapped.q[:n]
            line = median_slope(t_s, q) * (t_s - t_s[0])[:, None]
            steps = np.diff(t_s)
            rests.append(Rest(motion.index, np.append(steps, np.median(steps)), q - line - np.median(q - line, axis=0)))
    if not rests:
        raise LibraryFormatError(
            f"standing: wanted motions that begin with a rest of {config.least_frames} frames or more, none of "
            f"{len(motions)} does; record from before the motion begins"
        )
    return StandingNoise(tuple(rests), motions[0].dof_names, config)


def median_slope(t_s: FloatArray, values: FloatArray) -> FloatArray:
    """Return the median (D,) of the slopes between all pairs of rows (T, D): a few bad frames do not change it."""
    a, b = np.triu_indices(len(t_s), k=1)
    slope: FloatArray = np.median((values[b] - values[a]) / (t_s[b] - t_s[a])[:, None], axis=0)
    return slope
