"""Demonstrations to learn from: recorded reaches, and their later parts, as one meets them when predicting on the way.

A prediction made in the middle of a reach starts from a person in motion. P2 therefore also learns from each reach cut
at every 0.1 s, and keeps what came before the cut, so that velocity, acceleration and jerk at the cut are those of the
person. (The authors' code is one step off here: it looks at t0 - 7 dt to t0 - 2 dt; facts section 5.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ACTIVE, ReachRecording
from humanpred_ros.reaching.features import ReachFeatures, ReachSituation
from humanpred_ros.reaching.stencils import PADDING


@dataclass(frozen=True)
class SplittingConfig:
    """Where reaches are cut (facts section 5: 27 cuts of P2's seven).

    Attributes:
        first_s: the first cut, one frame at 100 Hz as in the authors' code.
        every_s: between cuts.
        least_s: a cut that leaves fewer frames than this lasts is not made (P2's code: 80 frames).

    Raises:
        UsageError: times that are not positive.
    """

    first_s: float = 0.01
    every_s: float = 0.10
    least_s: float = 0.80

    def __post_init__(self) -> None:
        if not all(np.isfinite(span) and span > 0.0 for span in (self.first_s, self.every_s, self.least_s)):
            raise UsageError(
                f"splitting: wanted positive times in seconds, got {self.first_s}, {self.every_s} and {self.least_s}"
            )


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A reach, or its rest after a cut, resampled evenly in time.

    Attributes:
        recording: name of the recording it is from.
        first_frame: frame of the recording it begins at, 0 for a whole reach.
        q: (N, J) postures.
        situation: duration, partner at the first frame, and the way there.
        partner: (J,) posture of the partner at the first frame; None if nobody is there.
    """

    recording: str
    first_frame: int
    q: FloatArray
    situation: ReachSituation
    partner: FloatArray | None = None

    @property
    def name(self) -> str:
        """`recording`, with `+frame` after a cut."""
        return f"{self.recording}+{self.first_frame}" if self.first_frame else self.recording


def demonstration(recording: ReachRecording, features: ReachFeatures, first_frame: int = 0) -> Demonstration:
    """Return a reach from one of its frames on.

    Where the history would reach back before the recording, the person is taken to have stood still there.

    Raises:
        MotionError: a frame outside, or one that leaves less than two frames.
        HumanModelError: a recording of another human.
    """
    features.model.check_dofs(recording.active.dof_names)
    active, N = recording.active, features.config.n_waypoints
    if not 0 <= first_frame <= len(active) - 2:
        raise MotionError(f"{recording.name}: wanted a cut at frame 0 to {len(active) - 2}, got {first_frame}")
    begin_s, end_s = float(active.t_s[first_frame]), float(active.t_s[-1])
    dt_s = (end_s - begin_s) / (N - 1)
    history = None
    if first_frame:
        history = _at(active, begin_s + dt_s * np.arange(-PADDING, 0, dtype=np.float64))
    partner = features.link_points(recording.passive.q[first_frame])
    postures = _at(active, np.linspace(begin_s, end_s, N))
    situation = ReachSituation(end_s - begin_s, partner, history)
    beside = recording.passive.q[first_frame]
    return Demonstration(recording.name, first_frame, frozen(postures), situation, beside)  # type: ignore[arg-type]


def cut_frames(motion: Motion, config: SplittingConfig | None = None) -> list[int]:
    """Return the frames at which a reach is cut, ascending; none if it is too short."""
    config = config or SplittingConfig()
    first, every, least = (
        max(1, round(span / motion.period_s)) for span in (config.first_s, config.every_s, config.least_s)
    )
    return list(range(first, len(motion) - least + 1, every))


def demonstrations(
    recordings: Sequence[ReachRecording],
    features: ReachFeatures,
    splitting: SplittingConfig | None = None,
    *,
    keep_unfit: bool = False,
) -> tuple[Demonstration, ...]:
    """Return what can be learned from recordings: every reach and, if `splitting` is given, its cuts.

    Args:
        recordings: some.
        features: settings of the resampling, and the human.
        splitting: where to cut; None for whole reaches only.
        keep_unfit: learn from recordings with jumps, too. Without it they are left out, but for parts after the jump.
            Recordings shorter than the jerk's difference are left out in any case.
    """
    found = []
    for recording in recordings:
        frames = [0, *(cut_frames(recording.active, splitting) if splitting else [])]
        for frame in frames:
            if len(recording.active) - frame < recording.least_frames:
                continue
            demo = demonstration(recording, features, frame)
            if keep_unfit or _steady(recording, demo):
                found.append(demo)
    return tuple(found)


def _steady(recording: ReachRecording, demo: Demonstration) -> bool:
    """Return whether no jump is in the demonstration or in what it remembers of the way there."""
    t_s = recording.active.t_s
    step_s = demo.situation.duration_s / (len(demo.q) - 1)
    seen_s = t_s[demo.first_frame] - (PADDING * step_s if demo.first_frame else 0.0)
    return not any(jump.role == ACTIVE and t_s[jump.frame] >= seen_s for jump in recording.jumps)


def _at(motion: Motion, t_s: FloatArray) -> FloatArray:
    """Interpolate postures; before the first and after the last frame the person stands still."""
    postures: FloatArray = np.stack([np.interp(t_s, motion.t_s, column) for column in motion.q.T], axis=1)
    return postures
