"""A reach predicted as others were seen to depart from the minimum-jerk line: simple, and hard to beat.

People do not move on a straight line in posture space: they bend the elbow and lift the hand first, and turn the
shoulder late. What a recorded reach has beyond the minimum-jerk line between its ends, as a function of the share of
the duration, is its bow. A long reach bows more than a short one; like the height of an arc of given curvature over
its chord, the bow is taken to grow with the square of the wrist's way. The common shape is fitted by least squares
with one more observation, of no bow at all, so that few recordings are not believed too much.

Not in P2. Postures are relative to the body but for the pelvis, which hardly moves, so nothing refers to the room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from humanpred_ros.errors import MotionError
from humanpred_ros.geometry.checks import FloatArray, frozen
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.reach_recordings import ReachRecording
from humanpred_ros.reaching.reach_task import ReachTask
from humanpred_ros.reaching.trivial import minimum_jerk

WRIST = "right_wrist"


@dataclass(frozen=True)
class BowConfig:
    """How the bow is learned; chosen on P2's seven, leaving one out.

    Attributes:
        growth: the bow grows with this power of the wrist's way.
        doubt: weight of the observation without bow, in mean observations.
        n_phases: phases at which the shape is kept.
    """

    growth: float = 2.0
    doubt: float = 1.0
    n_phases: int = 101


@dataclass(frozen=True, eq=False)
class BowedLine:
    """Predicts the minimum-jerk line and a learned bow.

    Attributes:
        shape: (P, J) bow at even phases of a reach whose wrist goes one metre.
        model: the human.
        config: settings.
    """

    shape: FloatArray
    model: HumanModel
    config: BowConfig

    def predict(self, task: ReachTask, rng: np.random.Generator) -> FloatArray:
        """Return the postures (n, J), ends exact; chance plays no part."""
        phases = np.linspace(0.0, 1.0, len(self.shape))
        bow = np.stack([np.interp(task.phase, phases, column) for column in self.shape.T], axis=1)
        size = wrist_way_m(self.model, task.start, task.goal) ** self.config.growth
        postures: FloatArray = _line(task.phase, task.start, task.goal) + size * bow
        return postures


def learn_bow(recordings: Sequence[ReachRecording], model: HumanModel, config: BowConfig | None = None) -> BowedLine:
    """Return the predictor with the bow of recorded reaches; those unfit for learning are left out.

    Raises:
        MotionError: nothing to learn from, or wrists that go nowhere.
    """
    config = config or BowConfig()
    usable = [recording.active for recording in recordings if recording.usable_for_learning]
    if not usable:
        raise MotionError("bow: wanted at least one recording fit for learning, got none")
    sizes = np.array([wrist_way_m(model, motion.q[0], motion.q[-1]) ** config.growth for motion in usable])
    if not sizes.any():
        raise MotionError("bow: wanted reaches, the wrist ends where it began in all recordings")
    phases = np.linspace(0.0, 1.0, config.n_phases)
    bows = []
    for motion in usable:
        phase = (motion.t_s - motion.t_s[0]) / motion.duration_s
        beyond = motion.q - _line(phase, motion.q[0], motion.q[-1])
        bows.append(np.stack([np.interp(phases, phase, column) for column in beyond.T], axis=1))
    squares = sizes**2
    shape = np.tensordot(sizes, np.array(bows), axes=1) / (squares.sum() + config.doubt * squares.mean())
    return BowedLine(frozen(shape), model, config)  # type: ignore[arg-type]


def wrist_way_m(model: HumanModel, start: FloatArray, goal: FloatArray) -> float:
    """Return how far apart the wrist is in two postures (J,)."""
    places = model.forward(np.stack([start, goal]))[WRIST]
    return float(np.linalg.norm(places[1] - places[0]))


def _line(phase: FloatArray, start: FloatArray, goal: FloatArray) -> FloatArray:
    done = minimum_jerk(phase)[:, None]
    postures: FloatArray = (1.0 - done) * start + done * goal
    return postures
