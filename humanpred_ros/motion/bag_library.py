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
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.motion.motion import SKELETON_POINTS, Motion, MotionLibrary

#: Stamp of the first motion: 0 means "no time" in ROS.
_FIRST_STAMP_NS = 1_000_000_000
#: Least time between motions; a recording without motion messages is cut where frames lie further apart.
_GAP_NS = 1_000_000_000
_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class BodyTopics:
    """Topics of one tracked body, named after REP-155."""

    body: str = "body_0"

    @property
    def joint_states(self) -> str:
        return f"/humans/bodies/{self.body}/joint_states"

    @property
    def motion(self) -> str:
        return f"/humans/bodies/{self.body}/motion"

    @property
    def points(self) -> str:
        return f"/humans/bodies/{self.body}/points"


def write_library_bag(library: MotionLibrary, directory: str | Path, *, overwrite: bool = False) -> Path:
    """Write a library as the bag `directory`, which appears only when complete; return its path.

    Raises:
        BagError: it exists and `overwrite` is not given, or cannot be written.
    """
    topics = BodyTopics()
    with BagWriter(directory, staged=True, overwrite=overwrite) as bag:
        bag.add_metadata("provenance", library.provenance)
        bag.add_metadata("library", {"name": library.name, "motions": str(len(library))})
        bag.add_topic(topics.motion, ros.STRING)
        bag.add_topic(topics.joint_states, ros.JOINT_STATE)
        if any(motion.points_m is not None for motion in library):
            bag.add_topic(topics.points, ros.POINT_CLOUD2)
        start_ns = _FIRST_STAMP_NS
        for motion in library:
            stamps = stamps_ns(motion, start_ns)
            bag.write_message(topics.motion, stamps[0], ros.string(motion_text(motion)))
            for k, stamp in enumerate(stamps):
                bag.write_message(
                    topics.joint_states,
                    stamp,
                    ros.joint_state(stamp, motion.dof_names, motion.q[k], frame_id=motion.frame_id),
                )
                if motion.points_m is not None:
                    bag.write_message(topics.points, stamp, points_message(stamp, motion.frame_id, motion.points_m[k]))
            start_ns = -(-stamps[-1] // _SECOND_NS) * _SECOND_NS + _GAP_NS
    return Path(directory)


def stamps_ns(motion: Motion, start_ns: int) -> list[int]:
    """Return the frames' stamps when the motion's first frame is at `start_ns`."""
    ticks = np.rint(motion.t_s * 1e9).astype(np.int64)
    return [start_ns + int(tick - ticks[0]) for tick in ticks]


def motion_text(motion: Motion) -> str:
    """Return the JSON that announces a motion; t0_ns is its first frame's time since the motion's start."""
    facts = {
        "label": motion.label,
        "index": motion.index,
        "n_frames": len(motion),
        "t0_ns": int(np.rint(motion.t_s[0] * 1e9)),
    }
    return json.dumps(facts)


def points_message(stamp_ns: int, frame_id: str, points_m: FloatArray) -> Any:
    """Return the (15, 3) skeleton points as PointCloud2 with float64 x, y, z; NaN where lost."""
    return ros.point_cloud2(stamp_ns, frame_id, {axis: points_m[:, k] for k, axis in enumerate("xyz")})


@dataclass
class _Draft:
    """A motion being collected from messages."""

    facts: dict[str, Any]
    names: tuple[str, ...] = ()
    frame_id: str = ""
    stamps: list[int] = field(default_factory=list)
    postures: list[FloatArray] = field(default_factory=list)
    points: dict[int, FloatArray] = field(default_factory=dict)

    def motion(self) -> Motion:
        first = self.stamps[0] - int(self.facts.get("t0_ns", 0))
        points: FloatArray | None = None
        if self.points:
            points = np.full((len(self.stamps), len(SKELETON_POINTS), 3), np.nan)
            for k, stamp in enumerate(self.stamps):
                if stamp in self.points:
                    points[k] = self.points[stamp]
        return Motion(
            t_s=np.array([stamp - first for stamp in self.stamps], dtype=np.float64) * 1e-9,
            q=np.array(self.postures),
            dof_names=self.names,
            label=self.facts["label"],
            index=self.facts["index"],
            frame_id=self.frame_id,
            points_m=points,
        )


def read_library_bag(
    path: str | Path, *, body: str = "body_0", incomplete: Literal["error", "drop"] = "error"
) -> MotionLibrary:
    """Return the library in a bag: a rosbag2 directory or an .mcap file; other topics are ignored.

    A recording of joint states without motion messages (from a live tracker) is cut into unlabelled
    motions where frames lie more than a second apart.

    Args:
        path: the bag.
        body: which tracked body.
        incomplete: what to do with a motion that has fewer frames than announced (a salvaged bag).

    Raises:
        BagError: not readable, without joint states of that body, or contradicting itself.
        MotionError: postures that are not finite, or stamps that do not increase.
    """
    bag = BagReader(path)
    topics = BodyTopics(body)
    if topics.joint_states not in bag.topics:
        raise BagError(
            f"{bag.path}: wanted human joint states on {topics.joint_states}, "
            f"the bag has {', '.join(sorted(bag.topics)) or 'no topics'}; name another body or bag"
        )
    bag.require_topic(topics.joint_states, ros.JOINT_STATE)
    announced = topics.motion in bag.topics and bag.require_topic(topics.motion, ros.STRING).count > 0
    wanted = [topics.joint_states] + [t for t in (topics.motion, topics.points) if t in bag.topics]
    drafts: list[_Draft] = []
    for message in bag.messages(wanted):
        content = bag.decode(message)
        if message.topic == topics.motion:
            drafts.append(_Draft(_motion_facts(bag.path, content.data)))
        elif message.topic == topics.joint_states:
            stamp = ros.ns_from_stamp(content.header.stamp)
            if not announced and (not drafts or stamp - drafts[-1].stamps[-1] > _GAP_NS):
                drafts.append(_Draft({"label": None, "index": len(drafts), "n_frames": None}))
            if not drafts:
                raise BagError(f"{bag.path}: wanted a message on {topics.motion} before the first posture, got none")
            _add_posture(bag.path, drafts[-1], stamp, content)
        elif drafts:
            drafts[-1].points[ros.ns_from_stamp(content.header.stamp)] = _points(bag.path, content)
    motions = _complete(bag.path, drafts, incomplete)
    record = bag.metadata.get("library", {})
    name = record.get("name") or bag.path.resolve().stem
    fallback = {"format": "bag", "source": name, "stamps": "recorded"}
    return MotionLibrary(name, tuple(motions), bag.metadata.get("provenance", fallback))


def _complete(path: Path, drafts: Sequence[_Draft], incomplete: Literal["error", "drop"]) -> list[Motion]:
    motions = []
    for draft in drafts:
        wanted, got = draft.facts["n_frames"], len(draft.stamps)
        if (wanted is not None and got != wanted) or got < 2:
            if incomplete == "drop" and (wanted is None or got < wanted):
                continue
            name = f"{draft.facts['label']}/{draft.facts['index']}"
            raise BagError(
                f"{path}: motion {name}: wanted {wanted or 'at least 2'} frames as announced, got {got}; "
                'read the others with incomplete="drop"'
            )
        motions.append(draft.motion())
    if not motions:
        raise BagError(f"{path}: wanted at least one complete motion, got none")
    return motions


def _motion_facts(path: Path, text: str) -> dict[str, Any]:
    try:
        facts = json.loads(text)
        label = facts["label"]
        return {
            "label": None if label is None else int(label),
            "index": int(facts["index"]),
            "n_frames": int(facts["n_frames"]),
            "t0_ns": int(facts.get("t0_ns", 0)),
        }
    except (ValueError, KeyError, TypeError, AttributeError) as trouble:
        raise BagError(f"{path}: wanted a motion's label, index and n_frames as JSON, got {text!r:.120}") from trouble


def _add_posture(path: Path, draft: _Draft, stamp: int, content: Any) -> None:
    names = tuple(content.name)
    if len(content.position) != len(names):
        raise BagError(f"{path}: joint state: wanted {len(names)} positions, got {len(content.position)}")
    if not draft.stamps:
        draft.names, draft.frame_id = names, content.header.frame_id
    elif names != draft.names or content.header.frame_id != draft.frame_id:
        raise BagError(
            f"{path}: joint state: wanted names {draft.names} in frame {draft.frame_id!r} throughout a motion, "
            f"got {names} in {content.header.frame_id!r}"
        )
    draft.stamps.append(stamp)
    draft.postures.append(np.asarray(content.position, dtype=np.float64))


def _points(path: Path, content: Any) -> FloatArray:
    columns = ros.point_cloud2_fields(content, "xyz")
    points = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    if points.shape != (len(SKELETON_POINTS), 3):
        raise BagError(f"{path}: wanted {len(SKELETON_POINTS)} skeleton points in a message, got {len(points)}")
    return points
