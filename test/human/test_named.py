from __future__ import annotations

import pytest

from humanpred_ros.errors import HumanModelError, UsageError
from humanpred_ros.human.named import HUMANS, human_named, human_with, name_of_human


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
