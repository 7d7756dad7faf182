"""Records a person who was never there, so that the package works and is tested without anybody's recordings.

A session goes as P1's went: the person stands at a table with eight places and reaches to one after the other and back,
in rounds, so that nothing about where somebody stands tells which place comes next. Hand paths
(`hand_path`), the body that follows (`reaching_body`) and the sensor (`depth_camera`) are modelled apart from each
other; this module is the session.

What is delivered is what a tracker would deliver: the posture of a frame is computed from its noisy points. A frame
whose points do not determine all 12 DoFs has no posture and is left out, points and all; nothing is filled in. A frame
that lacks only points that are not needed for the posture (legs, say) stays, with NaN for these.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np

from humanpred_ros import __version__
from humanpred_ros.errors import GoalUnreachableError, MotionError, UsageError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.kinect import KINECT12_DOFS, KinectSkeleton
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.depth_camera import DepthCamera, DepthCameraConfig, Recording
from humanpred_ros.motion.hand_path import HandPathConfig, draw_hand_path
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.reaching_body import BodyConfig, ReachingBody, slow_noise

#: Postures are delivered in whole steps of this size, metres and radians; library_b's have five decimals.
_POSTURE_STEP = 2.0**-17
#: A motion with fewer frames shows no reach.
_LEAST_FRAMES = 10


def table_grid(
    first_m: tuple[float, float, float] = (0.385, -1.455, 0.575),
    column_m: tuple[float, float, float] = (-0.228, 0.091, 0.004),
    row_m: tuple[float, float, float] = (0.125, 0.240, 0.010),
    columns: int = 4,
    rows: int = 2,
) -> tuple[tuple[float, float, float], ...]:
    """Return places on a table, row by row; class k is at place k.

    Defaults: the grid that fits library_a's goals best (within 3 cm; facts, section 2), with its numbering: 0 to 3
    near the person, from right to left, 4 to 7 behind them. They are 0.25 m apart, the rows 0.27 m.
    """
    first, column, row = np.asarray(first_m), np.asarray(column_m), np.asarray(row_m)
    places = [first + i * column + j * row for j in range(rows) for i in range(columns)]
    return tuple((float(x), float(y), float(z)) for x, y, z in places)


@dataclass(frozen=True)
class ReachGeneratorConfig:
    """A recording session.

    Attributes:
        name: of the library.
        motions_per_class: rounds; in every round each goal is reached once.
        goals_m: where the palm goes, class by class, in the tracker's frame.
        order: of the classes within a round.
        frame_id: of the tracker; x and y as library_a's, so that scenes made for it fit.
        rest_q: the person's average resting posture (12,): stands as in library_a, holds the arm as in library_b.
        rest_spread: its standard deviation (12,): the usual one (robust) of library_b's first frames, less what the
            tracker adds.
        round_share: share of that variance that is common to the motions of a round; the rest drifts from motion to
            motion.
        drift_memory: share of one motion's drift that is left at the next.
        goal_spread_m: standard deviation of where the palm stops, x, y, z.
        path, body, camera: how hand, body and sensor behave.
    """

    name: str = "synthetic_reaches"
    motions_per_class: int = 25
    goals_m: tuple[tuple[float, float, float], ...] = field(default_factory=table_grid)
    order: Literal["shuffled", "ascending"] = "shuffled"
    frame_id: str = "kinect"
    rest_q: tuple[float, ...] = (-0.169, -1.821, 0.763, 1.25, 0.087, 0.125, -0.010, 1.60, 0.12, -0.10, 0.090, 0.42)
    rest_spread: tuple[float, ...] = (0.03, 0.03, 0.01, 0.062, 0.014, 0.028, 0.003, 0.03, 0.045, 0.16, 0.008, 0.09)
    round_share: float = 0.45
    drift_memory: float = 0.7
    goal_spread_m: tuple[float, float, float] = (0.016, 0.020, 0.013)
    path: HandPathConfig = field(default_factory=HandPathConfig)
    body: BodyConfig = field(default_factory=BodyConfig)
    camera: DepthCameraConfig = field(default_factory=DepthCameraConfig)

    def __post_init__(self) -> None:
        n = len(KINECT12_DOFS)
        checked("goals_m", self.goals_m, ("K", 3), error=UsageError)
        checked("rest_q", self.rest_q, (n,), error=UsageError)
        for name, size in (("rest_spread", n), ("goal_spread_m", 3)):
            if (checked(name, getattr(self, name), (size,), error=UsageError) < 0).any():
                raise UsageError(f"{name}: wanted standard deviations, not negative, got {getattr(self, name)}")
        if self.motions_per_class < 1 or not self.goals_m:
            raise UsageError(
                f"synthetic library: wanted at least 1 motion per class and 1 goal, got {self.motions_per_class} "
                f"and {len(self.goals_m)}"
            )
        if not (0 <= self.round_share <= 1 and 0 <= self.drift_memory < 1):
            raise UsageError(
                f"synthetic library: wanted round_share within 0 to 1 and drift_memory from 0 to below 1, "
                f"got {self.round_share} and {self.drift_memory}"
            )
        if self.order not in ("shuffled", "ascending"):
            raise UsageError(f"order: wanted 'shuffled' or 'ascending', got {self.order!r}")


def generate_library(config: ReachGeneratorConfig, rng: np.random.Generator) -> MotionLibrary:
    """Return a library as one recording session gives it, in recording order; `index` is the round.

    The same config and a generator from the same seed give the same library. Provenance says that it is synthetic,
    and has the seed, the version and the config (JSON).

    Raises:
        GoalUnreachableError: a goal too far from the person.
        MotionError: a camera that loses so much that a motion has fewer than 10 frames.
    """
    provenance = {
        "source": "synthetic: computed by humanpred_ros, no person was recorded",
        "generator": f"humanpred_ros {__version__}",
        "seed": _seed_of(rng),
        "stamps": f"synthetic, {config.camera.rate_hz:g} Hz with jitter and lost frames",
        "config": json.dumps(asdict(config), sort_keys=True),
    }
    human = HumanModel.kinect12()
    body, skeleton = ReachingBody(human, config.body), KinectSkeleton(human)
    camera = DepthCamera(config.camera)
    _check_reachable(config, body)

    goals = np.array(config.goals_m)
    labels = [label for _ in range(config.motions_per_class) for label in _round_order(config, rng)]
    rests = _resting_postures(config, len(labels) + 1, rng)
    motions = []
    for n, label in enumerate(labels):
        goal = goals[label] + np.array(config.goal_spread_m) * rng.normal(size=3)
        path = draw_hand_path(body.palm_m(rests[n]), goal, body.palm_m(rests[n + 1]), config.path, rng)
        exposures = camera.exposures_s(path.duration_s)
        q = body.follow(path, exposures, rests[n], rng)
        recording = camera.observe(exposures, skeleton.points(q), rng)
        motions.append(_delivered(recording, skeleton, label, n // len(goals), config.frame_id))
    return MotionLibrary(config.name, tuple(motions), provenance)


def _delivered(recording: Recording, skeleton: KinectSkeleton, label: int, index: int, frame_id: str) -> Motion:
    """Return the motion a tracker delivers: the frames whose points determine a posture."""
    postures = skeleton.postures(recording.points_m)
    told = postures.complete
    if told.sum() < _LEAST_FRAMES:
        raise MotionError(
            f"synthetic motion {label}/{index}: wanted at least {_LEAST_FRAMES} frames with a posture, got "
            f"{told.sum()}; lower the camera's losses or raise its rate"
        )
    t_s = recording.t_s[told]
    return Motion(
        t_s=t_s - t_s[0],
        q=np.round(postures.q[told] / _POSTURE_STEP) * _POSTURE_STEP,
        dof_names=KINECT12_DOFS,
        label=label,
        index=index,
        frame_id=frame_id,
        points_m=recording.points_m[told],
    )


def _round_order(config: ReachGeneratorConfig, rng: np.random.Generator) -> list[int]:
    labels = np.arange(len(config.goals_m))
    return [int(label) for label in (rng.permutation(labels) if config.order == "shuffled" else labels)]


def _resting_postures(config: ReachGeneratorConfig, n: int, rng: np.random.Generator) -> FloatArray:
    """Draw where the person stands before each motion and after the last (n, 12): steps between rounds, slow drift."""
    dofs = len(config.rest_q)
    rounds = np.repeat(rng.normal(size=(n // len(config.goals_m) + 1, dofs)), len(config.goals_m), axis=0)[:n]
    if config.drift_memory > 0:
        drift = slow_noise(np.arange(n, dtype=np.float64), -1.0 / np.log(config.drift_memory), dofs, rng)
    else:
        drift = rng.normal(size=(n, dofs))
    deviation = np.sqrt(config.round_share) * rounds + np.sqrt(1.0 - config.round_share) * drift
    rests: FloatArray = np.array(config.rest_q) + np.array(config.rest_spread) * deviation
    return rests


def _check_reachable(config: ReachGeneratorConfig, body: ReachingBody) -> None:
    for label, goal in enumerate(np.array(config.goals_m)):
        miss = body.miss_m(goal, np.array(config.rest_q))
        if miss > 0.02:
            place = ", ".join(f"{value:.3f}" for value in goal)
            raise GoalUnreachableError(
                f"goal {label} at ({place}): wanted a place the person can reach, the palm stays {miss:.2f} m away "
                f"from it; move the goal or rest_q"
            )


def _seed_of(rng: np.random.Generator) -> str:
    """Return the seed with which the generator was made, if a new generator from it would give the same numbers."""
    bits = rng.bit_generator
    seeds = bits.seed_seq
    if not isinstance(seeds, np.random.SeedSequence) or type(bits)(seeds).state != bits.state:
        return "unknown: the generator had been used before"
    spawned = f", spawn key {seeds.spawn_key}" if seeds.spawn_key else ""
    return f"{seeds.entropy}{spawned} ({type(bits).__name__})"
