"""Flags tracking errors in a library, and changes or drops only what it is asked to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.motion import Motion, MotionLibrary, is_angle, unwrap_angles

#: Reasons of flags, with the unit of their value and what they mean.
REASONS = {
    "gap": ("s", "time step much longer than the others"),
    "wrap": ("rad", "angle passes a whole turn (unwrapping removes it)"),
    "jump": ("1/s", "one-frame step faster than a human"),
    "wild": ("m", "pelvis outside any room"),
    "goal": ("m", "goal far from those of its class"),
    "label": ("m", "goal far from those of its class, and where another class has them"),
}
#: Reasons for which a motion is not learned from.
DROP_REASONS = frozenset({"wild", "goal", "label"})

#: A median absolute deviation times this estimates a Gaussian's standard deviation.
_MAD_TO_SD = 1.4826


# What counts as wrong. The limits of speed are own judgement: shoulder and elbow of a quick reach stay below about 10
# rad/s; a person at a table moves at less than 1 m/s. Six deviations are more than the customary 3.5: distances
# scatter less regularly than a Gaussian does, and a good motion lost costs more than a fair one kept. The least noise
# is a depth camera's of the hand; with it a library without noise has no outliers.
_GAP_FACTOR = 5.0  #: a time step longer than this many median steps is a gap
_JOINT_SPEED_RAD_S = 30.0  #: faster one-frame steps of a joint are jumps
_SLIDE_SPEED_M_S = 5.0  #: faster one-frame steps of a DoF in metres are jumps
_ISOLATION = 5.0  #: a jump is also this many times the median step of the frames around it
_ROOM_M = 5.0  #: a pelvis this far from the library's median has left the room
_GOAL_DEVIATIONS = 6.0  #: a goal beyond this many robust standard deviations is far
_GOAL_NOISE_M = 0.02  #: the robust standard deviation is at least this
_LABEL_DEVIATIONS = 3.5  #: a far goal within this of another class's is mislabelled
_LEAST_MOTIONS = 4  #: classes with fewer motions have no usual goal


@dataclass(frozen=True)
class Flag:
    """Something suspicious."""

    motion: str  #: name, `class/index`
    frame: int | None  #: the frame at which it shows, None if the whole motion is meant
    dof: str | None  #: the DoF, None if no single one is meant
    reason: str  #: a key of REASONS
    value: float  #: how large, in the reason's unit (jumps: rad/s or m/s)

    def __str__(self) -> str:
        where = "" if self.frame is None else f", frame {self.frame}"
        which = "" if self.dof is None else f", {self.dof}"
        return f"{self.motion}{where}{which}: {REASONS[self.reason][1]} ({self.value:.3g} {REASONS[self.reason][0]})"


def flag_library(
    library: MotionLibrary,
    *,
    model: HumanModel | None = None,
) -> tuple[Flag, ...]:
    """Return everything suspicious in a library, motion by motion; changes nothing.

    Goals are compared by medians: the goal of a motion is where the hand is farthest from where it started,
    which is the end of a reach and the turning point of a reach and return.

    Args:
        library: any.
        model: the human whose hand is looked at; the one with the library's DoFs if None.

    Raises:
        HumanModelError: the library's DoFs are not the model's.
    """
    model = model or human_with(library.dof_names)
    model.check_dofs(library.dof_names)
    flags: list[Flag] = []
    pelvis = [d for d, name in enumerate(library.dof_names) if name.startswith("PelvisTrans")]
    home = np.median(np.concatenate([motion.q[:, pelvis] for motion in library]), axis=0)
    goals = {motion.name: goal_m(motion, model) for motion in library}
    far = {flag.motion: flag for flag in _far_goals(library, goals)}
    for motion in library:
        flags += _gaps(motion)
        flags += _steps(motion)
        flags += _wild(motion, pelvis, home)
        if motion.name in far:
            flags.append(far[motion.name])
    return tuple(flags)


def clean_library(
    library: MotionLibrary,
    *,
    drop: bool = False,
    model: HumanModel | None = None,
) -> MotionLibrary:
    """Return the library with angles unwrapped and, only if asked, without motions flagged wild or off their goal.

    What was done is added to the provenance under `cleaning`.

    Raises:
        HumanModelError: motions are to be dropped and the library's DoFs are not the model's.
        LibraryFormatError: nothing would be left.
    """
    motions = tuple(unwrap_angles(motion) for motion in library)
    changed = sum(new is not old for new, old in zip(motions, library, strict=True))
    library = replace(library, motions=motions)
    done = [f"unwrapped the angles of {changed} motions"]
    if drop:
        reasons: dict[str, str] = {}
        for flag in flag_library(library, model=model):
            if flag.reason in DROP_REASONS:
                reasons.setdefault(flag.motion, flag.reason)
        if len(reasons) == len(library):
            raise LibraryFormatError(
                f"library {library.name}: wanted some motions left, all {len(library)} are flagged; "
                "look at the flags, or do not drop"
            )
        library = library.select(lambda motion: motion.name not in reasons)
        named = ", ".join(f"{name} ({reason})" for name, reason in reasons.items())
        done.append(f"dropped {named}" if named else "dropped none")
    before = library.provenance.get("cleaning")
    text = "; ".join([before, *done] if before else done)
    return replace(library, provenance={**library.provenance, "cleaning": text})


def goal_m(motion: Motion, model: HumanModel, hand: str = "right_palm") -> FloatArray:
    """Return the (3,) position of the hand where it is farthest from its start, in the motion's frame."""
    path = model.forward(motion.q)[hand]
    farthest: FloatArray = path[np.argmax(np.linalg.norm(path - path[0], axis=1))]
    return farthest


def _gaps(motion: Motion) -> Iterator[Flag]:
    step = np.diff(motion.t_s)
    for k in np.flatnonzero(step > _GAP_FACTOR * np.median(step)):
        yield Flag(motion.name, int(k) + 1, None, "gap", float(step[k]))


def _steps(motion: Motion) -> Iterator[Flag]:
    """Yield wraps and jumps, frame by frame."""
    raw, step = np.diff(motion.q, axis=0), np.diff(unwrap_angles(motion).q, axis=0)
    angle = np.array([is_angle(name) for name in motion.dof_names])
    speed = np.abs(step) / np.diff(motion.t_s)[:, None]
    fast = speed > np.where(angle, _JOINT_SPEED_RAD_S, _SLIDE_SPEED_M_S)
    wrap = np.logical_and(angle, np.abs(raw) > np.pi)
    for k, d in np.argwhere(np.logical_or(fast, wrap)):
        frame, name = int(k) + 1, motion.dof_names[d]
        if wrap[k, d]:
            yield Flag(motion.name, frame, name, "wrap", float(abs(raw[k, d])))
        around = np.abs(step[max(0, k - 5) : k + 6, d])  # 11 steps, some 0.2 s of a depth camera's stream
        if fast[k, d] and abs(step[k, d]) > _ISOLATION * np.median(around):
            yield Flag(motion.name, frame, name, "jump", float(speed[k, d]))


def _wild(motion: Motion, pelvis: list[int], home: FloatArray) -> Iterator[Flag]:
    away = motion.q[:, pelvis] - home
    distance = np.linalg.norm(away, axis=1)
    if distance.max() > _ROOM_M:
        frame = int(np.argmax(distance > _ROOM_M))
        dof = motion.dof_names[pelvis[int(np.argmax(np.abs(away[frame])))]]
        yield Flag(motion.name, frame, dof, "wild", float(distance.max()))


def _far_goals(library: MotionLibrary, goals: dict[str, FloatArray]) -> Iterator[Flag]:
    counts = Counter(motion.label for motion in library)
    judged = [label for label in library.labels if counts[label] >= _LEAST_MOTIONS]
    if not judged:
        return
    centre = {label: np.median([goals[m.name] for m in library.of_class(label)], axis=0) for label in judged}
    distance = {
        motion.name: {label: float(np.linalg.norm(goals[motion.name] - centre[label])) for label in judged}
        for motion in library
    }
    # The spread is taken over all classes together: one class alone has too few motions for it.
    own = np.array([distance[m.name][m.label] for m in library if m.label in centre])
    median = float(np.median(own))
    deviation = max(_MAD_TO_SD * float(np.median(np.abs(own - median))), _GOAL_NOISE_M)
    for motion in library:
        if motion.label not in centre:
            continue
        value = distance[motion.name][motion.label]
        if value <= median + _GOAL_DEVIATIONS * deviation:
            continue
        nearest = min(judged, key=lambda label: distance[motion.name][label])
        there = distance[motion.name][nearest] <= median + _LABEL_DEVIATIONS * deviation
        yield Flag(motion.name, None, None, "label" if there and nearest != motion.label else "goal", value)
