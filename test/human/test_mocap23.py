"""The 23-DoF human: the reference positions of the recordings, the closed form, and a body that covers the bones."""

from __future__ import annotations

import csv
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from human_distance import distances_m
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_centres import JOINT_CENTRES, joint_centres
from paths import shared_data

from humanpred_ros.human.model import HumanModel

DOFS = (
    "PelvisTransX", "PelvisTransY", "PelvisTransZ", "PelvisRotX", "PelvisRotY", "PelvisRotZ",
    "TorsoX", "TorsoZ", "TorsoY", "rShoulderTransX", "rShoulderTransY", "rShoulderTransZ",
    "rShoulderY1", "rShoulderX", "rShoulderY2", "rArmTrans", "rElbowZ", "rElbowX", "rElbowY",
    "rForeArmTrans", "rWristZ", "rWristX", "rWristY",
)  # fmt: skip
HUMAN = HumanModel.mocap23()
POINT_OF_REFERENCE = dict(zip(("pelvis", "torso", "shoulder", "elbow", "wrist", "palm"), JOINT_CENTRES, strict=True))
#: Lengths and translations a person can have, rotations all of them (docs/papers.md, P2 human).
LOW = np.array([1.2, 0.6, 1.0, *[-3.1] * 6, 0.0, 0.15, 0.05, *[-3.1] * 3, 0.299, *[-3.1] * 3, 0.188, *[-3.1] * 3])
HIGH = np.array([2.2, 1.3, 1.3, *[3.1] * 6, 0.12, 0.28, 0.18, *[3.1] * 3, 0.5, *[3.1] * 3, 0.482, *[3.1] * 3])


def postures(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(LOW, HIGH, (count, 23))


def rot(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array({
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "r": [[c, 0, -s], [0, 1, 0], [s, 0, c]],  # about (0, -1, 0)
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis])  # fmt: skip


def closed_form(q: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """P2's forward kinematics written out (docs/papers.md, P2 human): the joint centres, and the palm's rotation."""
    d = dict(zip(DOFS, q, strict=True))
    R = rot("x", d["PelvisRotX"]) @ rot("y", d["PelvisRotY"]) @ rot("z", d["PelvisRotZ"])
    torso = q[:3] + R @ (0.037432, 0, 0.139749)
    R = R @ rot("x", d["TorsoX"]) @ rot("r", d["TorsoZ"]) @ rot("z", d["TorsoY"])
    shoulder = torso + R @ (d["rShoulderTransX"], -d["rShoulderTransZ"], d["rShoulderTransY"])
    R = R @ rot("z", d["rShoulderY1"]) @ rot("x", d["rShoulderX"]) @ rot("z", d["rShoulderY2"])
    elbow = shoulder + R @ (0, 0, -d["rArmTrans"])
    R = R @ rot("r", d["rElbowZ"]) @ rot("x", d["rElbowX"]) @ rot("z", d["rElbowY"])
    wrist = elbow + R @ (0, 0, -d["rForeArmTrans"])
    R = R @ rot("r", d["rWristZ"]) @ rot("x", d["rWristX"]) @ rot("z", d["rWristY"])
    places = q[:3], torso, shoulder, elbow, wrist, wrist + R @ (0, 0, -0.15)
    return dict(zip(JOINT_CENTRES, places, strict=True)), R


def rotation_of(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix())


def test_dofs_are_those_of_the_recordings_in_their_order() -> None:
    assert HUMAN.dof_names == DOFS
    for file in sorted(shared_data("icra2015").glob("*/*.csv")):
        with open(file, newline="") as rows:
            assert next(csv.reader(rows)) == ["t", *DOFS]


def test_reference_positions_and_palm_orientations_are_reproduced() -> None:
    folder, tables, seen = shared_data("icra2015"), {}, 0
    with open(folder / "fk_reference.csv", newline="") as rows:
        for row in csv.DictReader(rows):
            name = f"{row['demo']}_{row['role']}.csv"
            if name not in tables:
                tables[name] = np.loadtxt(next(folder.glob(f"*/{name}")), delimiter=",", skiprows=1)
            q = tables[name][int(row["frame"]), 1:]
            places = joint_centres(HUMAN, q)
            for column, point in POINT_OF_REFERENCE.items():
                reference = [float(row[f"{column}_{axis}"]) for axis in "xyz"]
                np.testing.assert_allclose(places[point], reference, atol=1e-6, err_msg=f"{name} {point}")
            R = HUMAN.link_poses(q)[HUMAN.link_names.index("right_palm"), :3, :3]
            np.testing.assert_allclose(R, rotation_of(*(float(row[f"palm_q{a}"]) for a in "wxyz")), atol=4e-6)
            seen += 1
    assert seen == 42


def test_the_closed_form_is_reproduced() -> None:
    palm = HUMAN.link_names.index("right_palm")
    for q in postures(50):
        places, R = closed_form(q)
        found = joint_centres(HUMAN, q)
        assert list(found) == list(places)
        for name, place in places.items():
            np.testing.assert_allclose(found[name], place, atol=1e-12, err_msg=name)
        np.testing.assert_allclose(HUMAN.link_poses(q)[palm, :3, :3], R, atol=1e-12)


def test_pinocchio_agrees_on_every_link() -> None:
    tree = pin.buildModelFromXML(HUMAN.urdf)
    data = tree.createData()
    for q in postures(10, seed=1):
        pin.framesForwardKinematics(tree, data, q)
        for name, T in zip(HUMAN.link_names, HUMAN.link_poses(q), strict=True):
            np.testing.assert_allclose(T, data.oMf[tree.getFrameId(name, pin.BODY)].homogeneous, atol=1e-12)


@settings(max_examples=50)
@given(seed=st.integers(0, 10_000))
def test_the_measured_lengths_are_the_distances_of_the_joint_centres(seed: int) -> None:
    q = postures(1, seed)[0]
    p = joint_centres(HUMAN, q)
    assert np.linalg.norm(p["rShoulderX"] - p["rElbowZ"]) == pytest.approx(q[DOFS.index("rArmTrans")], abs=1e-12)
    assert np.linalg.norm(p["rElbowZ"] - p["rWristX"]) == pytest.approx(q[DOFS.index("rForeArmTrans")], abs=1e-12)
    assert np.linalg.norm(p["rWristX"] - p["rPalm"]) == pytest.approx(0.15, abs=1e-12)


def test_recorded_postures_lie_within_the_limits() -> None:
    for file in sorted(shared_data("icra2015").glob("*/*.csv")):
        q = np.loadtxt(file, delimiter=",", skiprows=1)[:, 1:]
        assert ((q >= HUMAN.lower) & (q <= HUMAN.upper)).all(), file.name


def test_shoulder_elbow_and_wrist_carry_the_orientation_of_what_is_above_them() -> None:
    frames = [("right_shoulder", "torso"), ("right_elbow", "right_upper_arm"), ("right_wrist", "right_forearm")]
    for T in HUMAN.link_poses(postures(5, seed=2)):
        for point, above in frames:
            np.testing.assert_allclose(
                T[HUMAN.link_names.index(point), :3, :3], T[HUMAN.link_names.index(above), :3, :3], atol=1e-12
            )


@pytest.mark.parametrize("lengths_m", [(0.299, 0.188), (0.40, 0.245), (0.35, 0.30), (0.5, 0.482)])
def test_bones_are_covered_however_long(lengths_m: tuple[float, float]) -> None:
    q = np.zeros(23)
    q[9:12] = (0.068, 0.222, 0.123)
    q[[12, 13, 14, 16, 17, 18]] = (0.6, -0.8, 1.2, -1.0, -0.7, 0.2)
    q[[15, 19]] = lengths_m
    p = HUMAN.forward(q)
    for side in ("right", "left"):
        chain = [p[f"{side}_{name}"] for name in ("shoulder", "elbow", "wrist", "palm")]
        for a, b in pairwise(chain):
            assert distances_m(HUMAN, q, a + np.linspace(0, 1, 200)[:, None] * (b - a)).max() < 0.0


def test_published_body_sizes() -> None:
    poses = HUMAN.body_poses(np.zeros(23))
    found = {body.name: (body.shape, T[:3, 3]) for body, T in zip(HUMAN.bodies, poses, strict=True)}
    torso = np.array([0.037432, 0, 0.139749])
    np.testing.assert_allclose(found["pelvis"][1], (0.0276, -0.0031, -0.0373), atol=1e-9)
    np.testing.assert_allclose(found["torso"][1] - torso, (-0.0110, -0.0029, 0.1031), atol=1e-9)
    np.testing.assert_allclose(found["shoulders"][1] - torso, (-0.0268, -0.0044, 0.3076), atol=1e-9)
    np.testing.assert_allclose(found["neck"][1] - torso, (-0.0236, -0.0044, 0.4005), atol=1e-9)
    np.testing.assert_allclose(found["head"][1] - torso, (0.0202, -0.0049, 0.5429), atol=1e-9)
    assert (found["torso"][0].x_m, found["torso"][0].y_m, found["torso"][0].length_m) == (0.1415, 0.203, 0.2574)


def test_both_models_have_the_joint_centres() -> None:
    kinect = HumanModel.kinect12()
    assert list(joint_centres(kinect, np.zeros(12))) == list(JOINT_CENTRES)
    palm = kinect.forward(np.zeros(12))["right_palm"]
    np.testing.assert_array_equal(joint_centres(kinect, np.zeros(12))["rPalm"], palm)
