"""Where compiled functions are kept: in the user's cache folder, under a name that changes with their sources.

Numba would keep them beside the sources. There they outlive an uninstallation, and a function compiled yesterday goes
on being used although a function or a constant that it has from another file is a different one today: numba looks
only at the file it stands in.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba

from humanpred_ros.resources import PACKAGE_NAME

# Untyped on purpose: numba makes its settings as it is loaded.
_settings: Any = numba.config
#: Every file that compiles has this line, and what it compiles uses nothing of other files that have not (tested).
MARK = f"from {PACKAGE_NAME}.geometry.compiled import"
#: Folders that nobody has used for so long are removed, s.
_UNUSED_S = 30 * 24 * 3600.0


@contextlib.contextmanager
def own_cache() -> Iterator[None]:
    """While a function is decorated, let numba keep it in this package's folder; other packages keep their own."""
    before = _settings.CACHE_DIR
    _settings.CACHE_DIR = cache_folder()
    try:
        yield
    finally:
        _settings.CACHE_DIR = before


@lru_cache(maxsize=1)
def cache_folder() -> str:
    """Return the folder for what these sources compile to, in NUMBA_CACHE_DIR, XDG_CACHE_HOME or ~/.cache.

    Where nothing can be written there, numba keeps functions beside their sources after all.
    """
    root = cache_root()
    if root is None:
        return ""
    folder = root / sources_digest(Path(__file__).resolve().parent.parent)
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        remove_unused(root, time.time() - _UNUSED_S)
    return str(folder)


def sources_digest(package: Path) -> str:
    """Return a name for the state of all files of a package that compile anything, and of how they do."""
    digest = hashlib.sha256((package / "geometry" / "compiled.py").read_bytes())
    for source in sorted(package.rglob("*.py")):
        text = source.read_bytes()
        if MARK.encode() in text:
            digest.update(text)
    return digest.hexdigest()[:16]


def remove_unused(root: Path, before_s: float) -> None:
    """Remove the folders below `root` that were last used before a moment, seconds since the epoch."""
    for folder in root.iterdir():
        if folder.is_dir() and folder.stat().st_mtime < before_s:
            shutil.rmtree(folder, ignore_errors=True)


def cache_root() -> Path | None:
    """Return the folder of all versions; None for a user without a home."""
    wished = _settings.CACHE_DIR or os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(wished) if wished else Path.home() / ".cache") / PACKAGE_NAME
    except RuntimeError:
        return None
