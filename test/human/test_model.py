"""The human model: the published forward kinematics, pinocchio as oracle, and DoFs that do not fit."""

from __future__ import annotations

import csv
import pickle

import numpy as np
import pinocchio as pin
import pytest
from human_distance import least_distance_m
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import shared_data

from humanpred_ros.errors import HumanModelError, UsageError
from humanpred_ros.human.model import HUMANS, HumanModel, human_named, human_with, name_of_human
from humanpred_ros.resources import share_file

pytestmark = pytest.mark.core

DOFS = [
    "PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotZ", "TorsoX", "TorsoY", "TorsoZ",
    "rShoulderX", "rShoulderZ", "rShoulderY", "rArmTrans", "rElbowZ",
]  # fmt: skip

# World positions published with the recordings (docs/papers.md, P1 human).
PUBLISHED = [
    ("library_a", 3, 2, 99, {
        "right_shoulder": (-0.0337, -1.5649, 1.1070), "right_elbow": (-0.1454, -1.4030, 0.8502),
        "right_wrist": (-0.2590, -1.2685, 0.6718), "right_palm": (-0.3268, -1.1905, 0.5631)}),
    ("library_a", 0, 0, 0, {
        "right_shoulder": (0.0824, -1.9144, 1.1525), "right_elbow": (0.0977, -1.9860, 0.8352),
        "right_wrist": (0.1080, -1.9389, 0.5893), "right_palm": (0.1115, -1.9124, 0.4417)}),
    ("library_b", 4, 7, 57, {
        "right_shoulder": (1.5736, 1.5013, 1.3074), "right_elbow": (1.5987, 1.3717, 1.0274),
        "right_wrist": (1.6247, 1.2375, 0.8174), "right_palm": (1.6425, 1.1592, 0.6907)}),
]  # fmt: skip


@pytest.fixture(scope="module")
def human() -> HumanModel:
    return HumanModel.kinect12()


def postures(model: HumanModel, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(np.maximum(model.lower, -3), np.minimum(model.upper, 3), (count, len(model.dof_names)))


def recorded(library: str, label: int, index: int, frame: int) -> np.ndarray:
    with open(shared_data(f"iros2013/{library}") / f"class_{label}.csv", newline="") as file:
        for row in csv.DictReader(file):
            if (int(row["traj_id"]), int(row["frame"])) == (index, frame):
                return np.array([float(row[name]) for name in DOFS])
    raise LookupError((library, label, index, frame))


def rot(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array({
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis])  # fmt: skip


def closed_form(q: np.ndarray) -> dict[str, np.ndarray]:
    """P1's forward kinematics written out from absolute zero-pose positions (docs/papers.md, P1 human)."""
    p_to, p_sh = np.array([0.037432, 0, 0.139749]), np.array([-0.0112, -0.23982, 0.428571])
    p_el, p_wr = np.array([-0.007033, -0.446428, 0.430224]), np.array([-0.004259, -0.697, 0.43478])
    d = dict(zip(DOFS, q, strict=True))
    Rp = rot("z", d["PelvisRotZ"])
    torso = q[:3] + Rp @ p_to
    Rt = Rp @ rot("x", d["TorsoX"]) @ rot("y", d["TorsoY"]) @ rot("z", d["TorsoZ"])
    shoulder = torso + Rt @ (p_sh - p_to)
    Rs = Rt @ rot("x", d["rShoulderX"]) @ rot("z", d["rShoulderZ"]) @ rot("y", -d["rShoulderY"])
    elbow = shoulder + Rs @ (p_el - p_sh + (0, -d["rArmTrans"], 0))
    Re = Rs @ rot("z", d["rElbowZ"])
    return {
        "pelvis": q[:3], "torso": torso, "right_shoulder": shoulder, "right_elbow": elbow,
        "right_wrist": elbow + Re @ (p_wr - p_el), "right_palm": elbow + Re @ (p_wr - p_el + [0, -0.15, 0]),
        "head": torso + Rt @ (np.array([0.0576, -0.0049, 0.6827]) - p_to), "kinect_torso": np.add(q[:3], (0, 0, 0.2)),
    }  # fmt: skip


@pytest.mark.parametrize(("library", "label", "index", "frame", "places"), PUBLISHED)
def test_published_positions_are_reproduced(
    human: HumanModel, library: str, label: int, index: int, frame: int, places: dict[str, tuple[float, ...]]
) -> None:
    found = human.forward(recorded(library, label, index, frame))
    for name, place in places.items():
        np.testing.assert_allclose(found[name], place, atol=1e-4, err_msg=name)


def test_the_closed_form_is_reproduced(human: HumanModel) -> None:
    for q in postures(human, 50):
        found = human.forward(q)
        for name, place in closed_form(q).items():
            np.testing.assert_allclose(found[name], place, atol=1e-5, err_msg=name)


def test_pinocchio_agrees_on_every_link(human: HumanModel) -> None:
    tree = pin.buildModelFromXML(human.urdf)
    data = tree.createData()
    for q in postures(human, 20, seed=1):
        pin.framesForwardKinematics(tree, data, q)
        for name, T in zip(human.link_names, human.link_poses(q), strict=True):
            np.testing.assert_allclose(T, data.oMf[tree.getFrameId(name, pin.BODY)].homogeneous, atol=1e-12)


def test_dofs_and_limits_are_the_published_ones(human: HumanModel) -> None:
    assert human.dof_names == tuple(DOFS)
    limits = dict(zip(DOFS, np.c_[human.lower, human.upper], strict=True))
    for name, degrees in {
        "TorsoX": (-45, 45),
        "TorsoY": (-20, 40),
        "TorsoZ": (-45, 45),
        "rElbowZ": (-180, 180),
    }.items():
        np.testing.assert_allclose(limits[name], np.radians(degrees), atol=1e-6)
    np.testing.assert_allclose(limits["rArmTrans"], (-0.5, 0.5))


@pytest.mark.parametrize("library", ["library_a", "library_b"])
def test_recorded_postures_lie_within_the_limits(human: HumanModel, library: str) -> None:
    for label in range(8):
        table = np.loadtxt(shared_data(f"iros2013/{library}") / f"class_{label}.csv", delimiter=",", skiprows=1)
        if (library, label) == ("library_b", 6):
            table = table[table[:, 0] != 0]  # listed as wild in outliers.csv
        assert ((table[:, 2:] >= human.lower) & (table[:, 2:] <= human.upper)).all()


def test_sequences_and_single_postures_agree(human: HumanModel) -> None:
    q = postures(human, 7, seed=2)
    poses, places = human.link_poses(q), human.forward(q)
    assert poses.shape == (7, len(human.link_names), 4, 4)
    assert places["right_palm"].shape == (7, 3)
    np.testing.assert_allclose(human.link_poses(q[3]), poses[3], atol=1e-12)
    np.testing.assert_allclose(human.forward(q[3])["right_palm"], places["right_palm"][3], atol=1e-12)
    assert human.link_poses(q[:0]).shape == (0, len(human.link_names), 4, 4)


@settings(max_examples=30)
@given(
    shift=st.tuples(*[st.floats(-5, 5)] * 3), yaw=st.floats(-1.5, 1.5), seed=st.integers(0, 100)
)  # fmt: skip
def test_moving_the_pelvis_moves_everything_rigidly(shift: tuple[float, ...], yaw: float, seed: int) -> None:
    human = HumanModel.kinect12()
    q = postures(human, 1, seed)[0]
    q[:4] = 0
    moved = q + np.array([*shift, yaw, *[0] * 8])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rot("z", yaw), shift
    fixed = human.link_names.index("pelvis")
    for i, (before, after) in enumerate(zip(human.link_poses(q), human.link_poses(moved), strict=True)):
        if i >= fixed:
            np.testing.assert_allclose(after, T @ before, atol=1e-9)


def test_left_arm_hangs_as_in_the_scenes(human: HumanModel) -> None:
    found = human.forward(np.zeros(12))
    arm = found["left_palm"] - found["left_shoulder"]
    assert np.degrees(np.arctan2(-arm[2], arm[1])) == pytest.approx(76.9, abs=1.0)  # the bones bend by about 1 degree
    mirrored = human.forward(np.eye(12)[7] * np.radians(76.9))
    for point in ("shoulder", "elbow", "wrist", "palm"):
        np.testing.assert_allclose(mirrored[f"right_{point}"] * (1, -1, 1), found[f"left_{point}"], atol=1e-6)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (DOFS[:-1], "missing: rElbowZ"),
        ([*DOFS[:-1], "rElbowQ"], "unknown: rElbowQ; missing: rElbowZ"),
        ([*DOFS, "TorsoX"], "more than once: TorsoX"),
        ([*DOFS[1:], DOFS[0]], "another order: DoF 0 is PelvisTransY instead of PelvisTransX"),
    ],
)
def test_wrong_dofs_are_named(human: HumanModel, names: list[str], said: str) -> None:
    human.check_dofs(DOFS)
    with pytest.raises(HumanModelError, match=said):
        human.check_dofs(names)


@pytest.mark.parametrize("bad", [np.zeros(11), np.zeros((3, 13)), np.full(12, np.nan), np.zeros((2, 2, 12)), "q"])
def test_wrong_postures_are_refused(human: HumanModel, bad: object) -> None:
    with pytest.raises(HumanModelError, match="postures of human_kinect12"):
        human.forward(bad)


def test_signature_ignores_the_layout_and_sees_every_length(human: HumanModel) -> None:
    text = human.urdf
    relaid = (
        text.replace("\n    ", "\n\t ").replace("<!-- Pelvis", "<!-- The pelvis").replace('"0 0 0.2"', '"0. 0.0 .20"')
    )
    assert relaid != text
    assert HumanModel(relaid).signature == human.signature
    for old, new in [
        ('radius="0.13"', 'radius="0.131"'),
        ('lower="-0.785398"', 'lower="-0.7"'),
        ('x="0.1415"', 'x="0.15"'),
        ('axis xyz="0 -1 0"', 'axis xyz="0 1 0"'),
        ('xyz="-0.048632 -0.23982 0.288822"', 'xyz="-0.048632 -0.23983 0.288822"'),
    ]:
        assert HumanModel(text.replace(old, new)).signature != human.signature, old


def test_model_survives_pickling(human: HumanModel) -> None:
    copy = pickle.loads(pickle.dumps(human))
    q = postures(human, 3)
    assert copy.signature == human.signature
    np.testing.assert_array_equal(copy.link_poses(q), human.link_poses(q))


def test_limits_cannot_be_changed_by_accident(human: HumanModel) -> None:
    with pytest.raises(ValueError, match="read-only"):
        human.lower[0] = 0.0


def test_another_tree_loads_by_the_same_class() -> None:
    joint = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><origin xyz="0 0 1" rpy="0.3 0 0"/>'
    limit = '<axis xyz="{}"/><limit lower="-2" upper="2" effort="0" velocity="1"/></joint>'
    urdf = (
        '<robot name="t"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>'
        + joint.format("turn", "revolute", "a", "b") + limit.format("0.6 0.8 0")
        + joint.format("slide", "prismatic", "b", "c") + limit.format("0 0.6 -0.8")
        + joint.format("tip", "fixed", "c", "d") + "</joint></robot>"
    )  # fmt: skip
    model = HumanModel(urdf)
    assert model.dof_names == ("turn", "slide")
    tree = pin.buildModelFromXML(urdf)
    data = tree.createData()
    q = np.array([0.7, -1.2])
    pin.framesForwardKinematics(tree, data, q)
    np.testing.assert_allclose(
        model.link_poses(q)[-1], data.oMf[tree.getFrameId("d", pin.BODY)].homogeneous, atol=1e-12
    )
    with pytest.raises(HumanModelError, match="at least one <collision>"):
        model.surface_points(q)


@pytest.mark.parametrize(
    ("urdf", "said"),
    [
        ("not xml", "does not parse"),
        ("<sdf/>", "root element <robot>, got <sdf>"),
        ('<robot name="t"><link name="a"/></robot>', "at least one moving joint"),
        (
            '<robot name="t"><link name="a"/><link name="b"/>'
            '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>',
            "joint j is .* revolute with limits",
        ),
        ('<robot name="t"><link name="a"/><link name="b"/></robot>', "one tree of links"),
    ],
)
def test_unusable_models_are_refused(urdf: str, said: str) -> None:
    with pytest.raises(HumanModelError, match=said):
        HumanModel(urdf)


def test_absent_file_is_named(tmp_path: object) -> None:
    with pytest.raises(HumanModelError, match=r"no_such\.urdf"):
        HumanModel.from_urdf(f"{tmp_path}/no_such.urdf")
    assert HumanModel.from_urdf(share_file("urdf", "human_kinect12.urdf")).name == "human_kinect12"


def test_distance_to_the_human_is_exact_for_the_head_and_signed(human: HumanModel) -> None:
    q = postures(human, 1, seed=5)[0]
    q[4:7] = 0
    q[7:9] = (1.5, 0)  # arms down, so that nothing is nearer than the head from above
    head = human.forward(q)["head"]
    above = np.add(head, (0, 0, 1.0))
    assert least_distance_m(human, q, [above], [0.2]) == pytest.approx(1.0 - 0.13 - 0.2, abs=1e-9)
    assert least_distance_m(human, q, [head], [0.05]) == pytest.approx(-0.13 - 0.05, abs=1e-9)
    assert least_distance_m(human, q, [above, head], [0.2, 0.05]) == pytest.approx(-0.18, abs=1e-9)


@pytest.mark.parametrize("name", list(HUMANS))
def test_a_human_is_found_by_name_and_by_its_dofs(name: str) -> None:
    human = human_named(name)
    assert str(len(human.dof_names)) in name
    assert name_of_human(human.dof_names) == name
    assert human_with(human.dof_names).signature == human.signature


def test_who_is_nobody_is_named() -> None:
    with pytest.raises(UsageError, match=r"kinect12, mocap23, got 'alien'"):
        human_named("alien")
    mocap = human_named("mocap23").dof_names
    with pytest.raises(HumanModelError, match=r"human_mocap23.*missing: rWristY"):
        human_with(mocap[:-1])
    with pytest.raises(HumanModelError, match="another order"):
        human_with((*mocap[1:], mocap[0]))
