"""Writes motion libraries as class files, for tests that read such files."""

from __future__ import annotations

from pathlib import Path

from humanpred_ros.motion.motion import MotionLibrary


def write_csv_library(library: MotionLibrary, folder: str | Path) -> None:
    """Write `class_<k>.csv` files with stamps; reading them gives the same numbers, ordered by class."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    header = ",".join(("traj_id", "frame", "t_s", *library.dof_names))
    for label in library.labels:
        lines = [header]
        for motion in (m for m in library if m.label == label):
            for frame, (t, posture) in enumerate(zip(motion.t_s - motion.t_s[0], motion.q, strict=True)):
                # repr of a float is the shortest text that reads back as the same number.
                lines.append(f"{motion.index},{frame}," + ",".join(repr(float(value)) for value in (t, *posture)))
        (folder / f"class_{label}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
