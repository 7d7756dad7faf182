"""What the benchmarks of nodes share: what the nodes are shown, what each costs the machine, and how soon it answers.

The person reaches and draws back, over and over, in postures 1/30 s apart as a Kinect delivers them. A delay begins
when a posture was published (the sender's clock) and ends when the answer was received by the recorder, a process of
its own: what another node on this machine would see.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from humanpred_ros import topics
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import BagError, UsageError
from humanpred_ros.evaluation.planner_bench_world import SCENE, spread_goals
from humanpred_ros.evaluation.processes import ONE_PROCESS, NodeGroup
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.motion import Motion, MotionLibrary, pelvis_columns, resample
from humanpred_ros.resources import share_file
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.viewing.recorded import decision_of
from humanpred_ros.viewing.run import Entry, occupancies, stamped, trajectories_by_stamp

RATE_HZ = 30.0
#: Where the pelvises of the shipped library's people are in the scene at the start (median), world frame.
_STAND_M = (-0.08, -1.31, 0.91)
_STARTED, _READY, _PLANNER = "replay starts", "ready", "stomp_planner"
#: Nodes of executables that are more than one.
_NODES_OF = {ONE_PROCESS: "occupancy_predictor,stomp_planner"}
_GUARD_VALUES = "posture_to_factor_ms/"
#: Stamps are rounded to nanoseconds; steps are due this much early, as in the replanner.
_DUE_TOLERANCE_S = 1e-6
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
    return write_changed_scene(path, name=f"{SCENE}_{n_goals}_goals", goals=goals)


def write_scene_for(path: Path, library: MotionLibrary) -> Path:
    """Write the scene with the tracker's frame so placed that a library's people stand where the scene's person does.

    Raises:
        MotionError: bodies that cannot stand anywhere.
        HumanPredError: a scene that cannot be used.
    """
    columns = list(pelvis_columns(library.dof_names)[:3])
    pelvis = np.median([motion.q[0, columns] for motion in library], axis=0)
    offset = np.array(_STAND_M) - pelvis
    return write_changed_scene(path, name=f"{SCENE}_other_person", human={"offset_m": offset.tolist(), "yaw_deg": 0.0})


def write_changed_scene(path: Path, **changes: object) -> Path:
    """Write the scene with some of its entries replaced; raises HumanPredError for what cannot be used."""
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


def replay(
    group: NodeGroup,
    motion: Path,
    listener: str = "occupancy_predictor",
    within: Sequence[str] = (),
    meanwhile: Callable[[], None] = lambda: None,
) -> tuple[NodeUsage, ...]:
    """Replay the one motion of a bag to the nodes of a group, once they are ready; return what each used meanwhile.

    Args:
        group: the nodes.
        motion: bag with the motion.
        listener: node that must listen to the postures.
        within: as for `NodeGroup.start`.
        meanwhile: called again and again once the replay has started.

    Raises:
        UsageError: a node that failed, or did not get ready.
    """
    tracker = group.start(
        "skeleton_tracker_replay",
        {
            "library": str(motion.resolve()),
            "trajectory": "0",
            "hold_last_s": 0.0,
            "wait_for": ",".join(_NODES_OF.get(node.name, node.name) for node in group.nodes),
            "listener": listener,
            "ready_timeout_s": _READY_LIMIT_S,
        },
        within=within,
    )
    # When each node was looked at first and last, s, and what it had used then: some may end meanwhile.
    first: dict[str, tuple[float, float]] = {}
    last: dict[str, tuple[float, float, float]] = {}

    def note_usage() -> None:
        if first or _STARTED in tracker.tail():
            meanwhile()
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
    quiet = 0
    for _ in range(round(_REST_LIMIT_S / _RESTING_S)):
        group.check()
        used = {node.name: usage.cpu_s for node in group.nodes if (usage := node.usage()) is not None}
        resting = before and all(0.0 < used[name] < before[name] + _RESTING_SHARE * _RESTING_S for name in used)
        quiet = quiet + 1 if resting else 0
        if not used or quiet == 2:  # once may be a busy machine that let them wait
            return
        before = used
        time.sleep(_RESTING_S)


def guard_delays_ms(bag: Path) -> dict[str, float]:
    """Return what the separation guard said last of how long it took from a posture's publication to its factor.

    Returns:
        `median`, `p99` and `most` in ms, and of how many postures, `n`; empty if it said nothing.

    Raises:
        BagError: a damaged bag.
    """
    found: dict[str, float] = {}
    for entry in stamped(BagReader(bag), topics.DIAGNOSTICS):
        for status in entry.message.status:
            said = {value.key: value.value for value in status.values if value.key.startswith(_GUARD_VALUES)}
            found = {key.removeprefix(_GUARD_VALUES): float(text) for key, text in said.items()} or found
    return found


class PostureAnswer(NamedTuple):
    """A posture and the occupancy that answered it."""

    stamp_ns: int  #: of both
    sent_ns: int  #: when the posture was published
    heard_ns: int | None  #: when the recorder received the occupancy; None if there was none

    @property
    def delay_ms(self) -> float:
        """From one to the other; NaN without an answer."""
        return float("nan") if self.heard_ns is None else (self.heard_ns - self.sent_ns) * 1e-6


def posture_answers(reader: BagReader) -> tuple[PostureAnswer, ...]:
    """Return every posture of a run in real time with its answer.

    Raises:
        BagError: no postures, or a damaged bag.
    """
    postures = list(stamped(reader, topics.body_topic(reader.names, topics.human_joint_states)))
    if not postures:
        raise BagError(f"{reader.path}: wanted a run with postures, got none; did the tracker start?")
    heard_ns = {entry.stamp_ns: entry.heard_ns for entry in occupancies(reader)}
    return tuple(PostureAnswer(entry.stamp_ns, entry.sent_ns, heard_ns.get(entry.stamp_ns)) for entry in postures)


class Answers(NamedTuple):
    """How long the answers of one run took, and what was not answered."""

    #: from a posture's publication: `occupancy_ms` of every posture, `step_ms` (to the decision) of every replanning
    #: step, `trajectory_ms` of every step that sent one; `compute_ms`: what the planner itself says a step took
    delays_ms: Mapping[str, Sequence[float]]
    #: fewest STOMP iterations of a goal in each step, goals that were set aside left out; fewer than asked for mean
    #: that time ran out or the goal was far too expensive
    iterations: Sequence[int]
    #: `steps` that were taken; `late`: whose plan came too late to be taken over; `skipped`: that were due and not
    #: taken, because the planner was still busy with the one before; postures `unanswered`
    counts: Mapping[str, int]
    ready_s: float  #: from the start of the planner's process to its first word of being ready; NaN if it never was


def answers_of(bag: Path, period_s: float, planner_started_ns: int) -> Answers:
    """Return the answers recorded in `bag`.

    Args:
        bag: of a run in real time.
        period_s: of a replanning step.
        planner_started_ns: wall time at which the planner's process was started.

    Raises:
        BagError: no postures, or a damaged bag.
    """
    reader = BagReader(bag)
    answers = posture_answers(reader)
    sent_ns = {answer.stamp_ns: answer.sent_ns for answer in answers}
    decided = list(stamped(reader, topics.DECISION))
    decisions = [decision_of(entry.message, 0.0, 0.0) for entry in decided]
    steps = {e.stamp_ns: (e, decision) for e, decision in zip(decided, decisions, strict=True) if decision.is_step}
    trajectories = trajectories_by_stamp(stamped(reader, topics.TRAJECTORY), decided)

    def delays_ms(heard: Iterable[tuple[int, Entry]]) -> list[float]:
        return [(entry.heard_ns - sent_ns[stamp]) * 1e-6 for stamp, entry in heard if stamp in sent_ns]

    words = [(entry, status) for entry in stamped(reader, topics.DIAGNOSTICS) for status in entry.message.status]
    ready_ns = [entry.sent_ns for entry, status in words if (status.name, status.message) == (_PLANNER, _READY)]
    return Answers(
        {
            "occupancy_ms": [answer.delay_ms for answer in answers if answer.heard_ns is not None],
            "step_ms": delays_ms((stamp, entry) for stamp, (entry, _) in steps.items()),
            "trajectory_ms": delays_ms((stamp, entry) for stamp, entry in trajectories.items() if stamp in steps),
            "compute_ms": [1e3 * decision.compute_s for _, decision in steps.values()],
        },
        [min((goal.iterations for goal in step.goals if goal.iterations), default=0) for _, step in steps.values()],
        {
            "steps": len(steps),
            "late": sum(decision.action == "missed" for decision in decisions),
            "skipped": skipped_steps([stamp * 1e-9 for stamp in steps], period_s),
            "unanswered": sum(answer.heard_ns is None for answer in answers),
        },
        (ready_ns[0] - planner_started_ns) * 1e-9 if ready_ns else float("nan"),
    )


def skipped_steps(stamps_s: Sequence[float], period_s: float) -> int:
    """Return how many whole periods went by between neighbouring steps without one."""
    gaps = np.diff(np.asarray(stamps_s, dtype=np.float64))
    return int(np.maximum(np.floor((gaps + _DUE_TOLERANCE_S) / period_s) - 1, 0).sum())
