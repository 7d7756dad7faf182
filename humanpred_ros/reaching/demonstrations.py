"""What weights are learned from: recorded reaches, their later parts, and random variations of both (P2 III-C).

A prediction in the middle of a reach starts from a moving person. P2 therefore also learns from each reach cut at every
0.1 s, and keeps the postures before the cut, so that velocity, acceleration and jerk at the cut are the person's. (The
authors' code keeps t0 - 7 dt to t0 - 2 dt, one step too early.)

Around each demonstration, reaches are drawn that the person could have made instead. What distinguishes the
demonstration from them is what inverse optimal control learns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ACTIVE, LEAST_FRAMES, ReachRecording
from humanpred_ros.reaching.collisions import SampleCollisions
from humanpred_ros.reaching.features import PADDING, REACH, RULES, ReachFeatures, ReachSituation
from humanpred_ros.settings import Settings, setting

#: Where reaches are cut, which gives P2's 27 cuts of its seven reaches (docs/papers.md, "P2 learning"): time of the
#: first cut (as published, one frame at 100 Hz), time between cuts, and what a cut must leave.
_FIRST_S, _EVERY_S, _LEAST_S = 0.01, 0.10, 0.80


class SamplingSettings(Settings):
    """How demonstrations are varied (docs/papers.md, "P2 learning")."""

    n_samples: int = setting(700, "Number of variations of each demonstration", low=1)
    deviation: float = setting(
        1.5e-4,
        "Scale of the noise N(0, deviation^2 / R) of every DoF; the default moves the middle of a reach by 0.11 rad or "
        "m and its ends by 1e-4",
        low=1e-12,
    )
    attempts: int = setting(10, "At most so many times n_samples are drawn to find n_samples without collision", low=1)


@dataclass(frozen=True, eq=False)
class Demonstration:
    """A reach, or the rest of it after a cut, resampled evenly in time."""

    recording: str  #: name of the recording it is from
    first_frame: int  #: frame of the recording it begins at, 0 for a whole reach
    q: FloatArray  #: (N, J) postures
    situation: ReachSituation  #: duration, partner at the first frame, and the postures before it
    partner: FloatArray | None = None  #: (J,) posture of the partner at the first frame; None if there is none

    @property
    def name(self) -> str:
        """`recording`, with `+frame` after a cut."""
        return f"{self.recording}+{self.first_frame}" if self.first_frame else self.recording


def demonstration(recording: ReachRecording, features: ReachFeatures, first_frame: int = 0) -> Demonstration:
    """Return a reach from one of its frames on; before the recording the person is taken to have stood still.

    Raises:
        MotionError: a frame outside, or one that leaves less than two frames.
        HumanModelError: a recording of another human.
    """
    features.model.check_dofs(recording.active.dof_names)
    active, N = recording.active, features.n_waypoints
    if not 0 <= first_frame <= len(active) - 2:
        raise MotionError(f"{recording.name}: wanted a cut at frame 0 to {len(active) - 2}, got {first_frame}")
    begin_s, end_s = float(active.t_s[first_frame]), float(active.t_s[-1])
    dt_s = (end_s - begin_s) / (N - 1)
    history = None
    if first_frame:
        history = resampled(active.t_s, active.q, begin_s + dt_s * np.arange(-PADDING, 0, dtype=np.float64))
    partner = recording.passive.q[first_frame]
    situation = ReachSituation(end_s - begin_s, features.link_points(partner), history)
    q = frozen(resampled(active.t_s, active.q, np.linspace(begin_s, end_s, N)))
    return Demonstration(recording.name, first_frame, q, situation, partner)  # type: ignore[arg-type]


def cut_frames(motion: Motion) -> list[int]:
    """Return the frames at which a reach is cut, ascending; none if it is too short."""
    first, every, least = (max(1, round(span / motion.period_s)) for span in (_FIRST_S, _EVERY_S, _LEAST_S))
    return list(range(first, len(motion) - least + 1, every))


def demonstrations(
    recordings: Sequence[ReachRecording],
    features: ReachFeatures,
    *,
    cut: bool = False,
    keep_unfit: bool = False,
) -> tuple[Demonstration, ...]:
    """Return what can be learned from recordings: every reach and, if they are cut, its later parts.

    Args:
        recordings: some.
        features: number of waypoints, and the human.
        cut: whether later parts are learned from, too.
        keep_unfit: also learn from recordings with jumps. Without it only the parts after the jump are used.
            Recordings shorter than the jerk's difference are always left out.
    """
    found = []
    for recording in recordings:
        for frame in (0, *(cut_frames(recording.active) if cut else ())):
            if len(recording.active) - frame < LEAST_FRAMES:
                continue
            demo = demonstration(recording, features, frame)
            if keep_unfit or _has_no_jump(recording, demo):
                found.append(demo)
    return tuple(found)


def resampled(t_s: FloatArray, q: FloatArray, wanted_s: FloatArray) -> FloatArray:
    """Return postures (T, J) at times (T,), interpolated between postures (n, J) at times (n,); ends are repeated."""
    postures: FloatArray = np.stack([np.interp(wanted_s, t_s, column) for column in q.T], axis=-1)
    return postures


def _has_no_jump(recording: ReachRecording, demo: Demonstration) -> bool:
    """Return whether no jump is in the demonstration or in the postures kept before it."""
    t_s = recording.active.t_s
    step_s = demo.situation.duration_s / (len(demo.q) - 1)
    seen_s = t_s[demo.first_frame] - (PADDING * step_s if demo.first_frame else 0.0)
    return not any(jump.role == ACTIVE and t_s[jump.frame] >= seen_s for jump in recording.jumps)


def sample_around(
    demo: Demonstration,
    settings: SamplingSettings,
    rng: np.random.Generator,
    collisions: SampleCollisions | None = None,
) -> tuple[FloatArray, int]:
    """Return n_samples variations (K, N, J) of a demonstration, none of which collides, and how many more did.

    If some are still missing after the last attempt, fewer are returned. (The authors' code then keeps colliding ones.)

    Raises:
        MotionError: all samples collide, with the demonstration's name.
    """
    kept: list[FloatArray] = []
    found, drawn, collided, count = 0, 0, 0, settings.n_samples
    for _ in range(settings.attempts):
        samples = demo.q + settings.deviation * smooth_noise(rng, count, *demo.q.shape)
        drawn += count
        free = samples if collisions is None else samples[~collisions.of(samples)]
        collided += count - len(free)
        kept.append(free[: settings.n_samples - found])
        found += len(kept[-1])
        if found == settings.n_samples:
            break
        # As many as are likely to suffice, given the share that collided so far.
        count = min(settings.n_samples, 1 + (settings.n_samples - found) * drawn // max(found, 1))
    if found == 0 and collisions is not None:
        raise MotionError(
            f"demonstration {demo.name}: wanted samples around it that do not collide, all {settings.attempts} x "
            f"{settings.n_samples} do, most with {collisions.most_frequent(samples)}; check where table and objects "
            f"stand, leave the recording out, or lower the deviation {settings.deviation}"
        )
    return np.concatenate(kept), collided


def smooth_noise(rng: np.random.Generator, n_reaches: int, n_waypoints: int, n_dofs: int) -> FloatArray:
    """Return draws (R, N, J) of N(0, 1/R) with R = D'D of the jerk rule, every waypoint and DoF of unit scale.

    Raises:
        MotionError: fewer waypoints than the rule looks at.
    """
    white = rng.standard_normal((n_waypoints, n_reaches * n_dofs))
    drawn, _ = dtbtrs(_cholesky(n_waypoints), white)  # x = U^-1 z with R = U'U
    return np.ascontiguousarray(drawn.reshape(n_waypoints, n_reaches, n_dofs).swapaxes(0, 1))


@lru_cache(maxsize=16)
def _cholesky(n_waypoints: int) -> FloatArray:
    """Return the upper Cholesky factor of R in LAPACK's bands (7, N)."""
    if n_waypoints < 2 * REACH + 1:
        raise MotionError(f"sampling: wanted at least {2 * REACH + 1} waypoints, got {n_waypoints}")
    D = jerk_matrix(n_waypoints)
    R, width = D.T @ D, 2 * REACH
    bands = np.zeros((width + 1, n_waypoints))
    for k in range(width + 1):
        bands[width - k, k:] = np.diagonal(R, k)
    return frozen(cholesky_banded(bands))  # type: ignore[return-value]


def jerk_matrix(n_waypoints: int) -> FloatArray:
    """Return the dense third differences (N + 12, N) of a reach; what lies outside the reach counts as zero.

    Row r stands at waypoint r - 6. Every padded row that sees a waypoint is included, so D'D is the quadratic form of a
    change that vanishes outside.
    """
    rows = n_waypoints + 2 * PADDING
    D = np.zeros((rows, n_waypoints))
    for row in range(rows):
        for offset, factor in zip(range(-REACH, REACH + 1), RULES[2], strict=True):
            column = row - PADDING + offset
            if 0 <= column < n_waypoints:
                D[row, column] += factor
    return D
