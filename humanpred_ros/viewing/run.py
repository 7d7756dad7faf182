"""A recorded run read back from its folder: the one thing that summaries, plots and reports start from."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros import topics
from humanpred_ros.bags import messages
from humanpred_ros.bags.metadata import TopicInfo
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import BagError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.robot.pr2 import RIGHT_ARM_JOINTS
from humanpred_ros.viewing import run_topics
from humanpred_ros.viewing.tracks import (
    Latency,
    OccupancySnapshot,
    OccupancyTrack,
    PosteriorTrack,
    PostureTrack,
    RecordedDecision,
    RobotTrack,
    SentTrajectory,
)

#: Names of a run's latencies; the wall-clock times of sending are compared.
POSTURE_TO_OCCUPANCY = "posture to occupancy"
POSTURE_TO_TRAJECTORY = "posture to trajectory"

#: A reach seen up to here was seen whole: stamps of the last posture may round down.
WHOLE_REACH_PERCENT = 99.0
#: Actions that send a trajectory computed on the posture they answer.
_SENDING = ("replan", "evade")
#: Occupancies kept for comparison with what happened: while the human moves, and at rest afterwards.
_SAMPLES_MOVING, _SAMPLES_AT_REST = 60, 20
#: The arm's joints that turn without end.
_ENDLESS = ("r_forearm_roll_joint", "r_wrist_roll_joint")


@dataclass(frozen=True)
class Run:
    """Everything recorded in one run: immutable.

    Attributes:
        folder: the run's folder.
        facts: what the recorder was told about the run (scene, library, trajectory, seed, mode, ...).
        origin_ns: stamp of the first posture (or of whatever came first); all `t_s` count from it.
        duration_s: data time from the origin to the last posture, decision or robot state.
        recorded_ns: wall time of the first message in ns since the epoch, 0 without messages.
        wall_s: wall time from the first to the last message.
        motion_duration_s: length of the human's motion, 0 if unknown.
        postures, posterior, occupancy, decisions, robot, trajectories, latencies: see `tracks`.
        topics: the bag's topics with their message counts, by name.
        human_urdf: the tracked body's URDF, empty if it was not recorded.
        notes: what was left out when reading, and why.
    """

    folder: Path
    facts: Mapping[str, str]
    origin_ns: int
    duration_s: float
    recorded_ns: int
    wall_s: float
    motion_duration_s: float
    postures: PostureTrack
    posterior: PosteriorTrack
    occupancy: OccupancyTrack
    decisions: tuple[RecordedDecision, ...]
    robot: RobotTrack
    trajectories: tuple[SentTrajectory, ...]
    latencies: tuple[Latency, ...]
    topics: tuple[TopicInfo, ...]
    human_urdf: str = ""
    notes: tuple[str, ...] = ()

    @property
    def steps(self) -> tuple[RecordedDecision, ...]:
        """The decisions that are replanning steps, also those in vain, in time order."""
        return tuple(decision for decision in self.decisions if decision.is_step)

    @property
    def goal_names(self) -> tuple[str, ...]:
        """Names of the goals planned for, in the order of their first appearance."""
        return tuple(dict.fromkeys(goal.name for step in self.steps for goal in step.goals))

    @property
    def seen_percent(self) -> float | None:
        """How much of the human's motion was recorded, 0 to 100, None if that is unknown."""
        return self.percent(float(self.postures.t_s[-1])) if len(self.postures) else None

    def percent(self, t_s: float) -> float | None:
        """Return how much of the human's motion is over at `t_s`, 0 to 100, None if its length is unknown."""
        return float(np.clip(100.0 * t_s / self.motion_duration_s, 0.0, 100.0)) if self.motion_duration_s > 0 else None


def read_run(folder: str | Path) -> Run:
    """Read the run recorded in `folder`.

    Topics that are missing or empty give empty series, so an interrupted run can be read, too.

    Raises:
        BagError: no such folder, no bag in it, or a bag that is truncated or damaged.
    """
    folder = Path(folder)
    if not (folder / "bag").is_dir():
        raise BagError(f"{folder}: wanted a run (a folder with a bag/ in it), found none; record one: humanpred demo")
    reader = BagReader(folder / "bag")
    load = _Loader(reader)
    human_topic = topics.body_topic(reader.topics, topics.human_joint_states)
    human = load.stamped(human_topic, messages.JOINT_STATE)
    facts = MappingProxyType(dict(reader.metadata.get("run", {})))
    postures = _postures(human, load)
    motion_duration_s = _motion_duration_s(facts, postures)
    decided = load.stamped(topics.DECISION, messages.DIAGNOSTIC_ARRAY, monotone=False)
    robot = load.stamped(topics.JOINT_STATES, messages.JOINT_STATE)
    sent = load.stamped(topics.TRAJECTORY, messages.JOINT_TRAJECTORY, monotone=False)
    goals = load.stamped(topics.HUMAN_GOALS, messages.POINT_CLOUD2)
    planned = {entry.stamp_ns for entry in decided if len(entry.message.status) > 1}
    sample = EvenSample(_sample_times(human, motion_duration_s))
    occupied = load.stamped(
        topics.OCCUPANCY,
        messages.POINT_CLOUD2,
        keep=lambda stamp, message: _occupied(message, stamp in planned, sample.takes(stamp)),
    )

    firsts = [entries[0].stamp_ns for entries in (human, occupied, decided) if entries]
    origin_ns = firsts[0] if firsts else (robot[-1].stamp_ns if robot else 0)
    first_occupancy_s = _seconds(occupied[0].stamp_ns if occupied else origin_ns, origin_ns)
    decisions = _numbered(
        [run_topics.decision_of(e.message, _seconds(e.stamp_ns, origin_ns), first_occupancy_s) for e in decided], load
    )
    grid = load.text(topics.VOXEL_GRID)
    lasts = [entries[-1].stamp_ns for entries in (human, occupied, decided, robot) if entries]
    return Run(
        folder=folder,
        facts=facts,
        origin_ns=origin_ns,
        duration_s=max((_seconds(stamp, origin_ns) for stamp in lasts), default=0.0),
        recorded_ns=reader.start_ns or 0,
        wall_s=(reader.end_ns - reader.start_ns) * 1e-9 if reader.start_ns and reader.end_ns else 0.0,
        motion_duration_s=motion_duration_s,
        postures=postures,
        posterior=_posterior(goals, origin_ns),
        occupancy=_occupancy(occupied, run_topics.grid_of(grid) if grid else None, origin_ns),
        decisions=decisions,
        robot=_robot(robot, origin_ns),
        trajectories=tuple(run_topics.trajectory_of(e.message, origin_ns) for e in sent),
        latencies=(
            _delays(POSTURE_TO_OCCUPANCY, human, {e.stamp_ns: e.sent_ns for e in occupied}, origin_ns),
            _delays(POSTURE_TO_TRAJECTORY, human, _answers(sent, decided), origin_ns),
        ),
        topics=tuple(sorted(reader.topics.values(), key=lambda topic: topic.name)),
        human_urdf=load.text(topics.body_topic(reader.topics, topics.human_urdf)),
        notes=tuple(load.notes),
    )


class Entry(NamedTuple):
    """A message with its data time (header stamp), the time it was sent, and what is kept of it."""

    stamp_ns: int
    sent_ns: int
    message: Any


class EvenSample:
    """Picks, of messages with rising stamps, those that lie evenly in time: the first one at every due time.

    Clouds are large, so which are kept must be known before they are read.
    """

    def __init__(self, due_ns: Iterable[int]) -> None:
        self._due_ns = sorted(due_ns)
        self._n_past = 0

    def takes(self, stamp_ns: int) -> bool:
        """Return whether the message with this stamp is one of them; ask for each once, in order."""
        n_past = bisect_right(self._due_ns, stamp_ns)
        taken, self._n_past = n_past > self._n_past, n_past
        return taken


class _Loader:
    """Decodes topics of one bag and notes what it had to leave out."""

    def __init__(self, reader: BagReader) -> None:
        self.reader = reader
        self.notes: list[str] = []

    def stamped(
        self, topic: str | None, msgtype: str, *, monotone: bool = True, keep: Callable[[int, Any], Any] | None = None
    ) -> list[Entry]:
        """Return the topic's messages in the order they were logged; none if the bag lacks it.

        Args:
            topic: name.
            msgtype: the type it must have (BagError otherwise).
            monotone: leave out messages whose stamps do not exceed all earlier ones.
            keep: what to keep of a message, given its stamp; the message itself if None.
        """
        if topic is None or topic not in self.reader.topics:
            return []
        self.reader.require_topic(topic, msgtype)
        entries: list[Entry] = []
        backwards, last_ns = 0, -1
        for record in self.reader.messages([topic]):
            message = self.reader.decode(record)
            stamp = messages.ns_from_stamp(message.header.stamp)
            if monotone and stamp <= last_ns:
                backwards += stamp < last_ns  # equal stamps say the same thing twice: nothing to report
                continue
            last_ns = stamp
            entries.append(Entry(stamp, record.publish_time_ns, keep(stamp, message) if keep else message))
        if backwards:
            self.notes.append(f"{topic}: {backwards} messages with stamps older than earlier ones were left out")
        return entries

    def text(self, topic: str | None) -> str:
        """Return the first text of a String topic, empty if there is none."""
        texts = self.reader.decoded(topic) if topic and topic in self.reader.topics else iter(())
        return next((str(message.data) for _, message in texts), "")


class _Occupied(NamedTuple):
    n_voxels: int
    expected_voxels: float
    planned: bool
    sampled: bool
    cloud: tuple[FloatArray, FloatArray] | None


def _seconds(stamp_ns: int, origin_ns: int) -> float:
    return (stamp_ns - origin_ns) * 1e-9


def _times(entries: Iterable[Entry], origin_ns: int) -> FloatArray:
    return np.array([_seconds(entry.stamp_ns, origin_ns) for entry in entries], dtype=np.float64)


def _occupied(message: Any, planned: bool, sampled: bool) -> _Occupied:
    """Reduce a cloud to what plots need; whole clouds are kept only where asked, they are large."""
    centres, probability = run_topics.occupancy_of(message)
    cloud = (centres, probability) if planned or sampled else None
    return _Occupied(len(probability), float(probability.sum()), planned, sampled, cloud)


def _sample_times(human: list[Entry], motion_s: float) -> list[int]:
    """Return the stamps from which on the next occupancy is worth keeping, none without postures."""
    if not human:
        return []
    first_ns, last_ns = human[0].stamp_ns, human[-1].stamp_ns
    end_ns = min(last_ns, first_ns + round(motion_s * 1e9))
    moving = np.linspace(0, end_ns - first_ns, _SAMPLES_MOVING, endpoint=False)
    resting = np.linspace(end_ns - first_ns, last_ns - first_ns, _SAMPLES_AT_REST)
    return [first_ns + round(after_ns) for after_ns in np.concatenate([moving, resting]).tolist()]


def _postures(entries: list[Entry], load: _Loader) -> PostureTrack:
    origin_ns = entries[0].stamp_ns if entries else 0  # a run begins with its first posture
    names = tuple(entries[0].message.name) if entries else ()
    rows = [(entry, run_topics.positions_of(entry.message, names)) for entry in entries]
    usable = [(entry, row[0]) for entry, row in rows if row is not None]
    if len(usable) < len(entries):
        load.notes.append(f"{len(entries) - len(usable)} postures with missing or non-finite joints were left out")
    return PostureTrack(
        _times((entry for entry, _ in usable), origin_ns),
        np.array([q for _, q in usable], dtype=np.float64).reshape(len(usable), len(names)),
        names,
        str(entries[0].message.header.frame_id) if entries else "",
    )


def _numbered(decisions: list[RecordedDecision], load: _Loader) -> tuple[RecordedDecision, ...]:
    """Return the decisions with step numbers that rise; a planner that was started anew counts from 1 again."""
    numbers = [decision.step for decision in decisions if decision.is_step]
    if all(number >= 1 for number in numbers) and all(np.diff(numbers) > 0):
        return tuple(decisions)
    load.notes.append("the planner's step numbers do not rise from 1 on: replanning steps are counted anew")
    count = itertools.count(1)
    return tuple(replace(decision, step=next(count)) if decision.is_step else decision for decision in decisions)


def _posterior(entries: list[Entry], origin_ns: int) -> PosteriorTrack:
    columns = [run_topics.posterior_of(entry.message) for entry in entries]
    if not columns:
        return PosteriorTrack(np.zeros(0), (), np.zeros((0, 0)), np.zeros((0, 3)))
    # Goals may come and go; one that is not told of at a moment has no probability then.
    place = {int(label): goal for labels, _, goals in columns for label, goal in zip(labels, goals, strict=True)}
    all_labels = tuple(sorted(place))
    probability = np.zeros((len(columns), len(all_labels)))
    for row, (labels, told, _) in zip(probability, columns, strict=True):
        row[[all_labels.index(int(label)) for label in labels]] = told
    return PosteriorTrack(_times(entries, origin_ns), all_labels, probability, np.array([place[n] for n in all_labels]))


def _occupancy(entries: list[Entry], grid: VoxelGrid | None, origin_ns: int) -> OccupancyTrack:
    times = _times(entries, origin_ns)

    def kept(which: Callable[[_Occupied], bool]) -> tuple[OccupancySnapshot, ...]:
        return tuple(
            OccupancySnapshot(float(t), *entry.message.cloud)
            for t, entry in zip(times, entries, strict=True)
            if which(entry.message)
        )

    return OccupancyTrack(
        times,
        np.array([entry.message.n_voxels for entry in entries], dtype=np.int64),
        np.array([entry.message.expected_voxels for entry in entries], dtype=np.float64),
        grid,
        kept(lambda occupied: occupied.planned),
        kept(lambda occupied: occupied.sampled),
    )


def _robot(entries: list[Entry], origin_ns: int) -> RobotTrack:
    # Other publishers share the topic on a real robot; states without the arm are theirs.
    rows = [(entry, run_topics.positions_of(entry.message, RIGHT_ARM_JOINTS)) for entry in entries]
    usable = [(entry, *row) for entry, row in rows if row is not None]
    n_joints = len(RIGHT_ARM_JOINTS)
    t_s = _times((entry for entry, _, _ in usable), origin_ns)
    q = np.array([q for _, q, _ in usable], dtype=np.float64).reshape(-1, n_joints)
    v = np.array([v for _, _, v in usable], dtype=np.float64).reshape(-1, n_joints)
    for j, name in enumerate(RIGHT_ARM_JOINTS):
        if name in _ENDLESS and len(q):
            q[:, j] = np.unwrap(q[:, j])  # encoders of such joints start anew after a full turn
    differences = np.gradient(q, t_s, axis=0) if len(q) > 1 else np.zeros_like(q)
    return RobotTrack(t_s, q, np.where(np.isfinite(v), v, differences), RIGHT_ARM_JOINTS)


def _answers(sent: list[Entry], decided: list[Entry]) -> dict[int, int]:
    """Return when the trajectory of each replanning step was sent, by the stamp the step was computed on.

    The planner sends a trajectory right before its decision, so each belongs to the next decision.
    """
    answers: dict[int, int] = {}
    order = sorted(decided, key=lambda entry: entry.sent_ns)
    times = np.array([entry.sent_ns for entry in order], dtype=np.int64)
    for trajectory in sent:
        k = int(np.searchsorted(times, trajectory.sent_ns))
        if k < len(order) and order[k].message.status and order[k].message.status[0].message in _SENDING:
            answers[order[k].stamp_ns] = trajectory.sent_ns
    return answers


def _delays(name: str, human: list[Entry], sent_ns: Mapping[int, int], origin_ns: int) -> Latency:
    pairs = [
        (_seconds(posture.stamp_ns, origin_ns), (sent_ns[posture.stamp_ns] - posture.sent_ns) * 1e-9)
        for posture in human
        if posture.stamp_ns in sent_ns
    ]
    table = np.array(pairs, dtype=np.float64).reshape(-1, 2)
    return Latency(name, table[:, 0], table[:, 1])


def _motion_duration_s(facts: Mapping[str, str], postures: PostureTrack) -> float:
    try:
        told = float(facts.get("duration_s", ""))
    except ValueError:
        told = 0.0
    return told if np.isfinite(told) and told > 0.0 else postures.motion_end_s
