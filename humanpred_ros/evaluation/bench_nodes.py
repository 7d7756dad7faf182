"""What the benchmarks of nodes share: whom they are shown, how they are run, and what each costs the machine.

The person reaches and draws back, over and over, in postures 1/30 s apart as a Kinect delivers them.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.planner_bench_world import SCENE, spread_goals
from humanpred_ros.evaluation.processes import NodeGroup
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import Motion, MotionLibrary, pelvis_columns, resample
from humanpred_ros.resources import share_file
from humanpred_ros.robot.scene import load_scene

RATE_HZ = 30.0
#: Where the pelvises of the shipped library's people are in the scene at the start (median), world frame.
_STAND_M = (-0.08, -1.31, 0.91)
_STARTED = "replay starts"
#: The first start on a machine compiles the kernels.
_READY_LIMIT_S, _REST_LIMIT_S = 180.0, 60.0
#: Nodes that each use less than this share of a core for this long have finished starting.
_RESTING_SHARE, _RESTING_S = 0.25, 0.6


class NodeUsage(NamedTuple):
    """A node while postures came: mean share of one core, percent, and the most memory held, MB."""

    node: str
    cpu_percent: float
    memory_mb: float


def write_scene(path: Path, n_goals: int) -> Path:
    """Write the scene with `n_goals` goals, spread evenly along the closed line through the shipped scene's.

    Raises:
        HumanPredError: a goal in collision.
    """
    goals = [
        {"name": f"goal {k + 1}", "configuration_rad": [float(angle) for angle in q]}
        for k, q in enumerate(spread_goals(load_scene(SCENE), n_goals))
    ]
    return _write_changed(path, name=f"{SCENE}_{n_goals}_goals", goals=goals)


def write_scene_for(path: Path, library: MotionLibrary) -> Path:
    """Write the scene with the tracker's frame so placed that a library's people stand where the scene's person does.

    Raises:
        MotionError: bodies that cannot stand anywhere.
        HumanPredError: a scene that cannot be used.
    """
    columns = list(pelvis_columns(library.dof_names)[:3])
    pelvis = np.median([motion.q[0, columns] for motion in library], axis=0)
    offset = np.array(_STAND_M) - pelvis
    return _write_changed(path, name=f"{SCENE}_other_person", human={"offset_m": offset.tolist(), "yaw_deg": 0.0})


def _write_changed(path: Path, **changes: object) -> Path:
    content = yaml.safe_load(share_file("config", "scenes", f"{SCENE}.yaml").read_text(encoding="utf-8"))
    content.update(changes)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    load_scene(path)  # checks limits and collisions
    return path


def back_and_forth(motion: Motion, seconds: float) -> Motion:
    """Return a reach and its reverse, repeated for `seconds`, at `RATE_HZ`."""
    t_s = np.arange(round(seconds * RATE_HZ) + 1) / RATE_HZ
    turning = t_s % (2.0 * motion.duration_s)
    there = np.minimum(turning, 2.0 * motion.duration_s - turning)
    # Stamps have to rise, so the distinct ones are taken and put back in their order.
    distinct, place = np.unique(np.round(np.clip(there, 0.0, motion.duration_s), 9), return_inverse=True)
    whole = resample(motion, t_s=distinct)
    return Motion(t_s, whole.q[place.ravel()], motion.dof_names, motion.label, motion.index, motion.frame_id)


def write_motion(folder: Path, library: MotionLibrary, motion: Motion, seconds: float) -> Path:
    """Write the bag the tracker replays: the one motion `back_and_forth` makes."""
    played = MotionLibrary("back_and_forth", (back_and_forth(motion, seconds),), library.provenance)
    return write_library_bag(played, folder)


def replay(group: NodeGroup, motion: Path) -> tuple[NodeUsage, ...]:
    """Replay the one motion of a bag to the nodes of a group, once they are ready; return what each used meanwhile.

    Raises:
        UsageError: a node that failed, or did not get ready.
    """
    tracker = group.start(
        "skeleton_tracker_replay",
        {
            "library": str(motion.resolve()),
            "trajectory": "0",
            "hold_last_s": 0.0,
            "wait_for": ",".join(node.name for node in group.nodes),
            "listener": "occupancy_predictor",
            "ready_timeout_s": _READY_LIMIT_S,
        },
    )
    # When each node was looked at first and last, s, and what it had used then: some may end meanwhile.
    first: dict[str, tuple[float, float]] = {}
    last: dict[str, tuple[float, float, float]] = {}

    def note_usage() -> None:
        if first or _STARTED in tracker.tail():
            for node in group.nodes:
                usage = node.usage()
                if usage is not None:
                    first.setdefault(node.name, (time.perf_counter(), usage.cpu_s))
                    last[node.name] = (time.perf_counter(), *usage)

    group.wait_for(tracker, note_usage)
    if _STARTED not in tracker.log.read_text(encoding="utf-8", errors="replace"):
        raise UsageError(f"bench: wanted the tracker to start, its log says:\n{tracker.tail()}")
    found = []
    for name, (begin_s, begin_cpu_s) in first.items():
        end_s, cpu_s, memory_mb = last[name]
        share = (cpu_s - begin_cpu_s) / (end_s - begin_s) if end_s > begin_s else float("nan")
        found.append(NodeUsage(name, 100.0 * share, memory_mb))
    return tuple(found)


def wait_until_resting(group: NodeGroup) -> None:
    """Return when every node has finished starting, which shows in that it uses next to no processor time.

    At once where the system does not tell; after a minute in any case.

    Raises:
        UsageError: a node that failed.
    """
    before: dict[str, float] = {}
    for _ in range(round(_REST_LIMIT_S / _RESTING_S)):
        group.check()
        used = {node.name: usage.cpu_s for node in group.nodes if (usage := node.usage()) is not None}
        started = all(cpu_s > 0.0 for cpu_s in used.values())
        if not used or (before and started and all(used[n] - before[n] < _RESTING_SHARE * _RESTING_S for n in used)):
            return
        before = used
        time.sleep(_RESTING_S)
