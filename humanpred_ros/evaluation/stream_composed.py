"""What a sensor delivers over minutes: one person who stands, reaches, returns and stands, built from recordings.

Recordings end while the hand still moves, and the next one begins somewhere else. So that no joint of two pieces asks
for something a person could not do, the pieces are:

- the recorded motion, as it is, noise and all;
- a closing stroke, of least jerk, that takes up the recording's last velocity and brings every DoF to the posture
  from which the next motion starts (angles the short way round), at half the motion's greatest palm speed: the rest
  of the return. Where a library's motions end at the place reached for, the hand stops there instead, stays for a
  pause, and then returns by such a stroke, which makes it a motion of its own: a `made` one;
- a pause of standing in the posture that the next recording starts from, with the noise of recorded rests.

Angles are recorded values or within half a turn: they wrap as the sensor's do.

When a recorded motion really begins and ends is found from the whole recording, smoothed without delay, by nothing but
the speed of the palm. An online detector, which sees the past only, is measured against that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, median_filter

from humanpred_ros.errors import LibraryFormatError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, is_angle, unwrap_angles

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
#: A pause is uniform in this range; before the first motion and after the last there is standing of this at least.
PAUSE_S, LEAD_S = (1.0, 5.0), 2.0
#: Shortest and longest closing stroke, and its greatest speed as a share of the motion's.
_STROKE_S, _STROKE_SPEED_SHARE = (0.3, 1.5), 0.5
#: The recording's last velocity is the median slope of so much of its end.
_VELOCITY_S = 0.1
#: Time to stop at the place reached for, where motions end there.
_STOP_S = 0.2


@dataclass(frozen=True)
class Placed:
    """A motion within a stream."""

    name: str  #: of the recorded motion, `class/index`; a made return has the name of the motion before it
    label: str | None  #: class of the recorded motion
    made: bool  #: True for a return that is not recorded
    start_s: float  #: the recorded (or made) piece's first and last stamp in the stream
    stop_s: float
    onset_s: float  #: when the palm really moves (`motion_span`), in the stream
    end_s: float


@dataclass(frozen=True)
class Stream:
    """Postures (T, D) at stamps (T,), and the motions in them by time."""

    t_s: FloatArray
    q: FloatArray
    placed: tuple[Placed, ...]


def returns_home(library: MotionLibrary, human: HumanModel) -> bool:
    """Return whether the library's motions come back: half of them end nearer to the start than to where they turn."""
    shares = []
    for motion in library:
        palm = human.forward(motion.q)[PALM]
        away = np.linalg.norm(palm - palm[0], axis=1)
        shares.append(away[-1] / max(float(away.max()), 1e-9))
    return bool(np.median(shares) < 0.5)


def standing_stream(posture: FloatArray, duration_s: float, noise: StandingNoise, rng: np.random.Generator) -> Stream:
    """Return a person who does nothing but stand in one posture (D,)."""
    t_s, deviation = noise.draw(duration_s, rng)
    return Stream(t_s, _short_way(posture + deviation, noise.dof_names), ())


@dataclass(eq=False)
class StreamBuilder:
    """Makes one stream of motions: appends pieces one after the other."""

    human: HumanModel  #: tells where the palm is
    noise: StandingNoise  #: of standing
    rng: np.random.Generator  #: draws pauses and noise
    come_back: bool  #: the motions return by themselves (`returns_home`)
    pause_s: tuple[float, float] = PAUSE_S  #: a pause is uniform in this range
    lead_s: float = LEAD_S  #: standing before the first motion and after the last, at least

    def build(self, motions: Sequence[Motion]) -> Stream:
        """Return one stream of the motions, in their order.

        Raises:
            UsageError: no motions, or pauses that are none.
        """
        if not motions:
            raise UsageError("streams: wanted at least one motion, got none")
        if not 0.0 < self.pause_s[0] <= self.pause_s[1]:
            raise UsageError(f"streams: wanted pauses from above 0 s to no less than that, got {self.pause_s}")
        self.now_s = 0.0
        self.t_s: list[FloatArray] = []
        self.q: list[FloatArray] = []
        #: The same without the noise of pauses, for the truth.
        self.clean: list[FloatArray] = []
        #: Motions, whether they are made, and from when to when; and when the pauses around them begin.
        self.pieces: list[tuple[Motion, bool, float, float]] = []
        self.rest_from_s: list[float] = []
        stands = [self._stand(motion) for motion in motions]
        self._pause(stands[0], self.lead_s + self._pause_s())
        for k, motion in enumerate(motions):
            following = stands[min(k + 1, len(motions) - 1)]
            start_s = self.now_s + motion.period_s
            self._append(start_s + motion.t_s - motion.t_s[0], motion.q, unwrap_angles(motion).q)
            stop_s = self.now_s
            velocity = self._last_velocity(motion)
            peak_mps = motion_span(motion.t_s, self.human.forward(motion.q)[PALM]).peak_mps
            if self.come_back:
                self._stroke(motion.q[-1], velocity, following, peak_mps, motion.period_s)
                self.pieces.append((motion, False, start_s, stop_s))
            else:
                target = motion.q[-1] + 0.5 * _STOP_S * velocity
                self._stroke(motion.q[-1], velocity, target, peak_mps, motion.period_s, _STOP_S)
                self.pieces.append((motion, False, start_s, stop_s))
                self._pause(target, self._pause_s())
                start_s = self.now_s
                self._stroke(target, np.zeros_like(target), following, peak_mps, motion.period_s)
                self.pieces.append((motion, True, start_s, self.now_s))
            self._pause(following, self._pause_s() + (self.lead_s if k + 1 == len(motions) else 0.0))
        t_s, q = np.concatenate(self.t_s), np.concatenate(self.q)
        return Stream(t_s, q, self._placed(t_s, np.concatenate(self.clean)))

    def _placed(self, t_s: FloatArray, clean: FloatArray) -> tuple[Placed, ...]:
        """Return each motion with its true span, seen from the middle of the pause before to that of the one after."""
        palm = self.human.forward(clean)[PALM]
        rests_until_s = [*(start_s for _, _, start_s, _ in self.pieces), float(t_s[-1])]
        middles = [0.5 * (begin + end) for begin, end in zip(self.rest_from_s, rests_until_s, strict=True)]
        placed = []
        for (motion, made, start_s, stop_s), left, right in zip(self.pieces, middles, middles[1:], strict=False):
            inside = (t_s >= left) & (t_s <= right)
            span = motion_span(t_s[inside], palm[inside])
            placed.append(Placed(motion.name, motion.label, made, start_s, stop_s, span.onset_s, span.end_s))
        return tuple(placed)

    def _append(self, t_s: FloatArray, q: FloatArray, clean: FloatArray) -> None:
        if len(t_s):
            self.t_s.append(t_s)
            self.q.append(q)
            self.clean.append(clean)
            self.now_s = float(t_s[-1])

    def _pause_s(self) -> float:
        return float(self.rng.uniform(*self.pause_s))

    def _pause(self, posture: FloatArray, duration_s: float) -> None:
        self.rest_from_s.append(self.now_s)
        t_s, deviation = self.noise.draw(duration_s, self.rng)
        postures = _short_way(posture + deviation, self.noise.dof_names)
        self._append(self.now_s + t_s, postures, np.repeat(posture[None], len(t_s), axis=0))

    def _stroke(
        self,
        start: FloatArray,
        velocity: FloatArray,
        target: FloatArray,
        peak_mps: float,
        period_s: float,
        duration_s: float | None = None,
    ) -> None:
        """Append the stroke from `start` with `velocity` to rest at `target`, at a frame every `period_s`."""
        change = _short_way(target - start, self.noise.dof_names)
        if duration_s is None:
            palm = self.human.forward(np.stack([start, start + change]))[PALM]
            # A stroke of least jerk is 1.875 times as fast in the middle as on average.
            speed = max(_STROKE_SPEED_SHARE * peak_mps, 1e-6)
            duration_s = float(np.clip(1.875 * np.linalg.norm(palm[1] - palm[0]) / speed, *_STROKE_S))
        n = max(2, round(duration_s / period_s))
        u: FloatArray = (np.arange(1, n + 1) / n)[:, None]
        least_jerk = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        fading = u - 6.0 * u**3 + 8.0 * u**4 - 3.0 * u**5  # slope 1 at the start, at rest at the end, adds nothing
        q: FloatArray = start + least_jerk * change + fading * velocity * duration_s
        t_s = np.asarray(self.now_s + period_s * np.arange(1, n + 1), dtype=np.float64)
        self._append(t_s, _short_way(q, self.noise.dof_names), q)

    def _stand(self, motion: Motion) -> FloatArray:
        """Return the posture (D,) from which a motion starts: the median of its rest, its first posture if none."""
        q = unwrap_angles(motion).q
        onset_s = motion_span(motion.t_s, self.human.forward(q)[PALM]).onset_s
        until_s = min(onset_s - MARGIN_S, motion.t_s[0] + REST_S)
        n = int(np.searchsorted(motion.t_s, until_s))
        posture: FloatArray = np.median(q[:n], axis=0) if n >= 3 else q[0]
        return posture

    def _last_velocity(self, motion: Motion) -> FloatArray:
        """Return the median of the slopes between the last frames, which a single bad frame does not change."""
        q = unwrap_angles(motion).q
        first = min(len(q) - 2, int(np.searchsorted(motion.t_s, motion.t_s[-1] - _VELOCITY_S)))
        return median_slope(motion.t_s[first:], q[first:])


def _short_way(change: FloatArray, dof_names: Sequence[str]) -> FloatArray:
    """Return postures, or differences of them, with whole turns taken off: every angle within half a turn."""
    angle = np.array([is_angle(name) for name in dof_names])
    return np.where(angle, change - 2 * np.pi * np.round(change / (2 * np.pi)), change)


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
        palm = human.forward(unwrapped.q)[PALM]
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
