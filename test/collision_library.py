"""coal, pinocchio's collision library, under the name it has with the installed pinocchio."""

from __future__ import annotations

from typing import Any

coal: Any
try:
    import coal  # type: ignore[no-redef]

    Transform = coal.Transform3s
except ImportError:  # before pinocchio 3.3
    import hppfcl as coal  # type: ignore[no-redef]

    Transform = coal.Transform3f
