"""The humans of this package by name and by their DoFs, for whoever is told one or the other."""

from __future__ import annotations

from collections.abc import Sequence

from humanpred_ros.errors import UsageError
from humanpred_ros.human.model import HumanModel

#: Names users know the humans by, and whose they are; the default first.
HUMANS = {
    "kinect12": "P1: 12 DoFs, as a Kinect tracker sees a person",
    "mocap23": "P2: 23 DoFs, as motion capture sees trunk and right arm",
}


def human_named(name: str) -> HumanModel:
    """Return the human of that name.

    Raises:
        UsageError: another name.
    """
    if name not in HUMANS:
        raise UsageError(f"human: wanted one of {', '.join(HUMANS)}, got {name!r}")
    return HumanModel.mocap23() if name == "mocap23" else HumanModel.kinect12()


def human_with(dof_names: Sequence[str]) -> HumanModel:
    """Return the human that has these DoFs in this order; errors as `name_of_human`."""
    return human_named(name_of_human(dof_names))


def name_of_human(dof_names: Sequence[str]) -> str:
    """Return the name of the human that has these DoFs in this order.

    Raises:
        HumanModelError: none of them has; the message is about the one that comes nearest.
    """
    humans = {name: human_named(name) for name in HUMANS}
    shared = {name: len(set(human.dof_names) & set(dof_names)) for name, human in humans.items()}
    nearest = max(humans, key=lambda name: shared[name] / len(humans[name].dof_names))
    humans[nearest].check_dofs(dof_names)
    return nearest
