"""Predicted probabilities beside what happened: right ones look right, wrong ones wrong, and gaps are told."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from humanpred_ros.evaluation import occupancy_scores
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.scene import Scene
from humanpred_ros.viewing.recorded import OccupancySnapshot
from humanpred_ros.viewing.reliability import AT_REST, MOVING, OccupancyCalibration, measure_calibration
from humanpred_ros.viewing.run import Run, read_run
from humanpred_ros.viewing.workcell import load_workcell

REACH_S, N_POSTURES = 1.65, 100


def measured(run: Run) -> dict[str, OccupancyCalibration]:
    parts, notes = measure_calibration(run, load_workcell(run))
    assert notes == ()
    return parts


def with_samples(run: Run, samples: list[OccupancySnapshot]) -> Run:
    return dataclasses.replace(run, occupancy=dataclasses.replace(run.occupancy, samples=tuple(samples)))


@pytest.fixture(scope="module")
def future(full: Run, human: HumanModel, scene: Scene) -> NDArray[np.bool_]:
    """(T, V) voxels touched in each posture or any later one, found without the package's voxeliser."""
    R, p = scene.T_world_human[:3, :3], scene.T_world_human[:3, 3]
    masks = [scene.grid.mask_of(human.surface_points(q, 0.02) @ R.T + p).ravel() for q in full.postures.q]
    swept: NDArray[np.bool_] = np.logical_or.accumulate(masks[::-1])[::-1]
    return swept


def samples_of(run: Run, scene: Scene, masks: NDArray[np.bool_], probability: float) -> list[OccupancySnapshot]:
    """Return occupancies at every third posture that give one probability to that posture's mask (T, V)."""
    return [
        OccupancySnapshot(t, centres := scene.grid.centres_m(np.flatnonzero(mask)), np.full(len(centres), probability))
        for t, mask in list(zip(run.postures.t_s.tolist(), masks, strict=True))[::3]
    ]


def test_a_perfectly_predicted_run_is_perfectly_calibrated(make_run: Callable[..., Path]) -> None:
    parts = measured(read_run(make_run(foresight=True)))
    assert set(parts) == {MOVING, AT_REST}
    for part in parts.values():
        top = part.bins[-1]
        assert top.count == part.voxels > 10_000
        assert top.probability == 1.0
        assert top.observed == pytest.approx(1.0, abs=1e-3)  # a point on a voxel's face may fall to either side
        assert part.error == pytest.approx(0.0, abs=1e-3)
        assert part.missed == pytest.approx(0.0, abs=1e-3)
        assert part.expected_voxels == pytest.approx(part.swept_voxels, rel=1e-3)
    assert parts[MOVING].squared_error_ratio == pytest.approx(0.0, abs=0.01)
    assert parts[AT_REST].squared_error_ratio is None  # the current posture is all there is


def test_too_little_confidence_shows(full: Run, scene: Scene, future: NDArray[np.bool_]) -> None:
    part = measured(with_samples(full, samples_of(full, scene, future, 0.35)))[MOVING]
    (row,) = [row for row in part.bins if row.count]
    assert (row.low, row.high, row.probability) == (0.3, 0.4, pytest.approx(0.35))
    assert row.observed == pytest.approx(1.0, abs=1e-3)
    assert part.error == pytest.approx(0.65, abs=1e-3)
    assert part.missed == pytest.approx(0.0, abs=1e-3)


def test_half_of_what_was_given_one_half_comes_true(full: Run, scene: Scene, future: NDArray[np.bool_]) -> None:
    never = np.flatnonzero(~future[0])
    both = future.copy()
    for mask in both:
        mask[never[: mask.sum()]] = True  # as many that the body never touches
    part = measured(with_samples(full, samples_of(full, scene, both, 0.5)))[MOVING]
    assert part.error == pytest.approx(0.0, abs=1e-3)
    assert part.squared_error == pytest.approx(0.25 * 2.0 * part.swept_voxels, rel=1e-3)


def test_what_was_given_next_to_nothing_was_missed(full: Run, scene: Scene, future: NDArray[np.bool_]) -> None:
    part = measured(with_samples(full, samples_of(full, scene, future, 0.009)))[MOVING]
    assert (part.missed, part.voxels, part.error) == (1.0, 0, None)
    assert all(row.count == 0 and row.observed is None for row in part.bins)


def test_predicting_the_current_posture_only_is_the_baseline(full: Run, scene: Scene, human: HumanModel) -> None:
    R, p = scene.T_world_human[:3, :3], scene.T_world_human[:3, 3]
    now = np.array([scene.grid.mask_of(human.surface_points(q, 0.02) @ R.T + p).ravel() for q in full.postures.q])
    part = measured(with_samples(full, samples_of(full, scene, now, 1.0)))[MOVING]
    assert part.squared_error_ratio == pytest.approx(1.0, abs=1e-2)
    assert part.missed is not None
    assert part.missed * part.swept_voxels == pytest.approx(part.squared_error, rel=1e-6)


def test_figures_are_those_of_the_evaluation_over_libraries(full: Run, scene: Scene, future: NDArray[np.bool_]) -> None:
    """`humanpred evaluate occupancy` scores dense grids; what it says of these predictions is what the run says."""
    counts, squared, missed, swept, n = np.zeros(1), 0.0, 0.0, 0, 0
    for sample in full.occupancy.samples:
        if sample.t_s > REACH_S + 1e-6:
            continue
        p = np.zeros(scene.grid.size)
        p[scene.grid.flat_index(sample.centres_m)] = sample.probability
        y = future[int(np.argmin(np.abs(full.postures.t_s - sample.t_s)))]
        scores = occupancy_scores.voxel_scores(p, y, y | (p > 0.0))
        counts = counts + occupancy_scores.reliability(p, y, y | (p > 0.0))
        squared, n = squared + scores["squared_error"], n + 1
        missed, swept = missed + scores["missed"] * scores["n_swept"], swept + scores["n_swept"]
    table = occupancy_scores.calibration(counts)
    part = measured(full)[MOVING]
    assert part.occupancies == n > 50
    assert part.error == pytest.approx(table["error_predicted"], abs=1e-4)
    assert part.missed == pytest.approx(missed / swept, abs=1e-4)
    assert part.squared_error == pytest.approx(squared / n, rel=1e-3)
    for row, count, mean, observed in zip(
        part.bins, table["count"][1:], table["mean_probability"][1:], table["observed"][1:], strict=True
    ):
        assert row.count == count
        if count:
            assert row.probability == pytest.approx(mean)
            assert row.observed == pytest.approx(observed, abs=1e-3)


def test_occupancies_are_sampled_evenly_while_moving_and_at_rest(full: Run) -> None:
    times = np.array([sample.t_s for sample in full.occupancy.samples])
    moving, resting = times[times <= REACH_S + 1e-6], times[times > REACH_S + 1e-6]
    assert 55 <= len(moving) <= 61
    assert 15 <= len(resting) <= 20
    assert moving[0] == 0.0
    assert np.diff(moving).max() <= 2.0 * REACH_S / 60
    for sample in full.occupancy.samples:
        k = int(np.flatnonzero(full.occupancy.t_s == sample.t_s)[0])
        assert len(sample.probability) == full.occupancy.n_voxels[k]


def test_a_predictor_that_falls_behind_is_judged_by_what_it_published(make_run: Callable[..., Path]) -> None:
    parts = measured(read_run(make_run(foresight=True, occupancy_every=7)))
    assert parts[MOVING].occupancies == 15
    assert parts[MOVING].bins[-1].observed == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ({"without": ("/human_occupancy",)}, "no occupancy"),
        ({"without": ("/humans/bodies/body_0/joint_states",)}, "no posture"),
        ({"facts": {"scene": ""}}, "scene"),
        ({"n_postures": 60, "held": 0}, "after 60 %"),
    ],
)
def test_what_is_missing_is_named(make_run: Callable[..., Path], script: dict[str, object], why: str) -> None:
    run = read_run(make_run(**script))
    parts, (note,) = measure_calibration(run, load_workcell(run))
    assert parts == {}
    assert why in note


def test_clouds_that_cannot_be_compared_are_told(full: Run, scene: Scene) -> None:
    grid = full.occupancy.grid
    assert grid is not None
    first, *rest = full.occupancy.samples
    empty = [dataclasses.replace(s, centres_m=np.zeros((0, 3)), probability=np.zeros(0)) for s in (first, *rest)]
    odd = np.where(np.arange(len(first.probability)) == 3, np.nan, first.probability)
    shifted = first.centres_m + 0.4 * grid.resolution_m
    for samples, why in (
        (empty, "no voxel"),
        ([], "no voxel"),
        ([dataclasses.replace(first, probability=odd), *rest], "outside of 0 to 1"),
        ([dataclasses.replace(first, centres_m=shifted), *rest], "not voxel centres"),
        ([dataclasses.replace(first, centres_m=first.centres_m + 100.0), *rest], "not voxel centres"),
    ):
        parts, (note,) = measure_calibration(with_samples(full, samples), load_workcell(full))
        assert parts == {}
        assert why in note


def test_the_grid_may_be_unrecorded_as_the_scene_has_it(full: Run) -> None:
    bare = dataclasses.replace(full, occupancy=dataclasses.replace(full.occupancy, grid=None))
    assert measured(bare) == measured(full)


def test_a_person_who_never_moves_is_at_rest(full: Run) -> None:
    postures = dataclasses.replace(full.postures, q=np.repeat(full.postures.q[:1], len(full.postures), axis=0))
    still = dataclasses.replace(full, postures=postures, motion_duration_s=postures.motion_end_s)
    assert set(measured(still)) == {AT_REST}
