"""Recordings of body trackers: bags of their points become motions, by the same steps as live."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from humanpred_ros.bags.reader import BagReader
from humanpred_ros.errors import BagError, HumanPredError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.kinect import KINECT12_DOFS
from humanpred_ros.human.skeleton_tracker import TrackedPeople
from humanpred_ros.human.skeletons import Skeleton
from humanpred_ros.human.tracker_messages import READERS, seen_bodies
from humanpred_ros.motion.motion import Motion, MotionLibrary

#: A longer pause begins another motion; shorter pieces are none.
_GAP_NS, _LEAST_FRAMES = 1_000_000_000, 5


def read_tracker_recording(
    path: str | Path, skeleton: Skeleton, pose: FloatArray, topic: str | None = None
) -> MotionLibrary:
    """Return the motions of all people in a bag of a tracker's points, without labels; TF in the bag is not read.

    Frames that are no person's, or show too little of one, are left out and counted by reason under `left out`.

    Args:
        path: bag.
        skeleton: which point is which.
        pose: (4, 4) of the tracker (x forward, z up) in the frame that postures are wanted in.
        topic: of the points; the only one of a type that holds points if None.

    Raises:
        BagError: no such topic, several and none was named, or nothing that can be used.
    """
    bag = BagReader(path)
    topic = _topic(bag, topic)
    kind = bag.topics[topic].msgtype
    people, left_out = TrackedPeople(skeleton, pose), Counter[str]()
    frames: dict[str, list[tuple[int, FloatArray, FloatArray]]] = {}
    stampless = last_ns = 0
    for message in bag.messages([topic]):
        try:
            seen = seen_bodies(bag.decode(message), kind, skeleton)
        except HumanPredError as error:
            left_out[f"messages: {str(error).split(':')[0]}"] += 1
            continue
        if not seen.bodies:
            continue
        stamp_ns = seen.stamp_ns or message.log_time_ns
        stampless += not seen.stamp_ns
        if stamp_ns <= last_ns:
            left_out["frames not later than those before"] += 1
            continue
        last_ns = stamp_ns
        for body, posture in people.update(seen.bodies, stamp_ns * 1e-9):
            if posture.q is None:
                left_out[f"frames refused: {posture.refusal.split(':')[0]}"] += 1
            else:
                frames.setdefault(body, []).append((stamp_ns, posture.q, posture.points_m))
    motions: list[Motion] = []
    whose: Counter[str] = Counter()
    for body, seen_frames in sorted(frames.items()):
        for piece in _pieces(seen_frames):
            if len(piece) < _LEAST_FRAMES:
                left_out["pieces too short for a motion"] += 1
                continue
            stamps, q, points = zip(*piece, strict=True)
            t_s = [(stamp - stamps[0]) * 1e-9 for stamp in stamps]
            motions.append(Motion(t_s, q, KINECT12_DOFS, None, len(motions), "kinect", points))  # type: ignore[arg-type]
            whose[body] += 1
    reasons = "; ".join(f"{count} {what}" for what, count in left_out.items())
    if not motions:
        raise BagError(f"{bag.path}: wanted people on {topic}, got no posture ({reasons or 'nobody is seen'})")
    name = bag.path.resolve().stem
    provenance = {"format": "tracker's points", "source": name, "topic": topic, "stamps": "recorded"}
    provenance["people"] = "; ".join(f"{body}: {count} motions" for body, count in whose.items())
    if stampless:
        provenance["stamps"] = f"log times: {stampless} frames have no stamp of their own"
    if reasons:
        provenance["left out"] = reasons
    return MotionLibrary(name, tuple(motions), provenance)


def _topic(bag: BagReader, topic: str | None) -> str:
    held = [name for name, info in sorted(bag.topics.items()) if info.msgtype in READERS and info.count]
    if topic is not None:
        found = bag.require_topic(topic).name
        if found not in held:
            raise BagError(f"{bag.path}: wanted points on {found}, it holds {bag.topics[found].msgtype}")
        return found
    if len(held) != 1:
        had = ", ".join(held) or ", ".join(f"{name} ({info.msgtype})" for name, info in sorted(bag.topics.items()))
        ask = "; name one of them (--topic)" if held else ""
        raise BagError(f"{bag.path}: wanted one topic of points, the bag has {had or 'no topics'}{ask}")
    return held[0]


def _pieces(
    frames: list[tuple[int, FloatArray, FloatArray]],
) -> list[list[tuple[int, FloatArray, FloatArray]]]:
    pieces = [frames[:1]]
    for frame in frames[1:]:
        if frame[0] - pieces[-1][-1][0] > _GAP_NS:
            pieces.append([])
        pieces[-1].append(frame)
    return pieces
