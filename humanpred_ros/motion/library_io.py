"""One way to load a motion library, whatever form it is stored in."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

from humanpred_ros.errors import LibraryFormatError
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.bag_library import read_library_bag
from humanpred_ros.motion.csv_library import DEFAULT_FRAME_PERIOD_S, class_files, read_csv_library
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.motion.reach_recordings import ACTIVE, FRAME_ID, load_reach_recordings


def load_library(path: str | Path, *, frame_period_s: float = DEFAULT_FRAME_PERIOD_S) -> MotionLibrary:
    """Return all motions of a folder of CSV files, a rosbag2 directory, or an .mcap file; drops nothing.

    Class files hold the 12 DoFs of a Kinect's human or the 23 of motion capture's; their columns say which. Of a folder
    of two-person recordings (`reach_recordings`) the library is what the reaching people did, without classes.

    Args:
        path: the library.
        frame_period_s: seconds between frames where a CSV library has no stamps; bags have them.

    Raises:
        LibraryFormatError: nothing of that name, nothing of these kinds, or unusable CSV.
        MotionError: recordings of two people that cannot be used.
        BagError: unusable bag.
    """
    path = Path(path)
    if not path.exists():
        raise LibraryFormatError(f"{path}: wanted a motion library (CSV folder or bag), there is nothing of that name")
    if path.is_dir() and (files := class_files(path)):
        human = HumanModel.mocap23()
        if _columns(next(iter(files.values()))).issuperset(human.dof_names):
            return read_csv_library(path, frame_period_s=frame_period_s, dof_names=human.dof_names, frame_id=FRAME_ID)
        return read_csv_library(path, frame_period_s=frame_period_s)
    if path.suffix in (".mcap", ".db3") or (path / "metadata.yaml").exists() or any(path.glob("*.mcap")):
        return read_library_bag(path)
    if any(path.glob(f"*_{ACTIVE}.csv")):
        return _reaching_people(path)
    raise LibraryFormatError(
        f"{path}: wanted a folder with class_<k>.csv or <name>_{ACTIVE}.csv files, a rosbag2 directory, or an .mcap "
        "file, got none of these"
    )


def _columns(path: Path) -> set[str]:
    """Return the titles in a file's first line; what is wrong with it is for the reader to say."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            return {title.strip() for title in next(csv.reader(stream), [])}
    except (OSError, UnicodeDecodeError, csv.Error):
        return set()


def _reaching_people(folder: Path) -> MotionLibrary:
    recordings = load_reach_recordings(folder)
    motions = tuple(replace(recording.active, index=k) for k, recording in enumerate(recordings))
    name = folder.resolve().name
    provenance = {
        "format": "two-person recordings",
        "source": name,
        "stamps": "recorded",
        "recordings": "; ".join(f"{m.name} is {r.name}" for m, r in zip(motions, recordings, strict=True)),
    }
    if doubtful := [recording.unfit for recording in recordings if recording.unfit]:
        provenance["doubtful"] = "; ".join(doubtful)
    return MotionLibrary(name, motions, provenance)
