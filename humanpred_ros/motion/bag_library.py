"""Motion libraries as rosbag2 bags: one bag holds all motions of a library, in recording order.

Topics, for one human body: `joint_states` (one message per frame, stamped), `motion` (a JSON text before
each motion's first frame: label, index, n_frames, t0_ns) and, where recorded, `points` (the 15 skeleton
points per frame). Motions start on whole seconds and lie at least one second apart. Numbers are float64
and stamps whole nanoseconds, so a library reads back bit for bit.
"""

from __future__ import annotations

import json
import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import BagError
from humanpred_ros.files import json_of
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.model import MOCAP23_DOFS
from humanpred_ros.motion.labels import checked_label
from humanpred_ros.motion.motion import SKELETON_POINTS, Motion, MotionLibrary
from humanpred_ros.topics import human_joint_states

#: Stamp of the first motion: 0 means "no time" in ROS.
_FIRST_STAMP_NS = 1_000_000_000
#: Least time between motions; a recording without motion messages is cut where frames lie further apart.
_GAP_NS = 1_000_000_000
_SECOND_NS = 1_000_000_000
#: Orders of joints that this package knows; a bag may have them in another.
_DOFS = (KINECT12_DOFS, MOCAP23_DOFS)


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

    label: str | None
    index: int
    n_frames: int | None
    t0_ns: int = 0
    names: tuple[str, ...] = ()
    frame_id: str = ""
    n_came: int = 0
    stamps: list[int] = field(default_factory=list)
    postures: list[FloatArray] = field(default_factory=list)
    points: dict[int, FloatArray] = field(default_factory=dict)

    @classmethod
    def announced(cls, path: Path, text: str) -> _Draft:
        try:
            facts = json_of(text)
            label = None if facts["label"] is None else checked_label(facts["label"], BagError)
            return cls(label, int(facts["index"]), int(facts["n_frames"]), int(facts.get("t0_ns", 0)))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as trouble:
            raise BagError(
                f"{path}: wanted a motion's label, index and n_frames as JSON, got {text!r:.120}"
            ) from trouble

    def add_posture(self, stamp: int, content: Any) -> str:
        """Take a posture, its joints in the order of the first one's; return why it is left out."""
        self.n_came += 1
        names, position = tuple(content.name), np.asarray(content.position, dtype=np.float64)
        if len(position) != len(names) or not np.isfinite(position).all():
            return "without a finite position for every joint"
        if not self.stamps:
            self.names, self.frame_id = names, content.header.frame_id
        if content.header.frame_id != self.frame_id:
            return "in another frame than the first"
        if names != self.names:
            if sorted(names) != sorted(self.names):
                return "with other joints than the first"
            position = position[[names.index(name) for name in self.names]]
        self.stamps.append(stamp)
        self.postures.append(position)
        return ""

    def motion(self, kept: list[int]) -> Motion:
        """Return the motion of the frames numbered `kept`, its joints in the order of a human that has them."""
        stamps = [self.stamps[k] for k in kept]
        t_s = np.array([stamp - stamps[0] + self.t0_ns for stamp in stamps], dtype=np.float64) * 1e-9
        points: FloatArray | None = None
        if self.points:
            lost = np.full((len(SKELETON_POINTS), 3), np.nan)
            points = np.array([self.points.get(stamp, lost) for stamp in stamps])
        order = next((names for names in _DOFS if sorted(names) == sorted(self.names)), self.names)
        q = np.array([self.postures[k] for k in kept])[:, [self.names.index(name) for name in order]]
        return Motion(t_s, q, order, self.label, self.index, self.frame_id, points)


def read_library_bag(path: str | Path, *, body: str | None = None, points: bool = True) -> MotionLibrary:
    """Return the library in a bag, or in a recording of a live tracker; other topics are ignored.

    A recording of joint states without motion messages is cut into unlabelled motions where frames lie more than a
    second apart. What cannot be used is left out, and the provenance says so under `left out`: frames that are not
    later than those before, or have no posture; motions that are cut off, or too short. Where no frame has a
    stamp the log times are taken.

    Args:
        path: rosbag2 directory or file.
        body: which tracked body; the only one, or `body_0`, if None.
        points: whether the skeleton points are read, too.

    Raises:
        BagError: not readable, without joint states of that body, or nothing that can be used.
    """
    bag = BagReader(path)
    states_topic, motion_topic, points_topic = (bag.find(topic) for topic in body_topics(_body_in(bag, body)))
    assert states_topic is not None
    bag.require_topic(states_topic, ros.JOINT_STATE)
    announced = motion_topic is not None and bag.require_topic(motion_topic, ros.STRING).count > 0
    further = (motion_topic, points_topic) if points else (motion_topic,)
    drafts: list[_Draft] = []
    left_out: Counter[str] = Counter()
    stampless = 0
    for message in bag.messages([states_topic] + [topic for topic in further if topic]):
        content = bag.decode(message)
        if message.topic == motion_topic:
            drafts.append(_Draft.announced(bag.path, content.data))
            continue
        stamp = ros.ns_from_stamp(content.header.stamp)
        if stamp <= 0:
            stamp, stampless = message.log_time_ns, stampless + (message.topic == states_topic)
        if message.topic != states_topic:
            if drafts:
                drafts[-1].points[stamp] = _points(bag.path, content)
            continue
        if not announced and (not drafts or (drafts[-1].stamps and stamp - drafts[-1].stamps[-1] > _GAP_NS)):
            drafts.append(_Draft(None, len(drafts), None))
        if not drafts:
            raise BagError(f"{bag.path}: wanted a message on {motion_topic} before the first posture, got none")
        if why := drafts[-1].add_posture(stamp, content):
            left_out[f"frames {why}"] += 1
    motions = _usable(bag.path, drafts, left_out)
    name = bag.metadata.get("library", {}).get("name") or bag.path.resolve().stem
    provenance = dict(bag.metadata.get("provenance", {"format": "bag", "source": name, "stamps": "recorded"}))
    if stampless:
        provenance["stamps"] = f"log times: {stampless} frames have no stamp of their own"
    if left_out:
        provenance["left out"] = "; ".join(f"{count} {what}" for what, count in left_out.items())
    return MotionLibrary(name, motions, provenance)


def _body_in(bag: BagReader, body: str | None) -> str:
    """Return the id of the body to read.

    Raises:
        BagError: it is not there, or there are several and none was named.
    """
    pattern = re.compile(f"/?{human_joint_states('([^/]+)')}")
    there = sorted({found[1] for topic in bag.topics if (found := pattern.search(topic))})
    if body is None:
        body = "body_0" if "body_0" in there or len(there) != 1 else there[0]
    if bag.find(human_joint_states(body)) is None:
        had = f"bodies {', '.join(there)}; name one of them (--body)" if there else (
            f"{', '.join(sorted(bag.topics)) or 'no topics'}; name another bag")  # fmt: skip
        raise BagError(f"{bag.path}: wanted human joint states on {human_joint_states(body)}, the bag has {had}")
    return body


def _usable(path: Path, drafts: Sequence[_Draft], left_out: Counter[str]) -> tuple[Motion, ...]:
    motions: list[Motion] = []
    last = ""
    for draft in drafts:
        kept = _rising(draft.stamps)
        late = len(draft.stamps) - len(kept)
        wanted = draft.n_frames
        if wanted is not None and draft.n_came != wanted:
            last = f"motion {draft.label}/{draft.index}: wanted {wanted} frames as announced, got {draft.n_came}"
            left_out[f"motions cut off ({last})"] += 1
            continue
        if len(kept) < 2:
            last = f"{len(kept)} frames that can be used"
            left_out["pieces too short for a motion"] += 1
            continue
        if late:
            left_out["frames not later than those before"] += late
        index = sum(motion.label is None for motion in motions) if wanted is None else draft.index
        motions.append(replace(draft, index=index).motion(kept))
    if not motions:
        more = "; ".join(left_out)
        raise BagError(f"{path}: wanted at least one complete motion, got none ({last or more or 'no frames'}; {more})")
    return tuple(motions)


def _rising(stamps: Sequence[int]) -> list[int]:
    """Return the numbers of as many stamps as can be, each later than the one before: single ones may be wrong."""
    tails: list[int] = []
    ends: list[int] = []
    before: list[int] = []
    for k, stamp in enumerate(stamps):
        place = bisect_left(tails, stamp)
        before.append(ends[place - 1] if place else -1)
        tails[place : place + 1] = [stamp]
        ends[place : place + 1] = [k]
    kept: list[int] = []
    k = ends[-1] if ends else -1
    while k >= 0:
        kept.append(k)
        k = before[k]
    return kept[::-1]


def _points(path: Path, content: Any) -> FloatArray:
    columns = ros.point_cloud2_fields(content, "xyz")
    points = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    if points.shape != (len(SKELETON_POINTS), 3):
        raise BagError(f"{path}: wanted {len(SKELETON_POINTS)} skeleton points in a message, got {len(points)}")
    return points
