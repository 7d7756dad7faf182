"""Files such as strangers bring, small samples of every kind, and what is done to them to see that nothing breaks.

A case is known by its seed and number: it gives the same file again. Damage is of two sorts: of the bytes (cut off,
flipped, spliced, numbers replaced), and of what they say, written as a sound file (huge, negative and missing values,
names that lead elsewhere, other types, doubled or exchanged entries).
"""

from __future__ import annotations

import io
import json
import shutil
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.writer import CompressionType, Writer
from numpy.random import Generator
from rich.console import Console

from humanpred_ros import topics
from humanpred_ros.bags import messages as ros
from humanpred_ros.bags.reader import BagReader
from humanpred_ros.bags.salvage import check_bag, salvage_bag
from humanpred_ros.bags.writer import BagWriter
from humanpred_ros.errors import HumanPredError, LibraryFormatError
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

#: Where a name inside a file would write if it were followed, seen from the folder of a case.
ESCAPE = "escaped"
_NUMBERS: tuple[Any, ...] = (
    0, -1, 1e308, -1e308, 5e-324, float("inf"), float("nan"), 2**31, 2**63, -(2**63), 2**64, 10**15, 10**30, 1e12, 0.1,
)  # fmt: skip
_TEXTS: tuple[str, ...] = (
    "", " ", ".", "..", f"../{ESCAPE}", f"../../{ESCAPE}", f"/{ESCAPE}", "a/b", "CON", "-x", "\0", "\x1b[31m\n",
    "[red]", "[/nope]", "$x^$", "{{ 7 }}", "<b>", "%s%n", "no", "2024-01-01", "NaN", "1e999", "9" * 5000, "[" * 3000,
    "x" * 70000, "!!python/object/apply:os.system [true]", "&a [*a]", "\u202e", "\xed\xa0\x80", "/dev/zero",
    "{'a': 1}", "true", "null", "-inf",
)  # fmt: skip
_VALUES: tuple[Any, ...] = (*_NUMBERS, *_TEXTS, None, True, [], {}, [[]], {"a": {}}, [0] * 100)
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
    from humanpred_ros.evaluation.reproduce import planner_parameters

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


def damaged(sample: Path, folder: Path, rng: Generator) -> None:
    """Copy a sample to `folder` and damage one of its files."""
    shutil.copytree(sample, folder)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = files[int(rng.integers(len(files)))]
    rewrite = _REWRITE.get(path.suffix)
    if rewrite is not None and rng.random() < 0.7:
        rewrite(path, rng)
    if rewrite is None or rng.random() < 0.4:
        data = path.read_bytes()
        for _ in range(int(rng.integers(1, 4))):
            data = _BYTES[int(rng.integers(len(_BYTES)))](data, rng)
        path.write_bytes(data)
    if rng.random() < 0.02:  # a folder, or nothing, where a file is wanted
        path.unlink()
        if rng.random() < 0.5:
            path.mkdir()


def _cut(data: bytes, rng: Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def _flip(data: bytes, rng: Generator) -> bytes:
    changed = bytearray(data)
    for place in rng.integers(len(data), size=int(rng.integers(1, 9))) if data else ():
        changed[int(place)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _splice(data: bytes, rng: Generator) -> bytes:
    a, b, c = sorted(int(x) for x in rng.integers(len(data) + 1, size=3))
    return data[:a] + data[b:c] * int(rng.integers(1, 4)) + data[a:b] + data[c:]


def _drop(data: bytes, rng: Generator) -> bytes:
    a = int(rng.integers(len(data) + 1))
    return data[:a] + data[a + int(rng.integers(1, 200)) :]


def _put(data: bytes, rng: Generator) -> bytes:
    text = _TEXTS[int(rng.integers(len(_TEXTS)))].encode("utf-8", "surrogateescape")
    a = int(rng.integers(len(data) + 1))
    return data[:a] + text + data[a + int(rng.integers(0, 2)) * len(text) :]


def _binary_number(data: bytes, rng: Generator) -> bytes:
    kind = "<BHIQfd"[int(rng.integers(1, 7))]
    value = float(rng.choice([0.0, 1.0, 2.0**31, 2.0**32 - 1, 2.0**62, 1e30, np.inf, np.nan, 0xFFFF, 0xFF]))
    part = struct.pack(f"<{kind}", value if (kind in "fd" and abs(value) < 1e38) or kind == "d" else 0.0) \
        if kind in "fd" else (b"\xff" if rng.random() < 0.5 else b"\x7f") * struct.calcsize(kind)  # fmt: skip
    a = int(rng.integers(len(data) + 1))
    return data[:a] + part + data[a + len(part) :]


def _text_number(data: bytes, rng: Generator) -> bytes:
    """Replace a number written in text."""
    places = [k for k, byte in enumerate(data[:200_000]) if 48 <= byte <= 57 and not (k and 48 <= data[k - 1] <= 57)]
    if not places:
        return _binary_number(data, rng)
    a = b = places[int(rng.integers(len(places)))]
    while b < len(data) and data[b] in b"0123456789.eE+-":
        b += 1
    return data[:a] + str(_NUMBERS[int(rng.integers(len(_NUMBERS)))]).encode() + data[b:]


def _swap_words(data: bytes, rng: Generator) -> bytes:
    separator = (b"\n", b",", b" ", b'"', b"\t")[int(rng.integers(5))]
    words = data.split(separator)
    a, b = (int(x) for x in rng.integers(len(words), size=2))
    words[a], words[b] = words[b], words[a]
    return separator.join(words)


_BYTES = (_cut, _flip, _splice, _drop, _put, _binary_number, _text_number, _swap_words)


def changed_value(value: Any, rng: Generator) -> Any:
    """Return a value of lists and mappings with something in it replaced, dropped, doubled, renamed or nested."""
    inside = list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    if not inside or rng.random() < 0.12:
        return _VALUES[int(rng.integers(len(_VALUES)))]
    key = inside[int(rng.integers(len(inside)))]
    what = rng.random()
    copy = dict(value) if isinstance(value, dict) else list(value)
    if what < 0.7:
        copy[key] = changed_value(value[key], rng)
    elif what < 0.8:
        del copy[key]
    elif what < 0.9 and isinstance(copy, list):
        copy += copy[: int(rng.integers(1, 200))] * int(rng.integers(1, 20))
    elif isinstance(copy, dict):
        copy[_TEXTS[int(rng.integers(len(_TEXTS)))]] = copy.pop(key)
    else:
        for _ in range(int(rng.integers(1, 60))):
            copy = [copy]
    return copy


def _rewrite_yaml(path: Path, rng: Generator) -> None:
    value = changed_value(yaml.safe_load(path.read_text(encoding="utf-8")), rng)
    path.write_text(yaml.dump(value, sort_keys=False, allow_unicode=bool(rng.random() < 0.5)), "utf-8", "surrogatepass")


def _rewrite_json(path: Path, rng: Generator) -> None:
    path.write_text(json.dumps(changed_value(json.loads(path.read_text(encoding="utf-8")), rng)), encoding="utf-8")


def _rewrite_table(path: Path, rng: Generator) -> None:
    delimiter = "\t" if path.suffix == ".trc" else ","
    rows = [line.split(delimiter) for line in path.read_text(encoding="utf-8").splitlines()]
    for _ in range(int(rng.integers(1, 4))):
        row = rows[int(rng.integers(len(rows)))]
        row[int(rng.integers(len(row)))] = str(_VALUES[int(rng.integers(len(_VALUES)))])
    if rng.random() < 0.2:
        column, value = int(rng.integers(len(rows[0]))), str(_NUMBERS[int(rng.integers(len(_NUMBERS)))])
        for row in rows[1:]:
            row[min(column, len(row) - 1)] = value
    path.write_text("\n".join(delimiter.join(row) for row in rows), "utf-8", "surrogatepass")


def _rewrite_archive(path: Path, rng: Generator) -> None:
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for _ in range(int(rng.integers(1, 3))):
        name = list(arrays)[int(rng.integers(len(arrays)))]
        array = np.array(arrays[name])
        if name == "metadata":
            value = changed_value(json.loads(array.tobytes()), rng)
            arrays[name] = np.frombuffer(json.dumps(value).encode(), np.uint8)
            continue
        what = rng.random()
        with np.errstate(all="ignore"):
            if what < 0.5 and array.size:
                some = rng.random(array.shape) < rng.choice([0.02, 0.5, 1.0])
                if array.dtype.kind in "iuf":
                    value = float(rng.choice([0, -1, 1, 7, 1e6, -1e6, 1e12, -1e12, 2.0**31, 1e-300, 1e300, np.nan]))
                    array = np.where(some, value, array)
                    array = array.astype(arrays[name].dtype) if rng.random() < 0.8 else array
            elif what < 0.6:
                array = array[: int(rng.integers(len(array) + 1))] if array.ndim else array[None]
            elif what < 0.7:
                array = np.concatenate([array, array]) if array.ndim else np.array([array, array])
            elif what < 0.8:
                array = array.reshape(-1)[::-1].reshape(array.shape)
            elif what < 0.9:
                array = array.T if array.ndim > 1 else array[None]
            else:
                array = np.array(["text"]) if rng.random() < 0.5 else array.astype(str)
        arrays[name] = array
    if rng.random() < 0.1:
        arrays.pop(list(arrays)[int(rng.integers(len(arrays)))])
    stream = io.BytesIO()
    (np.savez_compressed if rng.random() < 0.05 else np.savez)(stream, **arrays)
    data = stream.getvalue()
    if rng.random() < 0.1:  # a member that says that it is larger than it is
        data = _binary_number(data[: len(data) // 2], rng) + data[len(data) // 2 :]
    if rng.random() < 0.05:
        with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive_file:
            archive_file.writestr("bomb.npy", bytes(1 << 20))
        data = stream.getvalue()
    path.write_bytes(data)


def _rewrite_bag(path: Path, rng: Generator) -> None:
    """Write the messages again, with some of them and of what is said about them changed, often without checksums."""
    bag = BagReader(path)
    kept, facts = list(bag.messages()), {name: dict(values) for name, values in bag.metadata.items()}
    if rng.random() < 0.4:
        facts = changed_value(facts, rng)
    compression = (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)[int(rng.integers(3))]
    sums, chunks = bool(rng.random() < 0.5), bool(rng.random() < 0.8)
    with path.open("wb") as stream:
        writer: Any = Writer(
            stream, chunk_size=4096, compression=compression, use_chunking=chunks, enable_crcs=sums,
            enable_data_crcs=sums,
        )  # fmt: skip
        writer.start(profile="ros2")
        for name, values in facts.items() if isinstance(facts, dict) else ():
            texts = values if isinstance(values, dict) else {"value": values}
            writer.add_metadata(_utf8(name), {_utf8(key): _utf8(value) for key, value in texts.items()})
        channels: dict[str, int] = {}
        for message in kept:
            topic, data = message.topic, message.data
            if topic not in channels:
                told = bag.topics[topic]
                strange = rng.random(3) < 0.03
                definition = ros.type_definition(told.msgtype)
                msgtype = _utf8(rng.choice(_TEXTS)) if strange[0] else told.msgtype
                schema = writer.register_schema(msgtype, "ros2msg", definition.text.encode())
                name = _utf8(rng.choice(_TEXTS)) if strange[1] else topic
                qos = {"offered_qos_profiles": _utf8(rng.choice(_TEXTS))} if strange[2] else {}
                channels[topic] = writer.register_channel(name, "cdr", schema, qos)
            what = rng.random()
            times = [message.log_time_ns, message.publish_time_ns]
            if what < 0.01:
                data = _BYTES[int(rng.integers(len(_BYTES)))](data, rng)
            elif what < 0.02 and bag.topics[topic].msgtype == ros.STRING:
                text = ros.decode(data, ros.STRING).data
                try:
                    text = json.dumps(changed_value(json.loads(text), rng))
                except ValueError:
                    text = _put(text.encode(), rng).decode("utf-8", "replace")
                data = ros.serialise(ros.string(text.replace("\0", "")))
            elif what < 0.03:
                times = [int(rng.choice(np.array([0, 1, 2**63 - 1, 2**63, 2**64 - 1], np.uint64))) for _ in times]
            elif what < 0.04:
                continue
            writer.add_message(channels[topic], log_time=times[0], data=data, publish_time=times[1])
        writer.finish()


def _utf8(value: Any) -> str:
    return str(value).encode("utf-8", "replace").decode()


_REWRITE: dict[str, Callable[[Path, Generator], None]] = {
    ".yaml": _rewrite_yaml,
    ".json": _rewrite_json,
    ".csv": _rewrite_table,
    ".trc": _rewrite_table,
    ".npz": _rewrite_archive,
    ".mcap": _rewrite_bag,
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
