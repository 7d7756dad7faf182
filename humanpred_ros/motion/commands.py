"""The commands `humanpred import` and `humanpred generate`."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.human.marker_skeleton import LONGEST_GAP_S
from humanpred_ros.human.model import MOCAP23_DOFS, HumanModel, name_of_human
from humanpred_ros.human.skeletons import load_skeleton, pose_of
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.cleaning import clean_library, flag_library
from humanpred_ros.motion.csv_files import UNITS
from humanpred_ros.motion.library_io import DEFAULT_FRAME_PERIOD_S, load_library
from humanpred_ros.motion.marker_files import SUFFIXES, MarkerRecording, read_marker_file
from humanpred_ros.motion.marker_import import MarkerReader, class_of, read_names
from humanpred_ros.motion.motion import Motion, MotionLibrary, is_angle, require_plain_name
from humanpred_ros.motion.reach_recordings import (
    ACTIVE,
    PASSIVE,
    check_units,
    read_reach_recording,
    write_reach_recording,
)
from humanpred_ros.motion.synthetic import ReachGeneratorConfig, generate_library
from humanpred_ros.motion.tracker_recordings import read_tracker_recording
from humanpred_ros.settings import LARGEST_SEED, Settings, setting, setting_of


class ImportSettings(Settings):
    """Settings of `humanpred import`."""

    source: tuple[str, ...] = setting(
        ...,
        "motion libraries: folders of class_<k>.csv files or of two-person recordings, bags; with --markers: C3D, TRC "
        "or CSV files of markers, or folders of them",
        positional=True,
    )
    out: Path = setting(..., "folder that gets a folder for each library")
    overwrite: bool = setting(False, "replace what exists")
    show_flags: bool = setting(False, "print everything that looks suspicious")
    clean: bool = setting(False, "unwrap angles; without it everything is kept as it is")
    drop: bool = setting(False, "clean, and leave out motions that jump or are mislabelled")
    frame_period: float = setting(
        DEFAULT_FRAME_PERIOD_S, "time between frames where a CSV library has no times", unit="s", low=1e-6
    )
    body: str | None = setting(None, "body to read of a bag that holds several; none: the only one, or body_0")
    units: str = setting("m,rad", "of the source's lengths and angles, as mm,deg; of markers and points by themselves")
    dry_run: bool = setting(False, "tell what would be written, and write nothing")
    skeleton: str | None = setting(
        None, "the sources are bags of a body tracker's points: a name in config/skeletons, or a YAML file"
    )
    topic: str | None = setting(None, "with --skeleton: of the points; none: the only one that holds points")
    tracker_pose: str = setting("", "with --skeleton: 'x y z roll pitch yaw' of the tracker (m, rad), x forward, z up")
    markers: Path | None = setting(None, "YAML file that names the markers: the sources are marker recordings")
    name: str | None = setting(None, "with --markers: name of the library; none: that of the YAML file")
    longest_gap: float = setting(LONGEST_GAP_S, "gaps up to this long are interpolated in time", unit="s", low=0.0)
    upright_pelvis: bool = setting(False, "take PelvisRotX and PelvisRotY as 0, as P2's recordings do")
    trim: bool = setting(False, "leave out first and last frames in which the markers do not determine all DoFs")


def import_libraries(settings: ImportSettings, console: Console) -> int:
    """Turn motion libraries, or recordings of markers, into MCAP bags.

    A motion library becomes the bag `OUT/<name>`. With `--markers NAMES.yaml` the sources are recordings of markers,
    one take each, and NAMES.yaml says which marker of the files is which (`humanpred_ros.motion.marker_import` has the
    format). As in P2 IV-B, joint centres are the middles of pairs of markers, and a posture has 23 DoFs: pelvis, torso
    and right arm.

    - One person: the bag `OUT/<name>` holds a motion for each take, to train on, replay and predict. Classes come from
      the takes' names (`classes: {"left_*": screws}`).
    - Two people (`persons: {active: ..., passive: ...}`): `OUT/<name>` gets `<take>_active.csv` and
      `<take>_passive.csv`, the form that `evaluate reaching` and the reach predictor learn from.

    Gaps: three markers of a segment determine the fourth; what is still hidden is interpolated for up to
    `--longest-gap`; a longer gap is an error that names take, segment and frames, unless it is at the beginning or the
    end and `--trim` is given. A marker that does not fit its segment's shape counts as hidden. Two labels that are
    exchanged, and lengths in another unit, are errors. Unlabelled recordings (`labels: shape`) are labelled by the
    shapes of the segments in the first frame and by closest distance from then on.

    With `--skeleton NAME` the sources are bags of a body tracker's points (MarkerArray, PoseArray, PointCloud2;
    docs/trackers.md): each piece without a pause becomes a motion without a label.

    What was recognised, assumed, converted and left out is told, with `--dry-run` before anything is written. Values
    that cannot be metres and radians are refused with the factor that would make them so (`--units mm,deg`).

    Nothing is written unless every source can be read, and nothing that exists is replaced without `--overwrite`.
    """
    if settings.markers is not None:
        return _import_markers(settings, settings.markers, console)
    factors = _factors(settings.units)
    libraries = [(source, _in_si(_read(settings, source), *factors)) for source in settings.source]
    for source, library in libraries:
        require_units(library, source)
    _require_different({source: library.name for source, library in libraries})
    for source, library in libraries:
        _write(source, library, settings, console)
    return 0


def _write(source: str, library: MotionLibrary, settings: ImportSettings, console: Console) -> None:
    flags = flag_library(library)
    for reason, count in Counter(flag.reason for flag in flags).items():
        console.print(f"{source}: {count} flagged {reason}", markup=False, highlight=False)
    if settings.show_flags:
        for flag in flags:
            console.print(f"  {flag}", markup=False, highlight=False)
    if settings.clean or settings.drop:
        library = clean_library(library, drop=settings.drop)
    for said in told(library):
        console.print(f"{source}: {said}", markup=False, highlight=False, soft_wrap=True)
    folder = settings.out / require_plain_name(source, library.name)
    if settings.dry_run:
        human, rate_hz = name_of_human(library.dof_names), 1.0 / np.median([motion.period_s for motion in library])
        console.print(
            f"{source} would become {folder}: {len(library)} motions of {len(library.labels)} classes, "
            f"{human}, {rate_hz:.3g} frames a second",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
        return
    bag = write_library_bag(library, folder, overwrite=settings.overwrite)
    console.print(f"{source} -> {bag}: {len(library)} motions", markup=False, highlight=False, soft_wrap=True)


def _read(settings: ImportSettings, source: str) -> MotionLibrary:
    if settings.skeleton is None:
        return load_library(source, frame_period_s=settings.frame_period, body=settings.body)
    skeleton, pose = load_skeleton(settings.skeleton), pose_of(settings.tracker_pose)
    if skeleton.centred and not settings.tracker_pose:
        raise UsageError(f"--tracker-pose: wanted where the person stands: points of {settings.skeleton} are about the "
                         "body's own middle")  # fmt: skip
    return read_tracker_recording(source, skeleton, pose, settings.topic)


def told(library: MotionLibrary) -> list[str]:
    """Return what a user must know of how a library was read: what was left out, and what was assumed."""
    said = [f"left out: {library.provenance['left out']}"] if "left out" in library.provenance else []
    if "people" in library.provenance:
        said.append(f"people: {library.provenance['people']}")
    if "columns not read" in library.provenance:
        said.append(f"columns not read: {library.provenance['columns not read']}")
    stamps = library.provenance.get("stamps", "")
    if stamps.startswith("assumed") or "; some files assumed" in stamps:
        said.append(f"stamps {stamps} (--frame-period)")
    elif stamps.startswith("log times"):
        said.append(f"stamps are {stamps}")
    return said


def require_units(library: MotionLibrary, source: str) -> None:
    """Refuse a library whose numbers cannot be metres, radians and seconds.

    Raises:
        MotionError: with the factor that would make them so.
    """
    bones = len(library.dof_names) == len(MOCAP23_DOFS)
    for motion in library:
        check_units(f"{source}: motion {motion.name}", motion.t_s, motion.q, library.dof_names, bones)


def _factors(units: str) -> tuple[float, float]:
    """Return what the units of lengths and angles are of metres and radians."""
    lengths, angles = ("m", "cm", "mm"), ("rad", "deg")
    given = [word.strip() for word in units.split(",") if word.strip()]
    strange = [word for word in given if word not in (*lengths, *angles)]
    if strange or sum(word in lengths for word in given) > 1 or sum(word in angles for word in given) > 1:
        raise UsageError(f"--units: wanted one of {', '.join(lengths)} and one of {', '.join(angles)}, got {units!r}")
    length, angle = (next((UNITS[word] for word in given if word in which), 1.0) for which in (lengths, angles))
    return length, angle


def _in_si(library: MotionLibrary, length: float, angle: float) -> MotionLibrary:
    if length == angle == 1.0:
        return library
    factor = np.array([angle if is_angle(name) else length for name in library.dof_names])
    motions = tuple(replace(m, q=m.q * factor, points_m=None) for m in library)
    provenance = {**library.provenance, "converted": f"lengths by {length:g}, angles by {angle:g}"}
    return replace(library, motions=motions, provenance=provenance)


def _import_markers(settings: ImportSettings, names_file: Path, console: Console) -> int:
    names = read_names(names_file)
    name = require_plain_name(str(names_file), settings.name or names_file.stem)
    files = _marker_files(settings.source)
    _require_different({str(path): path.stem for path in files})
    roles = names.persons or {"": names}
    filling = settings.longest_gap, settings.upright_pelvis
    readers = {role: MarkerReader(names, person, names_file.parent, *filling) for role, person in roles.items()}
    recordings = [read_marker_file(path, names.rate_hz) for path in files]
    if names.persons:
        return _write_two_people(settings, name, readers, recordings, console)
    motions: list[Motion] = []
    for recording in recordings:
        label = class_of(recording.name, names.classes, names_file)
        index = sum(motion.label == label for motion in motions)
        take = readers[""].take(recording, label, index, settings.trim)
        _say(console, f"{recording.name} is {take.motion.name}", len(take.motion), take.said)
        motions.append(take.motion)
    provenance = {
        "format": "markers",
        "source": names_file.name,
        "stamps": "recorded",
        "takes": "; ".join(f"{m.name} is {r.name}" for m, r in zip(motions, recordings, strict=True)),
    }
    _write(names_file.name, MotionLibrary(name, tuple(motions), provenance), settings, console)
    return 0


def _write_two_people(
    settings: ImportSettings,
    name: str,
    readers: dict[str, MarkerReader],
    recordings: list[MarkerRecording],
    console: Console,
) -> int:
    folder = settings.out / name
    names = [require_plain_name(str(recording.path), recording.name) for recording in recordings]
    existing = [path for take in names for role in (ACTIVE, PASSIVE)
                if os.path.lexists(path := folder / f"{take}_{role}.csv")]  # fmt: skip
    if existing and not settings.overwrite:
        raise UsageError(f"{existing[0]}: wanted a new file, this one exists; choose another --out or --overwrite")
    settings.out.mkdir(parents=True, exist_ok=True)
    # Everything is written beside the folder and read again before anything in the folder is replaced.
    with tempfile.TemporaryDirectory(prefix=".import-", dir=settings.out) as place:
        for recording in recordings:
            takes = {role: reader.take(recording, None, 0, settings.trim) for role, reader in readers.items()}
            begin = max(take.frames.start for take in takes.values())
            end = min(take.frames.stop for take in takes.values())
            if end - begin < 2:
                raise LibraryFormatError(f"{recording.path}: wanted frames that show both people, got {end - begin}")
            both: list[Motion] = []
            for take in (takes[ACTIVE], takes[PASSIVE]):
                part, motion = slice(begin - take.frames.start, end - take.frames.start), take.motion
                both.append(replace(motion, t_s=motion.t_s[part] - motion.t_s[part.start], q=motion.q[part]))
            files = write_reach_recording(Path(place), recording.name, *both)
            found = read_reach_recording(recording.name, *files, HumanModel.mocap23())
            said = [f"{role}: {take.said}" for role, take in takes.items() if take.said]
            _say(console, recording.name, end - begin, "; ".join([*said, *found.notes]))
        folder.mkdir(exist_ok=True)
        for path in Path(place).iterdir():
            path.replace(folder / path.name)
    console.print(f"{settings.markers} -> {folder}: {len(names)} recordings of two people", markup=False,
                  highlight=False, soft_wrap=True)  # fmt: skip
    return 0


def _marker_files(sources: tuple[str, ...]) -> list[Path]:
    files: list[Path] = []
    for source in map(Path, sources):
        inside = source.iterdir() if source.is_dir() else [source]
        found = sorted(path for path in inside if path.suffix.lower() in SUFFIXES or not source.is_dir())
        if not found:
            raise LibraryFormatError(f"{source}: wanted files of markers ({', '.join(SUFFIXES)}), found none")
        files += found
    return files


def _require_different(names: dict[str, str]) -> None:
    """Refuse two sources of one name: one would replace the other."""
    for name in names.values():
        others = [other for other in names if names[other] == name]
        if len(others) > 1:
            raise UsageError(
                f"{' and '.join(others)}: wanted sources of different names, both are named {name}; import them into "
                "different folders"
            )


def _say(console: Console, what: str, frames: int, said: str) -> None:
    more = f"; {said}" if said else ""
    console.print(f"  {what}: {frames} frames{more}", markup=False, highlight=False, soft_wrap=True)


class GenerateSettings(Settings):
    """Settings of `humanpred generate`."""

    out: Path = setting(..., "bag to write")
    motions: int = setting_of(ReachGeneratorConfig, "motions_per_class", description="motions per class")
    seed: int = setting(0, "of all random draws", low=0, high=LARGEST_SEED)
    overwrite: bool = setting(False, "replace a bag that exists")


def generate(settings: GenerateSettings, console: Console) -> int:
    """Make a synthetic motion library by simulation."""
    config = ReachGeneratorConfig(motions_per_class=settings.motions, name=settings.out.name)
    with console.status(f"generating {settings.motions} motions per class"):
        library = generate_library(config, np.random.default_rng(settings.seed))
    write_library_bag(library, settings.out, overwrite=settings.overwrite)
    console.print(f"{settings.out}: {len(library)} motions, seed {settings.seed}")
    return 0
