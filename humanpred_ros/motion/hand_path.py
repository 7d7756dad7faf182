"""Where a hand goes on a reach and back, so that synthetic motions have the shape of people's and not of a robot's.

A path is a sum of strokes, each with a bell-shaped speed: one out, often one that corrects it, one back. Overlapping
strokes simply add up, which is how corrections blend into a reach in recordings of people.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry.checks import FloatArray, checked


@dataclass(frozen=True)
class HandPathConfig:
    """How a person moves the hand; medians and spreads.

    Times: library_a's recorded stamps say that the middle half of a reach takes 0.46 s, library_b's phases how that
    compares with resting and returning (its motions then last 2.5 to 4 s). Shapes are library_b's.

    Attributes:
        wait_s: rest before the hand moves, (mean, standard deviation); the hand's first 5 cm take another 0.2 s.
        wait_least_s: shortest rest.
        reach_s, return_s: length of the strokes out and back.
        dwell_s: mean of the exponentially distributed rest at the goal, after correcting.
        tail_s: longest recording after the return (uniform from 0).
        spread: standard deviation of the logarithm of each of these lengths.
        tempo_spread: the same for a factor common to all parts of one motion.
        tail_of_return: share of the return that is always recorded; people stop a recording before the hand lies still.
        correction_share: share of the reaches that are corrected.
        correction_miss: standard deviation of the first stroke's miss per axis, as a share of the distance.
        correction_s: length of a correcting stroke.
        rise_out, rise_back: how much the hand rises above the straight line, as a share of the distance (mean).
        bow_spread: standard deviation of that, and of the deviation in the other directions.
        skew_spread: standard deviation of the exponent that makes a stroke start or end faster.
    """

    wait_s: tuple[float, float] = (0.42, 0.18)
    wait_least_s: float = 0.08
    reach_s: float = 1.15
    return_s: float = 1.70
    dwell_s: float = 0.15
    tail_s: float = 0.15
    spread: float = 0.10
    tempo_spread: float = 0.08
    tail_of_return: float = 0.75
    correction_share: float = 0.5
    correction_miss: float = 0.06
    correction_s: float = 0.40
    rise_out: float = 0.06
    rise_back: float = 0.17
    bow_spread: float = 0.05
    skew_spread: float = 0.08

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value).all() and np.min(value) >= 0):
                raise UsageError(f"hand path: wanted {field.name} finite and not negative, got {value}")
        for name in ("wait_least_s", "reach_s", "return_s", "correction_s", "tail_of_return"):
            if getattr(self, name) == 0:
                raise UsageError(f"hand path: wanted {name} above 0, got 0")
        for name in ("correction_share", "tail_of_return"):
            if getattr(self, name) > 1:
                raise UsageError(f"hand path: wanted {name} to be a share, 0 to 1, got {getattr(self, name)}")


@dataclass(frozen=True)
class Stroke:
    """One movement that adds `step_m` to where the hand is.

    Attributes:
        start_s, duration_s: when.
        step_m: (3,) from where to where.
        bow_m: (3,) deviation from the straight line, reached half way.
        skew: exponent on the elapsed share of the stroke; below 1 it starts faster.
    """

    start_s: float
    duration_s: float
    step_m: FloatArray
    bow_m: FloatArray
    skew: float = 1.0

    def at(self, t_s: FloatArray) -> FloatArray:
        """Return what the stroke has added at times (T,), as (T, 3)."""
        u = np.clip((t_s - self.start_s) / self.duration_s, 0.0, 1.0) ** self.skew
        share = (u**3 * (10.0 - 15.0 * u + 6.0 * u**2))[:, None]  # least jerk
        added: FloatArray = share * self.step_m + 4.0 * share * (1.0 - share) * self.bow_m
        return added


@dataclass(frozen=True)
class HandPath:
    """A hand's path over time.

    Attributes:
        start_m: (3,) where the hand rests.
        strokes: what moves it; times before the first and after the last are rest.
        arrival_s: when it is at the goal for the first time (corrections included).
        duration_s: length of the recording; it may end just before the last stroke does.
    """

    start_m: FloatArray
    strokes: tuple[Stroke, ...]
    arrival_s: float
    duration_s: float

    def at(self, t_s: ArrayLike) -> FloatArray:
        """Return the hand's positions (T, 3) at times (T,), seconds from the start of the recording."""
        times = checked("t_s", t_s, ("T",))
        place = np.tile(self.start_m, (len(times), 1))
        for stroke in self.strokes:
            place += stroke.at(times)
        return place


def draw_hand_path(
    start_m: ArrayLike, goal_m: ArrayLike, rest_m: ArrayLike, config: HandPathConfig, rng: np.random.Generator
) -> HandPath:
    """Return a path from `start_m` (3,) to `goal_m` (3,) and back to `rest_m` (3,); z is up."""
    start, goal = checked("start_m", start_m, (3,)), checked("goal_m", goal_m, (3,))
    rest = checked("rest_m", rest_m, (3,))
    tempo = rng.lognormal(0.0, config.tempo_spread)
    reach_s, correction_s, return_s = (
        tempo * median * rng.lognormal(0.0, config.spread)
        for median in (config.reach_s, config.correction_s, config.return_s)
    )
    leave_s = max(config.wait_least_s, tempo * rng.normal(*config.wait_s))
    distance = float(np.linalg.norm(goal - start))

    miss = np.zeros(3)
    if rng.random() < config.correction_share:
        miss = config.correction_miss * distance * rng.normal(size=3)
    strokes = [_stroke(leave_s, reach_s, goal + miss - start, config.rise_out, config, rng)]
    arrival_s = leave_s + reach_s
    if miss.any():
        # A correction starts before the reach has ended: eyes and arm do not wait for each other.
        correct_s = leave_s + rng.uniform(0.65, 0.9) * reach_s
        strokes.append(Stroke(correct_s, correction_s, -miss, np.zeros(3)))
        arrival_s = max(arrival_s, correct_s + correction_s)
    return_at_s = arrival_s + rng.exponential(config.dwell_s)
    strokes.append(_stroke(return_at_s, return_s, rest - goal, config.rise_back, config, rng))
    end_s = return_at_s + return_s * rng.uniform(config.tail_of_return, 1.0) + rng.uniform(0.0, config.tail_s)
    return HandPath(start, tuple(strokes), arrival_s, end_s)


def _stroke(
    start_s: float, duration_s: float, step_m: FloatArray, rise: float, config: HandPathConfig, rng: np.random.Generator
) -> Stroke:
    """Draw a stroke that is bowed upwards by `rise` on average, and somewhat in every direction."""
    bow = np.linalg.norm(step_m) * (np.array([0.0, 0.0, rise]) + config.bow_spread * rng.normal(size=3))
    skew = float(np.clip(rng.normal(1.0, config.skew_spread), 0.7, 1.4))
    return Stroke(start_s, duration_s, step_m, bow, skew)
