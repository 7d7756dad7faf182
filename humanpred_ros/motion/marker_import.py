"""From marker recordings and a file that names the markers to motions of P2's 23-DoF human (P2 IV-B).

The file of names is YAML; everything in it may be left out::

    units: mm                     # m, cm or mm; left out: what C3D and TRC files say, metres for CSV
    axes: [z, x, y]               # the file's axes that point along x, y and z here, z being up; e.g. [x, -z, y]
    rate_hz: 100                  # for CSV files without times; overrules what a file says
    prefix: "P1:"                 # what stands before each label in the files
    markers: {C7: Neck, RH2: R_Index}   # this package's marker: its label in the files, where it differs
    extra:                        # further markers, or the packaged ones on arm, hand at another place
      RFX: {segment: forearm, place_m: [0.0, -0.04, 0.1]}   # in the segment's link, hanging arm
    labels: file                  # or `shape`: the files' labels say nothing
    calibration: static.c3d       # a labelled trial that shows all markers: measures the person's shapes
    classes: {"left_*": screws, "right_*": housing}   # class of the takes whose name fits
    persons:                      # two people; each with prefix, markers, extra and calibration of their own
      active: {prefix: "A:"}      # the person who reaches
      passive: {prefix: "B:"}

Markers are those of `humanpred_ros.human.marker_set.UPPER_BODY`. The anatomical ones (in pairs, on both sides of a
joint) have to be there, the others help to fill gaps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import numpy as np

from humanpred_ros.errors import HumanModelError, LibraryFormatError, MotionError, SettingsError
from humanpred_ros.files import file_inside, read_yaml
from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.marker_labels import find_start, label_markers
from humanpred_ros.human.marker_set import ANATOMICAL, UPPER_BODY, Marker, MarkerSet
from humanpred_ros.human.marker_skeleton import MarkerSkeleton
from humanpred_ros.motion.labels import checked_label
from humanpred_ros.motion.marker_files import MarkerRecording, read_marker_file
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ACTIVE, FRAME_ID, PASSIVE, check_units
from humanpred_ros.settings import Settings, setting

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_AXES = tuple(sign + axis for sign in ("", "-") for axis in "xyz")


class ExtraMarker(Settings):
    """A marker that the packaged set lacks, or has elsewhere."""

    segment: Literal["waist", "torso", "shoulder", "upper_arm", "forearm", "hand"] = setting(..., "what it moves with")
    place_m: tuple[float, float, float] = setting(..., "where it is in the segment's link", unit="m")


class PersonNames(Settings):
    """How one person's markers are called."""

    prefix: str = setting("", "what stands before each label in the files")
    markers: dict[str, str] = setting({}, "label in the files of each marker, where it is not the marker's own")
    extra: dict[str, ExtraMarker] = setting({}, "markers that the packaged set lacks or has elsewhere")
    calibration: str | None = setting(None, "file of a labelled trial that shows all markers")


class MarkerNames(PersonNames):
    """A file of names: how the recordings are to be read."""

    units: Literal["m", "cm", "mm"] | None = setting(None, "unit of lengths; none: what the file says, else m")
    axes: tuple[str, str, str] = setting(("x", "y", "z"), "the files' axes that point along x, y and z, z being up")
    rate_hz: float | None = setting(None, "frames per second; none: what the file says", low=1e-3)
    labels: Literal["file", "shape"] = setting("file", "whether labels are the files', or found by shape and distance")
    classes: dict[str, str | int] = setting({}, "class of the takes whose name fits a pattern")
    persons: dict[str, PersonNames] = setting({}, "two people: active and passive")

    def check(self) -> None:
        """Refuse axes that are no right-handed frame, and other people than two."""
        if any(axis not in _AXES for axis in self.axes) or not np.isclose(np.linalg.det(self.rotation), 1.0):
            raise SettingsError(
                f"axes: wanted three of {', '.join(_AXES)} that form a right-handed frame, such as [z, x, y], got "
                f"{list(self.axes)}"
            )
        if self.persons and set(self.persons) != {ACTIVE, PASSIVE}:
            raise SettingsError(
                f"persons: wanted {ACTIVE} (the person who reaches) and {PASSIVE}, got "
                f"{', '.join(self.persons)}; for one person leave `persons` out"
            )
        if self.persons and (self.labels == "shape" or self.markers or self.prefix or self.extra or self.calibration):
            raise SettingsError(
                "persons: wanted prefix, markers, extra and calibration at each person, and labels from the file: "
                "shapes do not distinguish two people"
            )
        for label in self.classes.values():
            checked_label(label, SettingsError)

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) from the files' axes to those here, z up."""
        unit = {axis: np.eye(3)["xyz".index(axis)] for axis in "xyz"}
        return np.stack([(-1.0 if axis[0] == "-" else 1.0) * unit[axis[-1]] for axis in self.axes])


@dataclass(frozen=True)
class Take:
    """A person's motion in one recording."""

    motion: Motion  #: postures of the 23-DoF human
    frames: slice  #: the part of the recording that it covers
    said: str  #: what was done to the markers


def read_names(path: Path) -> MarkerNames:
    """Return the contents of a file of names.

    Raises:
        SettingsError: a file that cannot be read, or with entries that cannot be used, with file and entry.
    """
    content = read_yaml(path, SettingsError)
    try:
        if not isinstance(content, dict):
            raise SettingsError(f"wanted entries such as `markers:`, got {content!r:.60}")
        return MarkerNames(**{str(key): value for key, value in content.items()})
    except SettingsError as trouble:
        raise SettingsError(f"{path}: {trouble}") from trouble


class MarkerReader:
    """Reads takes of one person.

    Args:
        names: of the recordings.
        person: of the person's markers; `names` itself for a person alone.
        folder: where the calibration is looked for.
        longest_gap_s, upright_pelvis: as of `MarkerSkeleton`.

    Raises:
        SettingsError: names of markers that do not exist.
        LibraryFormatError, MotionError: a calibration that cannot be used.
    """

    def __init__(
        self, names: MarkerNames, person: PersonNames, folder: Path, longest_gap_s: float, upright_pelvis: bool
    ) -> None:
        self._names, self._person, self._longest_gap_s, self._upright = names, person, longest_gap_s, upright_pelvis
        all_markers = {marker.name: marker for marker in UPPER_BODY}
        all_markers |= {name: Marker(name, extra.segment, extra.place_m) for name, extra in person.extra.items()}
        unknown = sorted(set(person.markers) - set(all_markers))
        if unknown:
            raise SettingsError(
                f"markers: wanted {', '.join(all_markers)}, or markers named in `extra`, got {', '.join(unknown)}"
            )
        self._all = all_markers
        self._shapes: dict[str, FloatArray] | None = None
        if person.calibration is not None:
            trial = read_marker_file(
                file_inside(folder, person.calibration, SettingsError, "calibration"), names.rate_hz
            )
            worn, points = self._labelled(trial)
            try:
                self._shapes = dict(MarkerSkeleton(markers=worn).calibrated(points).shapes or {})
            except (MotionError, HumanModelError) as trouble:
                raise MotionError(f"{trial.path}: {trouble}") from trouble

    def take(self, recording: MarkerRecording, label: str | None, index: int, trim: bool) -> Take:
        """Return the person's motion in a recording.

        Args:
            recording: the take.
            label, index: class and number of the motion.
            trim: leave out frames at the beginning and the end in which the markers do not determine all DoFs.

        Raises:
            LibraryFormatError: markers that the recording lacks.
            MotionError: markers that do not determine all DoFs, or cannot be right; with the file.
        """
        try:
            if self._names.labels == "shape":  # by shape in the first frame, and by closest distance from then on
                worn, seen = MarkerSet(list(self._all.values())), self._in_metres(recording)
                start = find_start(worn, seen[0], self._shapes)
                points = label_markers(worn, list(seen), recording.t_s, start, self._shapes)
            else:
                worn, points = self._labelled(recording)
            skeleton = MarkerSkeleton(None, worn, self._longest_gap_s, self._upright, self._shapes)
            found = skeleton.postures(points, recording.t_s)
            complete = np.flatnonzero(found.complete)
            frames = slice(0, len(points))
            if trim and len(complete):
                frames = slice(int(complete[0]), int(complete[-1]) + 1)
            if not found.complete[frames].all():
                found.require_complete(recording.name)
            t_s, q = recording.t_s[frames], found.q[frames]
            check_units(recording.name, t_s, q, skeleton.model.dof_names)
            motion = Motion(t_s - t_s[0], q, skeleton.model.dof_names, label, index, FRAME_ID)
        except (MotionError, HumanModelError) as trouble:
            raise MotionError(f"{recording.path}: {trouble}") from trouble
        hidden, filled = ~np.isfinite(points).all(axis=2), found.markers
        said = [f"{100 * hidden.mean():.1f} % of the markers hidden"] if hidden.any() else []
        if filled.misplaced.any():
            said.append(f"{100 * filled.misplaced.mean():.1f} % misplaced")
        if frames != slice(0, len(points)):
            said.append(f"frames {frames.start} to {frames.stop - 1} of {len(points)} used")
        lacking = [name for name in self._all if name not in worn.index]
        if lacking:
            said.append(f"without the markers {', '.join(lacking)}")
        return Take(motion, frames, "; ".join(said))

    def _labelled(self, recording: MarkerRecording) -> tuple[MarkerSet, FloatArray]:
        """Return the markers that the recording has by its labels, and where they are (T, M, 3) in metres, z up."""
        needed = {name for pair in ANATOMICAL.values() for name in pair}
        needed |= {*self._person.markers, *self._person.extra}
        labels = {name: self._person.prefix + self._person.markers.get(name, name) for name in self._all}
        lacking = [f"{name} (as {label!r})" for name, label in labels.items()
                   if name in needed and label not in recording.names]  # fmt: skip
        if lacking:
            raise LibraryFormatError(
                f"{recording.path}: wanted the markers {', '.join(lacking)}, the file has {_some(recording.names)}; "
                "state their labels in the file of names (markers, prefix)"
            )
        worn = [name for name, label in labels.items() if label in recording.names]
        for name in worn:
            others = [other for other in worn if labels[other] == labels[name]]
            if len(others) > 1 or recording.names.count(labels[name]) > 1:
                raise LibraryFormatError(
                    f"{recording.path}: wanted one marker labelled {labels[name]!r} for {' and '.join(others)}, got "
                    f"{recording.names.count(labels[name])}; give each marker a label of its own"
                )
        columns = [recording.names.index(labels[name]) for name in worn]
        return MarkerSet([self._all[name] for name in worn]), self._in_metres(recording)[:, columns]

    def _in_metres(self, recording: MarkerRecording) -> FloatArray:
        unit = self._names.units or (recording.unit or "m").strip().lower()
        if unit not in _METRES:
            raise LibraryFormatError(
                f"{recording.path}: wanted lengths in {', '.join(_METRES)}, the file says {recording.unit!r}; "
                "state `units` in the file of names"
            )
        return np.asarray(_METRES[unit] * recording.points @ self._names.rotation.T)


def class_of(name: str, classes: Mapping[str, str | int], path: Path) -> str | None:
    """Return the class of a take by the patterns that its name fits, None if none does.

    Raises:
        SettingsError: it fits patterns of two classes.
    """
    found = sorted({str(label) for pattern, label in classes.items() if fnmatchcase(name, pattern)})
    if len(found) > 1:
        raise SettingsError(f"{path}: wanted one class for {name}, its name fits those of {found}; change `classes`")
    return found[0] if found else None


def _some(names: Sequence[str], most: int = 30) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(repr(name) for name in names[:most]) + more
