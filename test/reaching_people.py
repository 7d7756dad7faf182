"""Recordings of two made-up people at a table, for tests that must not need the papers' data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from humanpred_ros.geometry.checks import FloatArray
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import Motion
from humanpred_ros.motion.reach_recordings import ReachRecording

MODEL = HumanModel.mocap23()
#: A person beside a table and where the hand goes, in the order of the DoFs (magnitudes as in P2's recordings).
START = np.array(
    [2.1, 0.75, 1.14, 0, 0, 1.9, 0.0, -0.1, 0.0, 0.07, 0.21, 0.14, -0.7, -0.45, 2.5, 0.40, -1.9, -1.4, -1.0, 0.245,
     0.2, 0.3, 0.0]
)  # fmt: skip
GOAL = np.array(
    [2.05, 0.85, 1.12, 0, 0, 2.2, -0.2, -0.4, 0.2, 0.06, 0.23, 0.12, 0.6, -1.2, 1.2, 0.40, -0.6, -0.9, 0.4, 0.245,
     0.1, 0.1, 0.6]
)  # fmt: skip
PARTNER = np.array(
    [1.4, 0.75, 1.15, 0, 0, 1.6, 0.0, -0.1, 0.0, 0.07, 0.21, 0.14, -0.3, -0.5, 1.5, 0.35, -1.5, -1.2, -0.5, 0.29,
     0.1, 0.2, 0.1]
)  # fmt: skip


def reach(seed: int, n_frames: int = 100, period_s: float = 0.01) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return stamps (n,), postures (n, 23) of who reaches, and of the partner, different for each seed."""
    rng = np.random.default_rng(seed)
    t_s = period_s * np.arange(n_frames)
    phase = np.linspace(0.0, 1.0, n_frames)[:, None]
    done = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
    start, goal = (q + rng.normal(scale=0.02, size=23) for q in (START, GOAL))
    bow = rng.normal(scale=0.05, size=23) * np.sin(np.pi * phase)
    partner = PARTNER + rng.normal(scale=0.02, size=23) + 0.02 * np.sin(3.0 * phase)
    return t_s, start + done * (goal - start) + bow, partner


def recording(seed: int, n_frames: int = 100) -> ReachRecording:
    t_s, active, passive = reach(seed, n_frames)
    motions = (Motion(t_s, q, MODEL.dof_names, frame_id="mocap") for q in (active, passive))
    return ReachRecording(f"made_up_{seed}", *motions)


def write_csv(path: Path, t_s: FloatArray, q: FloatArray, names: tuple[str, ...] = MODEL.dof_names) -> None:
    lines = [",".join(("t", *names))]
    lines += [",".join(repr(float(value)) for value in (t, *row)) for t, row in zip(t_s, q, strict=True)]
    path.write_text("\n".join(lines) + "\n")


def write_recording(folder: Path, name: str, seed: int, n_frames: int = 100) -> None:
    t_s, active, passive = reach(seed, n_frames)
    write_csv(folder / f"{name}_active.csv", t_s, active)
    write_csv(folder / f"{name}_passive.csv", t_s, passive)
