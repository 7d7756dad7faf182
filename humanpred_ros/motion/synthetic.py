"""Makes a synthetic motion library: the package works and is tested without recordings of people.

A session is like P1's: the person stands at a table with eight places and reaches to one after the other and back, in
rounds, so that where somebody stands does not tell which place comes next. Hand and body (`synthetic_person`) and the
depth camera are modelled independently of each other.

The result is what a tracker delivers: the posture of a frame is computed from its noisy points. A frame whose points do
not determine all 12 DoFs is left out; nothing is filled in. A frame that lacks only points that the posture does not
need (legs, say) stays, with NaN for these.
"""

from __future__ import annotations

import json
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros import __version__
from humanpred_ros.errors import GoalUnreachableError, MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.human.kinect import KINECT12_DOFS, KinectSkeleton
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import SKELETON_POINTS, Motion, MotionLibrary
from humanpred_ros.motion.synthetic_person import BodyConfig, HandPathConfig, ReachingBody, draw_hand_path, slow_noise
from humanpred_ros.settings import Settings, setting

#: Postures are delivered in whole steps of this size, metres and radians; library_b's have five decimals.
_POSTURE_STEP = 2.0**-17
#: A motion with fewer frames shows no reach.
_LEAST_FRAMES = 10


_LIMBS = np.array([name.endswith(("elbow", "hand", "knee", "foot")) for name in SKELETON_POINTS])
_TORSO = SKELETON_POINTS.index("torso")
#: Lever that turns an error of the trunk's place into one of its direction, metres; half a trunk's size.
_LEVER_M = 0.25
#: Behind the table, most of the time.
_LEGS = np.array([name.endswith(("knee", "foot")) for name in SKELETON_POINTS])
#: Frames after which smoothing has forgotten how it began.
_SETTLING = 15
#: Independent errors of a frame: three of each point, and shift and turn of the trunk.
_ERRORS = 3 * len(SKELETON_POINTS) + 6


def table_grid(
    first_m: tuple[float, float, float] = (0.385, -1.455, 0.575),
    column_m: tuple[float, float, float] = (-0.228, 0.091, 0.004),
    row_m: tuple[float, float, float] = (0.125, 0.240, 0.010),
    columns: int = 4,
    rows: int = 2,
) -> tuple[tuple[float, float, float], ...]:
    """Return places on a table, row by row; class k is at place k.

    Defaults: the grid that fits library_a's places best (within 3 cm), with its numbering: 0 to 3
    near the person, from right to left, 4 to 7 behind them. They are 0.25 m apart, the rows 0.27 m.
    """
    first, column, row = np.asarray(first_m), np.asarray(column_m), np.asarray(row_m)
    places = [first + i * column + j * row for j in range(rows) for i in range(columns)]
    return tuple((float(x), float(y), float(z)) for x, y, z in places)


class DepthCameraConfig(Settings):
    """A camera like the first Kinect with OpenNI's tracker.

    Sizes are chosen so that the resulting postures tremble as much as library_b's at rest (palm 3 mm within 0.3 s,
    1 mm from frame to frame). Trackers fit the trunk as one piece: in library_b its twist TorsoZ stays within 0.004 rad
    at rest, while its yaw varies by 0.08. So the trunk shifts as a whole, and turns by as much on a lever of 0.25 m;
    each of its points has a small error of its own. Elbows, hands, knees and feet are thin and move: their errors are
    larger, and independent of each other.
    """

    position_m: tuple[float, float, float] = setting(
        (0.25, 0.75, 1.10), "the lens, in the tracker's frame; depth is the distance from it", unit="m"
    )
    rate_hz: float = setting(30.0, "frames per second", unit="Hz", low=1e-3)
    stamp_jitter_s: float = setting(0.0015, "standard deviation of the stamps' delay", unit="s", low=0.0)
    noise_m: float = setting(0.0025, "deviation of the trunk across the line of sight, unsmoothed", unit="m", low=0.0)
    depth_factor: float = setting(2.0, "how much larger errors are along the line of sight", low=0.0)
    limb_factor: float = setting(1.6, "how much larger errors are for elbows, hands, knees and feet", low=0.0)
    trunk_play: float = setting(0.05, "each trunk point's own error as a share of the trunk's", low=0.0)
    smoothing: float = setting(0.6, "share of the previous output in each output", low=0.0, high=0.999)
    wander_m: float = setting(0.004, "deviation of the slow error (the body's model slips)", unit="m", low=0.0)
    wander_s: float = setting(0.8, "its time constant", unit="s", low=1e-9)
    frame_loss: float = setting(0.01, "share of frames that never arrive", low=0.0, high=0.999)
    losses_per_s: float = setting(0.015, "how often a point gets lost", unit="1/s", low=0.0)
    leg_losses_per_s: float = setting(0.25, "the same for knees and feet, behind the table", unit="1/s", low=0.0)
    loss_s: float = setting(0.10, "mean duration of a loss", unit="s", low=1e-9)
    step_m: float = setting(2.0**-13, "points are delivered in whole steps of this size", unit="m", low=1e-12)


class ReachGeneratorConfig(Settings):
    """A recording session."""

    name: str = setting("synthetic_reaches", "name of the library")
    motions_per_class: int = setting(25, "rounds; in every round each place is reached once", low=1)
    goals_m: tuple[tuple[float, float, float], ...] = setting(
        table_grid(), "where the palm goes, class by class, in the tracker's frame", unit="m"
    )
    order: Literal["shuffled", "ascending"] = setting("shuffled", "order of the classes within a round")
    frame_id: str = setting("kinect", "frame of the tracker; x and y as library_a's, so that scenes made for it fit")
    rest_q: tuple[float, ...] = setting(
        (-0.169, -1.821, 0.763, 1.25, 0.087, 0.125, -0.010, 1.60, 0.12, -0.10, 0.090, 0.42),
        "the person's average resting posture: stands as in library_a, holds the arm as in library_b",
    )
    rest_spread: tuple[float, ...] = setting(
        (0.03, 0.03, 0.01, 0.062, 0.014, 0.028, 0.003, 0.03, 0.045, 0.16, 0.008, 0.09),
        "its standard deviation: the usual one (robust) of library_b's first frames, less what the tracker adds",
        low=0.0,
    )
    round_share: float = setting(0.45, "share of that variance common to a round's motions", low=0.0, high=1.0)
    drift_memory: float = setting(0.7, "share of one motion's drift that is left at the next", low=0.0, high=0.999)
    goal_spread_m: tuple[float, float, float] = setting(
        (0.016, 0.020, 0.013), "standard deviation of where the palm stops, x, y, z", unit="m", low=0.0
    )
    path: HandPathConfig = setting(HandPathConfig(), "how the hand behaves")
    body: BodyConfig = setting(BodyConfig(), "how the body behaves")
    camera: DepthCameraConfig = setting(DepthCameraConfig(), "how the sensor behaves")

    def check(self) -> None:
        """Refuse postures of another length and a session without places."""
        for name in ("rest_q", "rest_spread"):
            checked(name, getattr(self, name), (len(KINECT12_DOFS),), error=SettingsError)
        if not checked("goals_m", self.goals_m, ("K", 3), error=SettingsError).size:
            raise SettingsError("goals_m: wanted at least one place, got none")


class Observed(NamedTuple):
    """What arrives of a person."""

    t_s: FloatArray  #: (T,) stamps, strictly increasing
    points_m: FloatArray  #: (T, 15, 3) in the order of SKELETON_POINTS, NaN where a point was lost


def observe(
    exposures_s: FloatArray, points_m: FloatArray, config: DepthCameraConfig, rng: np.random.Generator
) -> Observed:
    """Return what arrives of a person whose points at the exposures (T,) are `points_m` (T, 15, 3).

    Raises:
        ArrayError: wrong shapes, or points that are not finite.
    """
    t = checked("exposures_s", exposures_s, ("T",))
    true = checked("points_m", points_m, (len(t), len(SKELETON_POINTS), 3))
    # The tracker has watched the person before the recording starts: its smoothing has settled by then.
    t = np.concatenate([t[0] - np.arange(_SETTLING, 0, -1) / config.rate_hz, t])
    true = np.concatenate([np.repeat(true[:1], _SETTLING, axis=0), true])
    noise = config.wander_m * _errors(true, slow_noise(t, config.wander_s, _ERRORS, rng), config)
    noise += config.noise_m * _errors(true, rng.normal(size=(len(t), _ERRORS)), config)
    sight = true - np.asarray(config.position_m)
    sight /= np.linalg.norm(sight, axis=-1, keepdims=True)
    noise += (config.depth_factor - 1.0) * (noise * sight).sum(axis=-1, keepdims=True) * sight
    seen = np.where(_losses(len(t), config, rng)[..., None], np.nan, true + noise)
    share = config.smoothing
    for k in range(1, len(seen)):  # after a loss the tracker's smoothing starts again
        seen[k] = np.where(np.isnan(seen[k - 1]), seen[k], share * seen[k - 1] + (1.0 - share) * seen[k])
    seen = np.round(seen[_SETTLING:] / config.step_m) * config.step_m
    # At most a third of a period either way: stamps keep their order whatever the jitter.
    jitter = np.clip(config.stamp_jitter_s * rng.normal(size=len(t)), -0.3 / config.rate_hz, 0.3 / config.rate_hz)
    arrived = rng.random(len(seen)) >= config.frame_loss
    return Observed((t + jitter)[_SETTLING:][arrived], seen[arrived])


def _errors(true: FloatArray, noise: FloatArray, config: DepthCameraConfig) -> FloatArray:
    """Return errors (T, 15, 3) in units of the trunk's, from unit noise (T, 51): points, trunk's shift and turn."""
    own = noise[:, :-6].reshape(true.shape)
    shift, turn = noise[:, None, -6:-3], noise[:, None, -3:] / _LEVER_M
    trunk = shift + np.cross(turn, true - true[:, _TORSO : _TORSO + 1]) + config.trunk_play * own
    errors: FloatArray = np.where(_LIMBS[:, None], config.limb_factor * own, trunk)
    return errors


def _losses(n: int, config: DepthCameraConfig, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Draw which points are lost when (T, 15): each comes and goes as a two-state Markov chain."""
    begin = 1.0 - np.exp(-np.where(_LEGS, config.leg_losses_per_s, config.losses_per_s) / config.rate_hz)
    end = 1.0 - np.exp(-1.0 / (config.loss_s * config.rate_hz))
    chance = rng.random((n, len(SKELETON_POINTS)))
    lost = np.zeros((n + 1, len(SKELETON_POINTS)), dtype=bool)
    for k in range(n):
        lost[k + 1] = np.where(lost[k], chance[k] >= end, chance[k] < begin)
    return lost[1:]


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
        "config": json.dumps(config.model_dump(), sort_keys=True),
    }
    human = HumanModel.kinect12()
    body, skeleton = ReachingBody(human, config.body), KinectSkeleton(human)
    goals, average = np.array(config.goals_m), np.array(config.rest_q)
    for label, goal in enumerate(goals):
        if (miss := body.miss_m(goal, average)) > 0.02:
            place = ", ".join(f"{value:.3f}" for value in goal)
            raise GoalUnreachableError(
                f"goal {label} at ({place}): wanted a place the person can reach, the palm stays {miss:.2f} m away "
                f"from it; move the goal or rest_q"
            )
    labels: list[int] = []
    for _ in range(config.motions_per_class):
        labels += (rng.permutation(len(goals)) if config.order == "shuffled" else np.arange(len(goals))).tolist()
    rests = _resting_postures(config, len(labels) + 1, rng)
    motions = []
    for n, label in enumerate(labels):
        goal = goals[label] + np.array(config.goal_spread_m) * rng.normal(size=3)
        path = draw_hand_path(body.palm_m(rests[n]), goal, body.palm_m(rests[n + 1]), config.path, rng)
        exposures = np.arange(int(path.duration_s * config.camera.rate_hz) + 1) / config.camera.rate_hz
        q = body.follow(path, exposures, rests[n], rng)
        recording = observe(exposures, skeleton.points(q), config.camera, rng)
        motions.append(_delivered(recording, skeleton, str(label), n // len(goals), config.frame_id))
    return MotionLibrary(config.name, tuple(motions), provenance)


def _delivered(recording: Observed, skeleton: KinectSkeleton, label: str, index: int, frame_id: str) -> Motion:
    """Return the motion a tracker delivers: the frames whose points determine a posture."""
    postures = skeleton.postures(recording.points_m)
    usable = postures.complete
    if usable.sum() < _LEAST_FRAMES:
        raise MotionError(
            f"synthetic motion {label}/{index}: wanted at least {_LEAST_FRAMES} frames with a posture, got "
            f"{usable.sum()}; lower the camera's losses or raise its rate"
        )
    t_s = recording.t_s[usable]
    q = np.round(postures.q[usable] / _POSTURE_STEP) * _POSTURE_STEP
    return Motion(t_s - t_s[0], q, KINECT12_DOFS, label, index, frame_id, recording.points_m[usable])


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


def _seed_of(rng: np.random.Generator) -> str:
    """Return the seed with which the generator was made, if a new generator from it would give the same numbers."""
    bits = rng.bit_generator
    seeds = bits.seed_seq
    if not isinstance(seeds, np.random.SeedSequence) or type(bits)(seeds).state != bits.state:
        return "unknown: the generator had been used before"
    spawned = f", spawn key {seeds.spawn_key}" if seeds.spawn_key else ""
    return f"{seeds.entropy}{spawned} ({type(bits).__name__})"
