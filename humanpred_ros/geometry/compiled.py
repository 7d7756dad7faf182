"""How inner loops are compiled: numba's options, where compiled functions are kept, and how compiling is announced.

Compiled functions are kept in the user's cache folder, one folder per source file, named after the contents of that
file and of all compiling files that it imports from. So an edit recompiles what it touches and nothing else. Numba
alone would keep them beside the sources, where they outlive an uninstallation, and it looks only at the file that a
function stands in: a function that uses an edited one from another file would not be compiled anew.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numba
from numba.core import event
from numpy.typing import NDArray

from humanpred_ros.resources import PACKAGE_NAME, cache_root

F = TypeVar("F", bound=Callable[..., Any])
#: What compiled functions take where the kind of number does not matter.
Array: TypeAlias = NDArray[Any]

# Untyped on purpose: numba's own annotations differ from release to release, and its settings are made as it is loaded.
_njit: Any = numba.njit
_settings: Any = numba.config

#: Every file that compiles has the first of these lines; what it compiles uses nothing of other files but of those that
#: have one of them (tested).
MARK = f"from {PACKAGE_NAME}.geometry.compiled import"
MARKS = (MARK, "# Compiled functions use these constants.")
_IMPORT = re.compile(rf"^from {PACKAGE_NAME}\.?([\w.]*) import (\([^)]*\)|.*)$", re.MULTILINE)
#: Folders that nobody has used for so long are removed, s.
_UNUSED_S = 30 * 24 * 3600.0


def fast(function: F) -> F:
    """Compile for throughput: sums may be reordered and vectorised, values must be finite."""
    return _kernel(function, fastmath=True)


def exact(function: F) -> F:
    """Compile with the arithmetic as written, infinities included."""
    return _kernel(function)


def fast_part(function: F) -> F:
    """Compile, like `fast`, what only other compiled functions call: half the work of compiling a function."""
    return cast(F, Part(function, fastmath=True))


def exact_part(function: F) -> F:
    """Compile, like `exact`, what only other compiled functions call: half the work of compiling a function."""
    return cast(F, Part(function))


def fast_inline(function: F) -> F:
    """Like `fast`, and pasted into compiled callers: for what one kernel calls in one place, or has constants for."""
    return _kernel(function, fastmath=True, inline="always")


#: Without Python's lock, so that goals planned in threads run side by side; nothing in C or Python needs to call parts.
_OPTIONS = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}


def _kernel(function: F, **options: Any) -> F:
    """Compile a function that Python calls; kept on disk, so that only the first process on a machine waits for it."""
    with _own_cache(function):
        return cast(F, _njit(cache=True, **_OPTIONS, **options)(function))


class Part:
    """A compiled part of kernels: it has no entry for Python and is kept with the kernels that it is part of.

    Python that calls it runs its source, uncompiled.
    """

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        self.py_func = function
        self.dispatcher = _njit(no_cpython_wrapper=True, **_OPTIONS, **options)(function)

    @property
    def _numba_type_(self) -> Any:
        return self.dispatcher._numba_type_

    def __call__(self, *args: Any) -> Any:
        return self.py_func(*args)


@contextlib.contextmanager
def announced(what: str, announce: Callable[[str], None]) -> Iterator[None]:
    """Say it if anything has to be compiled meanwhile: one line as it begins, one when it is done, with times.

    Args:
        what: what is made ready, for the message ("the planner").
        announce: takes the lines, such as a logger's `info`.
    """
    listener = _Listener(what, announce)
    try:
        with event.install_listener("numba:compile", listener):
            yield
    finally:
        if listener.collecting:
            gc.enable()
    if listener.began is not None:
        wall_s, processor_s = (now - before for now, before in zip(_clocks(), listener.began, strict=True))
        announce(f"{what}: compiled in {wall_s:.0f} s ({processor_s:.1f} s of processor time)")


def _clocks() -> tuple[float, float]:
    return time.monotonic(), time.process_time()


class _Listener(event.Listener):
    def __init__(self, what: str, announce: Callable[[str], None]) -> None:
        self.what, self.announce = what, announce
        self.began: tuple[float, float] | None = None
        self.collecting = False

    def on_start(self, event: Any) -> None:
        if self.began is None:
            self.began = _clocks()
            # A compiler makes many objects and little garbage: looking for it takes a tenth of the time.
            self.collecting = gc.isenabled()
            gc.disable()
            where = cache_root() or "beside its sources"
            self.announce(
                f"{self.what}: compiling its inner loops for this processor, which takes some ten seconds and is done "
                f"once (kept: {where})"
            )

    def on_end(self, event: Any) -> None:
        pass


@contextlib.contextmanager
def _own_cache(function: Callable[..., Any]) -> Iterator[None]:
    """While a function is decorated, let numba keep it in this package's folder; other packages keep their own."""
    before = _settings.CACHE_DIR
    _settings.CACHE_DIR = cache_folder(Path(function.__code__.co_filename))
    try:
        yield
    finally:
        _settings.CACHE_DIR = before


@cache
def cache_folder(source: Path) -> str:
    """Return the folder for what a source file of this package compiles to.

    Where nothing can be written, it is empty: numba then keeps functions beside their sources after all.
    """
    root = _tidied_root()
    if root is None:
        return ""
    package = Path(__file__).resolve().parent.parent
    folder = root / f"{source.stem}-{source_digest(source.resolve(), package)}"
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    return str(folder)


@lru_cache(maxsize=1)
def _tidied_root() -> Path | None:
    root = cache_root()
    if root is not None and root.is_dir():
        with contextlib.suppress(OSError):
            remove_unused(root, time.time() - _UNUSED_S)
    return root


def source_digest(source: Path, package: Path) -> str:
    """Return a name for the state of a compiling file, of all compiling files it imports from, and of this one."""
    files, waiting = {package / "geometry" / "compiled.py"}, {source}
    while waiting:
        file = waiting.pop()
        files.add(file)
        waiting |= _compiling_imports(file, package) - files
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _compiling_imports(source: Path, package: Path) -> set[Path]:
    found = set()
    for module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
        place = package.joinpath(*module.split("."))
        modules = [place.with_suffix(".py"), *(place / f"{name}.py" for name in re.findall(r"\w+", names))]
        texts = {file: file.read_text(encoding="utf-8") for file in modules if file.is_file()}
        found |= {file for file, text in texts.items() if any(mark in text for mark in MARKS)}
    return found


def remove_unused(root: Path, before_s: float) -> None:
    """Remove the folders below `root` that were last used before a moment, seconds since the epoch."""
    for folder in root.iterdir():
        if folder.is_dir() and folder.stat().st_mtime < before_s:
            shutil.rmtree(folder, ignore_errors=True)
