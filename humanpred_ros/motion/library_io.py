"""One way to load a motion library, whatever form it is stored in."""

from __future__ import annotations

from pathlib import Path

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.motion.bag_library import read_library_bag, write_library_bag
from humanpred_ros.motion.csv_library import DEFAULT_FRAME_PERIOD_S, class_files, read_csv_library
from humanpred_ros.motion.motion import MotionLibrary


def load_library(path: str | Path, *, frame_period_s: float = DEFAULT_FRAME_PERIOD_S) -> MotionLibrary:
    """Return all motions of a folder of class CSV files, a rosbag2 directory, or an .mcap file; drops nothing.

    Args:
        path: the library.
        frame_period_s: seconds between frames where a CSV library has no stamps; bags have them.

    Raises:
        LibraryFormatError: nothing of that name, nothing of these three kinds, or unusable CSV.
        BagError: unusable bag.
    """
    path = Path(path)
    if not path.exists():
        raise LibraryFormatError(f"{path}: wanted a motion library (CSV folder or bag), there is nothing of that name")
    if path.is_dir() and class_files(path):
        return read_csv_library(path, frame_period_s=frame_period_s)
    if path.suffix in (".mcap", ".db3") or (path / "metadata.yaml").exists() or any(path.glob("*.mcap")):
        return read_library_bag(path)
    raise LibraryFormatError(
        f"{path}: wanted a folder with class_<k>.csv files, a rosbag2 directory, or an .mcap file, got none of these"
    )


def import_library(
    source: str | Path,
    out: str | Path,
    *,
    frame_period_s: float = DEFAULT_FRAME_PERIOD_S,
    overwrite: bool = False,
) -> Path:
    """Write the library at `source` as the bag `<out>/<library name>/` and return that folder.

    Raises:
        LibraryFormatError, BagError: as `load_library`; or the bag exists and `overwrite` is not given.
    """
    library = load_library(source, frame_period_s=frame_period_s)
    return write_library_bag(library, Path(out) / library.name, overwrite=overwrite)
