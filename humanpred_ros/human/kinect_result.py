"""Postures that may be incomplete, because a tracker loses points and what it lost must be told, never guessed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel


@dataclass(frozen=True)
class KinectPosture:
    """A posture as far as the tracker's points determine it.

    Attributes:
        q: (12,) posture, NaN exactly where a DoF is in `missing` or `implausible`.
        missing: DoF -> why it could not be determined (a lost point, or a DoF it builds on).
        implausible: DoF -> why what was measured cannot be a person.
    """

    q: FloatArray
    missing: Mapping[str, str]
    implausible: Mapping[str, str]

    @property
    def complete(self) -> bool:
        """True if every DoF is determined."""
        return not self.missing and not self.implausible


@dataclass(frozen=True)
class KinectPostures:
    """The postures of a sequence; index it, or iterate over it, for single frames.

    Attributes:
        q: (T, 12) postures, NaN where undetermined.
        missing, implausible: T mappings, as in `KinectPosture`.
    """

    q: FloatArray
    missing: tuple[Mapping[str, str], ...]
    implausible: tuple[Mapping[str, str], ...]

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, frame: int) -> KinectPosture:
        return KinectPosture(self.q[frame], self.missing[frame], self.implausible[frame])

    def __iter__(self) -> Iterator[KinectPosture]:
        return (self[frame] for frame in range(len(self)))

    @property
    def complete(self) -> NDArray[np.bool_]:
        """(T,) True where every DoF is determined."""
        return np.asarray(np.isfinite(self.q).all(axis=1))


class Findings:
    """What has been found of T postures so far: values where sound, a reason per frame and DoF where not.

    The first reason stands: what a DoF builds on is judged before it.
    """

    def __init__(self, frames: int, model: HumanModel) -> None:
        self._model = model
        self._q = np.full((frames, len(model.dof_names)), np.nan)
        self._missing: list[dict[str, str]] = [{} for _ in range(frames)]
        self._implausible: list[dict[str, str]] = [{} for _ in range(frames)]
        self._books = (self._missing, self._implausible)

    def __getitem__(self, dof: str) -> FloatArray:
        return self._q[:, self._model.dof_index[dof]]

    def put(
        self,
        values: Mapping[str, FloatArray],
        *,
        points: Mapping[str, FloatArray],
        after: Sequence[str] = (),
    ) -> None:
        """Store DoFs (T,) that follow from `points` (name -> (T, 3), NaN where lost) and from the DoFs `after`.

        They count as missing where one of those is missing, and as implausible outside the model's limits.
        """
        lost = {name: np.asarray(np.isnan(place).any(axis=1)) for name, place in points.items()}
        for dof, value in values.items():
            column = self._model.dof_index[dof]
            known = [dof in missing or dof in doubted for missing, doubted in zip(*self._books, strict=True)]
            self._q[:, column] = np.where(known, np.nan, value)
            for name, where in lost.items():
                self.lose(where, (dof,), f"the point {name} is lost")
            for earlier in after:
                self.lose(np.isnan(self[earlier]), (dof,), f"it builds on {earlier}, which is not determined")
            self.doubt(np.isnan(self._q[:, column]), (dof,), "points that should be apart coincide")
            lower, upper = self._model.lower[column], self._model.upper[column]
            with np.errstate(invalid="ignore"):
                outside = (value < lower - 1e-9) | (value > upper + 1e-9)
            self.doubt(outside, (dof,), f"{{:.3f}} is outside the limits {lower:.3f} to {upper:.3f}", value)

    def lose(self, where: NDArray[np.bool_], dofs: Sequence[str], reason: str) -> None:
        """Mark DoFs as missing in the frames `where` (T,), unless something is known against them already."""
        self._mark(self._missing, where, dofs, reason, None)

    def doubt(
        self, where: NDArray[np.bool_], dofs: Sequence[str], reason: str, value: FloatArray | None = None
    ) -> None:
        """Mark DoFs as implausible likewise; `{...}` in the reason is filled with the frame's `value` (T,)."""
        self._mark(self._implausible, where, dofs, reason, value)

    def result(self) -> KinectPostures:
        """Return everything found."""
        return KinectPostures(self._q, tuple(self._missing), tuple(self._implausible))

    def _mark(
        self,
        book: list[dict[str, str]],
        where: NDArray[np.bool_],
        dofs: Sequence[str],
        reason: str,
        value: FloatArray | None,
    ) -> None:
        for frame in np.flatnonzero(where):
            for dof in dofs:
                if not any(dof in pages[frame] for pages in self._books):
                    book[frame][dof] = reason if value is None else reason.format(value[frame])
                    self._q[frame, self._model.dof_index[dof]] = np.nan
