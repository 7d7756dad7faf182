"""Points fixed to the moving chain of a human, for many postures at once, as planning for a human needs them.

`HumanModel.link_poses` computes every link of the tree, 10 microseconds per posture; here only the points asked for are
computed (six points of the 23-DoF human: 0.1 microseconds in float32), with their derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import HumanModelError
from humanpred_ros.geometry import chain_kernels
from humanpred_ros.geometry.checks import FloatArray, checked
from humanpred_ros.geometry.joints import FIRST, KIND, LAST
from humanpred_ros.human.model import HumanModel


class ChainPoints:
    """Positions and derivatives of points on a human whose moving joints form one chain; immutable, thread safe.

    Args:
        model: a human whose joints follow one another and turn about, or slide along, a coordinate axis each (the
            12-DoF and the 23-DoF human are such).
        links: P names, the links the points are fixed to.
        local_m: (P, 3) the points in their links' frames; the links' origins if left out.

    Raises:
        HumanModelError: another kind of model, no points, or links it does not have.
        ArrayError: `local_m` of another shape.
    """

    def __init__(self, model: HumanModel, links: Sequence[str], local_m: ArrayLike | None = None) -> None:
        lacking = sorted(set(links) - set(model.link_names))
        if lacking or not links:
            raise HumanModelError(
                f"points on {model.name}: wanted at least one of its links, got {', '.join(lacking) or 'none'}; "
                f"use {', '.join(model.link_names)}"
            )
        number = np.array([model.link_names.index(link) for link in links])
        T = model.T_joint_link[number]
        here = np.zeros((len(links), 3)) if local_m is None else checked("local_m", local_m, (len(links), 3))
        local = np.einsum("pij,pj->pi", T[:, :3, :3], here) + T[:, :3, 3]
        joint = model.link_joint[number]
        order = np.argsort(joint, kind="stable")
        self.model = model
        self.links = tuple(links)
        self._dofs = len(model.dof_names)
        self._back = np.argsort(order)  # from the order of the joints to that of `links`
        self._in_order = bool((order == np.arange(len(order))).all())
        _check_chain(model)
        self._joint, self._local = joint[order], np.ascontiguousarray(local[order])
        first = np.searchsorted(self._joint, np.arange(1, self._dofs + 2))
        table = model.joints.table.astype(np.float32)
        table[:, FIRST], table[:, LAST] = first[:-1], first[1:]
        self._single = (table, np.column_stack([self._local, np.zeros(len(local))]).astype(np.float32))

    def positions(self, q: ArrayLike) -> NDArray[Any]:
        """Return the points (..., P, 3) of postures (..., D) in the tracker's frame, in the precision of the postures.

        float32 postures give float32 points, right to about 1e-6 m per metre from the origin, three times as fast.

        Raises:
            HumanModelError: wrong shape or values that are not finite.
        """
        postures, shape = self._flat(q)
        if postures.dtype == np.float32:
            points = chain_kernels.point_positions_32(postures, *self._single)
        else:
            points = chain_kernels.point_positions(postures, self.model.joints, self._joint, self._local)
        if not self._in_order:
            points = points[:, self._back]
        return np.asarray(points.reshape(*shape, len(self.links), 3))

    def jacobian(self, q: ArrayLike) -> FloatArray:
        """Return the derivatives (..., P, 3, D) of the points over the DoFs, for postures (..., D), in float64."""
        postures, shape = self._flat(np.asarray(q, dtype=np.float64))
        J = chain_kernels.point_jacobians(postures, self.model.joints, self._joint, self._local)[:, self._back]
        return np.asarray(J.reshape(*shape, len(self.links), 3, self._dofs))

    def _flat(self, q: ArrayLike) -> tuple[NDArray[Any], tuple[int, ...]]:
        postures = np.asarray(q)
        if postures.dtype != np.float32:
            postures = checked(f"postures of {self.model.name}", q, postures.shape, error=HumanModelError)
        if postures.ndim == 0 or postures.shape[-1] != self._dofs or not np.isfinite(postures).all():
            raise HumanModelError(
                f"postures of {self.model.name}: wanted finite numbers of shape (..., {self._dofs}), got shape "
                f"{postures.shape}{'' if np.isfinite(postures).all() else ' with values that are not finite'}"
            )
        return np.ascontiguousarray(postures.reshape(-1, self._dofs)), postures.shape[:-1]


def _check_chain(model: HumanModel) -> None:
    """Refuse joints that do not follow one another along coordinate axes (HumanModelError)."""
    serial = model.joints.parent == np.arange(len(model.dof_names))
    straight = model.joints.table[:, KIND] <= 5
    for name, *well in zip(model.dof_names, serial, straight, strict=True):
        if not all(well):
            reasons = ("does not follow the joint before it", "has an axis beside the coordinate axes")
            raise HumanModelError(
                f"points on {model.name}: wanted one chain of joints about or along coordinate axes, but {name} "
                f"{reasons[well.index(False)]}; use HumanModel.link_poses for such a model"
            )
