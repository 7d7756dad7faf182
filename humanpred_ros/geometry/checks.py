"""Checks of arrays at the public boundary: one place, one wording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from humanpred_ros.errors import ArrayError

FloatArray = NDArray[np.float64]


def checked(
    name: str,
    value: ArrayLike,
    shape: Sequence[int | str],
    *,
    finite: bool = True,
    error: type[Exception] = ArrayError,
) -> FloatArray:
    """Return `value` as a float64 array after checking its shape and that it is finite.

    Args:
        name: the argument's name as the caller knows it, for the message.
        value: anything NumPy can turn into a float array.
        shape: expected shape; a string stands for any length (`("T", 12)`).
        finite: refuse NaN and infinity.
        error: the class raised.

    Raises:
        error: with what was wanted and what came.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as trouble:
        raise error(f"{name}: wanted numbers of shape {_spell(shape)}, got {value!r:.80}") from trouble
    if array.ndim != len(shape) or any(
        isinstance(want, int) and want != got for want, got in zip(shape, array.shape, strict=False)
    ):
        raise error(f"{name}: wanted shape {_spell(shape)}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise error(f"{name}: wanted finite numbers, got {array[where]} at index {where}; clean or drop it first")
    return array


def frozen(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a read-only copy of `array`, so that shared data cannot be changed by accident."""
    copy = np.array(array)
    copy.setflags(write=False)
    return copy


def _spell(shape: Sequence[int | str]) -> str:
    inside = ", ".join(str(part) for part in shape)
    return f"({inside},)" if len(shape) == 1 else f"({inside})"
