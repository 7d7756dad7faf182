"""Fast positions of points on the chain: equal to the model's, with derivatives that finite differences confirm."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_centres import JOINT_CENTRES, joint_centres

from humanpred_ros.errors import ArrayError, HumanModelError
from humanpred_ros.human.chain_points import ChainPoints
from humanpred_ros.human.model import HumanModel

pytestmark = pytest.mark.core

HUMANS = {"mocap23": HumanModel.mocap23(), "kinect12": HumanModel.kinect12()}
both = pytest.mark.parametrize("human", HUMANS.values(), ids=list(HUMANS))


def postures(human: HumanModel, *shape: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(np.maximum(human.lower, -3), np.minimum(human.upper, 3), (*shape, len(human.dof_names)))


@both
@settings(max_examples=30)
@given(count=st.integers(0, 200), seed=st.integers(0, 1000))
def test_joint_centres_are_those_of_the_model(human: HumanModel, count: int, seed: int) -> None:
    q = postures(human, count, seed=seed)
    found = ChainPoints(human, list(JOINT_CENTRES.values())).positions(q)
    wanted = np.stack(list(joint_centres(human, q).values()), axis=1)
    assert found.shape == (count, 6, 3)
    np.testing.assert_allclose(found, wanted, atol=1e-12)


@both
def test_single_precision_is_kept_and_close(human: HumanModel) -> None:
    q, centres = postures(human, 300), ChainPoints(human, list(JOINT_CENTRES.values()))
    single = centres.positions(q.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, centres.positions(q), atol=3e-6)
    turned = np.zeros_like(q)  # angles of several turns, as unwrapping makes them
    turned[:, [i for i, name in enumerate(human.dof_names) if "Trans" not in name]] = 6 * np.pi
    np.testing.assert_allclose(centres.positions((q + turned).astype(np.float32)), single, atol=2e-5)


@both
def test_any_leading_shape(human: HumanModel) -> None:
    q, centres = postures(human, 3, 70), ChainPoints(human, list(JOINT_CENTRES.values()))
    batch = centres.positions(q)
    assert batch.shape == (3, 70, 6, 3)
    np.testing.assert_array_equal(centres.positions(q[2, 65]), batch[2, 65])
    assert centres.jacobian(q).shape == (3, 70, 6, 3, len(human.dof_names))


@both
def test_points_of_any_links_in_any_order(human: HumanModel) -> None:
    links = ["right_palm", "head", "right_palm", "left_palm", human.link_names[0], "right_elbow", "torso"]
    local = np.random.default_rng(1).normal(0, 0.1, (len(links), 3))
    q = postures(human, 50)
    points = ChainPoints(human, links, local)
    poses = human.link_poses(q)[:, [human.link_names.index(link) for link in links]]
    wanted = np.einsum("tpij,pj->tpi", poses[..., :3, :3], local) + poses[..., :3, 3]
    np.testing.assert_allclose(points.positions(q), wanted, atol=1e-12)


@both
def test_derivatives_are_those_of_finite_differences(human: HumanModel) -> None:
    q = postures(human, 20, seed=3)
    points = ChainPoints(human, ["right_palm", "pelvis", "right_elbow"], [[0.02, 0.01, -0.2], [0, 0, 0], [0, 0.1, 0]])
    step = 1e-6
    differences = [(points.positions(q + step * e) - points.positions(q - step * e)) / (2 * step)
                   for e in np.eye(len(human.dof_names))]  # fmt: skip
    np.testing.assert_allclose(points.jacobian(q), np.stack(differences, axis=-1), atol=1e-8)


def test_results_do_not_depend_on_the_batch() -> None:
    human = HUMANS["mocap23"]
    centres = ChainPoints(human, ["right_wrist", "pelvis"])
    for dtype in (np.float32, np.float64):
        q = postures(human, 130).astype(dtype)
        np.testing.assert_array_equal(centres.positions(q)[::-1], centres.positions(q[::-1]))


def test_bad_input_is_named() -> None:
    human = HUMANS["mocap23"]
    centres = ChainPoints(human, list(JOINT_CENTRES.values()))
    with pytest.raises(HumanModelError, match="got right_tail; use tracker"):
        ChainPoints(human, ["right_tail"])
    with pytest.raises(HumanModelError, match="got none"):
        ChainPoints(human, [])
    with pytest.raises(ArrayError, match="local_m"):
        ChainPoints(human, ["head"], [0, 0, 0])
    for dtype in (np.float32, np.float64):
        with pytest.raises(HumanModelError, match="shape"):
            centres.positions(np.zeros((4, 22), dtype))
        with pytest.raises(HumanModelError, match="finite"):
            centres.positions(np.full((4, 23), np.nan, dtype))


def _tree(axis: str = "0 0 1", rpy: str = "0 0 0", parent: str = "b") -> HumanModel:
    joint = '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="0 0 1" rpy="{}"/>'
    end = '<axis xyz="{}"/><limit lower="-2" upper="2" effort="0" velocity="1"/></joint>'
    return HumanModel(
        '<robot name="t"><link name="a"/><link name="b"/><link name="c"/>'
        + joint.format("one", "a", "b", "0 0 0") + end.format("1 0 0")
        + joint.format("two", parent, "c", rpy) + end.format(axis) + "</robot>"
    )  # fmt: skip


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ({"axis": "0.6 0.8 0"}, "two has an axis beside"),
        ({"parent": "a"}, "two does not follow"),
    ],
)
def test_other_kinds_of_chains_are_refused(model: dict[str, str], said: str) -> None:
    ChainPoints(_tree(), ["c"])
    with pytest.raises(HumanModelError, match=said):
        ChainPoints(_tree(**model), ["c"])
