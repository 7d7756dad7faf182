"""What is said of one run, as plain data that tables, files and reports share."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class StepRow:
    """One replanning step, 1-based as in P1.

    Attributes:
        step: its number, the planner's.
        action: replan, keep (no better path was found), hold (no way was found), evade (out of the person's way) or
            missed (too late).
        t_s, percent: data time of the occupancy it was computed on; share of the human's motion over by then.
        best_class, best_probability: most probable class then, None without a posterior.
        costs: selection cost per goal, None where it has none.
        chosen: the chosen goal, empty if none.
        switched: the chosen goal differs from the previous step's.
        compute_ms: wall time the step took, None if not told.
        margin: by how much the chosen goal was cheaper than the next one, negative where habit decided; None if there
            was no choice.
        reason: the planner's explanation.
        out: why goals could not be chosen, by name.
        instead: "hold" or "evade" where the arm did that rather than work on the chosen goal, whether this step decided
            it or kept to it; else empty.
    """

    step: int
    action: str
    t_s: float
    percent: float | None
    best_class: int | None
    best_probability: float | None
    costs: Mapping[str, float | None]
    chosen: str
    switched: bool
    compute_ms: float | None
    margin: float | None = None
    reason: str = ""
    out: Mapping[str, str] = field(default_factory=dict)
    instead: str = ""

    @property
    def missed(self) -> bool:
        """Whether it came too late to be carried out."""
        return self.action == "missed"

    @property
    def effective(self) -> bool:
        """Whether the arm worked on the chosen goal because of it."""
        return not (self.missed or self.instead)


@dataclass(frozen=True)
class Switch:
    """A change of the chosen goal.

    Attributes:
        step: 1-based number of the step that decided it.
        step_in_effect: the step during which the robot acts on it, one later (P1 Fig. 4).
        t_s, percent: data time of the decision; share of the human's motion over by then.
        t_effect_s: when the new trajectory takes over, None if not told.
        goal_before, goal_after: names.
        reason: the planner's explanation.
    """

    step: int
    step_in_effect: int
    t_s: float
    percent: float | None
    t_effect_s: float | None
    goal_before: str
    goal_after: str
    reason: str = ""


@dataclass(frozen=True)
class Interruption:
    """A time in which the arm works on no goal, for one reason: it stops, or moves out of the person's way.

    It lasts until the arm is sent on or another way, or the run ends; `decisions` says how often it was decided.
    """

    t_s: float
    until_s: float
    decisions: int
    reason: str


@dataclass(frozen=True)
class Closest:
    """The least distance between robot and human: negative when they penetrate."""

    distance_m: float
    t_s: float
    percent: float | None
    robot_link: str
    human_body: str


@dataclass(frozen=True)
class Recognised:
    """Since when the true class was the most probable one up to the end of a movement; None if it never was so.

    Of several movements the first such one counts: a recorded reach may come with its return.
    """

    true_class: int
    t_s: float | None
    percent: float | None


@dataclass(frozen=True)
class Belief:
    """What a movement of the human was believed to be in the end: a classifier may find several, with rest between.

    Attributes:
        from_s, until_s: first and last posterior that tell classes apart.
        best_class, probability: the most probable class at the end, and its probability.
        since_s, since_percent: since when it was the most probable one up to then; share of the recorded motion over
            by then.
        unknown: probability at the end that the movement is of no class, 0 from classifiers that do not consider it.
        unknown_max, unknown_max_s: its maximum over the movement, and when that was.
    """

    from_s: float
    until_s: float
    best_class: int
    probability: float
    since_s: float
    since_percent: float | None
    unknown: float
    unknown_max: float
    unknown_max_s: float

    @property
    def rather_unknown(self) -> bool:
        """Whether no class at all is more probable than the most probable class."""
        return self.unknown > self.probability


@dataclass(frozen=True)
class ReliabilityBin:
    """Voxels whose predicted probability was at least `low` and less than `high`.

    Attributes:
        low, high: the last bin holds `high` = 1, too.
        count: how many, over all occupancies compared.
        probability: mean of what was predicted, None without voxels.
        observed: share of them that came true, None without voxels.
    """

    low: float
    high: float
    count: int
    probability: float | None
    observed: float | None


@dataclass(frozen=True)
class OccupancyCalibration:
    """Predicted occupancies beside the voxels the body really swept from then on.

    Attributes:
        occupancies: how many were compared.
        voxels: voxels in `bins`, over all of them.
        error: expected calibration error: mean over these voxels of |mean probability - observed share| of their
            bin, None without any.
        missed: share of the swept voxels that were given less than 1 %, None if nothing was swept.
        expected_voxels, swept_voxels: sum of the probabilities, and voxels really swept; means per occupancy.
        squared_error: sum over voxels of (p - y)^2, mean per occupancy (divided by the grid's size: Brier score).
        squared_error_current: the same of the baseline that predicts the current posture only.
        squared_error_ratio: the one over the other, None where the baseline made no error.
        bins: reliability table.
    """

    occupancies: int
    voxels: int
    error: float | None
    missed: float | None
    expected_voxels: float
    swept_voxels: float
    squared_error: float
    squared_error_current: float
    squared_error_ratio: float | None
    bins: tuple[ReliabilityBin, ...]


@dataclass(frozen=True)
class LatencyFigures:
    """Median, 99th percentile and maximum of a latency over `count` samples; None without samples."""

    count: int
    median_ms: float | None
    p99_ms: float | None
    max_ms: float | None


@dataclass(frozen=True)
class Reached:
    """The goal the arm ended at: since when it has stayed there, and the final largest joint error."""

    goal: str
    t_s: float
    error_rad: float


@dataclass(frozen=True)
class RunSummary:
    """What is said of a run, in tables, files and reports.

    Attributes:
        outcome: one sentence.
        facts: what the recorder was told about the run.
        duration_s: data time; `wall_s` wall time; `motion_duration_s` the human's motion.
        goals: names of the goals, in the planner's order.
        steps, switches: see their types.
        holds, evasions: when the arm stopped, and when it moved out of the person's way.
        actions: how many decisions were to do what, by action.
        missed: number of replanning steps that came too late.
        closest: over the whole run, None if it could not be evaluated.
        recognised: how early the human's motion was recognised, None if its true class is not known.
        beliefs: what each movement was taken for, in time order; none without a posterior.
        calibration: whether the predicted occupancy came true, by part of the run; empty if that cannot be told.
        latency: by name.
        planning: wall time of one replanning step.
        reached: None if the arm did not end at a goal.
        peak_velocity: largest joint speed as a share of the joint's limit, None if unknown.
        counts: number of postures, occupancies, decisions, trajectories and robot states recorded.
        notes: what could not be read or evaluated, and why.
    """

    outcome: str
    facts: Mapping[str, str]
    duration_s: float
    wall_s: float
    motion_duration_s: float
    goals: tuple[str, ...]
    steps: tuple[StepRow, ...]
    switches: tuple[Switch, ...]
    holds: tuple[Interruption, ...]
    missed: int
    closest: Closest | None
    recognised: Recognised | None
    beliefs: tuple[Belief, ...]
    calibration: Mapping[str, OccupancyCalibration]
    latency: Mapping[str, LatencyFigures]
    planning: LatencyFigures
    reached: Reached | None
    peak_velocity: float | None
    counts: Mapping[str, int]
    evasions: tuple[Interruption, ...] = ()
    actions: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def to_json(self) -> str:
        """Return the summary as strict JSON: numbers that are not finite become null."""
        return json.dumps(_plain(dataclasses.asdict(self)), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
