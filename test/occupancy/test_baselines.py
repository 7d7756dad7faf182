"""Baselines: the body where it is or was, or where it goes on to, no farther than joints allow, without glitches."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_library import REST, small_library

from humanpred_ros.errors import ArrayError, MotionError, SettingsError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.human.model import HumanModel
from humanpred_ros.occupancy.baselines import (
    AccumulatedOccupancyPredictor,
    ConstantVelocityPredictor,
    ConstantVelocitySettings,
    CurrentOccupancyPredictor,
)
from humanpred_ros.occupancy.swept_volume_predictor import swept_volume
from humanpred_ros.occupancy.voxeliser import BodyVoxeliser

HUMAN = HumanModel.kinect12()
GRID = VoxelGrid((-1.5, -1.5, -0.4), 0.05, (60, 60, 48))
BODY = BodyVoxeliser(HUMAN, GRID, np.eye(4))
ELBOW, LEAN, ROLL = (HUMAN.dof_index[name] for name in ("rElbowZ", "TorsoY", "rShoulderY"))
PERIOD_S = 1 / 60


def predictor(**changes: float) -> ConstantVelocityPredictor:
    return ConstantVelocityPredictor(HUMAN, GRID, np.eye(4), settings=ConstantVelocitySettings(**changes))


def moving(dof: int, speed: float, n: int = 12, start: FloatArray = REST) -> FloatArray:
    q = np.repeat(start[None], n, axis=0)
    q[:, dof] += speed * PERIOD_S * np.arange(n)
    return q


def shown(p: ConstantVelocityPredictor, q: FloatArray) -> np.ndarray:
    p.start()
    for k, posture in enumerate(q):
        occupancy = p.update(posture, 5.0 + k * PERIOD_S).occupancy
    return occupancy.probability > 0


def test_one_posture_is_where_the_body_is() -> None:
    np.testing.assert_array_equal(shown(predictor(), REST[None]), BODY.mask(REST))


@settings(max_examples=20)
@given(speed=st.floats(-2.0, 2.0), horizon_s=st.floats(0.05, 0.4))
def test_goes_on_as_it_moves(speed: float, horizon_s: float) -> None:
    q = moving(ELBOW, speed)
    there = q[-1].copy()
    there[ELBOW] += speed * horizon_s
    found = shown(predictor(horizon_s=horizon_s), q)
    steps = q[-1] + np.linspace(0, 1, 100)[:, None] * (there - q[-1])
    assert (found | ~BODY.mask(q[-1])).all()
    assert found.sum() <= BODY.mask(steps).sum() + 2
    # It goes in steps of half a voxel, so single voxels that are only grazed may be passed over.
    assert (BODY.mask(steps) & ~found).sum() <= 0.05 * found.sum()
    # The velocity is exact up to rounding, which may move a point across the face of a voxel.
    assert (BODY.mask(there) & ~found).sum() <= 2


def test_joints_stop_at_their_limits_but_do_not_snap_back() -> None:
    q = moving(LEAN, 3.0, start=np.where(np.arange(12) == LEAN, HUMAN.upper[LEAN] - 0.7, REST))
    limit = q[-1].copy()
    limit[LEAN] = HUMAN.upper[LEAN]
    found = shown(predictor(horizon_s=2.0), q)
    assert not (found & ~BODY.mask(q[-1] + np.linspace(0, 1, 400)[:, None] * (limit - q[-1]))).any()
    beyond = q + np.where(np.arange(12) == LEAN, 1.5, 0.0)
    np.testing.assert_array_equal(shown(predictor(horizon_s=2.0), beyond), BODY.mask(beyond[-1]))


def test_a_wrapped_angle_is_no_motion_and_no_limit() -> None:
    q = moving(ROLL, 1.5, start=np.where(np.arange(12) == ROLL, np.pi - 0.1, REST))
    wrapped = q.copy()
    wrapped[:, ROLL] = (q[:, ROLL] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(np.diff(wrapped[:, ROLL])).max() > 6.0
    a, b = predictor(), predictor()
    assert (shown(a, q) != shown(b, wrapped)).sum() <= 2
    np.testing.assert_allclose(b.velocity()[ROLL], 1.5, rtol=1e-9)


@pytest.mark.parametrize("glitch", range(6, 12))
def test_one_mistracked_posture_does_not_set_the_velocity(glitch: int) -> None:
    q = moving(ELBOW, 1.0)
    q[glitch, ELBOW] += 0.8
    p = predictor(window_s=0.15)
    shown(p, q)
    np.testing.assert_allclose(p.velocity()[ELBOW], 1.0, atol=1e-9)


def test_only_the_last_while_counts() -> None:
    q = np.vstack([moving(ELBOW, -2.0, 60), moving(ELBOW, 0.0, 30)])
    p = predictor()
    shown(p, q)
    np.testing.assert_array_equal(p.velocity(), 0.0)
    assert len(p._recent) <= 8  # memory does not grow with the motion


def test_posture_by_posture_on_a_reach() -> None:
    motion = small_library(1, 1).motions[0]
    p = predictor()
    for q, t_s in zip(motion.q, motion.t_s, strict=True):
        prediction = p.update(q, t_s)
        assert set(np.unique(prediction.occupancy.probability)) <= {0.0, 1.0}
        assert prediction.posterior is None
        assert prediction.occupancy.t_s == t_s


def test_what_cannot_be_used_is_refused_and_changes_nothing() -> None:
    p = predictor()
    q = moving(ELBOW, 1.0)
    shown(p, q)
    before = p.velocity()
    for posture, t_s, error in (
        (np.full(12, np.nan), 9.0, ArrayError),
        (REST[:5], 9.0, ArrayError),
        (REST, 5.0, MotionError),
        (REST, np.nan, MotionError),
    ):
        with pytest.raises(error):
            p.update(posture, t_s)
    np.testing.assert_array_equal(p.velocity(), before)
    for setting in ("window_s", "horizon_s", "step_voxels"):
        with pytest.raises(SettingsError, match=setting):
            ConstantVelocitySettings(**{setting: 0.0})


T = np.array([[0.0, -1.0, 0.0, 0.2], [1.0, 0.0, 0.0, 0.1], [0.0, 0.0, 1.0, 0.05], [0.0, 0.0, 0.0, 1.0]])
MOTION = small_library(1, 1, 12).motions[0]


def test_one_exactly_where_the_body_is_and_no_memory() -> None:
    predictor = CurrentOccupancyPredictor(HUMAN, GRID, T)
    for q, t_s in zip(MOTION.q, MOTION.t_s, strict=True):
        prediction = predictor.update(q, t_s)
        body = GRID.mask_of(HUMAN.surface_points(q) @ T[:3, :3].T + T[:3, 3])
        assert (prediction.occupancy.probability != body).sum() <= 2
        assert prediction.occupancy.t_s == t_s
        assert prediction.posterior is None


def test_accumulating_ends_with_the_swept_volume_and_start_clears_it() -> None:
    predictor = AccumulatedOccupancyPredictor(HUMAN, GRID, T)
    before = np.zeros(GRID.shape, dtype=np.float32)
    kept = []
    for q, t_s in zip(MOTION.q, MOTION.t_s, strict=True):
        now = predictor.update(q, t_s).occupancy.probability
        kept.append((now, now.copy()))
        assert (now >= before).all()
        before = now
    np.testing.assert_array_equal(before, swept_volume(BodyVoxeliser(HUMAN, GRID, T), MOTION.q))
    for occupancy, copy in kept:
        np.testing.assert_array_equal(occupancy, copy)
    predictor.start()
    alone = CurrentOccupancyPredictor(HUMAN, GRID, T).update(MOTION.q[0], 0.0)
    np.testing.assert_array_equal(predictor.update(MOTION.q[0], 0.0).occupancy.probability, alone.occupancy.probability)


@pytest.mark.parametrize("q", [np.full(12, np.nan), np.zeros((1, 12)), np.zeros(5)])
def test_a_posture_that_cannot_be_used_is_refused(q: np.ndarray) -> None:
    with pytest.raises(ArrayError):
        CurrentOccupancyPredictor(HUMAN, GRID, T).update(q, 0.0)
