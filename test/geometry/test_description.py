"""Reading small URDFs written here: chains, surfaces, solids, what is refused, and what the cache keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pr2 import URDF

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry import urdf as reader
from humanpred_ros.geometry.description import Description, PlacedDescription
from humanpred_ros.geometry.solids import Box, Capsule, EllipticCylinder, Sphere, planar_pose
from humanpred_ros.geometry.urdf import parse_description, read_description

pytestmark = pytest.mark.core

ARM = """
<robot name="crane">
  <link name="base"/>
  <link name="mast"><collision><geometry><box size="0.2 0.4 0.6"/></geometry></collision></link>
  <link name="boom"><collision><origin xyz="0.5 0 0"/><geometry>{geometry}</geometry></collision></link>
  <link name="hook"/>
  <joint name="stand" type="fixed"><parent link="base"/><child link="mast"/><origin xyz="0 0 0.3"/></joint>
  <joint name="turn" type="{kind}"><parent link="mast"/><child link="boom"/>
    <origin xyz="0 0 0.3" rpy="0 0 1.5707963267948966"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="2" velocity="3" effort="1"/></joint>
  <joint name="hang" type="fixed"><parent link="boom"/><child link="hook"/><origin xyz="1 0 -0.1"/></joint>
</robot>
"""
BOX = '<box size="1 0.1 0.1"/>'


def crane(folder: Path, kind: str = "revolute", geometry: str = BOX) -> PlacedDescription:
    path = folder / f"{kind}{len(geometry)}.urdf"
    path.write_text(ARM.format(kind=kind, geometry=geometry))
    return PlacedDescription(read_description(path), planar_pose(1.0, 0.0), {})


def link(inner: str) -> str:
    return f'<robot name="t"><link name="a">{inner}</link></robot>'


def cylinder(name: str = "limb") -> str:
    return f'<collision name="{name}"><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>'


def test_chain_takes_up_fixed_joints_and_rotated_frames(tmp_path: Path) -> None:
    chain = crane(tmp_path).chain(["turn"], "hook")
    np.testing.assert_allclose(chain.tool_pose([0.0])[:3, 3], [1.0, 1.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(chain.tool_pose([-np.pi / 2])[:3, 3], [2.0, 0.0, 0.5], atol=1e-9)
    assert (chain.lower[0], chain.upper[0], chain.velocity_limit[0]) == (-1.0, 2.0, 3.0)


def test_surfaces_are_shared_out_between_moving_and_fixed(tmp_path: Path) -> None:
    model = crane(tmp_path)
    [[boom]] = model.moving_surfaces(["turn"])
    assert boom.link == "boom"
    assert boom.triangles.shape == (12, 3, 3)
    np.testing.assert_allclose(boom.triangles.reshape(-1, 3).min(axis=0), [0.0, -0.05, -0.05], atol=1e-12)
    np.testing.assert_allclose(boom.triangles.reshape(-1, 3).max(axis=0), [1.0, 0.05, 0.05], atol=1e-12)
    [(mast, T_world_mast)] = model.fixed_surfaces(["turn"])
    assert mast.link == "mast"
    np.testing.assert_allclose(T_world_mast[:3, 3], [1.0, 0.0, 0.3])
    normals = np.cross(mast.triangles[:, 1] - mast.triangles[:, 0], mast.triangles[:, 2] - mast.triangles[:, 0])
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(2 * (0.2 * 0.4 + 0.2 * 0.6 + 0.4 * 0.6))
    assert ((normals * mast.triangles.mean(axis=1)).sum(axis=1) > 0).all(), "normals point outwards"


def test_limits_of_a_continuous_joint_are_infinite(tmp_path: Path) -> None:
    model = crane(tmp_path, kind="continuous")
    assert model.description.limits("turn") == (-np.inf, np.inf)
    assert model.chain(["turn"], "hook").continuous.tolist() == [True]
    assert model.description.link_of("turn") == "boom"


def test_what_cannot_be_used_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"hinges.*turn"):
        crane(tmp_path, kind="prismatic").chain(["turn"], "hook")
    with pytest.raises(UsageError, match=r"link.*'claw'"):
        crane(tmp_path).chain(["turn"], "claw")
    with pytest.raises(UsageError, match=r"joint.*'lift'.*turn"):
        crane(tmp_path).description.limits("lift")
    with pytest.raises(UsageError, match=r"tool that moves with turn, got mast"):
        crane(tmp_path).chain(["turn"], "mast")
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot")
    with pytest.raises(UsageError, match="readable URDF"):
        read_description(broken)
    with pytest.raises(UsageError, match=r"missing\.urdf"):
        read_description(tmp_path / "missing.urdf")


def test_joints_that_do_not_follow_each_other_are_refused() -> None:
    model = PlacedDescription(read_description(URDF), np.eye(4), {})
    with pytest.raises(UsageError, match="follow each other"):
        model.chain(["r_shoulder_pan_joint", "r_elbow_flex_joint"], "r_gripper_tool_frame")


def test_every_kind_of_solid_is_read() -> None:
    said = parse_description(
        link(
            '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
            '<collision name="b"><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'
            + cylinder("c") + cylinder("d") + cylinder("e")
            + '<collision_checking><capsule name="d"/><elliptic_cylinder name="e" x="0.05"/></collision_checking>'
        )
    )  # fmt: skip
    assert [body.name for body in said.bodies] == ["a", "b", "c", "d", "e"]
    assert [body.shape for body in said.bodies] == [
        Sphere(0.1), Box(0.1, 0.2, 0.3), EllipticCylinder(0.1, 0.1, 0.4), Capsule(0.1, 0.4),
        EllipticCylinder(0.05, 0.1, 0.4),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("inner", "said"),
    [
        ('<collision><geometry><mesh filename="m.stl"/></geometry></collision>', r"link a.*mesh m\.stl"),
        ("<collision/>", "link a.*<geometry>"),
        ('<collision><geometry><sphere radius="wide"/></geometry></collision>', "link a.*wide"),
        ('<collision><geometry><sphere/></geometry></collision>', "link a"),
        ('<collision><geometry><sphere radius="-1"/></geometry></collision>', "link a.*positive radius_m, got -1"),
        ('<collision><geometry><box size="1 2"/></geometry></collision>', "link a.*3 finite numbers in 'size'"),
        ('<collision><origin xyz="0 0 nan"/><geometry><sphere radius="1"/></geometry></collision>', "link a.*'xyz'"),
        (cylinder() + '<collision_checking><capsule name="leg"/></collision_checking>', "link a.*leg"),
        (cylinder() + '<collision_checking><elliptic_cylinder name="limb"/></collision_checking>', "'x', got None"),
    ],
)  # fmt: skip
def test_bad_collision_geometry_is_refused(inner: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        parse_description(link(inner))


def gripper(offset: float = 0.1) -> str:
    finger = '<link name="{0}_tip"/><joint name="{0}" type="revolute"><parent link="palm"/><child link="{0}_tip"/>'
    limit = '<axis xyz="0 0 2"/><limit lower="-1" upper="1" velocity="1" effort="1"/>'
    mimic = f'<mimic joint="left" multiplier="-2" offset="{offset}"/>'
    joints = f"{finger.format('left')}{limit}</joint>{finger.format('right')}{limit}{mimic}</joint>"
    return f'<robot name="gripper"><link name="palm"/>{joints}</robot>'


def turn_of(said: Description, link_name: str, values: dict[str, float]) -> float:
    R = said.link_poses(values)[said.link_index(link_name)]
    return float(np.arctan2(R[1, 0], R[0, 0]))


def test_mimic_joints_follow_unless_they_are_set() -> None:
    said = parse_description(gripper())
    assert said.mimic["right"] == ("left", -2.0, 0.1)
    assert turn_of(said, "left_tip", {"left": 0.3}) == pytest.approx(0.3)
    assert turn_of(said, "right_tip", {"left": 0.3}) == pytest.approx(-0.5)
    assert turn_of(said, "right_tip", {"left": 0.3, "right": 0.2}) == pytest.approx(0.2)


FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 %d 0\nendloop\nendfacet\n"
STL = b"solid s\n" + FACET + b"endsolid s\n"


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(reader, "cache_root", lambda: tmp_path / "cache")
    parse_description.cache_clear()
    return tmp_path / "cache"


def test_meshes_of_packages_are_found_above_the_file_and_scaled(tmp_path: Path) -> None:
    mesh = tmp_path / "some_description" / "meshes" / "part.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_bytes(STL % 1)
    file = tmp_path / "some_description" / "urdf" / "part.urdf"
    file.parent.mkdir()
    name = "package://some_description/meshes/part.stl"
    file.write_text(link(f'<collision><geometry><mesh filename="{name}" scale="2 3 4"/></geometry></collision>'))
    [part] = read_description(file).meshes
    np.testing.assert_array_equal(part.triangles, [[[0, 0, 0], [2, 0, 0], [0, 3, 0]]])


def test_a_description_is_kept_until_the_text_or_a_mesh_changes(
    tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = []
    parse = reader._parse
    monkeypatch.setattr(reader, "_parse", lambda *given: read.append(given) or parse(*given))
    mesh, file = tmp_path / "part.stl", tmp_path / "part.urdf"
    mesh.write_bytes(STL % 1)
    file.write_text(link('<collision><geometry><mesh filename="part.stl"/></geometry></collision>'))

    def triangles() -> np.ndarray:
        parse_description.cache_clear()  # as another process would begin
        return read_description(file).meshes[0].triangles

    first = triangles()
    np.testing.assert_array_equal(triangles(), first)
    assert len(read) == 1
    mesh.write_bytes(STL % 10)
    assert triangles().max() == 10.0
    file.write_text(file.read_text().replace('name="a"', 'name="b"'))
    assert read_description(file).meshes[0].link == "b"
    assert len(read) == 3
    for entry in own_cache.rglob("*.pickle"):
        entry.write_bytes(b"no description")
    assert triangles().max() == 10.0
    assert any(entry.read_bytes() != b"no description" for entry in own_cache.rglob("*.pickle"))


def test_without_a_cache_descriptions_are_still_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "cache_root", lambda: None)
    parse_description.cache_clear()
    assert parse_description(gripper(0.2)).joint_names == ("left", "right")
