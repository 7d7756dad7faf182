"""`humanpred record`: a motion library of one's own people, from the running tracker or from a recording."""

from __future__ import annotations

import os
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from humanpred_ros import topics
from humanpred_ros.errors import BagError, HumanPredError, UsageError
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel, human_named, human_with
from humanpred_ros.human.skeletons import load_skeleton, pose_of
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.labels import checked_label
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.motion.tracker_recordings import read_tracker_recording
from humanpred_ros.reaching.places import places_in_world
from humanpred_ros.recognition.reach_cutter import (
    NO_REACH,
    ReachCutter,
    ends_m,
    labels_by_cluster,
    labels_by_place,
    misplaced,
)
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.settings import Settings, setting

_LOOK_S, _SAY_S = 0.2, 3.0


class RecordSettings(Settings):
    """Settings of `humanpred record`."""

    out: Path = setting(..., "bag to write, a motion library")
    labels: tuple[str, ...] = setting((), "what is reached for, as screws,housing; none: the scene's places")
    count: int = setting(25, "reaches of each label", low=1, high=10_000)
    scene: str = setting("", "scene name in config/scenes, or a YAML file: its places are the labels")
    from_: str | None = setting(None, "cut a recording instead: a bag of postures, or with --skeleton of points")
    skeleton: str | None = setting(None, "with --from: which tracker's points the bag holds (config/skeletons)")
    topic: str | None = setting(None, "with --from and --skeleton: of the points; none: the only one that holds points")
    tracker_pose: str = setting("", "with --skeleton: 'x y z roll pitch yaw' of the tracker (m, rad), x forward, z up")
    body: str | None = setting(None, "whose postures; none: the only body")
    human: str = setting("kinect12", "live: whose postures come: kinect12 or mocap23")
    namespace: str = setting("", "live: of the tracker, as /robot1")
    overwrite: bool = setting(False, "replace what exists")


def record(settings: RecordSettings, console: Console) -> int:
    """Make a motion library of your own people: `train` and `demo` run on it.

    Live, the running tracker is listened to. The command says whom it sees and what is to be reached for next, the
    labels in turns; it cuts each reach out of the stream by onset and rest, counts it, or refuses it with the reason,
    and stops at `--count` of each. The bag is written anew after each reach, so that Ctrl-C keeps what there is.

    With `--from BAG` a recording is cut in the same way, and the label of a reach follows from where the hand ends: at
    a place of the scene, or among ends that lie together; `--labels` then names the places in the order in which they
    are first reached for.
    """
    labels = [checked_label(label, UsageError) for label in settings.labels]
    if len(set(labels)) != len(labels):
        raise UsageError(f"--labels: wanted different ones, got {', '.join(labels)}")
    scene = load_scene(settings.scene) if settings.scene else None
    places = {} if scene is None else {place.label: place.place_m for place in scene.places}
    found = None if scene is None else places_in_world(places, scene.T_world_human)
    if scene is not None and found is None:
        raise UsageError(f"--scene: wanted a scene with places, {settings.scene} has none; add them, or give --labels")
    if unknown := [label for label in labels if found is not None and label not in found.labels]:
        raise UsageError(f"--labels: wanted places of the scene, {', '.join(places)}, got {', '.join(unknown)}")
    known = {} if found is None else {name: m for name, m in found.by_label.items() if not labels or name in labels}
    if os.path.lexists(settings.out) and not settings.overwrite:
        raise UsageError(f"--out: wanted a new bag, {settings.out} exists; choose another or --overwrite")
    if settings.from_ is not None:
        return _record_from(settings, settings.from_, labels, known, console)
    if not (labels or known):
        raise UsageError("--labels: wanted what is reached for, as screws,housing, or a --scene with places, got none")
    return _record_live(settings, labels or [*known], console)


def _write(settings: RecordSettings, reaches: list[Motion], source: str, left_out: Counter[str]) -> None:
    provenance = {"format": "recorded reaches", "source": source, "stamps": "recorded"}
    if left_out:
        provenance["left out"] = "; ".join(f"{count} {what}" for what, count in left_out.items())
    library = MotionLibrary(settings.out.name, tuple(reaches), provenance)
    write_library_bag(library, settings.out, overwrite=True)


def _record_from(
    settings: RecordSettings, source: str, labels: list[str], places: dict[str, FloatArray], console: Console
) -> int:
    if settings.skeleton is None:
        recorded = load_library(source, body=settings.body, points=False)
    else:
        recorded = read_tracker_recording(
            source, load_skeleton(settings.skeleton), pose_of(settings.tracker_pose), settings.topic
        )
    human = human_with(recorded.dof_names)
    cut: list[Motion] = []
    left_out: Counter[str] = Counter()
    for stream in recorded:
        cutter = ReachCutter(human)
        held_t, held_q = stream.timeline(round(3.0 / stream.period_s))  # a recording may end before the rest is noticed
        for tick, q in zip(held_t, held_q, strict=True):
            found = cutter.update(q, tick * 1e-9)
            if found is not None and found.motion is not None:
                cut.append(replace(found.motion, index=len(cut), frame_id=recorded.frame_id))
            elif found is not None:
                left_out[found.refusal] += 1
    if not cut:
        reasons = "; ".join(f"{count} {what}" for what, count in left_out.items()) or "nobody moved"
        raise BagError(f"{source}: wanted reaches with rest between them, got none ({reasons})")
    ends = ends_m(cut, human)
    named = labels_by_place(ends, places) if places else labels_by_cluster(ends, labels)
    reaches: list[Motion] = []
    counts: Counter[str] = Counter()
    for motion, label in zip(cut, named, strict=True):
        if label is None:
            left_out["ends at none of the places"] += 1
        elif counts[label] == settings.count:
            left_out[f"more than {settings.count} of {label}"] += 1
        else:
            reach = replace(motion, label=label, index=counts[label])
            if why := misplaced([*reaches, reach], human):
                left_out[why] += 1
            else:
                reaches.append(reach)
                counts[label] += 1
    if not reaches:
        raise BagError(
            f"{source}: wanted reaches to {', '.join(places)}, all {len(cut)} end elsewhere; check the scene"
        )
    _write(settings, reaches, Path(source).name, left_out)
    for what, count in left_out.items():
        console.print(f"{source}: left out {count}: {what}", highlight=False, soft_wrap=True)
    said = ", ".join(f"{count} {label}" for label, count in counts.items())
    console.print(f"{source} -> {settings.out}: {len(reaches)} reaches ({said})", highlight=False, soft_wrap=True)
    return 0


class Session:
    """The reaches recorded so far: which label is next, and what became of each movement.

    Args:
        settings: of the command.
        labels: at least one.
        human: whose postures come.
    """

    def __init__(self, settings: RecordSettings, labels: list[str], human: HumanModel) -> None:
        self.settings, self.labels, self.human = settings, labels, human
        self.reaches: list[Motion] = []
        self.counts: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self._cutter = ReachCutter(human)

    @property
    def next_label(self) -> str | None:
        """The label with the fewest reaches, the first of them; None once there are enough of all."""
        label = min(self.labels, key=lambda label: self.counts[label])
        return label if self.counts[label] < self.settings.count else None

    def take(self, q: FloatArray, t_s: float, frame_id: str) -> str:
        """Take a posture (D,); return what is to be said, empty if nothing is."""
        try:
            cut = self._cutter.update(q, t_s)
        except HumanPredError as error:
            self.refused[f"frames: {str(error).partition(',')[0]}"] += 1
            return ""
        label = self.next_label
        if cut is None or label is None:
            return ""
        why = cut.refusal
        if cut.motion is not None:
            reach = replace(cut.motion, label=label, index=self.counts[label], frame_id=frame_id)
            why = misplaced([*self.reaches, reach], self.human)
            if not why:
                self.reaches.append(reach)
                self.counts[label] += 1
                _write(self.settings, self.reaches, "live", self.refused)
                return f"{label}: {self.counts[label]} of {self.settings.count}"
        self.refused[why] += 1
        if why.startswith(NO_REACH):
            return ""
        return f"{label}: refused, {why}; once more"


def _record_live(settings: RecordSettings, labels: list[str], console: Console) -> int:
    import rclpy
    from sensor_msgs.msg import JointState

    from humanpred_ros.nodes import conversions, qos
    from humanpred_ros.nodes.base import check_namespace, new_executor

    human = human_named(settings.human)
    session = Session(settings, labels, human)
    namespace = f"/{settings.namespace.lstrip('/')}"
    check_namespace(namespace)

    def say(text: str) -> None:
        console.print(text, highlight=False, soft_wrap=True)

    def on_posture(message: JointState) -> None:
        try:
            q = conversions.ordered_positions(message, human.dof_names)
        except HumanPredError as error:
            session.refused[f"frames: {str(error).partition(',')[0]}"] += 1
            return
        if said := session.take(q, conversions.stamp_ns(message.header.stamp) * 1e-9, message.header.frame_id):
            say(said)

    rclpy.init(args=[])
    executor = new_executor()
    try:
        node = rclpy.create_node(f"humanpred_record_{os.getpid()}", namespace=namespace)
        executor.add_node(node)
        seen: tuple[str, ...] = ()
        asked: tuple[str | None, int] = (None, -1)
        listening, look_s, tell_s = "", 0.0, time.monotonic() + _SAY_S
        while session.next_label is not None:
            executor.spin_once(timeout_sec=_LOOK_S)
            label = session.next_label
            if label is not None and (label, session.counts[label]) != asked and listening:
                asked = label, session.counts[label]
                say(f"next: {label} ({session.counts[label]} of {settings.count} there)")
            if (now_s := time.monotonic()) < look_s:
                continue
            look_s = now_s + _LOOK_S
            bodies = [name for name in (settings.body or "",) if name] or sorted(
                parts[-2] for name, _ in node.get_topic_names_and_types()
                if (parts := name.split("/"))[-1] == "joint_states" and "bodies" in parts
            )  # fmt: skip
            if tuple(bodies) != seen:
                seen = tuple(bodies)
                say(f"sees {', '.join(seen) or 'nobody'}" + ("; name one with --body" if len(seen) > 1 else ""))
            if len(bodies) == 1 and bodies[0] != listening:
                listening = bodies[0]
                node.create_subscription(JointState, topics.human_joint_states(listening), on_posture, qos.LOSSLESS)
            if not listening and now_s > tell_s:
                there = ", ".join(name for name, _ in node.get_topic_names_and_types()) or "nothing"
                say(f"waiting for {namespace.rstrip('/')}/{topics.human_joint_states('<id>')}; published: {there}")
                tell_s = now_s + 60.0
    finally:
        executor.shutdown()
        rclpy.try_shutdown()
    say(f"{settings.out}: {len(session.reaches)} reaches, {sum(session.refused.values())} refused")
    return 0
