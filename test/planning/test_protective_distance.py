"""The protective distance: the standard's terms, what no body may gain by, and a factor that keeps what it promises."""

from __future__ import annotations

import numpy as np
import pytest

from humanpred_ros.human.model import HumanModel
from humanpred_ros.planning.protective_distance import (
    ProtectiveDistance,
    ProtectiveDistanceSettings,
    SeenBody,
    Separation,
    SpeedFactor,
)
from humanpred_ros.robot.scene import load_scene

SCENE = load_scene("face_to_face")
HUMAN = HumanModel.kinect12()
#: Constant speed of the person, as in the standard's simple form.
CONSTANT = ProtectiveDistanceSettings(person_acceleration_m_s2=1000.0, person_uncertainty_m=0.04, intrusion_m=0.02)
Q = SCENE.start


def posture(offset_m: float = 0.0) -> np.ndarray:
    """Return a posture in front of the robot, moved by so much towards it."""
    q = np.zeros(len(HUMAN.dof_names))
    q[: len(TOWARDS)] += (STANDS + offset_m * TOWARDS)[: len(TOWARDS)]
    return q


def _place() -> tuple[np.ndarray, np.ndarray]:
    """Return the pelvis' place in the postures' frame, and the way from there to the arm, for the DoFs that move it."""
    tool_m = SCENE.arm.chain.tool_pose(Q)[:3, 3]
    T = np.linalg.inv(SCENE.T_world_human)
    q = np.zeros(len(HUMAN.dof_names))
    pelvis = {name: k for k, name in enumerate(HUMAN.dof_names) if name.startswith("PelvisTrans")}
    assert list(pelvis.values()) == [0, 1, 2]
    origin_m = HUMAN.forward(q)["pelvis"]
    goal_m = (T @ np.append(tool_m, 1.0))[:3] - origin_m
    out = T[:3, :3] @ (tool_m - SCENE.arm.chain.link_poses(Q)[0, :3, 3])  # beyond the hand, seen from the shoulder
    away = np.array([out[0], out[1], 0.0]) / np.linalg.norm(out[:2])
    return goal_m + 1.2 * away, -away


STANDS, TOWARDS = _place()


def _towards_the_person() -> np.ndarray:
    """Return a velocity with which the arm comes nearer to the person."""
    distance = ProtectiveDistance(HUMAN, SCENE.arm, SCENE.T_world_human)
    body, unit = SeenBody(), np.eye(len(Q))
    body.see(posture(0.6), 0.0)
    return 0.4 * np.sign([
        distance.separation([body], Q, v, 1.0).arm_speed_m_s - distance.separation([body], Q, -v, 1.0).arm_speed_m_s
        for v in unit
    ])  # fmt: skip


V = _towards_the_person()


def seen(offset_m: float = 0.0, speed_m_s: float | None = None) -> SeenBody:
    body = SeenBody()
    if speed_m_s is not None:
        for k in range(4):
            body.see(posture(offset_m - (3 - k) * 0.033 * speed_m_s), 0.033 * k)
    else:
        body.see(posture(offset_m), 0.0)
    return body


def separation(
    body: SeenBody, v: np.ndarray | None = None, factor: float = 1.0, settings: ProtectiveDistanceSettings = CONSTANT
) -> Separation:
    return ProtectiveDistance(HUMAN, SCENE.arm, SCENE.T_world_human, settings).separation(
        [body], Q, V if v is None else v, factor, 0.03
    )


def test_the_terms_are_those_of_the_standard() -> None:
    found = separation(seen())
    assert found.arm_speed_m_s > 0.05
    assert found.reaction_s == pytest.approx(0.13)
    assert found.stopping_s == pytest.approx(0.4 / 4.0)
    assert found.person_m == pytest.approx(1.6 * (0.13 + 0.1))
    assert found.arm_m == pytest.approx(found.arm_speed_m_s * 0.13)
    assert found.stopping_m == pytest.approx(found.arm_speed_m_s * 0.1 / 2.0)
    total = found.person_m + found.arm_m + found.stopping_m + 0.02 + 0.04 + 0.01
    assert found.protective_m == pytest.approx(total)
    assert np.isnan(found.person_speed_m_s)


def test_the_speed_is_that_of_the_known_formula() -> None:
    # facts of ISO/TS 15066: v = sqrt(v_h^2 + (a T_r)^2 - 2 a C + 2 a d) - a T_r - v_h, where the arm stops with a.
    d_m = next(d for d in np.arange(0.0, 1.2, 0.01) if 0.2 < separation(seen(d)).factor < 0.8)
    found = separation(seen(d_m))
    assert found.arm_speed_m_s > 0.05
    a, h, r_s = found.arm_speed_m_s / found.stopping_s, 1.6, 0.13
    c_m = 0.02 + 0.04 + 0.01
    allowed = np.sqrt(h**2 + (a * r_s) ** 2 - 2 * a * c_m + 2 * a * found.distance_m) - a * r_s - h
    assert found.factor * found.arm_speed_m_s == pytest.approx(allowed, rel=0.02)


def test_at_the_factor_it_gives_the_distance_is_the_protective_one() -> None:
    d_m = next(d for d in np.arange(0.0, 1.2, 0.01) if 0.2 < separation(seen(d)).factor < 0.8)
    factor = separation(seen(d_m)).factor
    slowed = separation(seen(d_m), v=factor * V, factor=factor)
    assert slowed.factor == pytest.approx(factor, abs=0.005)
    assert slowed.protective_m == pytest.approx(slowed.distance_m, abs=0.005)


@pytest.mark.parametrize("settings", [CONSTANT, ProtectiveDistanceSettings()])
def test_nearer_and_faster_never_gain(settings: ProtectiveDistanceSettings) -> None:
    for speed in (-1.0, 0.0, 0.2, 1.5, 2.5):
        for v, factor in ((V, 1.0), (0.3 * V, 0.3), (0.0 * V, 0.0)):
            nearer = [
                separation(seen(d, speed), v=v, factor=factor, settings=settings).factor
                for d in np.arange(-0.2, 1.0, 0.05)
            ]
            assert (np.diff(nearer) <= 1e-9).all()
            assert nearer[-1] == 0.0
            assert nearer[0] == 1.0 or speed > 0.2
    faster = [separation(seen(0.5, speed), settings=settings).factor for speed in (0.0, 0.5, 1.0, 2.0, 3.0)]
    assert (np.diff(faster) <= 1e-9).all()


def test_a_body_that_moves_away_gains_nothing_over_one_that_rests() -> None:
    settings = ProtectiveDistanceSettings()
    for d_m in (0.3, 0.5, 0.7, 0.8):
        resting, away = (separation(seen(d_m, speed), settings=settings) for speed in (0.0, -2.0))
        assert away.factor == pytest.approx(resting.factor)


def oracle(
    distance: ProtectiveDistance, body: SeenBody, q: np.ndarray, v: np.ndarray, factor: float, age_s: float
) -> tuple[float, float, float]:
    """Return factor, distance and least distance as the definitions give them, one solid at a time."""
    settings, step_s, dq = distance.settings, 1e-3, body.velocity
    assert dq is not None
    spheres = SCENE.arm.spheres()
    centres = spheres.world_m(SCENE.arm.chain, np.stack([q, q + step_s * v]))
    poses = SCENE.T_world_human @ HUMAN.body_poses(np.stack([body.q, body.q + step_s * dq]))

    def distances(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
        found = [
            body.shape.distance_m((points - T[:3, 3]) @ T[:3, :3])
            for T, body in zip(pose, HUMAN.bodies, strict=True)
        ]  # fmt: skip
        return np.array(found) - spheres.radius_m

    now = distances(poses[0], centres[0])
    arm_speed = np.maximum(now - distances(poses[0], centres[1]), 0.0) / step_s / factor
    person_speed = (now - distances(poses[1], centres[0])) / step_s
    reaction_s, full_stopping_s = settings.reaction_s + age_s, np.abs(v).max() / settings.braking_rad_s2 / factor
    fixed_m = settings.intrusion_m + settings.person_uncertainty_m + settings.arm_uncertainty_m

    def protective_m(f: float) -> np.ndarray:
        for_s = reaction_s + f * full_stopping_s
        speed = np.maximum(person_speed, 0.0)
        most = np.maximum(speed, settings.person_speed_m_s)
        faster_s = np.minimum((most - speed) / settings.person_acceleration_m_s2, for_s)
        reached = speed + settings.person_acceleration_m_s2 * faster_s
        travel = 0.5 * (speed + reached) * faster_s + reached * (for_s - faster_s)
        return travel + f * arm_speed * (reaction_s + 0.5 * f * full_stopping_s) + fixed_m

    allowed = [f for f in np.linspace(0.0, 1.0, 4001) if (protective_m(f) <= now).all()]
    return max(allowed, default=0.0), float(now.min()), float((now - protective_m(factor)).min())


@pytest.mark.parametrize("seed", range(8))
def test_the_compiled_search_finds_what_the_definitions_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    distance = ProtectiveDistance(HUMAN, SCENE.arm, SCENE.T_world_human)
    body, before = SeenBody(), posture(rng.uniform(0.2, 0.9))
    before[3:] = np.clip(rng.uniform(-0.6, 0.6, len(before) - 3), HUMAN.lower[3:], HUMAN.upper[3:])
    body.see(before, 0.0)
    body.see(before + rng.uniform(-0.05, 0.05, len(before)), 0.1)
    q, v = Q + rng.uniform(-0.3, 0.3, len(Q)), rng.uniform(-1.0, 1.0, len(Q))
    found = distance.separation([body], q, v, 0.6, 0.02)
    factor, least_m, margin_m = oracle(distance, body, q, v, 0.6, 0.02)
    assert found.factor == pytest.approx(factor, abs=6e-4)
    assert found.least_m == pytest.approx(least_m, abs=1e-9)
    if factor in (0.0, 1.0):
        assert found.distance_m - found.protective_m == pytest.approx(margin_m, abs=1e-6) or factor == 0.0
    gap_m = np.linalg.norm(found.body_point_m - found.arm_point_m)
    radii = SCENE.arm.spheres().radius_m
    assert abs(gap_m - radii - found.distance_m).min() < 1e-3 or found.distance_m < 0.0


def test_an_arm_that_is_being_slowed_down_is_not_taken_for_one_that_hurries() -> None:
    settings = ProtectiveDistanceSettings()
    distance = ProtectiveDistance(HUMAN, SCENE.arm, SCENE.T_world_human, settings)
    d_m = next(d for d in np.arange(0.0, 1.2, 0.01) if 0.3 < separation(seen(d, 0.0), settings=settings).factor < 0.7)
    body, speed = seen(d_m, 0.0), SpeedFactor(settings)
    settled = distance.separation([body], Q, V, 1.0, 0.02).factor
    factors = [speed.follow(1.0, t_s) for t_s in np.arange(0.0, 4.0, 0.02)]
    assert factors[-1] == 1.0
    for t_s in np.arange(4.0, 6.0, 0.02):  # the arm obeys 0.03 s later, and is measured where it is
        obeyed = float(speed.between(t_s - 0.03, t_s)[0])
        then = float(speed.between(t_s - 0.05, t_s).max())
        factors.append(speed.follow(distance.separation([body], Q, obeyed * V, then, 0.02).factor, t_s))
    assert min(factors[200:]) > settled - 0.05
    assert factors[-1] == pytest.approx(settled, abs=0.02)


def test_of_several_bodies_the_worst_decides() -> None:
    far, near = seen(0.0, 0.0), seen(0.8, 0.0)
    distance = ProtectiveDistance(HUMAN, SCENE.arm, SCENE.T_world_human)
    both = distance.separation([far, near], Q, V, 1.0)
    assert both.body == 1
    assert both.factor == distance.separation([near], Q, V, 1.0).factor
    gap_m = np.linalg.norm(both.body_point_m - both.arm_point_m)
    assert gap_m == pytest.approx(both.distance_m + max(SCENE.arm.spheres().radius_m), abs=0.1)


def test_an_arm_that_stands_is_taken_to_set_out_towards_the_person() -> None:
    d_m = next(d for d in np.arange(0.0, 1.2, 0.01) if separation(seen(d, 0.0), v=0.0 * V, factor=0.0).factor < 1.0)
    assert separation(seen(d_m, 0.0), v=0.01 * V, factor=1.0).factor == 1.0


def test_the_pace_falls_at_once_rises_smoothly_and_resumes_late() -> None:
    pace = SpeedFactor(ProtectiveDistanceSettings(rise_per_s=0.5, resume_factor=0.2))
    assert pace.follow(1.0, 0.0) <= 0.01
    rising = [pace.follow(1.0, 0.1 * k) for k in range(1, 40)]
    assert max(np.diff([0.01, *rising])) <= 0.06
    assert rising[-1] == 1.0
    assert pace.follow(0.437, 4.0) == 0.43
    assert pace.follow(0.005, 4.1) == 0.0
    assert pace.follow(0.19, 4.2) == 0.0  # too little to set out for
    assert pace.follow(0.21, 4.3) == pytest.approx(0.05)
    assert pace.follow(0.15, 4.4) == pytest.approx(0.10)


def test_a_time_set_back_begins_a_body_anew() -> None:
    body = seen(0.0, 1.0)
    assert body.velocity is not None
    assert body.velocity[:3] == pytest.approx(TOWARDS)
    body.see(posture(), -5.0)
    assert body.velocity is None
    body.see(posture(), -4.0)  # too long ago to tell
    assert body.velocity is None
