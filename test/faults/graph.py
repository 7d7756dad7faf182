"""The running graph of `humanpred bench faults`, and what can be done to it."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from faults.catalogue import (
    ARM,
    CLOCK,
    DIRECT,
    GUARD,
    GUARDED,
    NODES,
    PLANNER,
    POSTURES,
    PREDICTOR,
    RECORDER,
    TRACKED_BODY,
    TRACKER,
    WATCHED,
    wired,
)
from faults.spoilt_messages import Spoil
from faults.wire import Wire
from humanpred_ros import topics
from humanpred_ros.bags.salvage import scan_records
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.bench_nodes import RATE_HZ, write_changed_scene
from humanpred_ros.evaluation.planner_bench_world import SCENE
from humanpred_ros.evaluation.processes import NodeGroup, NodeProcess, ParameterValue, free_domain_id
from humanpred_ros.human.model import human_with
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary, resample
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR
from humanpred_ros.recognition.training import model_of
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.robot.scene_file import read_scene_file

_LIBRARY = "synthetic_reaches"
#: Classes of the reaches, and the arm's goals where they end.
_CLASSES, _GOALS = ("3", "5"), ("place 3", "place 5")
#: Length of the replayed motion; pause at the end of each reach; way from one to the next, s. A sensor's noise.
SECONDS, _PAUSE_S, _BETWEEN_S, _NOISE = 600.0, 1.0, 0.5, 1e-4
#: Of the URDF's limits; slow, so that the arm is on its way for long.
VELOCITY_SCALE = 0.1
#: As in the demo, about, and fewer iterations: on a busy machine a step takes its time.
PERIOD_S, ITERATIONS = 0.2, 20
#: A simulated clock begins at 1 s; so much later it can be set back, s.
_CLOCK_BEGINS_S = 1000.0
_FIRST_START_S, _END_S = 180.0, 10.0
#: Works until its parent has ended.
_BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"
#: What the nodes on the wire's other side call by its name there.
_ACROSS: Mapping[str, Sequence[str]] = {
    # Clouds are spoilt; the compact form goes where nobody listens, so that the planner takes the clouds.
    PREDICTOR: (topics.OCCUPANCY, topics.COMPACT_OCCUPANCY),
    ARM: (topics.TRAJECTORY, topics.JOINT_STATES),
    TRACKER: (topics.CLOCK,),
}  # fmt: skip
_RELAYED = (POSTURES, topics.OCCUPANCY, topics.JOINT_STATES, topics.TRAJECTORY)


class Inputs:
    """What the nodes are given: files in a folder."""

    def __init__(self, folder: Path, seconds: float = SECONDS) -> None:
        """Write a scene and a motion of that length; find or train the model."""
        self.folder = folder
        library = load_library(locate(_LIBRARY, "bags"))
        human = human_with(library.dof_names)
        places = read_scene_file(SCENE).goals
        goals = [goal.model_dump(mode="json", exclude_none=True) for goal in places if goal.name in _GOALS]
        self.scene = write_changed_scene(folder / "scene.yaml", name="two_places", goals=goals)
        self.model = model_of(library, human, {DEFAULT_CLASSIFIER: None})
        palm_y = {
            m.name: [human.forward(q)["right_palm"][1] for q in m.q] for k in _CLASSES for m in library.of_class(k)
        }
        played = MotionLibrary("two_places", (_reaches(library, palm_y, seconds),), library.provenance)
        self.motion = write_library_bag(played, folder / "motion")


def _reaches(library: MotionLibrary, palm_y: dict[str, list[float]], seconds: float) -> Motion:
    """Return reaches to the places in turn, with a pause at each: one motion at `RATE_HZ`."""
    rng = np.random.default_rng(0)
    parts: list[Any] = []
    of_class = [library.of_class(label) for label in _CLASSES]
    k = frames = 0
    while frames < seconds * RATE_HZ:
        motions = of_class[k % len(of_class)]
        whole = motions[k // len(of_class) % len(motions)]
        farthest = int(np.argmax(palm_y[whole.name]))
        t_s = np.arange(0.0, whole.duration_s, 1.0 / RATE_HZ)
        reach = resample(whole, t_s=np.round(t_s, 9) + whole.t_s[0]).q
        pause_at = round((whole.t_s[farthest] - whole.t_s[0]) * RATE_HZ)
        paused = np.repeat(reach[pause_at : pause_at + 1], round(_PAUSE_S * RATE_HZ), axis=0)
        if parts:
            u = np.linspace(0.0, 1.0, round(_BETWEEN_S * RATE_HZ) + 1)[1:-1, None]
            way = u**2 * (3.0 - 2.0 * u)
            parts.append(parts[-1][-1] * (1.0 - way) + reach[0] * way)
        parts += [reach[:pause_at], paused, reach[pause_at:]]
        frames, k = sum(map(len, parts)), k + 1
    q = np.vstack(parts)
    q = q + _NOISE * rng.standard_normal(q.shape)
    return Motion(np.arange(len(q)) / RATE_HZ, q, library.dof_names, None, 0, library.motions[0].frame_id)


class FaultGraph:
    """Five nodes on a domain of their own, and the wire between them or beside them; use as a context manager.

    Attributes:
        wire: what spoils messages and listens.
        grid: lattice of the scene.
        logs: folder of logs and bags.
    """

    def __init__(self, kind: str, inputs: Inputs, logs: Path) -> None:
        """Take the kind of graph, what the nodes are given, and a new folder for logs and bags."""
        scene = load_scene(inputs.scene)
        self.grid = scene.grid
        self._kind, self._inputs, self.logs = kind, inputs, logs
        relayed = {DIRECT: (), CLOCK: (POSTURES, topics.CLOCK), GUARDED: (WATCHED,)}.get(kind, _RELAYED)
        self._group = NodeGroup(logs, free_domain_id())
        self.wire = Wire(self._group.domain_id, scene.arm.chain.joint_names, relayed)
        self._relayed = relayed
        self._usual: dict[str, Spoil] = {}
        self._clock_s = 0.0
        self._busy: list[subprocess.Popen[bytes]] = []
        self._bags = 0
        self.watched: tuple[Path, int] | None = None

    def __enter__(self) -> FaultGraph:
        with ExitStack() as stack:
            stack.callback(self.work, 0)
            stack.enter_context(self._group)
            stack.enter_context(self.wire)
            if self._kind == CLOCK:
                self.set_clock(_CLOCK_BEGINS_S)
            for node in (RECORDER, ARM, *((GUARD,) if self._kind == GUARDED else ()), PREDICTOR, PLANNER, TRACKER):
                self.start(node)
            self._ends = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends.__exit__(kind, value, trace)

    def wait_until_working(self) -> None:
        """Return when the arm is on its way.

        Raises:
            UsageError: it does not set out.
        """
        heard = self.wire.heard
        if not self.wire.wait(lambda: heard.under_way(time.monotonic(), 0.0), _FIRST_START_S):
            self._group.check()
            said = {entry.name: entry.text for entry in heard.diagnostics}
            raise UsageError(f"bench faults: wanted the arm to set out, the nodes say {said}; see the logs with --keep")

    def start(self, node: str) -> None:
        """Start a node, again or once more."""
        relayed = {*self._relayed, *((topics.COMPACT_OCCUPANCY,) if topics.OCCUPANCY in self._relayed else ())}
        remap = {topic: wired(topic) for topic in _ACROSS.get(node, ()) if topic in relayed}
        parameters = self._parameters(node) | ({"use_sim_time": True} if self._kind == CLOCK else {})
        self._group.start(node, parameters, remap)

    def _parameters(self, node: str) -> dict[str, ParameterValue]:
        scene: dict[str, ParameterValue] = {"scene": str(self._inputs.scene)}
        if node == RECORDER:
            self._bags += 1
            return {"output": str(self._bag())}
        if node == GUARD:
            return scene | {"bodies": ["watched"]}
        if node == ARM:
            return scene | {"rate_hz": 100.0}
        if node == PREDICTOR:
            return scene | {"model": str(self._inputs.model), "predictor": DEFAULT_PREDICTOR, "bodies": ["body_0"]}
        if node == PLANNER:
            return scene | {"velocity_scale": VELOCITY_SCALE, "period_s": PERIOD_S, "iterations": ITERATIONS}
        relayed = POSTURES in self._relayed
        return {
            "library": str(self._inputs.motion), "trajectory": "0", "hold_last_s": 0.0,
            "body_id": TRACKED_BODY if relayed else "body_0",
            "publish_clock": self._kind == CLOCK,
            "listener": self.wire.name if relayed else PREDICTOR,
        }  # fmt: skip

    def _bag(self) -> Path:
        return self.logs / f"bag_{self._bags}"

    def _process(self, node: str) -> NodeProcess:
        running = [entry for entry in self._group.nodes if entry.name == node and entry.running]
        if not running:
            last = [entry for entry in self._group.nodes if entry.name == node][-1]
            raise UsageError(f"bench faults: the {NODES[node]} has ended by itself; the end of its log:\n{last.tail()}")
        return running[-1]

    def processes(self) -> list[NodeProcess]:
        """Return those of the nodes that run."""
        return [entry for entry in self._group.nodes if entry.running]

    def signal(self, node: str, number: int) -> None:
        """Send a signal to a node's process."""
        process = self._process(node).process
        if node == RECORDER and number == signal.SIGKILL:
            self.watched = (self._bag(), time.time_ns())
        process.send_signal(number)

    def end(self, node: str) -> None:
        """End a node as a terminal would, and wait for it; of two of the name, the one started last."""
        process = self._process(node).process
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()

    def set_parameter(self, node: str, name: str, value: ParameterValue) -> None:
        """Set a parameter of a node."""
        self.wire.set_parameter(node, name, value)

    def spoil(self, topic: str, how: Spoil | None) -> None:
        """Spoil what goes over a topic; None passes it on as usual."""
        self.wire.spoil(topic, how or self._usual.get(topic))

    def push_arm(self, by_rad: float) -> None:
        """Move the arm by hand, or back if it has been moved: its driver does not know."""
        offset = 0.0 if self.wire.arm_offset_rad else by_rad

        self.wire.arm_offset_rad = offset
        for topic, by in ((topics.JOINT_STATES, offset), (topics.TRAJECTORY, -offset)):
            self._usual[topic] = partial(_moved, by)
            self.spoil(topic, None)

    def set_clock(self, by_s: float) -> None:
        """Set /clock, and the tracker's clock with it."""
        self._clock_s += by_s
        offset_ns = round(self._clock_s * 1e9)

        def shifted(message: Any) -> Iterable[Any]:
            stamp = message.clock if hasattr(message, "clock") else message.header.stamp
            stamp.sec, stamp.nanosec = divmod(stamp.sec * 1_000_000_000 + stamp.nanosec + offset_ns, 1_000_000_000)
            return [message]

        for topic in (topics.CLOCK, POSTURES):
            self._usual[topic] = shifted
            self.spoil(topic, None)

    def work(self, processes: int) -> None:
        """Let so many processes do nothing but work; 0 ends them."""
        for process in self._busy:
            process.kill()
            process.wait()
        self._busy = [subprocess.Popen([sys.executable, "-c", _BUSY]) for _ in range(processes)]

    def publish_factor(self, on: bool) -> None:
        """Publish a speed factor beside the guard's, or no longer."""
        self.wire.publish_factor(on)

    def fill_disk(self) -> None:
        """Let no file of the recorder grow any further: every write fails, as on a full disk."""
        self.watched = (self._bag(), time.time_ns())
        largest = max(file.stat().st_size for file in self._bag().iterdir())
        pid = self._process(RECORDER).process.pid
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (largest, resource.RLIM_INFINITY))

    def lost_s(self) -> float | None:
        """Return how much the last bag lacks that was watched: s from its last message to the fault; None without."""
        if self.watched is None:
            return None
        (folder, at_ns), self.watched = self.watched, None
        times = [
            record.log_time
            for file in sorted(folder.glob("*.mcap"))
            for record in scan_records(file)
            if hasattr(record, "log_time") and record.log_time <= at_ns
        ]
        return (at_ns - max(times)) * 1e-9 if times else float("inf")


def _moved(by_rad: float, message: Any) -> Iterable[Any]:
    """Return joint states or a trajectory with every joint elsewhere."""
    if hasattr(message, "points"):
        for point in message.points:
            point.positions = [value + by_rad for value in point.positions]
    else:
        message.position = [value + by_rad for value in message.position]
    return [message]
