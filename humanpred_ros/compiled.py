"""How inner loops are compiled: one place for numba's options, with types that mypy understands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

# Untyped on purpose: numba's own annotations differ from release to release.
_njit: Any = numba.njit
# No Python lock, so that goals planned in threads run side by side; kept on disk, so that only the first
# process on a machine waits for the compiler.
_COMMON = {"nogil": True, "error_model": "numpy", "cache": True}


def fast(function: F) -> F:
    """Compile for throughput: sums may be reordered and vectorised, values must be finite."""
    return cast(F, _njit(fastmath=True, **_COMMON)(function))


def fast_inline(function: F) -> F:
    """Like `fast`, and pasted into its callers, whose constants it then sees."""
    return cast(F, _njit(fastmath=True, inline="always", **_COMMON)(function))


def exact(function: F) -> F:
    """Compile with the arithmetic as written, infinities included."""
    return cast(F, _njit(**_COMMON)(function))
