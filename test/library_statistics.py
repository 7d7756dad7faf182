"""Aggregate numbers of motion libraries, to compare libraries without showing anybody's recordings.

Everything is relative to the resting person (forwards, left, up of the pelvis, or displacement from the resting palm),
so that libraries recorded in different frames compare. The palm is the model's, from the postures.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.cleaning import clean_library
from humanpred_ros.motion.labels import label_order
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary, resample_phase, unwrap_angles

#: Postures a motion is resampled to: one per percent of its duration, as P1's libraries are.
_N_PHASES = 101
#: Speeds are taken over this share of a motion: a few frames, so that a tracker's trembling does not count as speed.
_SPEED_STEP = 4


class Spread(NamedTuple):
    """Median and outer percentiles of something over the motions of a library."""

    p5: float
    p50: float
    p95: float

    @classmethod
    def of(cls, values: FloatArray) -> Spread:
        """Return the spread of values (N,)."""
        return cls(*(float(value) for value in np.percentile(values, (5, 50, 95))))

    def text(self, digits: int = 2, scale: float = 1.0) -> str:
        """Return `median (5 % to 95 %)`."""
        low, middle, high = (f"{scale * value:.{digits}f}" for value in self)
        return f"{middle} ({low} to {high})"


class LibraryStatistics:
    """Aggregates of a library of C classes with D degrees of freedom; lengths in metres, angles in radians.

    The library counts as it is: clean it first (`cleaning`), wild postures count like others. Speeds are the palm's,
    over 4 % of a motion. Phases are shares of a motion. Places (`goal_m`, `extent_m`) are forwards, left and up of the
    resting pelvis.

    Args:
        library: at least two classes, all motions labelled.
        model: the human, with a `right_palm` and pelvis DoFs; P1's if left out.

    Raises:
        LibraryFormatError: a motion without a label, or fewer than two classes.
        HumanModelError: the library's DoFs are not the model's.
    """

    def __init__(self, library: MotionLibrary, *, model: HumanModel | None = None) -> None:
        human = model or HumanModel.kinect12()
        human.check_dofs(library.dof_names)
        if len(library.labels) < 2 or any(motion.label is None for motion in library):
            raise LibraryFormatError(
                f"library {library.name}: wanted labelled motions of at least 2 classes, got classes {library.labels}"
                " and maybe motions without; select labelled motions"
            )
        motions = [unwrap_angles(motion) for motion in library]
        q = np.stack([resample_phase(motion, _N_PHASES).q for motion in motions])
        palm = human.forward(q.reshape(-1, q.shape[-1]))["right_palm"].reshape(len(q), _N_PHASES, 3)
        labels = np.array([library.labels.index(motion.label) for motion in motions if motion.label is not None])
        classes = [labels == k for k in range(len(library.labels))]
        self.name = library.name
        self.n_motions, self.n_frames = len(library), sum(len(motion) for motion in library)
        self.labels = library.labels
        self.motions_per_class = tuple(int(mine.sum()) for mine in classes)
        #: Where the times come from; durations and speeds are worth no more than that.
        self.stamps = library.provenance.get("stamps", "unknown")
        duration = np.array([motion.duration_s for motion in motions])
        self.duration_s = Spread.of(duration)
        self.frame_period_s = Spread.of(np.concatenate([np.diff(motion.t_s) for motion in library]))

        step = np.linalg.norm(palm[:, _SPEED_STEP:] - palm[:, :-_SPEED_STEP], axis=-1)
        speed = step / (duration * _SPEED_STEP / (_N_PHASES - 1))[:, None]
        self.mean_speed_m_s, self.peak_speed_m_s = Spread.of(speed.mean(axis=1)), Spread.of(speed.max(axis=1))
        paths = [human.forward(motion.q)["right_palm"] for motion in motions]
        lengths = [float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in paths]
        self.path_m = Spread.of(np.array(lengths))  # length of the palm's path
        away = np.linalg.norm(palm - palm[:, :1], axis=-1)
        reach, apex = away.max(axis=1), away.argmax(axis=1)
        self.reach_m = Spread.of(reach)  # greatest distance of the palm from where it rested
        self.end_m = Spread.of(away[:, -1])  # its distance from there in the last frame
        #: When the palm has left by 10 % of its reach, and when it is farthest.
        self.leave_phase = Spread.of((away > 0.1 * reach[:, None]).argmax(axis=1) / (_N_PHASES - 1))
        self.apex_phase = Spread.of(apex / (_N_PHASES - 1))
        tens = np.arange(0, _N_PHASES, 10)
        #: (11,) median distance of the palm from rest at 0, 10, ... 100 % of the motion.
        self.distance_m: FloatArray = np.median(away[:, tens], axis=0)

        goal = palm[np.arange(len(palm)), apex]
        pelvis = human.link_poses(q[:, 0])[:, human.link_names.index("pelvis")]
        seen = np.einsum("nji,ntj->nti", pelvis[:, :3, :3], palm - pelvis[:, None, :3, 3])
        seen_goal = seen[np.arange(len(palm)), apex]
        #: (C, 3) median place of the palm when farthest, by class, and its standard deviation on the tracker's axes.
        self.goal_m: FloatArray = np.array([np.median(seen_goal[mine], axis=0) for mine in classes])
        self.goal_sd_m: FloatArray = np.array([goal[mine].std(axis=0) for mine in classes])
        centre = np.array([np.median(goal[mine], axis=0) for mine in classes])
        apart = np.linalg.norm(centre[:, None] - centre, axis=-1)
        np.fill_diagonal(apart, np.inf)
        self.goal_spacing_m: FloatArray = apart.min(axis=1)  # (C,) distance to the nearest other class's
        #: (3, 2) 1 and 99 % of the palm's places.
        self.extent_m: FloatArray = np.percentile(seen.reshape(-1, 3), (1, 99), axis=0).T
        self.dof_names = library.dof_names
        self.dof_range: FloatArray = np.median(np.ptp(q, axis=1), axis=0)  # (D,) median of the range within a motion
        self.dof_start_sd: FloatArray = q[:, 0].std(axis=0)  # (D,) standard deviation of the first posture
        index = np.array([motion.index for motion in motions])
        #: (11,) share of the motions whose class one posture shows; above `chance` at 0 %, the start gives it away.
        self.class_found: FloatArray = np.array([_found_by_nearest_mean(q[:, k], labels, index) for k in tens])
        self.chance = 1.0 / len(library.labels)  # share that guessing gets right


def comparison_markdown(a: MotionLibrary, b: MotionLibrary) -> str:
    """Return Markdown tables of both libraries' statistics; only aggregates, no motion of either.

    Both are cleaned the same way first (unwrapped, without motions flagged wild or off their goal).

    Raises:
        LibraryFormatError: motions without labels, or fewer than two classes.
        HumanModelError: a library of another human than P1's.
    """
    both = [LibraryStatistics(clean_library(library, drop=True)) for library in (a, b)]
    names = [s.name for s in both]
    spacing = [(s.goal_spacing_m.min(), s.goal_spacing_m.max()) for s in both]
    goal_sd = [np.median(s.goal_sd_m, axis=0) for s in both]
    rows = [
        ("motions left out", [f"{len(x) - s.n_motions} of {len(x)}" for x, s in zip((a, b), both, strict=True)]),
        ("motions, frames", [f"{s.n_motions}, {s.n_frames}" for s in both]),
        ("motions per class", [", ".join(map(str, s.motions_per_class)) for s in both]),
        ("stamps", [s.stamps for s in both]),
        ("duration, s", [s.duration_s.text() for s in both]),
        ("time step, ms", [s.frame_period_s.text(1, 1e3) for s in both]),
        ("mean palm speed, m/s", [s.mean_speed_m_s.text() for s in both]),
        ("peak palm speed, m/s", [s.peak_speed_m_s.text() for s in both]),
        ("length of the palm's path, m", [s.path_m.text() for s in both]),
        ("greatest distance of the palm from rest, m", [s.reach_m.text() for s in both]),
        ("distance from rest in the last frame, m", [s.end_m.text() for s in both]),
        ("phase at which the palm leaves, %", [s.leave_phase.text(0, 100) for s in both]),
        ("phase at which it is farthest, %", [s.apex_phase.text(0, 100) for s in both]),
        ("goals: distance to the next class's, m", [_numbers(pair, " to ") for pair in spacing]),
        ("goals: standard deviation x, y, z, m", [_numbers(sd, ", ", 3) for sd in goal_sd]),
        *(
            (f"palm, {where} of the resting pelvis, m", [_numbers(s.extent_m[k], " to ") for s in both])
            for k, where in enumerate(("forwards", "left", "up"))
        ),
    ]  # fmt: skip
    tens = [f"{10 * k} %" for k in range(11)]
    guessing = " and ".join(f"{s.chance:.3f}" for s in both)
    parts = [
        "Motions flagged as wild or off their goal (`humanpred_ros.motion.cleaning`) are left out, angles unwrapped. "
        "Medians, with the 5th and 95th percentiles in brackets; ranges are 1st to 99th percentiles.",
        _table(["", *names], [[what, *cells] for what, cells in rows]),
        "Share of motions whose class the nearest class mean gives from one posture alone (motions of a round "
        f"left out together). Guessing gets {guessing}; more at 0 % would mean that the start gives the class away.",
        _table(["at", *tens], [[s.name, *(f"{share:.2f}" for share in s.class_found)] for s in both]),
        "Median distance of the palm from where it rested, m.",
        _table(["at", *tens], [[s.name, *(f"{value:.2f}" for value in s.distance_m)] for s in both]),
        "Goals: median place of the palm when farthest; forwards, left and up of the resting pelvis, m. The libraries "
        "may number their classes differently.",
        _table(
            ["class", *names],
            [
                [label, *(_goal(s, label) for s in both)]
                for label in sorted({*both[0].labels, *both[1].labels}, key=label_order)
            ],
        ),
        "Degrees of freedom, m and rad: range within a motion (median); standard deviation of the first posture.",
        _table(
            ["", *(f"{what}, {name}" for what in ("range", "start") for name in names)],
            [
                [dof, *(f"{s.dof_range[k]:.3f}" for s in both), *(f"{s.dof_start_sd[k]:.3f}" for s in both)]
                for k, dof in enumerate(both[0].dof_names)
            ],
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _numbers(values: Iterable[float], between: str, digits: int = 2) -> str:
    return between.join(f"{value:.{digits}f}" for value in values)


def _goal(statistics: LibraryStatistics, label: str) -> str:
    if label not in statistics.labels:
        return "none"
    return _numbers(statistics.goal_m[statistics.labels.index(label)], ", ")


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def _found_by_nearest_mean(postures: FloatArray, labels: NDArray[np.int64], index: NDArray[np.int64]) -> float:
    """Return how often the class mean nearest to a posture (N, D) is its class's, in the DoFs' standard deviations.

    Motions of the same index (recorded in one round) are left out together. Leaving out a single motion would move its
    own class's mean away from it, and chance would come out too low.
    """
    scaled = postures / np.maximum(postures.std(axis=0), 1e-9)
    right = 0
    for left_out in np.unique(index):
        test = index == left_out
        known = [label for label in np.unique(labels) if (~test & (labels == label)).any()]
        if not known:
            continue
        means = np.array([scaled[~test & (labels == label)].mean(axis=0) for label in known])
        nearest = np.linalg.norm(scaled[test][:, None] - means, axis=-1).argmin(axis=1)
        right += int((np.array(known)[nearest] == labels[test]).sum())
    return right / len(postures)


if __name__ == "__main__":
    print(comparison_markdown(*map(load_library, sys.argv[1:3])))
