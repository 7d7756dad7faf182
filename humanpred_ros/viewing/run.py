"""A recorded run read back from its folder: the one thing that summaries, plots and reports start from."""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from humanpred_ros import topics
from humanpred_ros.bags import messages
from humanpred_ros.bags.metadata import TopicInfo
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import BagError, HumanPredError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.geometry.lattice import VoxelGrid
from humanpred_ros.motion.labels import label_order
from humanpred_ros.robot.robot_file import read_robot_file
from humanpred_ros.robot.scene_file import read_scene_file, recorded_scene
from humanpred_ros.viewing import recorded

#: Names of a run's latencies; the wall-clock times of sending are compared.
POSTURE_TO_OCCUPANCY = "posture to occupancy"
POSTURE_TO_TRAJECTORY = "posture to trajectory"

#: A reach seen up to here was seen whole: stamps of the last posture may round down.
WHOLE_REACH_PERCENT = 99.0
#: Actions that send a trajectory computed on the posture they answer.
_SENDING = ("replan", "evade")
#: Occupancies kept for comparison with what happened: while the human moves, and at rest afterwards.
_SAMPLES_MOVING, _SAMPLES_AT_REST = 60, 20
#: Messages of one topic that are read: an arm's joint states at 1 kHz for eight minutes, or at 30 Hz for hours.
_MOST_MESSAGES = 500_000
#: No joint turns half a turn in less time, s.
_HALF_TURN_S = 0.5


@dataclass(frozen=True)
class Run:
    """Everything recorded in one run: immutable. For its series see `recorded`."""

    folder: Path
    facts: Mapping[str, str]  #: what the recorder was told about the run (scene, library, trajectory, seed, mode, ...)
    origin_ns: int  #: stamp of the first posture (or of whatever came first); all `t_s` count from it
    duration_s: float  #: data time from the origin to the last posture, decision or robot state
    recorded_ns: int  #: wall time of the first message in ns since the epoch, 0 without messages
    wall_s: float  #: wall time from the first to the last message
    motion_duration_s: float  #: length of the human's motion, 0 if unknown
    postures: recorded.JointTrack
    posterior: recorded.PosteriorTrack
    occupancy: recorded.OccupancyTrack
    decisions: tuple[recorded.RecordedDecision, ...]
    robot: recorded.JointTrack
    trajectories: tuple[recorded.JointTrack, ...]  #: as sent to the arm's controller
    latencies: tuple[recorded.Latency, ...]
    topics: tuple[TopicInfo, ...]  #: of the bag, with their message counts, by name
    human_urdf: str = ""  #: of the tracked body, empty if it was not recorded
    notes: tuple[str, ...] = ()  #: what was left out when reading, and why

    @property
    def steps(self) -> tuple[recorded.RecordedDecision, ...]:
        """The decisions that are replanning steps, also those in vain, in time order."""
        return tuple(decision for decision in self.decisions if decision.is_step)

    @property
    def goal_names(self) -> tuple[str, ...]:
        """Names of the goals planned for, in the order of their first appearance."""
        return tuple(dict.fromkeys(goal.name for step in self.steps for goal in step.goals))

    @property
    def planning(self) -> recorded.Latency:
        """Wall time of each replanning step, as far as it is told."""
        told = [(step.t_s, step.compute_s) for step in self.steps if np.isfinite(step.compute_s)]
        table = np.array(told, dtype=np.float64).reshape(-1, 2)
        return recorded.Latency("planning one step", table[:, 0], table[:, 1])

    @property
    def seen_percent(self) -> float | None:
        """How much of the human's motion was recorded, 0 to 100, None if that is unknown."""
        return self.percent(float(self.postures.t_s[-1])) if len(self.postures) else None

    def percent(self, t_s: float) -> float | None:
        """Return how much of the human's motion is over at `t_s`, 0 to 100, None if its length is unknown."""
        return float(np.clip(100.0 * t_s / self.motion_duration_s, 0.0, 100.0)) if self.motion_duration_s > 0 else None


def read_run(folder: str | Path, namespace: str | None = None) -> Run:
    """Read the run recorded in `folder`; of several robots the one in `namespace`.

    Topics that are missing or empty give empty series, so an interrupted run can be read, too.

    Raises:
        BagError: no such folder, no bag in it, a bag that is truncated or damaged, or several robots and no namespace.
    """
    folder = Path(folder)
    if not (folder / "bag").is_dir():
        raise BagError(f"{folder}: wanted a run (a folder with a bag/ in it), found none; record one: humanpred demo")
    bag = BagReader(folder / "bag", namespace)
    notes: list[str] = []
    facts = MappingProxyType(dict(bag.metadata.get("run", {})))
    human = list(_stamped(bag, topics.body_topic(bag.names, topics.human_joint_states), messages.JOINT_STATE, notes))
    postures = _postures(human, notes)
    motion_duration_s = _motion_duration_s(facts, postures)
    decided = list(_stamped(bag, topics.DECISION, messages.DIAGNOSTIC_ARRAY))
    robot = list(_stamped(bag, topics.JOINT_STATES, messages.JOINT_STATE, notes))
    sent = list(_stamped(bag, topics.TRAJECTORY, messages.JOINT_TRAJECTORY))
    goals = list(_stamped(bag, topics.HUMAN_GOALS, messages.POINT_CLOUD2, notes))
    occupied = _Occupancies(bag, decided, _due_ns(human, motion_duration_s), notes)

    firsts = [entries[0].stamp_ns for entries in (human, occupied.entries, decided) if entries]
    origin_ns = firsts[0] if firsts else (robot[-1].stamp_ns if robot else 0)
    first_occupancy_s = _seconds(occupied.entries[0].stamp_ns if occupied.entries else origin_ns, origin_ns)
    decisions = [recorded.decision_of(e.message, _seconds(e.stamp_ns, origin_ns), first_occupancy_s) for e in decided]
    grid = _text(bag, topics.VOXEL_GRID)
    lasts = [entries[-1].stamp_ns for entries in (human, occupied.entries, decided, robot) if entries]
    return Run(
        folder=folder,
        facts=facts,
        origin_ns=origin_ns,
        duration_s=max((_seconds(stamp, origin_ns) for stamp in lasts), default=0.0),
        recorded_ns=bag.start_ns or 0,
        wall_s=(bag.end_ns - bag.start_ns) * 1e-9 if bag.start_ns and bag.end_ns else 0.0,
        motion_duration_s=motion_duration_s,
        postures=postures,
        posterior=_posterior(goals, origin_ns),
        occupancy=occupied.track(recorded.grid_of(grid) if grid else None, origin_ns),
        decisions=_numbered(decisions, notes),
        robot=_robot(robot, _arm_joints(folder, facts, sent, robot), origin_ns),
        trajectories=tuple(recorded.trajectory_of(e.message, origin_ns) for e in sent),
        latencies=(
            _delays(POSTURE_TO_OCCUPANCY, human, {entry.stamp_ns: entry for entry in occupied.entries}, origin_ns),
            _delays(POSTURE_TO_TRAJECTORY, human, trajectories_by_stamp(sent, decided), origin_ns),
        ),
        topics=tuple(sorted(bag.topics.values(), key=lambda topic: topic.name)),
        human_urdf=_text(bag, topics.body_topic(bag.names, topics.human_urdf)),
        notes=tuple(notes),
    )


class Entry(NamedTuple):
    """A message with its data time (header stamp), and when it was sent and received, in ns since the epoch."""

    stamp_ns: int
    sent_ns: int
    heard_ns: int
    message: Any


def stamped(bag: BagReader, topic: str | None, msgtype: str | None = None) -> Iterator[Entry]:
    """Yield a topic's messages in the order they were logged; none if the bag lacks it, BagError for another type."""
    if topic is None or bag.find(topic) is None:
        return
    bag.require_topic(topic, msgtype)
    for k, record in enumerate(bag.messages([topic])):
        if k == _MOST_MESSAGES:
            raise BagError(f"{bag.path}: wanted at most {_MOST_MESSAGES} messages of {topic}, it has more; cut the bag")
        message = bag.decode(record)
        stamp_ns = messages.ns_from_stamp(message.header.stamp)
        yield Entry(stamp_ns, record.publish_time_ns, record.log_time_ns, message)


def _stamped(bag: BagReader, topic: str | None, msgtype: str, notes: list[str] | None = None) -> Iterator[Entry]:
    """Yield as `stamped`; given a list for notes, leave out messages whose stamps do not exceed all earlier ones."""
    backwards, last_ns = 0, -1
    for entry in stamped(bag, topic, msgtype):
        if notes is not None and entry.stamp_ns <= last_ns:
            backwards += entry.stamp_ns < last_ns  # equal stamps say the same thing twice: nothing to report
            continue
        last_ns = entry.stamp_ns
        yield entry
    if backwards and notes is not None:
        notes.append(f"{topic}: {backwards} messages with stamps older than earlier ones were left out")


def occupancies(bag: BagReader, notes: list[str] | None = None) -> Iterator[Entry]:
    """Yield the occupancies of a bag, in the form it holds, as `_stamped`."""
    topic = topics.recorded_occupancy({name: bag.topics[full].count for name, full in bag.names.items()})
    msgtype = messages.COMPRESSED_IMAGE if topic == topics.COMPACT_OCCUPANCY else messages.POINT_CLOUD2
    return _stamped(bag, topic, msgtype, notes)


def _text(bag: BagReader, topic: str | None) -> str:
    """Return the first text of a String topic, empty if there is none."""
    texts = bag.decoded(topic) if topic and bag.find(topic) else iter(())
    return next((str(message.data) for _, message in texts), "")


def _seconds(stamp_ns: int, origin_ns: int) -> float:
    return (stamp_ns - origin_ns) * 1e-9


def _times(entries: Iterable[Entry], origin_ns: int) -> FloatArray:
    return np.array([_seconds(entry.stamp_ns, origin_ns) for entry in entries], dtype=np.float64)


def _joints(entries: list[Entry], names: tuple[str, ...], origin_ns: int) -> recorded.JointTrack:
    """Return the named joints of joint states; those that lack one, or a finite position of it, are left out."""
    rows = [(entry, *row) for entry in entries if (row := recorded.positions_of(entry.message, names)) is not None]
    q, v = (np.array([row[k] for row in rows], dtype=np.float64).reshape(len(rows), len(names)) for k in (1, 2))
    return recorded.JointTrack(_times((row[0] for row in rows), origin_ns), q, v, names)


def _postures(entries: list[Entry], notes: list[str]) -> recorded.JointTrack:
    if not entries:
        return recorded.JointTrack(np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
    first = entries[0]  # a run begins with its first posture
    track = _joints(entries, tuple(first.message.name), first.stamp_ns)
    if len(track) < len(entries):
        notes.append(f"{len(entries) - len(track)} postures with missing or non-finite joints were left out")
    return replace(track, frame_id=str(first.message.header.frame_id))


def _arm_joints(folder: Path, facts: Mapping[str, str], sent: list[Entry], states: list[Entry]) -> tuple[str, ...]:
    """Return the arm's joints: those of the scene's robot, else those that were commanded, else all."""
    try:
        return read_robot_file(read_scene_file(recorded_scene(folder, facts.get("scene", ""))).robot.robot).joints
    except HumanPredError:
        return next(
            (tuple(entry.message.joint_names) for entry in sent), tuple(states[0].message.name if states else ())
        )


def _robot(entries: list[Entry], names: tuple[str, ...], origin_ns: int) -> recorded.JointTrack:
    track = _joints(entries, names, origin_ns)  # on a real robot others publish states of other joints
    # Encoders of joints that turn without end start anew after a full turn.
    turns = np.round(np.diff(track.q, axis=0) / (2.0 * np.pi)) * (np.diff(track.t_s) < _HALF_TURN_S)[:, None]
    q = track.q.copy()
    q[1:] -= 2.0 * np.pi * np.cumsum(turns, axis=0)
    differences = np.gradient(q, track.t_s, axis=0) if len(q) > 1 else np.zeros_like(q)
    return replace(track, q=q, v=np.where(np.isfinite(track.v), track.v, differences))


def _motion_duration_s(facts: Mapping[str, str], postures: recorded.JointTrack) -> float:
    try:
        told = float(facts.get("duration_s", ""))
    except ValueError:
        told = 0.0
    return told if np.isfinite(told) and told > 0.0 else postures.motion_end_s


def _due_ns(human: list[Entry], motion_s: float) -> list[int]:
    """Return the stamps from which on the next occupancy is worth keeping, none without postures."""
    if not human:
        return []
    first_ns, last_ns = human[0].stamp_ns, human[-1].stamp_ns
    end_ns = min(last_ns, first_ns + round(motion_s * 1e9))
    moving = np.linspace(0, end_ns - first_ns, _SAMPLES_MOVING, endpoint=False)
    resting = np.linspace(end_ns - first_ns, last_ns - first_ns, _SAMPLES_AT_REST)
    return sorted(first_ns + round(after_ns) for after_ns in np.concatenate([moving, resting]).tolist())


class _Occupancies:
    """The occupancies of a bag; whole clouds are large and kept only where they are planned on or sampled."""

    def __init__(self, bag: BagReader, decided: list[Entry], due_ns: list[int], notes: list[str]) -> None:
        self.planned = {entry.stamp_ns for entry in decided if len(entry.message.status) > 1}
        self.sampled: set[int] = set()
        self.entries: list[Entry] = []  # with the probabilities alone as messages
        self.clouds: dict[int, tuple[FloatArray, ...]] = {}
        n_past = 0
        for entry in occupancies(bag, notes):
            stamp, cloud = entry.stamp_ns, recorded.occupied_of(entry.message)
            self.entries.append(entry._replace(message=(len(cloud[1]), float(cloud[1].sum()))))
            if (n_due := bisect_right(due_ns, stamp)) > n_past:  # the first one at or after every due time
                self.sampled.add(stamp)
            n_past = n_due
            if stamp in self.planned or stamp in self.sampled:
                self.clouds[stamp] = cloud

    def track(self, grid: VoxelGrid | None, origin_ns: int) -> recorded.OccupancyTrack:
        """Return them on the run's time axis."""
        table = np.array([entry.message for entry in self.entries], dtype=np.float64).reshape(-1, 2)
        snapshots, samples = (
            tuple(
                recorded.OccupancySnapshot(_seconds(stamp, origin_ns), *cloud)
                for stamp, cloud in self.clouds.items()
                if stamp in which
            )
            for which in (self.planned, self.sampled)
        )
        times = _times(self.entries, origin_ns)
        return recorded.OccupancyTrack(times, table[:, 0].astype(np.int64), table[:, 1], grid, snapshots, samples)


def _posterior(entries: list[Entry], origin_ns: int) -> recorded.PosteriorTrack:
    told = [recorded.posterior_of(entry.message) for entry in entries]
    # Goals may come and go; one that is not told of at a moment has no probability then.
    place = {label: goal for places, labels, _ in told for label, goal in zip(labels, places, strict=True)}
    all_labels = tuple(sorted(place, key=label_order))
    probability = np.zeros((len(told), len(all_labels)))
    for row, (_, labels, p) in zip(probability, told, strict=True):
        row[[all_labels.index(label) for label in labels]] = p
    places = np.array([place[label] for label in all_labels]).reshape(-1, 3)
    return recorded.PosteriorTrack(_times(entries, origin_ns), all_labels, probability, places)


def _numbered(decisions: list[recorded.RecordedDecision], notes: list[str]) -> tuple[recorded.RecordedDecision, ...]:
    """Return the decisions with step numbers that rise; a planner that was started anew counts from 1 again."""
    numbers = [decision.step for decision in decisions if decision.is_step]
    if all(number >= 1 for number in numbers) and all(np.diff(numbers) > 0):
        return tuple(decisions)
    notes.append("the planner's step numbers do not rise from 1 on: replanning steps are counted anew")
    count = itertools.count(1)
    return tuple(replace(decision, step=next(count)) if decision.is_step else decision for decision in decisions)


def trajectories_by_stamp(sent: Iterable[Entry], decided: Iterable[Entry]) -> dict[int, Entry]:
    """Return the trajectories that decisions sent, by the stamp each was computed on.

    The planner sends a trajectory right before its decision, so each belongs to the next decision.
    """
    answers: dict[int, Entry] = {}
    order = sorted(decided, key=lambda entry: entry.sent_ns)
    times = np.array([entry.sent_ns for entry in order], dtype=np.int64)
    for trajectory in sent:
        k = int(np.searchsorted(times, trajectory.sent_ns))
        if k < len(order) and order[k].message.status and order[k].message.status[0].message in _SENDING:
            answers[order[k].stamp_ns] = trajectory
    return answers


def _delays(name: str, human: list[Entry], answers: Mapping[int, Entry], origin_ns: int) -> recorded.Latency:
    answered = [posture for posture in human if posture.stamp_ns in answers]
    delay_s = [(answers[posture.stamp_ns].sent_ns - posture.sent_ns) * 1e-9 for posture in answered]
    return recorded.Latency(name, _times(answered, origin_ns), np.array(delay_s, dtype=np.float64))
