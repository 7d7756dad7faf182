"""Motion libraries as rosbag2 bags: one bag holds all motions of a library, in recording order.

Topics, for one human body: `joint_states` (one message per frame, stamped), `motion` (a JSON text before
each motion's first frame: label, index, n_frames, t0_ns) and, where recorded, `points` (the 15 skeleton
points per frame). Motions start on whole seconds and lie at least one second apart. Numbers are float64
and stamps whole nanoseconds, so a library reads back bit for bit.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError
from humanpred_ros.files import json_of
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import SKELETON_POINTS, Motion, MotionLibrary
from humanpred_ros.topics import human_joint_states

#: Stamp of the first motion: 0 means "no time" in ROS.
_FIRST_STAMP_NS = 1_000_000_000
#: Least time between motions; a recording without motion messages is cut where frames lie further apart.
_GAP_NS = 1_000_000_000
_SECOND_NS = 1_000_000_000


def body_topics(body: str = "body_0") -> tuple[str, str, str]:
    """Return the topics of one tracked body: joint states, motion and points; relative names, after REP-155."""
    return human_joint_states(body), f"humans/bodies/{body}/motion", f"humans/bodies/{body}/points"


def write_library_bag(library: MotionLibrary, directory: str | Path, *, overwrite: bool = False) -> Path:
    """Write a library as the bag `directory`, which appears only when complete; return its path.

    Raises:
        BagError: it exists and `overwrite` is not given, or cannot be written.
    """
    states_topic, motion_topic, points_topic = (f"/{topic}" for topic in body_topics())
    with BagWriter(directory, staged=True, overwrite=overwrite) as bag:
        bag.add_metadata("provenance", library.provenance)
        bag.add_metadata("library", {"name": library.name, "motions": str(len(library))})
        bag.add_topic(motion_topic, ros.STRING)
        bag.add_topic(states_topic, ros.JOINT_STATE)
        if any(motion.points_m is not None for motion in library):
            bag.add_topic(points_topic, ros.POINT_CLOUD2)
        start_ns = _FIRST_STAMP_NS
        for motion in library:
            ticks = np.rint(motion.t_s * 1e9).astype(np.int64)
            stamps = [start_ns + int(tick - ticks[0]) for tick in ticks]
            bag.write_message(motion_topic, stamps[0], ros.string(motion_text(motion)))
            for k, stamp in enumerate(stamps):
                state = ros.joint_state(stamp, motion.dof_names, motion.q[k], frame_id=motion.frame_id)
                bag.write_message(states_topic, stamp, state)
                if motion.points_m is not None:  # float64; NaN where lost
                    columns = dict(zip("xyz", motion.points_m[k].T, strict=True))
                    bag.write_message(points_topic, stamp, ros.point_cloud2(stamp, motion.frame_id, columns))
            start_ns = -(-stamps[-1] // _SECOND_NS) * _SECOND_NS + _GAP_NS
    return Path(directory)


def motion_text(motion: Motion) -> str:
    """Return the JSON that announces a motion; t0_ns is its first frame's time since the motion's start."""
    t0_ns = int(np.rint(motion.t_s[0] * 1e9))
    return json.dumps({"label": motion.label, "index": motion.index, "n_frames": len(motion), "t0_ns": t0_ns})


@dataclass
class _Draft:
    """A motion being collected from messages."""

    label: int | None
    index: int
    n_frames: int | None
    t0_ns: int = 0
    names: tuple[str, ...] = ()
    frame_id: str = ""
    stamps: list[int] = field(default_factory=list)
    postures: list[FloatArray] = field(default_factory=list)
    points: dict[int, FloatArray] = field(default_factory=dict)

    @classmethod
    def announced(cls, path: Path, text: str) -> _Draft:
        try:
            facts = json_of(text)
            label = None if facts["label"] is None else int(facts["label"])
            return cls(label, int(facts["index"]), int(facts["n_frames"]), int(facts.get("t0_ns", 0)))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as trouble:
            raise BagError(
                f"{path}: wanted a motion's label, index and n_frames as JSON, got {text!r:.120}"
            ) from trouble

    def add_posture(self, path: Path, stamp: int, content: Any) -> None:
        names = tuple(content.name)
        if len(content.position) != len(names):
            raise BagError(f"{path}: joint state: wanted {len(names)} positions, got {len(content.position)}")
        if not self.stamps:
            self.names, self.frame_id = names, content.header.frame_id
        elif names != self.names or content.header.frame_id != self.frame_id:
            raise BagError(
                f"{path}: joint state: wanted names {self.names} in frame {self.frame_id!r} throughout a motion, "
                f"got {names} in {content.header.frame_id!r}"
            )
        self.stamps.append(stamp)
        self.postures.append(np.asarray(content.position, dtype=np.float64))

    def motion(self) -> Motion:
        t_s = np.array([stamp - self.stamps[0] + self.t0_ns for stamp in self.stamps], dtype=np.float64) * 1e-9
        points: FloatArray | None = None
        if self.points:
            lost = np.full((len(SKELETON_POINTS), 3), np.nan)
            points = np.array([self.points.get(stamp, lost) for stamp in self.stamps])
        q = np.array(self.postures)
        return Motion(t_s, q, self.names, self.label, self.index, self.frame_id, points)


def read_library_bag(
    path: str | Path, *, body: str = "body_0", incomplete: Literal["error", "drop"] = "error", points: bool = True
) -> MotionLibrary:
    """Return the library in a bag: a rosbag2 directory or an .mcap file; other topics are ignored.

    A recording of joint states without motion messages (from a live tracker) is cut into unlabelled
    motions where frames lie more than a second apart.

    Args:
        path: the bag.
        body: which tracked body.
        incomplete: what to do with a motion that has fewer frames than announced (a salvaged bag).
        points: whether the skeleton points are read, too.

    Raises:
        BagError: not readable, without joint states of that body, or contradicting itself.
        MotionError: postures that are not finite, or stamps that do not increase.
    """
    bag = BagReader(path)
    states_topic, motion_topic, points_topic = (bag.find(topic) for topic in body_topics(body))
    if states_topic is None:
        raise BagError(
            f"{bag.path}: wanted human joint states on {human_joint_states(body)}, "
            f"the bag has {', '.join(sorted(bag.topics)) or 'no topics'}; name another body or bag"
        )
    bag.require_topic(states_topic, ros.JOINT_STATE)
    announced = motion_topic is not None and bag.require_topic(motion_topic, ros.STRING).count > 0
    further = (motion_topic, points_topic) if points else (motion_topic,)
    drafts: list[_Draft] = []
    for message in bag.messages([states_topic] + [topic for topic in further if topic]):
        content = bag.decode(message)
        if message.topic == motion_topic:
            drafts.append(_Draft.announced(bag.path, content.data))
        elif message.topic == states_topic:
            stamp = ros.ns_from_stamp(content.header.stamp)
            if not announced and (not drafts or stamp - drafts[-1].stamps[-1] > _GAP_NS):
                drafts.append(_Draft(None, len(drafts), None))
            if not drafts:
                raise BagError(f"{bag.path}: wanted a message on {motion_topic} before the first posture, got none")
            drafts[-1].add_posture(bag.path, stamp, content)
        elif drafts:
            drafts[-1].points[ros.ns_from_stamp(content.header.stamp)] = _points(bag.path, content)
    name = bag.metadata.get("library", {}).get("name") or bag.path.resolve().stem
    fallback = {"format": "bag", "source": name, "stamps": "recorded"}
    motions = _complete(bag.path, drafts, incomplete)
    return MotionLibrary(name, motions, bag.metadata.get("provenance", fallback))


def _complete(path: Path, drafts: Sequence[_Draft], incomplete: Literal["error", "drop"]) -> tuple[Motion, ...]:
    whole = []
    for draft in drafts:
        wanted, got = draft.n_frames, len(draft.stamps)
        if got >= 2 and wanted in (None, got):
            whole.append(draft)
        elif incomplete == "error" or (wanted is not None and got >= wanted):
            raise BagError(
                f"{path}: motion {draft.label}/{draft.index}: wanted {wanted or 'at least 2'} frames as announced, got "
                f'{got}; read the others with incomplete="drop"'
            )
    if not whole:
        raise BagError(f"{path}: wanted at least one complete motion, got none")
    return tuple(draft.motion() for draft in whole)


def _points(path: Path, content: Any) -> FloatArray:
    columns = ros.point_cloud2_fields(content, "xyz")
    points = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    if points.shape != (len(SKELETON_POINTS), 3):
        raise BagError(f"{path}: wanted {len(SKELETON_POINTS)} skeleton points in a message, got {len(points)}")
    return points
