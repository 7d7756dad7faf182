"""What `humanpred bench graph` feeds the nodes: a scene with as many goals as asked, and a person who does not stop.

The person reaches and draws back, over and over, in postures 1/30 s apart as a Kinect delivers them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.planner_bench.world import spread_goals
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import Motion, MotionLibrary, resample
from humanpred_ros.motion.placement import pelvis_columns
from humanpred_ros.resources import share_file
from humanpred_ros.robot.scene import load_scene

RATE_HZ = 30.0
#: Robot, table, start and the corners between which goals are spread are this scene's.
_SCENE = "four_places"
#: Where the pelvises of the shipped library's people are there at the start (median), world frame.
_STAND_M = (-0.08, -1.31, 0.91)


def write_scene(path: Path, n_goals: int) -> Path:
    """Write the scene with `n_goals` goals, spread evenly along the closed line through the shipped scene's.

    Raises:
        UsageError: no goals.
        HumanPredError: a goal in collision.
    """
    if n_goals < 1:
        raise UsageError(f"--goals: wanted at least 1, got {n_goals}")
    goals = [
        {"name": f"goal {k + 1}", "configuration_rad": [float(angle) for angle in q]}
        for k, q in enumerate(spread_goals(load_scene(_SCENE), n_goals))
    ]
    return _write_changed(path, name=f"{_SCENE}_{n_goals}_goals", goals=goals)


def write_scene_for(path: Path, library: MotionLibrary) -> Path:
    """Write the scene with the tracker's frame so placed that a library's people stand where the scene's person does.

    Raises:
        MotionError: bodies that cannot stand anywhere.
        HumanPredError: a scene that cannot be used.
    """
    columns = list(pelvis_columns(library.dof_names)[:3])
    pelvis = np.median([motion.q[0, columns] for motion in library], axis=0)
    offset = np.array(_STAND_M) - pelvis
    return _write_changed(path, name=f"{_SCENE}_other_person", human={"offset_m": offset.tolist(), "yaw_deg": 0.0})


def _write_changed(path: Path, **changes: object) -> Path:
    content = yaml.safe_load(share_file("config", "scenes", f"{_SCENE}.yaml").read_text(encoding="utf-8"))
    content.update(changes)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    load_scene(path)  # checks limits and collisions
    return path


def back_and_forth(motion: Motion, seconds: float) -> Motion:
    """Return a reach and its reverse, repeated for `seconds`, at `RATE_HZ`.

    Raises:
        UsageError: shorter than two postures.
    """
    count = round(seconds * RATE_HZ) + 1
    if count < 2:
        raise UsageError(f"--seconds: wanted at least {1 / RATE_HZ:.2f}, got {seconds}")
    t_s = np.arange(count) / RATE_HZ
    turning = t_s % (2.0 * motion.duration_s)
    there = np.minimum(turning, 2.0 * motion.duration_s - turning)
    # Stamps have to rise, so the distinct ones are taken and put back in their order.
    distinct, place = np.unique(np.round(np.clip(there, 0.0, motion.duration_s), 9), return_inverse=True)
    whole = resample(motion, t_s=distinct) if len(distinct) > 1 else motion
    return Motion(t_s, whole.q[place.ravel()], motion.dof_names, motion.label, motion.index, motion.frame_id)


def write_motion(folder: Path, library: MotionLibrary, motion: Motion, seconds: float) -> Path:
    """Write the bag the tracker replays: the one motion `back_and_forth` makes."""
    return write_library_bag(
        MotionLibrary("back_and_forth", (back_and_forth(motion, seconds),), library.provenance), folder
    )
