"""Files such as strangers bring: small samples of every kind, and what is done with each to see that nothing breaks."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console

from humanpred_ros import topics
from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.salvage import check_bag, salvage_bag
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import HumanPredError, LibraryFormatError
from humanpred_ros.evaluation.reproduce import planner_parameters
from humanpred_ros.human.marker_skeleton import MarkerSkeleton
from humanpred_ros.human.model import HumanModel, human_with
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.commands import ImportSettings, import_libraries
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary, resample_phase
from humanpred_ros.motion.reach_recordings import write_reach_recording
from humanpred_ros.occupancy.predictor import PredictorRequest, make_predictor
from humanpred_ros.plugins import given_settings
from humanpred_ros.reaching.features import NAMED_WEIGHTS
from humanpred_ros.reaching.weights import ReachWeights, load_weights, save_weights
from humanpred_ros.recognition.forest import ForestSettings
from humanpred_ros.recognition.gmm_classifier import GmmSettings
from humanpred_ros.recognition.training import load_model, save_model, train_model
from humanpred_ros.resources import share_file
from humanpred_ros.robot.scene import load_scene
from humanpred_ros.viewing.analysis import analyse
from humanpred_ros.viewing.key_figures import print_summary
from humanpred_ros.viewing.report import render_report
from humanpred_ros.viewing.run import read_run

_QUIET = Console(file=io.StringIO(), markup=False, emoji=False, width=100)


def make_samples(folder: Path) -> None:
    """Write a sound file or folder of each of `KINDS` below `folder`, each under its kind's name."""
    library = load_library(share_file("bags", "synthetic_reaches"), points=False)
    few = tuple(resample_phase(m, 12) for label in library.labels[:2] for m in library.of_class(label)[:3])
    small = MotionLibrary("few", few, {"source": "a sample"})
    human = human_with(small.dof_names)
    write_library_bag(small, folder / "library" / "few")
    shutil.copytree(folder / "library", folder / "bag")
    (folder / "model").mkdir()
    settings = {"forest": ForestSettings(n_trees=3, n_postures=8), "gmm": GmmSettings(n_components=2, n_phase_frames=8)}
    save_model(train_model(small, human, settings), folder / "model" / "model.npz")
    (folder / "scene").mkdir()
    shutil.copy(share_file("config", "scenes", "four_places.yaml"), folder / "scene")
    (folder / "weights").mkdir()
    weights = next(iter(NAMED_WEIGHTS.values()))
    save_weights(ReachWeights(weights, np.stack([weights, weights]), (), {"by": "hand"}), folder / "weights" / "w.json")
    (folder / "urdf").mkdir()
    (folder / "urdf" / "human.urdf").write_text(human.urdf, encoding="utf-8")
    _write_tables(folder, small)
    _write_run(folder / "run", small.motions[0], human)
    (folder / "setting").mkdir()
    (folder / "setting" / "words.txt").write_text("gmm.evidence=mean", encoding="utf-8")


def _write_tables(folder: Path, library: MotionLibrary) -> None:
    (folder / "table").mkdir()
    for label in library.labels:
        lines = [",".join(("traj_id", "raw_frame", "t_s", *library.dof_names))]
        for motion in library.of_class(label):
            lines += [f"{motion.index},{k},{t!r},{','.join(map(repr, q.tolist()))}"
                      for k, (t, q) in enumerate(zip(motion.t_s.tolist(), motion.q, strict=True))]  # fmt: skip
        (folder / "table" / f"class_{label}.csv").write_text("\n".join(lines), encoding="utf-8")
    skeleton, phase = MarkerSkeleton(), np.linspace(0.0, 1.0, 12)[:, None]
    model = HumanModel.mocap23()
    bones = np.array([0.3 if name.endswith("Trans") else 0.0 for name in model.dof_names])
    middle = np.clip(bones, model.lower, model.upper)
    q = middle + 0.2 * phase * (np.clip(middle + 1.0, model.lower, model.upper) - middle)
    both = [Motion(0.01 * np.arange(12.0), postures, model.dof_names) for postures in (q, middle + 0.1 * (q - middle))]
    (folder / "people").mkdir()
    write_reach_recording(folder / "people", "one", both[0], both[1])
    (folder / "markers").mkdir()
    points, labels = skeleton.points(q), skeleton.markers.names
    titles = ",".join(["time", *(f"{name}_{axis}" for name in labels for axis in "xyz")])
    rows = [",".join(map(repr, [0.01 * k, *frame.ravel().tolist()])) for k, frame in enumerate(points)]
    (folder / "markers" / "take.csv").write_text("\n".join([titles, *rows]), encoding="utf-8")
    trc = ["PathFileType\t4\t(X/Y/Z)\ttake.trc", "DataRate\tNumFrames\tUnits", f"100\t{len(points)}\tm"]
    trc += [
        "Frame#\tTime\t" + "\t\t\t".join(labels),
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(len(labels))),
    ]
    trc += ["\t".join(map(repr, [k + 1, 0.01 * k, *frame.ravel().tolist()])) for k, frame in enumerate(points)]
    (folder / "markers" / "other.trc").write_text("\n".join(trc), encoding="utf-8")
    names = {"units": "m", "axes": ["x", "y", "z"], "rate_hz": 100, "classes": {"take*": 0}, "markers": {"C7": "C7"}}
    (folder / "markers" / "names.yaml").write_text(yaml.safe_dump(names), encoding="utf-8")
    try:
        import ezc3d
    except ImportError:
        return
    content: Any = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    content["parameters"]["POINT"]["LABELS"]["value"] = tuple(labels)
    content["parameters"]["POINT"]["UNITS"]["value"] = ["m"]
    content["data"]["points"] = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2).transpose(2, 1, 0)
    content.write(str(folder / "markers" / "third.c3d"))


def _write_run(folder: Path, motion: Motion, human: HumanModel) -> None:
    scene = load_scene("face_to_face", check=False)
    joints = scene.arm.chain.joint_names
    grid, goal, status = scene.grid, scene.goals[0].name, ros.message_class("diagnostic_msgs/msg/DiagnosticStatus")
    pair, header = ros.message_class("diagnostic_msgs/msg/KeyValue"), ros.header
    facts = {
        "scene": "face_to_face", "library": "few", "trajectory": motion.name, "seed": "0", "period_s": "0.1",
        "mode": "stepped", "predictor": "forecast", "duration_s": repr(motion.duration_s), "set": "[]",
    }  # fmt: skip
    lattice = {"origin_m": grid.origin_m, "resolution_m": grid.resolution_m, "shape": grid.shape}
    body = "/humans/bodies/body_0"
    with BagWriter(folder / "bag") as bag:
        bag.add_metadata("run", facts)
        bag.write_message(f"{body}/urdf", 10**9, ros.string(human.urdf))
        bag.write_message(f"/{topics.VOXEL_GRID}", 10**9, ros.string(json.dumps(lattice)))
        for k, (t_s, q) in enumerate(zip(motion.t_s.tolist(), motion.q, strict=True)):
            stamp = 2 * 10**9 + round(t_s * 1e9)
            bag.write_message(
                f"{body}/joint_states", stamp, ros.joint_state(stamp, motion.dof_names, q, frame_id="lab")
            )
            q_arm = scene.start + 0.01 * k
            bag.write_message(f"/{topics.JOINT_STATES}", stamp, ros.joint_state(stamp, joints, q_arm))
            voxels = grid.centres_m(np.arange(4 * k, 4 * k + 8))
            cloud = {**dict(zip("xyz", voxels.T, strict=True)), "probability": np.full(8, 0.5, np.float32)}
            bag.write_message(f"/{topics.OCCUPANCY}", stamp, ros.point_cloud2(stamp, "world", cloud))
            goals = {axis: np.array([0.5, 0.6]) for axis in "xyz"}
            goals |= {"class_id": np.array([0.0, 1.0]), "probability": np.array([0.4, 0.6])}
            bag.write_message(f"/{topics.HUMAN_GOALS}", stamp, ros.point_cloud2(stamp, "world", goals))
            told = {"step": str(k + 1), "chosen": goal, "reason": "because", "compute_ms": "5.0", "t_switch_s": "0.1"}
            plan = {"selection_cost": "0.5", "iterations": "10", "cost/human_occupancy": "0.1", "valid": "true"}
            statuses = [
                status(level=0, name=name, message=said, hardware_id="",
                       values=[pair(key=key, value=value) for key, value in values.items()])
                for name, said, values in (("planner", "replan", told), (goal, "chosen", plan))
            ]  # fmt: skip
            array = ros.message_class(ros.DIAGNOSTIC_ARRAY)(header=header(stamp, ""), status=statuses)
            bag.write_message(f"/{topics.DECISION}", stamp, array)


# What is done with a file of each kind; each returns or raises HumanPredError.


def _read_scene(folder: Path, out: Path, number: int) -> None:
    load_scene(folder / "four_places.yaml", check=False)


def _read_library(folder: Path, out: Path, number: int) -> None:
    import_libraries(ImportSettings(source=(str(folder / "few"),), out=out, clean=True), _QUIET)


def _read_bag(folder: Path, out: Path, number: int) -> None:
    check_bag(folder / "few")
    salvage_bag(folder / "few", out)
    for _ in BagReader(out).messages():
        pass


def _read_table(folder: Path, out: Path, number: int) -> None:
    import_libraries(ImportSettings(source=(str(folder),), out=out, drop=True), _QUIET)


def _read_people(folder: Path, out: Path, number: int) -> None:
    load_library(folder)


def _read_markers(folder: Path, out: Path, number: int) -> None:
    sources = tuple(str(path) for path in sorted(folder.iterdir()) if path.suffix != ".yaml")
    if not sources:
        raise LibraryFormatError("no file of markers is left")
    source = sources[number % len(sources)]
    import_libraries(ImportSettings(source=(source,), out=out, markers=folder / "names.yaml"), _QUIET)


def _read_model(folder: Path, out: Path, number: int) -> None:
    human = HumanModel.kinect12()
    model = load_model(folder / "model.npz", human)
    grid = load_scene("four_places", check=False).grid
    motion = model.library.motions[0]
    for name, classifier in (("forecast", "forest"), ("swept_volume", "gmm")):
        if classifier in model.classifiers:
            predictor = make_predictor(name, PredictorRequest(human, grid, np.eye(4), model, classifier))
            for k in range(3):
                predictor.update(np.clip(motion.q[k % len(motion)], human.lower, human.upper), 0.1 * k)


def _read_weights(folder: Path, out: Path, number: int) -> None:
    load_weights(folder / "w.json")


def _read_urdf(folder: Path, out: Path, number: int) -> None:
    model = HumanModel.from_urdf(folder / "human.urdf")
    model.surface_points(np.clip(np.zeros(len(model.dof_names)), model.lower, model.upper), 0.05)


def _read_run(folder: Path, out: Path, number: int) -> None:
    try:
        planner_parameters(folder, BagReader(folder / "bag").metadata.get("run", {}))
    finally:
        analysis = analyse(read_run(folder))
        print_summary(analysis.summary, _QUIET)
        if number % 50 == 0:  # plots take seconds
            render_report(analysis)


def _read_setting(folder: Path, out: Path, number: int) -> None:
    path = folder / "words.txt"  # stands for a word of the command line
    given_settings([path.read_text(encoding="utf-8", errors="surrogateescape") if path.is_file() else ""])


#: What is done with a file of each kind: the folder with the sample, a folder to write into that is not there, number.
KINDS: dict[str, Callable[[Path, Path, int], None]] = {
    "scene": _read_scene,
    "library": _read_library,
    "bag": _read_bag,
    "table": _read_table,
    "people": _read_people,
    "markers": _read_markers,
    "model": _read_model,
    "weights": _read_weights,
    "urdf": _read_urdf,
    "run": _read_run,
    "setting": _read_setting,
}


def outcome(kind: str, folder: Path, out: Path, number: int) -> str:
    """Return what reading a damaged file led to: `accepted`, `refused: ERROR`, or `failed: ...`."""
    try:
        KINDS[kind](folder, out, number)
    except HumanPredError as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, MemoryError):
                return f"failed: it took too much memory before it was refused ({error})"
            cause = cause.__cause__
        return f"refused: {type(error).__name__}"
    except MemoryError:
        return "failed: it took too much memory"
    return "accepted"
