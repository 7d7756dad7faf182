"""Where the package's own data lie (a checkout, a wheel's prefix, a colcon install space); files written whole."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from humanpred_ros.errors import HumanPredError, UsageError

PACKAGE_NAME = "humanpred_ros"


def share_directory() -> Path:
    """Return the folder that holds config/, urdf/, launch/ and bags/.

    The checkout around this file comes first (editable installs), then the prefix this file was
    installed under, then every prefix ROS or Python knows of.
    """
    package = Path(__file__).resolve().parent
    candidates = [package.parent]
    candidates += [parent / "share" / PACKAGE_NAME for parent in package.parents]
    candidates += [
        Path(prefix) / "share" / PACKAGE_NAME
        for prefix in [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
        if prefix
    ]
    for candidate in candidates:
        if (candidate / "urdf" / "human_kinect12.urdf").is_file():
            return candidate
    raise UsageError(
        f"the data files of {PACKAGE_NAME} (urdf/human_kinect12.urdf) were looked for around {package} and not found; "
        "reinstall the package"
    )


def cache_root() -> Path | None:
    """Return where this package keeps what it can make again: below NUMBA_CACHE_DIR, XDG_CACHE_HOME or ~/.cache.

    None for a user without a home.
    """
    wished = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(wished) if wished else Path.home() / ".cache") / PACKAGE_NAME
    except RuntimeError:
        return None


def share_file(*parts: str) -> Path:
    """Return a file or folder below `share_directory()`; it must exist."""
    path = share_directory().joinpath(*parts)
    if not path.exists():
        raise UsageError(f"wanted the package's own {'/'.join(parts)}, not found under {share_directory()}")
    return path


def locate(name: str, *folder: str, suffix: str = "") -> Path:
    """Return `name` if such a path exists, else the package's own file of that name below `folder`.

    Raises:
        UsageError: neither exists; the message lists the names the package ships.
    """
    # Path("") is the current folder, which nobody means by an empty name.
    if name and Path(name).exists():
        return Path(name)
    home = share_file(*folder)
    shipped = home / f"{name}{suffix}"
    if name and shipped.exists():
        return shipped
    fitting = [entry for entry in home.iterdir() if (entry.name.endswith(suffix) if suffix else entry.is_dir())]
    names = ", ".join(sorted(entry.name.removesuffix(suffix) for entry in fitting))
    raise UsageError(f"{name!r} is neither a path that exists nor a name shipped in {'/'.join(folder)} ({names})")


@contextmanager
def replacing(path: Path, error: type[HumanPredError] = UsageError) -> Iterator[Path]:
    """Give a temporary file to write, in the same folder; it takes the name `path` only if all went well.

    A reader sees the old file or the new one, never a part.

    Raises:
        HumanPredError: of class `error`, where the file cannot be written, as on a full disk.
    """
    name = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)  # mkstemp lets nobody else read
        yield Path(name)
        with open(name, "rb") as written:
            os.fsync(written.fileno())  # some disks say only now that they are full
        os.replace(name, path)
    except OSError as trouble:
        raise error(f"{path}: cannot be written ({trouble.strerror or trouble}); choose another place") from trouble
    finally:
        if name is not None:
            with suppress(OSError):
                os.unlink(name)
