"""An arm beside a person with a separation guard: what it executes follows the factor, and it stands when it must."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from humanpred_ros.evaluation.run_figures import ExecutedMotion
from humanpred_ros.evaluation.simulation import drive_guarded, held_postures, nobody
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.planning.replanner import Replanner
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.stomp.config import StompConfig


def test_a_guarded_arm_is_as_fast_as_the_factor_and_stands_while_it_is_zero() -> None:
    scene, motion = load_scene("face_to_face"), load_library(locate("synthetic_reaches", "bags")).motions[0]
    n_held = held_postures(motion, 4.0)
    config = ReplannerConfig(threads=1, stomp=StompConfig(iterations=3, waypoints=30))
    with closing(Replanner.for_scene(scene, config)) as replanner:
        people = HumanModel.kinect12(), motion, nobody(scene.grid, motion, n_held), n_held
        decisions, pace = drive_guarded(replanner, scene, *people)
        assert (replanner.factor, replanner.stopped) == (1.0, "")
    factors = {factor for _, _, factor in pace.changes}
    assert any(0.0 < factor < 1.0 for factor in factors)
    executed = ExecutedMotion.of(scene.start, decisions, 0.0, pace)
    t = np.arange(0.0, min(executed.end_s, motion.duration_s + 4.0), 0.005)
    speed = np.abs(np.diff(executed.at(t), axis=0)).max(axis=1) / 0.005
    limit = float((config.velocity_scale * scene.arm.chain.velocity_limit).max())
    # Between two moments the larger of their factors counts.
    begins = np.array([change[0] for change in pace.changes])
    factor = np.array(pace.changes)[np.searchsorted(begins, t, side="right") - 1, 2]
    assert (speed <= 1.05 * np.maximum(factor[1:], factor[:-1]) * limit + 1e-9).all()
    shares = [executed.share(t[-1], lambda f, low=low: (f == 0.0) == low) for low in (False, True)]
    np.testing.assert_allclose(sum(shares), 1.0)
