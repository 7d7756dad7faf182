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
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.standing import MARGIN_S, PALM, REST_S, StandingNoise, median_slope, motion_span
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion, MotionLibrary, is_angle, unwrap_angles

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
    label: int | None  #: class of the recorded motion
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
