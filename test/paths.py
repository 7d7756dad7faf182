"""Where tests find the papers' recordings, which are read in place and never copied here."""

from __future__ import annotations

from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


def shared_data(name: str) -> Path:
    """Return `../shared/data/<name>`, or skip the calling test with a reason."""
    path = REPOSITORY.parent / "shared" / "data" / name
    if not path.exists():
        pytest.skip(f"needs the papers' recordings at ../shared/data/{name}")
    return path
