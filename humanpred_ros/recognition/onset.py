"""Tells, frame by frame of a sensor's stream, when a motion begins and when it is over.

What is looked at is the palm and the elbow of the reaching arm and the neck, seen from the pelvis: Cartesian points do
not wrap as angles do, and a body that sways or walks with a quiet arm stays put. Everything is measured in seconds, not
frames, so that 30 and 60 Hz, jittering stamps and repeated frames come out the same.

**Rest.** A `RestModel` learns where the points of a resting body are and how they scatter there. The errors of a depth
camera have directions: the twist of a nearly straight arm, say, is hardly known, so that the palm wanders across the
forearm and not along it. Distances from rest are therefore measured in standard deviations of what this person showed
at rest before this sensor (Mahalanobis), with a floor for each coordinate.

**Onset.** A frame farther from rest than `distance` speaks for a motion, and else against it; how much one frame can
say is bounded. The evidence is summed up over time and never falls below zero (a CUSUM test with clipped increments):
one mistracked frame cannot start a motion however far it jumps, while a hand that has really left is found within
`evidence_s` after that. When the motion began is then looked up in the last frames.

**End.** A motion is over when the palm has stayed within a small ball, excursions as short as a mistracked frame not
counted: for a short time if it is back near its rest place, for a longer one if it is elsewhere, because people dwell
at a target before they come back, and out and back are one motion. A palm that stays there for longer rests there: that
place is then the rest place, and the place before is remembered as home, where the next motion may end quickly, too.
"""

from __future__ import annotations

import math
from collections import deque
from functools import partial
from typing import NamedTuple

import numpy as np

from humanpred_ros.errors import MotionError, SettingsError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.compiled import exact
from humanpred_ros.human.model import HumanModel
from humanpred_ros.settings import Settings, setting

#: What a detector looks at: so many points.
N_POINTS = 3
#: Frames closer than this say much the same: a camera's errors last for two or three of its frames.
CORRELATED_S = 0.1
#: Deviations beyond so many times the median one count as that, where all frames are looked at together.
_BAD = 6.0
#: A setting that is a positive number.
_positive = partial(setting, low=1e-6, high=1e6)


class OnsetSettings(Settings):
    """When something counts as a motion.

    Chosen on the even recording rounds of library_b and on the untrimmed recordings of library_a (docs/papers.md, P1
    library); the odd rounds of library_b were left for testing.
    """

    distance: float = _positive(
        1.55,
        "from so many standard deviations on a frame speaks for a motion (root mean square over the coordinates: three "
        "times as many in one direction alone are as much)",
    )
    full_distance: float = _positive(2.45, "and from so many on as much as it can")
    evidence_s: float = _positive(
        0.049,
        "evidence needed: a frame adds at most its time step; a mistracked frame of a 30 Hz sensor lasts 0.033 s",
        unit="s",
    )
    scatter_m: tuple[float, float, float] = _positive(
        (0.006, 0.004, 0.002),
        "usual standard deviation of palm, elbow and neck at rest, per coordinate, where learning begins",
        unit="m",
    )
    floor_m: float = _positive(0.0035, "standard deviation of each coordinate on top of what is learned", unit="m")
    turn_rad: float = _positive(
        0.01, "a body at rest sways, and turns as a whole about the vertical, by this standard deviation", unit="rad"
    )
    noise_s: float = _positive(30.0, "time constant of learning the scatter", unit="s")
    settled_s: float = _positive(
        1.0, "where a body settles, what was learned elsewhere counts as this long a part of the new rest", unit="s"
    )
    drift_s: float = _positive(
        0.5, "time constant with which the rest place follows; at first it is the mean of all frames", unit="s"
    )
    trusted: float = _positive(
        2.0, "a frame at rest farther away than this counts less, by the square of how much farther it is"
    )
    lag_s: float = _positive(
        0.15, "age at which frames are learned, so that a motion is found before it is taken for rest", unit="s"
    )
    lookback_s: float = _positive(0.5, "an onset is dated back by this much at most", unit="s")
    onset_share: float = _positive(0.25, "to when the points were this share of their distance at detection away")
    still_m: float = _positive(0.03, "radius of the ball within which a palm at rest stays", unit="m")
    blink_s: float = _positive(0.07, "leaving it for less than this does not count", unit="s")
    settle_s: float = _positive(0.3, "a new rest is learned from its last part", unit="s")
    near_s: float = _positive(0.5, "staying this long near the rest place or home ends a motion", unit="s")
    far_s: float = _positive(2.0, "and this long anywhere else", unit="s")
    near_m: float = _positive(0.12, "near is within this distance of it", unit="m")
    near_share: float = _positive(0.4, "or within this share of the farthest that was reached, if that is more")
    gap_s: float = _positive(0.5, "a longer step between stamps ends the motion; what follows begins at rest", unit="s")

    def check(self) -> None:
        if self.settle_s > min(self.near_s, self.lookback_s):
            raise SettingsError(
                f"OnsetSettings settle_s: wanted no longer than near_s and lookback_s, got {self.settle_s} s"
            )
        if self.distance >= self.full_distance:
            raise SettingsError(
                f"OnsetSettings distance: wanted less than full_distance, got {self.distance} and {self.full_distance}"
            )
        if self.near_s > self.far_s:
            raise SettingsError(
                f"OnsetSettings near_s: wanted no longer than far_s, got {self.near_s} s and {self.far_s} s"
            )


class MotionState(NamedTuple):
    """Whether the person is in motion."""

    moving: bool  #: True from the frame an onset is found at to the one the end is found at
    since_s: float  #: when the motion, or the rest, began; estimated, and earlier than it was found
    found_s: float  #: stamp of the frame at which that was found
    n_motions: int  #: onsets found so far; a larger one than before means a new motion


class BodyPoints:
    """Takes from a posture what an `OnsetDetector` looks at."""

    def __init__(self, human: HumanModel, side: str = "right") -> None:
        """Look at the arm of one side; raises UsageError for a human without the links."""
        names = (f"{side}_palm", f"{side}_elbow", "neck", "pelvis")
        missing = [name for name in names if name not in human.link_names]
        if missing:
            raise UsageError(f"onset: wanted a human with the links {', '.join(names)}, {human.name} lacks {missing}")
        self.human = human
        self._links = np.array([human.link_names.index(name) for name in names])

    def __call__(self, q: FloatArray) -> FloatArray:
        """Return palm, elbow and neck (3, 3) relative to the pelvis, in the tracker's axes, of one posture (D,).

        Raises:
            ArrayError: wrong shape or values that are not finite.
        """
        q = checked("posture", q, (len(self.human.dof_names),))
        points = self.human.link_poses(q)[self._links, :3, 3]
        relative: FloatArray = points[:-1] - points[-1]
        return relative


class RestModel:
    """Running mean and covariance of the coordinates of points, both robust: what lies far off counts little.

    One update takes a few microseconds.

    Attributes:
        settings: how rest is learned.
        place: (K,) where the coordinates (x y z of each point, metres) rest.
        covariance: (K, K) of their scatter, as learned.
        rested_s: how much of the present rest the place is known from.
    """

    def __init__(self, scatter_m: FloatArray, settings: OnsetSettings | None = None) -> None:
        """Make a model that knows nothing but the usual standard deviations (K,), K a multiple of 3."""
        self.settings = settings or OnsetSettings()
        self.covariance = np.diag(np.asarray(scatter_m, dtype=np.float64) ** 2)
        self.place = np.zeros(len(self.covariance))
        self.rested_s = 0.0

    def settle(self, x: FloatArray, rested_s: float) -> None:
        """Say that the body has come to rest, and was at (n, K) for the last `rested_s` seconds."""
        self.place = np.median(x, axis=0)
        self.rested_s = rested_s
        deviation = x - self.place
        # A frame that the tracker got wrong counts no more than a bad one.
        usual = np.maximum(np.median(np.abs(deviation), axis=0), self.settings.floor_m)
        deviation = np.clip(deviation, -_BAD * usual, _BAD * usual)
        new = rested_s / (rested_s + self.settings.settled_s)
        self.covariance += new * (deviation.T @ deviation / len(x) - self.covariance)

    def distance(self, x: FloatArray) -> float:
        """Return how far coordinates (K,) are from rest, in standard deviations (root mean square over K).

        A place known from a short rest only is itself uncertain, which makes all distances less.
        """
        settings = self.settings
        known = self.rested_s / (self.rested_s + CORRELATED_S)
        return math.sqrt(known * _squared(x, self.place, self.covariance, settings.floor_m, settings.turn_rad))

    def learn(self, x: FloatArray, distance: float, step_s: float) -> None:
        """Take coordinates (K,), at their `distance`, as those of a resting body for `step_s` seconds."""
        if step_s <= 0 or not math.isfinite(distance):
            return
        settings = self.settings
        weight = 1.0 if distance <= settings.trusted else (settings.trusted / distance) ** 2
        # The place of settling counts as one frame.
        follow = weight * min(1.0, step_s / (min(settings.drift_s, self.rested_s + step_s) + step_s))
        self.rested_s += step_s
        _learn(x, self.place, self.covariance, follow, weight, min(1.0, step_s / settings.noise_s))


class _Frame(NamedTuple):
    t_s: float
    x: FloatArray  # (9,)


class OnsetDetector:
    """Tells motion from rest, one frame at a time, at a cost that does not grow (see the module)."""

    def __init__(self, settings: OnsetSettings | None = None) -> None:
        self.settings = settings or OnsetSettings()
        self.start()

    @property
    def state(self) -> MotionState | None:
        """What the last frame led to; None before the first."""
        return self._state

    def start(self) -> None:
        """Forget everything: the next frame is the first, and the person rests until seen moving."""
        settings = self.settings
        self._state: MotionState | None = None
        self._last_s = -math.inf
        self._evidence_s = 0.0
        self._rest = RestModel(np.repeat(settings.scatter_m, 3), settings)

    def continues(self, t_s: float) -> bool:
        """Return whether a frame at `t_s` belongs to what was seen so far: False for the first, and after a gap."""
        return self._state is not None and t_s - self._last_s <= self.settings.gap_s

    def may_begin(self, t_s: float) -> bool:
        """Return whether an onset could be found at a frame at `t_s`: False while the person is plainly at rest."""
        if self._state is None or self._state.moving or not self.continues(t_s):
            return False
        return self._evidence_s + (t_s - self._last_s) >= self.settings.evidence_s

    def check(self, points_m: FloatArray, t_s: float) -> FloatArray:
        """Return points (3, 3) if `update` would take them; changes nothing.

        Raises:
            ArrayError: wrong shape or values that are not finite.
            MotionError: a stamp that is not finite or not later than the one before.
        """
        points = checked("points_m", points_m, (N_POINTS, 3))
        if not math.isfinite(t_s) or t_s <= self._last_s:
            after = "" if self._state is None else f" later than {self._last_s} s"
            raise MotionError(
                f"onset: wanted a finite stamp{after}, got {t_s} s; call start() when the clock was set back"
            )
        return points

    def update(self, points_m: FloatArray, t_s: float) -> MotionState:
        """Take palm, elbow and neck (3, 3) in metres, stamped `t_s`, and return whether there is a motion.

        A call that raises leaves the detector as it was; raises as `check`.
        """
        x = self.check(points_m, t_s).ravel()
        continued = self.continues(t_s)
        step_s, self._last_s = t_s - self._last_s, t_s
        if self._state is None or not continued:
            n_motions = 0 if self._state is None else self._state.n_motions
            self._state = MotionState(False, t_s, t_s, n_motions)
            self._home: FloatArray | None = None
            self._recent: deque[_Frame] = deque()
            self._settle(x[None], 0.0)
            step_s = 0.0
        self._recent.append(_Frame(t_s, x))
        while self._recent[0].t_s < t_s - self.settings.lookback_s:
            self._recent.popleft()
        if self._state.moving:
            self._state = self._moving(self._state, x, t_s)
        else:
            self._state = self._resting(self._state, x, t_s, step_s)
        return self._state

    def _resting(self, state: MotionState, x: FloatArray, t_s: float, step_s: float) -> MotionState:
        settings = self.settings
        distance = self._rest.distance(x)
        says = (distance - settings.distance) / (settings.full_distance - settings.distance)
        self._evidence_s = max(0.0, self._evidence_s + min(1.0, max(-1.0, says)) * step_s)
        if self._evidence_s < settings.evidence_s:
            self._unlearned.append((t_s, x, distance, step_s))
            lag_s = min(self.settings.lag_s, self._rest.rested_s)
            while self._unlearned and self._unlearned[0][0] <= t_s - lag_s:
                self._rest.learn(*self._unlearned.popleft()[1:])
            return state
        return self._begin(state, x)

    def _settle(self, frames: FloatArray, rested_s: float) -> None:
        self._rest.settle(frames, rested_s)
        self._evidence_s = 0.0
        self._unlearned: deque[tuple[float, FloatArray, float, float]] = deque()

    def _begin(self, state: MotionState, x: FloatArray) -> MotionState:
        away = math.dist(x, self._rest.place)
        since_s = self._last_s
        for frame in reversed(self._recent):
            if frame.t_s < state.since_s:
                break
            since_s = frame.t_s
            if math.dist(frame.x, self._rest.place) < self.settings.onset_share * away:
                break
        self._palm = self._rest.place[:3].copy()
        self._anchor, self._stays_since_s = x[:3], self._last_s
        self._left_s: float | None = None
        self._farthest_m = 0.0
        return MotionState(True, since_s, self._last_s, state.n_motions + 1)

    def _moving(self, state: MotionState, x: FloatArray, t_s: float) -> MotionState:
        settings, palm = self.settings, x[:3]
        if math.dist(palm, self._anchor) <= settings.still_m:
            self._left_s = None
        elif self._left_s is None:
            self._left_s = t_s
        if self._left_s is not None and t_s - self._left_s >= settings.blink_s:
            self._anchor, self._stays_since_s = palm, self._left_s
            self._left_s = None
        away = math.dist(self._anchor, self._palm)
        self._farthest_m = max(self._farthest_m, away)
        near = max(settings.near_m, settings.near_share * self._farthest_m)
        is_near = away <= near or (self._home is not None and math.dist(self._anchor, self._home) <= near)
        if t_s - self._stays_since_s < (settings.near_s if is_near else settings.far_s):
            return state
        if is_near:
            self._home = None
        elif self._home is None:
            self._home = self._palm
        # By then it lies still; how it came there says nothing about its scatter.
        still = [frame for frame in self._recent if frame.t_s >= max(self._stays_since_s, t_s - settings.settle_s)]
        self._settle(np.stack([frame.x for frame in still]), t_s - still[0].t_s)
        return MotionState(False, self._stays_since_s, t_s, state.n_motions)


@exact
def _squared(x: FloatArray, place: FloatArray, covariance: FloatArray, floor: float, turn: float) -> float:
    """Return the mean squared distance over the coordinates, by a Cholesky factor L of the covariance.

    To what was learned come the floor and a turn of all points, x y z after each other, about the vertical axis.
    """
    n = len(x)
    moved = np.zeros(n)
    for i in range(0, n, 3):
        moved[i], moved[i + 1] = -turn * place[i + 1], turn * place[i]
    L = np.zeros((n, n))
    total = 0.0
    y = np.zeros(n)
    for i in range(n):
        for j in range(i + 1):
            s = covariance[i, j] + moved[i] * moved[j]
            if i == j:
                s += floor * floor
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = np.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
        s = x[i] - place[i]
        for k in range(i):
            s -= L[i, k] * y[k]
        y[i] = s / L[i, i]
        total += y[i] * y[i]
    return total / n


@exact
def _learn(
    x: FloatArray, place: FloatArray, covariance: FloatArray, follow: float, weight: float, learn: float
) -> None:
    n = len(x)
    for i in range(n):
        for j in range(n):
            square = weight * (x[i] - place[i]) * (x[j] - place[j])
            covariance[i, j] += learn * (square - covariance[i, j])
    for i in range(n):
        place[i] += follow * (x[i] - place[i])
