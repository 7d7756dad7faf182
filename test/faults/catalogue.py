"""The faults of `humanpred bench faults`: what each does to the graph, and what must follow.

A fault is put in while the arm moves, and taken away again; then the arm must work on, and the same fault is put in
once more. Four graphs are used: `direct`, whose nodes talk to each other; `relayed`, where what tracker, predictor,
arm and planner send passes through a node of the bench's that spoils it; and `clock`, in simulated time that the bench
can set; `guarded` is `direct` with a separation guard, which sees the person through the bench.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from faults.spoilt_messages import (
    ANGLES,
    LENGTHS,
    MakeSpoil,
    Spoil,
    always,
    backwards,
    briefly,
    claims_more,
    foreign,
    frozen,
    full,
    huge,
    in_frame,
    lost,
    same_stamp,
    stamped,
    torn,
    two_people,
    with_column,
    with_joint_twice,
    with_points,
    with_value,
    without_last,
)
from faults.trials import GOES_ON, HOLDS, STOPS
from humanpred_ros import topics
from humanpred_ros.evaluation.processes import ParameterValue
from humanpred_ros.geometry.lattice import VoxelGrid

TRACKER, PREDICTOR, PLANNER = "skeleton_tracker_replay", "occupancy_predictor", "stomp_planner"
ARM, RECORDER, GUARD = "simulated_arm", "run_recorder", "separation_guard"
#: Names of the nodes for people.
NODES = {
    TRACKER: "tracker",
    PREDICTOR: "predictor",
    PLANNER: "planner",
    ARM: "arm driver",
    RECORDER: "recorder",
    GUARD: "guard",
}
POSTURES = topics.human_joint_states("body_0")
#: The person for the guard alone.
WATCHED = topics.human_joint_states("watched")
DIRECT, RELAYED, CLOCK, GUARDED = "direct", "relayed", "clock", "guarded"
#: A hold follows when human data or joint states are so old (defaults of the nodes), s; and a stop when the guard has
#: heard nothing for so long, or nobody has heard the guard.
MAX_AGE_S, GUARD_S = 0.5, 0.3
#: Body that the tracker tells of where its postures are relayed.
TRACKED_BODY = "tracked"


class Graph(Protocol):
    """What a fault may do to a running graph."""

    grid: VoxelGrid  #: lattice of the scene

    def signal(self, node: str, number: int) -> None:
        """Send a signal to a node's process."""

    def start(self, node: str) -> None:
        """Start a node, again or once more."""

    def end(self, node: str) -> None:
        """End a node as a terminal would, and wait for it; of two of the name, the one started last."""

    def set_parameter(self, node: str, name: str, value: ParameterValue) -> None:
        """Set a parameter of a node."""

    def spoil(self, topic: str, how: Spoil | None) -> None:
        """Spoil what goes over a topic; None passes it on as it is."""

    def push_arm(self, by_rad: float) -> None:
        """Move the arm by hand: from now on every joint is elsewhere, under the same commands."""

    def set_clock(self, by_s: float) -> None:
        """Set /clock, and the tracker's clock with it."""

    def work(self, processes: int) -> None:
        """Let so many processes do nothing but work; 0 ends them."""

    def publish_factor(self, on: bool) -> None:
        """Publish a speed factor beside the guard's, or no longer."""

    def fill_disk(self) -> None:
        """Let no file of the recorder grow any further."""


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong."""

    name: str
    graph: str  #: DIRECT, RELAYED, CLOCK or GUARDED
    begin: Callable[[Graph], object]
    end: Callable[[Graph], object]
    expected: str  #: what must follow, for people
    reasons: tuple[str, ...] = ()  #: a part of what the planner, or /diagnostics, must say; one of these
    outcome: str = HOLDS
    rests: bool = True  #: whether the arm must come to rest, in time
    lasts_s: float = 1.2  #: how long the fault is there at least
    patience_s: float = 3.0  #: how much longer it may be there until what is expected has happened
    joins: str = ""  #: node that is started again, and must have spoken before the graph is what it was
    noticed_s: float = MAX_AGE_S  #: the arm has to rest so soon and its stopping time, s
    data_age_s: float | None = None  #: greatest age of the data on which the arm may move meanwhile


def wired(topic: str) -> str:
    """Return the name under which a relayed topic goes to or comes from the node on the wire's other side."""
    if topic == WATCHED:
        return POSTURES
    return topic.replace("body_0", TRACKED_BODY) if topic == POSTURES else f"wire/{topic.lstrip('/')}"


def _nothing(_: Graph) -> None:
    """Leave the graph as it is."""


def _of_message(name: str, topic: str, make: MakeSpoil, *reasons: str, graph: str = RELAYED, **more: Any) -> Fault:
    """Return a fault of what goes over a topic."""
    expected = more.pop("expected", "hold that names it")
    return Fault(
        name, graph, lambda g: g.spoil(topic, make(g.grid)), lambda g: g.spoil(topic, None), expected, reasons, **more
    )


# Faults of processes.


def _killed(node: str, *reasons: str, **more: Any) -> Fault:
    what = {HOLDS: "hold; works on when another has joined", GOES_ON: "the arm works on; its bag loses at most 1 s"}
    expected = more.pop("expected", what.get(more.get("outcome", HOLDS), ""))
    return Fault(
        f"{NODES[node]} killed and another joins late", more.pop("graph", DIRECT),
        partial(_signal, node, signal.SIGKILL), lambda g: g.start(node), expected, reasons, lasts_s=3.0,
        joins=node, **more,
    )  # fmt: skip


def _stopped(node: str, *reasons: str, **more: Any) -> Fault:
    what = {HOLDS: "hold", GOES_ON: "the arm works on"}
    expected = more.pop("expected", what.get(more.get("outcome", HOLDS), ""))
    return Fault(
        f"{NODES[node]} stopped for 2 s", more.pop("graph", DIRECT), partial(_signal, node, signal.SIGSTOP),
        partial(_signal, node, signal.SIGCONT), expected, reasons, lasts_s=2.0, patience_s=0.0,
        **more,
    )  # fmt: skip


def _restarted(node: str, *reasons: str, **more: Any) -> Fault:
    expected = more.pop("expected", "hold until it is back" if more.get("outcome", HOLDS) == HOLDS else "works on")
    return Fault(
        f"{NODES[node]} restarted", DIRECT, partial(_restart, node), _nothing, expected, reasons,
        joins=node, **more,
    )  # fmt: skip


def _restart(node: str, graph: Graph) -> None:
    graph.end(node)
    graph.start(node)


def _signal(node: str, number: int, graph: Graph) -> None:
    graph.signal(node, number)


def _of_arm(name: str, parameter: str, value: ParameterValue, usual: ParameterValue, **more: Any) -> Fault:
    return Fault(
        name, DIRECT, lambda g: g.set_parameter(ARM, parameter, value),
        lambda g: g.set_parameter(ARM, parameter, usual), "hold; planned anew from where the arm is",
        ("the arm does not follow",), **more,
    )  # fmt: skip


_GUARDED: Mapping[str, Any] = {"graph": GUARDED, "noticed_s": GUARD_S}
_STOPS: Mapping[str, Any] = {**_GUARDED, "outcome": STOPS, "expected": "the guard stops the arm; works on afterwards"}
_WORKS_ON: Mapping[str, Any] = {"outcome": GOES_ON, "rests": False}
_NO_CLOUD = ("stale human data",)
_CANNOT_BE = ("too large", "outside the lattice", "joint limit", "units", "jump")
_SILENT_OR_ASTRAY = ("silent arm", "the arm does not follow")

# fmt: off
FAULTS: tuple[Fault, ...] = (
    # Nodes that die, hang, come back and join late.
    _killed(TRACKER, *_NO_CLOUD),
    _killed(PREDICTOR, *_NO_CLOUD),
    _killed(PLANNER, "silent planner", **_STOPS),
    _killed(ARM, "silent arm", expected="hold; works on, from where the new one is"),
    _killed(RECORDER, **_WORKS_ON),
    _stopped(TRACKER, *_NO_CLOUD),
    _stopped(PREDICTOR, *_NO_CLOUD),
    _stopped(PLANNER, "silent planner", **_STOPS),
    _stopped(ARM, *_SILENT_OR_ASTRAY),
    _stopped(RECORDER, **_WORKS_ON),
    _restarted(TRACKER, *_NO_CLOUD),
    _restarted(PREDICTOR, *_NO_CLOUD),
    _restarted(PLANNER, "the planner is ended", expected="stops the arm before it ends; goes on from where it is"),
    _restarted(ARM, *_SILENT_OR_ASTRAY),
    _restarted(RECORDER, **_WORKS_ON),
    _killed(GUARD, "guard silent", **_GUARDED),
    _stopped(GUARD, "guard silent", **_GUARDED),
    _of_message("person lost for the guard", WATCHED, lost, "stale human data: watched", **_GUARDED),
    Fault(
        "somebody else publishes a speed factor", GUARDED, lambda g: g.publish_factor(True),
        lambda g: g.publish_factor(False), "hold that names it", ("two speed factors", "two guards"),
    ),
    Fault(
        "disk full", DIRECT, lambda g: g.fill_disk(), partial(_restart, RECORDER),
        "the arm works on; told on /diagnostics; what is there stays readable", ("not recording",), **_WORKS_ON,
        lasts_s=2.0, joins=RECORDER,
    ),
    Fault(
        "two planners", DIRECT, lambda g: g.start(PLANNER), lambda g: g.end(PLANNER),
        "the second refuses and names the first; the arm works on", ("two planners",), **_WORKS_ON,
        lasts_s=1.0, patience_s=30.0,
    ),
    Fault(
        "eight busy processes", DIRECT, lambda g: g.work(8), lambda g: g.work(0),
        "works on in time, or rests within 1 s", **_WORKS_ON, lasts_s=5.0, data_age_s=1.0,
    ),
    # The arm.
    _of_arm("arm does not follow (stands)", "stuck", True, False),
    _of_arm("arm paused by its controller", "speed_factor", 0.0, 1.0),
    _of_arm("arm slowed to 0.2 by its controller", "speed_factor", 0.2, 1.0, rests=False, lasts_s=3.0),
    Fault(
        "arm moved by hand", RELAYED, lambda g: g.push_arm(0.15), _nothing, "hold; planned anew from where the arm is",
        ("the arm does not follow",), lasts_s=0.6,
    ),
    Fault(
        "arm's commands get lost", RELAYED, lambda g: g.spoil(topics.TRAJECTORY, lost(g.grid)),
        lambda g: g.spoil(topics.TRAJECTORY, None), "hold; planned anew from where the arm is",
        ("the arm does not follow",), rests=False, lasts_s=1.0, patience_s=20.0,
    ),
    _of_message("arm silent", topics.JOINT_STATES, lost, "silent arm"),
    _of_message("arm: a joint missing", topics.JOINT_STATES, always(without_last), "missing joints", "silent arm"),
    _of_message(
        "arm: NaN", topics.JOINT_STATES, always(with_value, ("r_",), lambda x: math.nan), "not finite", "silent arm"
    ),
    _of_message("arm: a joint twice", topics.JOINT_STATES, always(with_joint_twice), "joint twice", "silent arm"),
    # Postures.
    _of_message("NaN in postures", POSTURES, always(with_value, ("PelvisTransX",), lambda x: math.nan), "not finite"),
    _of_message("one joint missing", POSTURES, always(without_last), "missing joints"),
    _of_message("one joint twice", POSTURES, always(with_joint_twice), "joint twice"),
    _of_message("jump of 1 m", POSTURES, always(with_value, ("PelvisTransX",), lambda x: x + 1.0), "jump"),
    _of_message("jump of 100 m", POSTURES, always(with_value, ("PelvisTransX",), lambda x: x + 100.0), *_CANNOT_BE),
    _of_message("1e308", POSTURES, always(with_value, LENGTHS, lambda x: 1e308), *_CANNOT_BE),
    _of_message("frozen", POSTURES, frozen, "frozen", lasts_s=1.6),
    _of_message("interleaved people", POSTURES, two_people, "jump"),
    _of_message("millimetres", POSTURES, always(with_value, LENGTHS, lambda x: x * 1000.0), "units"),
    _of_message("degrees", POSTURES, always(with_value, ANGLES, math.degrees), *_CANNOT_BE),
    _of_message("wrong frame", POSTURES, always(in_frame, "depth_camera_link"), "frame"),
    _of_message("no frame", POSTURES, always(in_frame, ""), "frame"),
    _of_message("stamps run back", POSTURES, backwards, "stamp", "stale human data"),
    _of_message("stamps stand still", POSTURES, same_stamp, "stamp", "stale human data"),
    _of_message("stamps 2 s back", POSTURES, always(stamped, by_s=-2.0), "stale human data", "stamp"),
    _of_message("stamps zero", POSTURES, always(stamped, at_ns=0), "stale human data", "stamp"),
    _of_message("a few stamps an hour ahead", POSTURES, briefly(stamped, by_s=3600.0), "stamp ahead", rests=False),
    _of_message("stamps 3 s ahead", POSTURES, always(stamped, by_s=3.0), "stamp ahead"),
    _of_message("postures get lost", POSTURES, lost, *_NO_CLOUD),
    # Clouds.
    _of_message("empty cloud", topics.OCCUPANCY, always(with_points, b"", 0), "empty occupancy"),
    _of_message("full cloud", topics.OCCUPANCY, full, "human", "person", "overload"),
    _of_message("torn cloud", topics.OCCUPANCY, always(torn), "cloud data"),
    _of_message("cloud that claims 4e9 points", topics.OCCUPANCY, always(claims_more), "huge cloud"),
    _of_message("foreign cloud", topics.OCCUPANCY, always(foreign), "cloud fields"),
    _of_message("huge cloud", topics.OCCUPANCY, huge, "huge cloud", "human data"),
    _of_message(
        "wrong lattice", topics.OCCUPANCY, always(with_column, 0, lambda x: x + np.float32(0.013)), "other lattice"
    ),
    _of_message(
        "NaN in clouds", topics.OCCUPANCY, always(with_column, 1, lambda x: x * np.float32(np.nan)), "not finite"
    ),
    _of_message(
        "probabilities above 1", topics.OCCUPANCY, always(with_column, 3, lambda p: p + np.float32(1)), "probabilities"
    ),
    _of_message("cloud in another frame", topics.OCCUPANCY, always(in_frame, "kinect"), "frame"),
    _of_message("cloud in no frame", topics.OCCUPANCY, always(in_frame, ""), "frame"),
    _of_message(
        "a few clouds a day ahead", topics.OCCUPANCY, briefly(stamped, by_s=86400.0), "stamp ahead", rests=False
    ),
    _of_message("clouds with stamps zero", topics.OCCUPANCY, always(stamped, at_ns=0), "stale human data"),
    # Time.
    Fault(
        "/clock 5 s back", CLOCK, lambda g: g.set_clock(-5.0), _nothing, "hold; begins anew", ("clock", "stamp",
        "stale"), lasts_s=0.6,
    ),
    _of_message("/clock stands still", topics.CLOCK, lost, "stale", "clock", "silent arm", graph=CLOCK),
)
# fmt: on

#: Those that CI tries, on one graph: a node that hangs, and what the nodes' own tests do not send.
SHORT = (
    "predictor stopped for 2 s", "arm paused by its controller", "interleaved people", "stamps 3 s ahead", "torn cloud",
)  # fmt: skip
