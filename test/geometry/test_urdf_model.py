"""Reading small URDFs written here: what becomes a chain, what becomes a surface, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from humanpred_ros.errors import UsageError
from humanpred_ros.geometry import urdf_model
from humanpred_ros.geometry.shapes import planar_pose
from humanpred_ros.geometry.urdf_model import UrdfModel, find_pr2_urdf

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


def crane(folder: Path, kind: str = "revolute", geometry: str = BOX) -> UrdfModel:
    path = folder / f"{kind}{len(geometry)}.urdf"
    path.write_text(ARM.format(kind=kind, geometry=geometry))
    return UrdfModel(path, planar_pose(1.0, 0.0), {})


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
    assert model.limits("turn") == (-np.inf, np.inf)
    assert model.chain(["turn"], "hook").continuous.tolist() == [True]
    assert model.link_of("turn") == "boom"


def test_what_cannot_be_used_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"hinges.*turn"):
        crane(tmp_path, kind="prismatic").chain(["turn"], "hook")
    with pytest.raises(UsageError, match=r"frame.*'claw'"):
        crane(tmp_path).chain(["turn"], "claw")
    with pytest.raises(UsageError, match=r"joint.*'lift'.*turn"):
        crane(tmp_path).limits("lift")
    with pytest.raises(UsageError, match=r"meshes or boxes.*boom"):
        crane(tmp_path, geometry='<sphere radius="0.1"/>').moving_surfaces(["turn"])
    broken = tmp_path / "broken.urdf"
    broken.write_text("<robot")
    with pytest.raises(UsageError, match="readable URDF"):
        UrdfModel(broken, np.eye(4), {})


def test_joints_that_do_not_follow_each_other_are_refused() -> None:
    model = UrdfModel(find_pr2_urdf(), np.eye(4), {})
    with pytest.raises(UsageError, match="follow each other"):
        model.chain(["r_shoulder_pan_joint", "r_elbow_flex_joint"], "r_gripper_tool_frame")


def test_urdf_is_found_below_a_ros_prefix_or_its_absence_explained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "share" / "example-robot-data" / "robots" / "pr2_description" / "urdf" / "pr2.urdf"
    monkeypatch.setattr(urdf_model.pin, "__file__", str(tmp_path / "empty" / "pinocchio" / "__init__.py"))
    monkeypatch.setattr(urdf_model.sys, "path", [])
    monkeypatch.setattr(urdf_model.sys, "prefix", str(tmp_path / "empty"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    with pytest.raises(UsageError, match="pip install example-robot-data"):
        find_pr2_urdf()
    elsewhere.parent.mkdir(parents=True)
    elsewhere.write_text("<robot/>")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert find_pr2_urdf() == elsewhere
