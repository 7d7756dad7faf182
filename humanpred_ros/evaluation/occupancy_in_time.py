"""How well is it predicted when voxels will be occupied, for motions that were not learned from?

Slices of 0.2 s follow each other from the posture seen last on. The truth of a slice is what the recorded body touches
in its time; slices that the recording does not reach have none, and are left out. Scores are those of `evaluate
occupancy`. Beside the predictors that know times stands what a planner uses that does not: the swept prediction, taken
as if all of it were occupied in every slice.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.evaluation.framework import Advance, Report, Table
from humanpred_ros.evaluation.leave_one_out import LeaveOneOut, UpdateLog, answers
from humanpred_ros.evaluation.occupancy import OccupancySettings, space_of, tested_motions
from humanpred_ros.evaluation.occupancy_scores import calibration, reliability, swept_region, voxel_scores
from humanpred_ros.evaluation.outputs import library_facts
from humanpred_ros.evaluation.parallel import map_processes
from humanpred_ros.evaluation.recognition_scores import percent_indices
from humanpred_ros.evaluation.timing import durations_ms
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.cleaning import DROP_REASONS, flag_library
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.predictor import SLICES_S
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser

#: Predictors that know times; of the first one the swept prediction is scored, too.
_TIMED = ("forecast", "constant_velocity")
_SWEPT = "swept as if now"
#: The slice that begins so long ahead is compared in the title, s.
_COMPARED_S = 0.6
_SCORES = ("brier", "log_loss", "missed")


@dataclass(frozen=True, eq=False)
class LeftOutSlices:
    """Shows one motion, called with its name, to predictors that have not learned from it.

    Returns:
        By predictor: scores (S, 3) summed over moments, calibration (S, 3, B), moments (S,), and ms of each update.
    """

    settings: OccupancySettings
    library: MotionLibrary
    human: HumanModel
    grid: VoxelGrid
    T_world_human: FloatArray
    region: NDArray[np.bool_]

    def __call__(self, name: str) -> dict[str, tuple[FloatArray, FloatArray, FloatArray, list[float]]]:
        motion = self.library.find(name)
        seen = np.unique(percent_indices(len(motion))[np.array(self.settings.percents) - 1]).tolist()
        truths = {k: self._truth(motion.q, motion.t_s, k) for k in seen}
        found = {}
        for kind, fold in self._folds.items():
            predictor = fold.without(name)
            names = (kind, _SWEPT) if kind == _TIMED[0] else (kind,)
            n = len(SLICES_S) - 1
            tallies: dict[str, Any] = {who: (np.zeros((n, 3)), [0.0] * n, np.zeros(n), []) for who in names}
            shown = answers(predictor, motion.q[: seen[-1] + 1], motion.t_s[: seen[-1] + 1], UpdateLog())
            for k, said in enumerate(shown):
                if k not in truths or said is None:
                    continue
                slices = predictor.in_time(SLICES_S)
                tallies[kind][3].extend(durations_ms(predictor.in_time, [SLICES_S]))
                assert slices is not None
                for s, truth in enumerate(truths[k]):
                    for who in names:
                        p = (said.occupancy if who == _SWEPT else slices.during(s)).probability.ravel()
                        scores, tables, count, _ = tallies[who]
                        marks = voxel_scores(p, truth, self.region)
                        scores[s] += [marks[score] for score in _SCORES]
                        tables[s] = tables[s] + reliability(p, truth, self.region)
                        count[s] += 1
            found.update(tallies)
        return found

    def _truth(self, q: FloatArray, t_s: FloatArray, k: int) -> list[NDArray[np.bool_]]:
        """Return the voxels touched in each slice after posture `k` that the recording covers."""
        found = []
        for begin_s, end_s in zip(SLICES_S[:-1] + t_s[k], SLICES_S[1:] + t_s[k], strict=True):
            if end_s > t_s[-1]:
                break
            moments = np.unique([begin_s, *t_s[(t_s > begin_s) & (t_s < end_s)], end_s])
            postures = np.stack([np.interp(moments, t_s, column) for column in q.T], axis=1)
            found.append(self._voxeliser.mask(postures).ravel())
        return found

    @cached_property
    def _voxeliser(self) -> BodyVoxeliser:
        return BodyVoxeliser(self.human, self.grid, self.T_world_human)

    @cached_property
    def _folds(self) -> dict[str, LeaveOneOut]:
        space = self.human, self.grid, self.T_world_human
        return {kind: LeaveOneOut(kind, self.library, *space, gmm=self.settings.gmm) for kind in _TIMED}


def evaluate_in_time(library: MotionLibrary, settings: OccupancySettings, advance: Advance) -> Report:
    """Leave out each tested motion in turn and score the slices that are predicted on its way.

    Raises:
        HumanPredError: other DoFs, people outside the lattice.
    """
    human, tested = human_with(library.dof_names), tested_motions(library, settings.every)
    wild = {flag.motion for flag in flag_library(library, model=human) if flag.reason in DROP_REASONS}
    grid, T_world_human = space_of(library, settings, human, wild)
    region = swept_region(library, BodyVoxeliser(human, grid, T_world_human), settings.margin_voxels)
    runs = LeftOutSlices(settings, library, human, grid, T_world_human, region.ravel())
    outcomes = map_processes(runs, tested, settings.jobs, advance, settings.scheduler)
    results = {who: _joined([outcome[who] for outcome in outcomes]) for who in outcomes[0]}
    ahead = [f"{begin:.1f}" for begin in SLICES_S[:-1]]
    heads = [("seconds ahead",), *((text, ".2f") for text in ahead)]
    shares = [("seconds ahead",), *((text, ".1%") for text in ahead)]
    first, k = results[_TIMED[0]], int(np.searchsorted(SLICES_S, _COMPARED_S + 1e-9)) - 1
    ratios = {who: float(first["brier"][k] / result["brier"][k]) for who, result in results.items() if who != _TIMED[0]}
    stamps = library.provenance.get("stamps", "")
    return Report(
        f"{library.name}: {len(tested)} of {len(library)} motions left out in turn; "
        f"{_TIMED[0]}'s Brier score from {_COMPARED_S:g} s ahead on is "
        + " and ".join(f"{ratio:.2f} times that of {who}" for who, ratio in ratios.items()),
        (
            Table.of_rows("Brier score x 1000", heads, [(w, *(1e3 * r["brier"])) for w, r in results.items()]),
            Table.of_rows("log score x 1000", heads, [(w, *(1e3 * r["log_loss"])) for w, r in results.items()]),
            Table.of_rows("occupied voxels given < 1 %", shares, [(w, *r["missed"]) for w, r in results.items()]),
            Table.of_rows(
                "calibration error of voxels given 1 % and more",
                heads,
                [(w, *(one["error_predicted"] for one in r["calibration"])) for w, r in results.items()],
            ),
            Table.of_rows("moments scored", ["seconds ahead", *ahead], [("all", *first["moments"].astype(int))]),
        ),
        {"library": library_facts(library), "slices_s": SLICES_S, "tested": tested, "ratios": ratios} | results,
        (
            f"An update takes {first['update_ms']:.1f} ms in the median, beside that of the swept prediction.",
            *([f"The stamps of the library are {stamps}: slices are only as true."] if "assumed" in stamps else []),
        ),
    )


def _joined(parts: list[tuple[FloatArray, Any, FloatArray, list[float]]]) -> dict[str, Any]:
    """Return the mean scores (S,) and the calibration of all motions' slices; of slices nobody reaches, NaN."""
    scores, count = sum(part[0] for part in parts), sum(part[2] for part in parts)
    times = [ms for part in parts for ms in part[3]]
    with np.errstate(invalid="ignore"):
        means = scores / np.asarray(count)[:, None]
    tables = [sum(part[1][s] for part in parts) for s in range(len(SLICES_S) - 1)]
    return {
        **{name: means[:, k] for k, name in enumerate(_SCORES)},
        "calibration": [
            calibration(table) if np.ndim(table) else {"error_predicted": float("nan")} for table in tables
        ],
        "moments": np.asarray(count),
        "update_ms": float(np.median(times)) if times else float("nan"),
    }
