"""How inner loops are compiled: one place for numba's options, with types that mypy understands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

from humanpred_ros.geometry.kernel_cache import own_cache

F = TypeVar("F", bound=Callable[..., Any])

# Untyped on purpose: numba's own annotations differ from release to release.
_njit: Any = numba.njit


def fast(function: F) -> F:
    """Compile for throughput: sums may be reordered and vectorised, values must be finite."""
    return _compiled(function, fastmath=True)


def fast_inline(function: F) -> F:
    """Like `fast`, and pasted into its callers, whose constants it then sees."""
    return _compiled(function, fastmath=True, inline="always")


def exact(function: F) -> F:
    """Compile with the arithmetic as written, infinities included."""
    return _compiled(function)


def _compiled(function: F, **options: Any) -> F:
    """Without Python's lock, so that goals planned in threads run side by side; kept on disk, so that only the first
    process on a machine waits for the compiler."""
    with own_cache():
        return cast(F, _njit(nogil=True, error_model="numpy", cache=True, **options)(function))
