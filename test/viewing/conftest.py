"""Plausible recorded runs, made of the package's own parts, with facts the tests can look for."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_messages import diagnostic_array, joint_trajectory
from numpy.typing import NDArray
from pr2 import RIGHT_ARM_JOINTS

from humanpred_ros.bags import messages
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.evaluation.processes import free_domain_id
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.viewing.analysis import Analysis, RunSummary, analyse
from humanpred_ros.viewing.run import Run, read_run

REACH_START = (-0.169, -1.821, 0.763, 1.33, 0.05, 0.02, 0.0, 0.80, 0.05, -0.30, 0.10, 0.35)
REACH_END = (-0.150, -1.700, 0.750, 1.45, 0.12, 0.12, 0.0, 1.50, 0.60, -0.55, 0.12, 0.55)
REACH_S, N_POSTURES, PERIOD_S = 1.65, 100, 0.0825
POSTURE_S = REACH_S / (N_POSTURES - 1)
ROBOT_PERIOD_S = 0.01
#: Voxel centres (V, 3) float32, and which of them each class sweeps (8, V).
Swept = tuple[NDArray[np.float32], FloatArray]
TERMS = ("obstacle", "human_occupancy", "smoothness", "joint_limits", "length")


@dataclass(frozen=True)
class Script:
    """What happens in a synthetic run.

    Attributes:
        n_postures: of the reach that are published; then the last one is repeated `held` times.
        switch_step: 1-based replanning step at which the choice changes from red to blue, 0 for never.
        missed_step: 1-based step that came too late, 0 for none.
        evade_step: 1-based step that moves out of the way instead, 0 for none.
        hold_from_s: from then on every decision is a hold and the arm stands still, None for never.
        robot_end_s: when the arm is at its goal, unless it holds.
        occupancy_delay_s, trajectory_delay_s: wall time from sending a posture to sending the answers.
        full_turns: of the wrist roll, added to what the arm reports from 1 s on, as encoders do.
        nan_posture: number of a posture with a lost joint.
        unknown: probability of no class at the end of the reach, twice as much half way there; the classes have the
            rest.
        foresight: predict exactly the voxels the body touches from then on, for sure.
        occupancy_every: how many postures one occupancy is recorded for, as from a predictor that falls behind.
        facts: change the bag's run record; an empty value drops the fact.
        without: topics that are not recorded.
    """

    n_postures: int = N_POSTURES
    held: int = 60
    switch_step: int = 4
    missed_step: int = 0
    evade_step: int = 0
    hold_from_s: float | None = None
    robot_end_s: float = 2.4
    occupancy_delay_s: float = 0.004
    trajectory_delay_s: float = 0.031
    full_turns: int = 0
    nan_posture: int | None = None
    unknown: float = 0.0
    foresight: bool = False
    occupancy_every: int = 1
    origin_ns: int = 1_760_000_000_123_456_789
    facts: Mapping[str, str] = field(default_factory=dict)
    without: tuple[str, ...] = ()


@pytest.fixture(scope="session")
def human() -> HumanModel:
    return HumanModel.kinect12()


@pytest.fixture(scope="session")
def scene() -> Scene:
    return load_scene("face_to_face")


@pytest.fixture(scope="session")
def make_run(tmp_path_factory: pytest.TempPathFactory, human: HumanModel, scene: Scene) -> Callable[..., Path]:
    """Return a function that writes the run of a script, given by its fields, once, and returns its folder."""
    swept = swept_masks(human, scene)
    made: dict[str, Path] = {}

    def make(**fields: Any) -> Path:
        script = Script(**fields)
        if repr(script) not in made:
            made[repr(script)] = tmp_path_factory.mktemp("run")
            write_run(made[repr(script)], script, human, scene, swept)
        return made[repr(script)]

    return make


@pytest.fixture(scope="session")
def full_folder(make_run: Callable[..., Path]) -> Path:
    """Folder of a run in which everything happens that should, with one missed step."""
    return make_run(missed_step=9)


@pytest.fixture(scope="session")
def full(full_folder: Path) -> Run:
    return read_run(full_folder)


@pytest.fixture(scope="session")
def analysis(full: Run) -> Analysis:
    return analyse(full)


@pytest.fixture(scope="session")
def full_summary(analysis: Analysis) -> RunSummary:
    return analysis.summary


def smooth(t_s: FloatArray, t0: float, t1: float) -> FloatArray:
    """Return a minimum-jerk way from 0 at t0 to 1 at t1."""
    s = np.clip((t_s - t0) / (t1 - t0), 0.0, 1.0)
    blend: FloatArray = 10 * s**3 - 15 * s**4 + 6 * s**5
    return blend


def posture_at(t_s: FloatArray) -> FloatArray:
    """Return the reach's postures (T, 12)."""
    return np.array(REACH_START) + smooth(t_s, 0.0, REACH_S)[:, None] * (np.array(REACH_END) - np.array(REACH_START))


def arm_at(t_s: FloatArray, script: Script, scene: Scene) -> FloatArray:
    """Return the arm's configurations (T, 7): towards red, then bent over to blue after the switch."""
    towards = red = scene.goal("red").configuration
    if script.hold_from_s is not None:
        t_s = np.minimum(t_s, script.hold_from_s)
    if script.switch_step:
        turned = smooth(t_s, script.switch_step * PERIOD_S, script.robot_end_s)[:, None]
        towards = red + turned * (scene.goal("blue").configuration - red)
    q = scene.start + smooth(t_s, PERIOD_S, script.robot_end_s)[:, None] * (towards - scene.start)
    return np.asarray(q)


def write_run(folder: Path, script: Script, human: HumanModel, scene: Scene, swept: Swept) -> None:
    """Write `folder`/bag as the recorder would."""
    facts = {
        "scene": "face_to_face", "library": "synthetic_reaches", "trajectory": "3/2", "seed": "7", "mode": "real_time",
        "period_s": repr(PERIOD_S), "predictor": "swept_volume", "threshold": "0.001", "package_version": "0.1.0",
        "duration_s": repr(REACH_S), **script.facts,
    }  # fmt: skip
    sent: list[tuple[int, str, Any]] = []
    origin, grid = script.origin_ns, scene.grid
    sent.append((origin - 900_000_000, "/humans/bodies/body_0/urdf", messages.string(human.urdf)))
    lattice = {"frame_id": "world", "origin_m": grid.origin_m, "resolution_m": grid.resolution_m, "shape": grid.shape}
    sent.append((origin - 800_000_000, "/human_occupancy/voxel_grid", messages.string(json.dumps(lattice))))
    times_s = POSTURE_S * np.arange(script.n_postures + script.held if script.n_postures else 0)
    robot_s = np.arange(-0.2, (times_s[-1] if len(times_s) else 0.1) + 0.02, ROBOT_PERIOD_S)
    q_robot = arm_at(robot_s, script, scene)
    q_robot[robot_s > 1.0, 6] += 2 * np.pi * script.full_turns
    for t_s, q in zip(robot_s.tolist(), q_robot, strict=True):
        stamp = origin + round(t_s * 1e9)
        sent.append((stamp, "/joint_states", messages.joint_state(stamp, RIGHT_ARM_JOINTS, q)))
    sent += _answered_postures(times_s, script, human, scene, swept)
    with BagWriter(folder / "bag") as writer:
        writer.add_metadata("run", {key: value for key, value in facts.items() if value})
        for wall_ns, topic, message in sorted(sent, key=lambda entry: entry[0]):
            if topic not in script.without:
                writer.write_message(topic, wall_ns + 300_000, message, wall_ns)


def _answered_postures(
    times_s: FloatArray, script: Script, human: HumanModel, scene: Scene, swept: Swept
) -> list[tuple[int, str, Any]]:
    """Return every posture with what predictor and planner answer to it, as (time of sending, topic, message)."""
    sent: list[tuple[int, str, Any]] = []
    postures = posture_at(np.minimum(times_s, POSTURE_S * (script.n_postures - 1)))
    future = futures(postures, human, scene) if script.foresight else []
    step, last_due_s, chosen = 0, 0.0, ""
    for k, (t_s, q) in enumerate(zip(times_s.tolist(), postures, strict=True)):
        stamp = script.origin_ns + round(t_s * 1e9)
        if k == script.nan_posture:
            q[7] = np.nan
        posture = messages.joint_state(stamp, human.dof_names, q, frame_id="kinect")
        sent.append((stamp, "/humans/bodies/body_0/joint_states", posture))
        posterior = posterior_at(t_s / REACH_S)
        predicted = stamp + round(script.occupancy_delay_s * 1e9) + jitter_ns(k)
        if k % script.occupancy_every == 0:
            told = (future[k], np.ones(1)) if future else (swept, posterior)
            sent.append((predicted, "/human_occupancy", _cloud(stamp, *told)))
        sent.append((predicted, "/human_goals", _goals(stamp, posterior * (1.0 - unknown_at(t_s, script)))))
        decided = stamp + round(script.trajectory_delay_s * 1e9) + jitter_ns(k)
        values = {"step": "-1", "chosen": chosen, "previous": chosen, "switched": "false", "reason": ""}
        action, statuses = "keep", []
        if script.hold_from_s is not None and t_s >= script.hold_from_s:
            action = "hold"
            values["reason"] = f"stale human data: {0.5 + t_s:.2f} s old, at most 0.5 s allowed"
        elif t_s >= script.robot_end_s:
            action = "arrived"
        elif t_s - last_due_s >= PERIOD_S - 1e-9:
            last_due_s, step = t_s, step + 1
            better = "blue" if script.switch_step and step >= script.switch_step else "red"
            action = "missed" if step == script.missed_step else "replan"
            action = "evade" if step == script.evade_step else action
            better = chosen if action in ("missed", "evade") else better
            values |= {
                "step": str(step), "chosen": better, "switched": str(bool(chosen) and better != chosen).lower(),
                "reason": "planned after its switch time" if action == "missed" else "",
                "t_switch_s": repr(t_s + PERIOD_S), "compute_ms": "27.5",
            }  # fmt: skip
            statuses = [_goal(name, better, step) for name in ("red", "blue")]
            if action in ("replan", "evade"):
                chosen = better
                trajectory = _trajectory(t_s + PERIOD_S, script, scene)
                sent.append((decided - 50_000, "/r_arm_controller/joint_trajectory", trajectory))
        decision = diagnostic_array(stamp, [(0, "decision", action, values), *statuses])
        sent.append((decided, "/stomp_planner/decision", decision))
    return sent


def jitter_ns(k: int) -> int:
    """Return how much later than usual the answers to posture `k` came."""
    return round(1e6 * (0.4 * np.sin(12.9898 * k) + 0.5))


def cost_at(name: str, number: int) -> float:
    """Return a goal's selection cost at a 1-based step: red rises where blue falls, between steps 3 and 4."""
    progress = number / 20.0
    if name == "red":
        return 0.0018 + 0.6 / (1.0 + float(np.exp(9.0 - 54.0 * progress)))
    return 0.0025 + 1.6 * float(np.exp(-12.0 * progress))


def posterior_at(phase: float) -> FloatArray:
    """Return P(class) of 8 classes: flat at first, class 2 early on, then class 3."""
    score = np.zeros(8)
    score[3], score[2], score[7] = 9.0 * phase, 5.0 * phase + 0.6 * np.sin(9 * phase), 3.0 * phase
    weight = np.exp(score)
    return np.asarray(weight / weight.sum())


def unknown_at(t_s: float, script: Script) -> float:
    """Return P(no class): up to twice `script.unknown` half way, and `script.unknown` from the reach's end on."""
    half = REACH_S / 2.0
    return script.unknown * float(np.interp(t_s, [0.0, half, REACH_S], [0.0, 2.0, 1.0]))


def futures(postures: FloatArray, human: HumanModel, scene: Scene) -> list[Swept]:
    """Return what the body touches in each of the postures (T, D) or any later one, as a single class would sweep it.

    Surfaces are gone through point by point: the slow way, to compare the fast one with.
    """
    R, p = scene.T_world_human[:3, :3], scene.T_world_human[:3, 3]
    masks = [scene.grid.mask_of(human.surface_points(q, 0.02) @ R.T + p).ravel() for q in postures]
    swept = np.logical_or.accumulate(masks[::-1])[::-1]
    return [(scene.grid.centres_m(np.flatnonzero(m)).astype(np.float32), np.ones((1, m.sum()))) for m in swept]


def _goal(name: str, chosen: str, number: int) -> tuple[int, str, str, dict[str, str]]:
    cost, valid = cost_at(name, number), not (name == "blue" and number == 2)
    message = ("chosen" if name == chosen else "candidate") if valid else "in collision with the table at waypoint 31"
    shares = dict(zip(TERMS, (0.0, cost, 0.4 * cost + 0.01, 0.0, 0.002), strict=True))
    values = {
        "selection_cost": repr(cost), "valid": str(valid).lower(), "iterations": "50",
        "human": repr(cost), "length": "1.0", "warm_start": "reconnected",
        **{f"cost/{term}": repr(share) for term, share in shares.items()},
    }  # fmt: skip
    return (0 if valid else 2, name, message, values)


def _trajectory(t_s: float, script: Script, scene: Scene) -> Any:
    knots = t_s + np.linspace(0.0, 1.0, 5)
    still = np.zeros((5, 7))
    return joint_trajectory(
        script.origin_ns + round(t_s * 1e9), RIGHT_ARM_JOINTS, knots - t_s, arm_at(knots, script, scene),
        velocities=still, accelerations=still,
    )  # fmt: skip


def swept_masks(human: HumanModel, scene: Scene) -> Swept:
    """Return what each class sweeps: the reach, turned about the pelvis."""
    masks = []
    for k in range(8):
        q = posture_at(np.linspace(0.0, REACH_S, 8))
        q[:, 3] += 0.22 * (3 - k) * np.linspace(0.0, 1.0, 8)
        points = human.surface_points(q, 0.03) @ scene.T_world_human[:3, :3].T + scene.T_world_human[:3, 3]
        masks.append(scene.grid.mask_of(points).ravel())
    flat = np.flatnonzero(np.any(masks, axis=0))
    return scene.grid.centres_m(flat).astype(np.float32), np.array(masks, dtype=np.float64)[:, flat]


def _cloud(stamp: int, swept: Swept, posterior: FloatArray) -> Any:
    centres, masks = swept
    probability = (posterior @ masks).clip(0.0, 1.0)
    sent = probability > 0.001
    x, y, z = centres[sent].T
    fields = {"x": x, "y": y, "z": z, "probability": probability[sent].astype(np.float32)}
    return messages.point_cloud2(stamp, "world", fields)


def _goals(stamp: int, posterior: FloatArray) -> Any:
    places = np.array([[0.5 - 0.25 * (k % 4), -0.98 + 0.1 * (k % 4) + 0.26 * (k // 4), 0.72] for k in range(8)])
    x, y, z = places.astype(np.float32).T
    labels, probability = np.arange(8, dtype=np.float32), posterior.astype(np.float32)
    return messages.point_cloud2(
        stamp, "world", {"x": x, "y": y, "z": z, "class_id": labels, "probability": probability}
    )


@pytest.fixture
def make_node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Any]]:
    """Return what makes nodes on a domain of their own."""
    rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=free_domain_id())
    nodes = []

    def make(name: str) -> Any:
        nodes.append(rclpy.create_node(name, context=context))
        return nodes[-1]

    try:
        yield make
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown(context=context)
