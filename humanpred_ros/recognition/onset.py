"""Sensors deliver people who mostly stand; this tells, frame by frame, when a motion begins and when it is over.

What is looked at is the palm and the elbow of the reaching arm and the neck, seen from the pelvis: Cartesian points do
not wrap as angles do, and a body that sways or walks with a quiet arm stays put. Everything is measured in seconds, not
frames, so that 30 and 60 Hz, jittering stamps and repeated frames come out the same.

**Onset.** At rest, a `RestModel` knows where the points are and how this person scatters there before this sensor. A
frame farther away than `distance` speaks for a motion, and else against it; how much one frame can say is bounded. The
evidence is summed up over time and never falls below zero (a CUSUM test with clipped increments): one mistracked frame
cannot start a motion however far it jumps, while a hand that has really left is found within `evidence_s` after that.
When the motion began is then looked up in the last frames.

**End.** A motion is over when the palm has stayed within a small ball, excursions as short as a mistracked frame not
counted: for a short time if it is back near its rest place, for a longer one if it is elsewhere, because people dwell
at a target before they come back and out and back are one motion. Who stays there for longer rests there: that place
is then the rest place, and the place before is remembered as home, where the next motion may end quickly, too.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.model import HumanModel
from humanpred_ros.recognition.rest_model import RestConfig, RestModel, check_positive

#: What a detector looks at: so many points.
N_POINTS = 3


@dataclass(frozen=True)
class OnsetConfig:
    """When something counts as a motion.

    Chosen on the even recording rounds of library_b and on library_a_raw_timed (facts: iros2013, section 7); the odd
    rounds of library_b were left for testing.

    Attributes:
        distance: from so many standard deviations on (root mean square over the coordinates, so that three times as
            many in one direction alone are as much) a frame speaks for a motion,
        full_distance: and from so many on as much as it can.
        evidence_s: evidence needed: a frame adds at most its time step. A mistracked frame of a 30 Hz sensor lasts
            0.033 s.
        scatter_m: usual standard deviation of palm, elbow and neck at rest, per coordinate, where learning begins.
        rest: how rest is learned.
        lag_s: frames are learned when they are so old, so that a motion is found before it is taken for rest.
        lookback_s: an onset is dated back by this much at most,
        onset_share: to when the points were this share of their distance at detection away.
        still_m: radius of the ball within which a palm at rest stays.
        blink_s: leaving it for less than this does not count.
        settle_s: a new rest is learned from its last so long.
        near_s: staying this long near the rest place or home ends a motion,
        far_s: and this long anywhere else.
        near_m, near_share: near is within this distance, or within this share of the farthest reached if that is more.
        gap_s: a longer step between stamps ends what was; what follows starts anew, at rest.
    """

    distance: float = 1.55
    full_distance: float = 2.45
    evidence_s: float = 0.049
    scatter_m: tuple[float, float, float] = (0.006, 0.004, 0.002)
    rest: RestConfig = field(default_factory=RestConfig)
    lag_s: float = 0.15
    lookback_s: float = 0.5
    onset_share: float = 0.25
    still_m: float = 0.03
    blink_s: float = 0.07
    settle_s: float = 0.3
    near_s: float = 0.5
    far_s: float = 2.0
    near_m: float = 0.12
    near_share: float = 0.4
    gap_s: float = 0.5

    def __post_init__(self) -> None:
        check_positive("onset", self, skip=("rest",))
        if len(self.scatter_m) != N_POINTS:
            raise UsageError(f"onset: wanted scatter_m of palm, elbow and neck, got {self.scatter_m}")
        if self.settle_s > min(self.near_s, self.lookback_s):
            raise UsageError(f"onset: wanted settle_s no longer than near_s and lookback_s, got {self.settle_s} s")
        if self.distance >= self.full_distance:
            raise UsageError(f"onset: wanted distance below full_distance, got {self.distance}, {self.full_distance}")
        if self.near_s > self.far_s:
            raise UsageError(f"onset: wanted near_s no longer than far_s, got {self.near_s} s and {self.far_s} s")


class MotionState(NamedTuple):
    """Whether the person is in motion.

    Attributes:
        moving: True from the frame an onset is found at to the one the end is found at.
        since_s: when the motion, or the rest, began; estimated, and earlier than it was found.
        found_s: stamp of the frame at which that was found.
        n_motions: onsets found so far; a larger one than before means a new motion.
    """

    moving: bool
    since_s: float
    found_s: float
    n_motions: int


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


class _Frame(NamedTuple):
    t_s: float
    x: FloatArray  # (9,)


class OnsetDetector:
    """Tells motion from rest, one frame at a time, at a cost that does not grow (see the module)."""

    def __init__(self, config: OnsetConfig | None = None) -> None:
        self.config = OnsetConfig() if config is None else config
        self.start()

    @property
    def state(self) -> MotionState | None:
        """What the last frame led to; None before the first."""
        return self._state

    def start(self) -> None:
        """Forget everything: the next frame is the first, and the person rests until seen moving."""
        config = self.config
        self._state: MotionState | None = None
        self._last_s = -math.inf
        self._evidence_s = 0.0
        self._rest = RestModel(np.repeat(config.scatter_m, 3), config.rest)

    def continues(self, t_s: float) -> bool:
        """Return whether a frame at `t_s` belongs to what was seen so far: False for the first, and after a gap."""
        return self._state is not None and t_s - self._last_s <= self.config.gap_s

    def may_begin(self, t_s: float) -> bool:
        """Return whether an onset could be found at a frame at `t_s`: False while the person is plainly at rest."""
        if self._state is None or self._state.moving or not self.continues(t_s):
            return False
        return self._evidence_s + (t_s - self._last_s) >= self.config.evidence_s

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
        while self._recent[0].t_s < t_s - self.config.lookback_s:
            self._recent.popleft()
        if self._state.moving:
            self._state = self._moving(self._state, x, t_s)
        else:
            self._state = self._resting(self._state, x, t_s, step_s)
        return self._state

    def _resting(self, state: MotionState, x: FloatArray, t_s: float, step_s: float) -> MotionState:
        config = self.config
        distance = self._rest.distance(x)
        says = (distance - config.distance) / (config.full_distance - config.distance)
        self._evidence_s = max(0.0, self._evidence_s + min(1.0, max(-1.0, says)) * step_s)
        if self._evidence_s < config.evidence_s:
            self._unlearned.append((t_s, x, distance, step_s))
            lag_s = min(self.config.lag_s, self._rest.rested_s)
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
            if math.dist(frame.x, self._rest.place) < self.config.onset_share * away:
                break
        self._palm = self._rest.place[:3].copy()
        self._anchor, self._stays_since_s = x[:3], self._last_s
        self._left_s: float | None = None
        self._farthest_m = 0.0
        return MotionState(True, since_s, self._last_s, state.n_motions + 1)

    def _moving(self, state: MotionState, x: FloatArray, t_s: float) -> MotionState:
        config, palm = self.config, x[:3]
        if math.dist(palm, self._anchor) <= config.still_m:
            self._left_s = None
        elif self._left_s is None:
            self._left_s = t_s
        if self._left_s is not None and t_s - self._left_s >= config.blink_s:
            self._anchor, self._stays_since_s = palm, self._left_s
            self._left_s = None
        away = math.dist(self._anchor, self._palm)
        self._farthest_m = max(self._farthest_m, away)
        near = max(config.near_m, config.near_share * self._farthest_m)
        is_near = away <= near or (self._home is not None and math.dist(self._anchor, self._home) <= near)
        if t_s - self._stays_since_s < (config.near_s if is_near else config.far_s):
            return state
        if is_near:
            self._home = None
        elif self._home is None:
            self._home = self._palm
        # By then it lies still; how it came there says nothing about its scatter.
        still = [frame for frame in self._recent if frame.t_s >= max(self._stays_since_s, t_s - config.settle_s)]
        self._settle(np.stack([frame.x for frame in still]), t_s - still[0].t_s)
        return MotionState(False, self._stays_since_s, t_s, state.n_motions)
