"""The main job: a recorded reach is replayed, predicted and planned around over DDS, and recorded."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from rich.console import Console

from humanpred_ros import __version__
from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.evaluation.processes import NodeGroup, NodeProcess, ParameterValue, free_domain_id
from humanpred_ros.human.model import human_with, name_of_human
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.occupancy.predictor import DEFAULT_PREDICTOR
from humanpred_ros.predictors.factory import check_predictor, needs_model, uses_classifier
from humanpred_ros.recognition.classifier import DEFAULT_CLASSIFIER
from humanpred_ros.recognition.forest_config import ForestConfig
from humanpred_ros.recognition.gmm_config import GmmConfig
from humanpred_ros.recognition.model_file import load_model, save_model
from humanpred_ros.recognition.training import train_model
from humanpred_ros.resources import locate
from humanpred_ros.robot.scene import Scene, load_scene
from humanpred_ros.viewing.report import write_report
from humanpred_ros.viewing.run import read_run
from humanpred_ros.viewing.summary import RunSummary, print_summary, summarise

_POLL_S = 0.05
_SETTLE_S = 0.3  # the last messages reach the recorder after the tracker has ended
_LOG_LINE = re.compile(r"^\[\w+\] \[[\d.]+\] \[stomp_planner\]: (.*)$")
_TRACKER = "skeleton_tracker_replay"
_PEERS = ("occupancy_predictor", "stomp_planner", "simulated_pr2", "run_recorder")


@dataclass(frozen=True)
class DemoOptions:
    """What a demo run replays, where, and how.

    Attributes:
        scene: name in config/scenes, or a YAML file.
        library: motion library the reach comes from and the classes are trained on.
        trajectory: `class/index` or running number.
        model: trained model file; None trains on the library without the held-out motions.
        hold_out: this many first motions of every class are kept from training (P1 leaves out five).
        seed: of the planner and of training.
        rate: playback speed in real time; None steps: the next posture waits for the decision on the last, so
            that a run comes out the same on any machine.
        steps: replanning steps per human motion (P1: 20, so 5 % each).
        predictor, classifier: what predicts the occupancy, and what recognises the reach.
        detect_onsets: find where the motion begins and ends; without it the first posture begins one, as in P1.
        evidence, window_frames: how `gmm` weighs the postures seen (`GmmConfig`; 0 counts all).
        threshold: voxels at or below this probability are not published.
        hold_last_s: how long the human stays at the end, for the arm to finish.
        markers: record markers too, for a look at the bag in a viewer; costs the nodes time.
        out: folder of the run; None makes one below runs/.
    """

    scene: str = "four_places"
    library: str = "synthetic_reaches"
    trajectory: str = "3/2"
    model: str | None = None
    hold_out: int = 5
    seed: int = 0
    rate: float | None = None
    steps: int = 20
    predictor: str = DEFAULT_PREDICTOR
    classifier: str = DEFAULT_CLASSIFIER
    detect_onsets: bool = True
    evidence: str = "sum"
    window_frames: int = 0
    threshold: float = 0.001
    hold_last_s: float = 6.0
    markers: bool = False
    out: str | None = None

    @property
    def stepped(self) -> bool:
        return self.rate is None


def run_demo(options: DemoOptions, console: Console) -> RunSummary:
    """Run the graph once and return the summary; everything else lies in the run's folder.

    Raises:
        HumanPredError: unusable input (before anything is written), or a node that failed.
    """
    check_predictor(options.predictor, options.classifier)
    scene = load_scene(options.scene)
    library = load_library(locate(options.library, "bags"))
    human = human_with(library.dof_names)
    motion = library.find(options.trajectory)
    folder = _new_folder(options, scene, motion)
    model = None
    if options.model:
        load_model(options.model, human)
    elif needs_model(options.predictor):
        training = training_part(library, motion, options.hold_out)
        with console.status(f"training on {len(training)} motions of {library.name}"):
            model = train_model(training, human, GmmConfig(seed=options.seed), ForestConfig(seed=options.seed))

    folder.mkdir(parents=True)
    model_path = Path(options.model or folder / "model.npz").resolve()
    if model is not None:
        save_model(model, model_path)
    replayed = MotionLibrary(f"motion_{motion.name.replace('/', '_')}", (motion,), library.provenance)
    bag = write_library_bag(replayed, folder / replayed.name)
    console.print(
        f"[bold]{scene.name}[/bold]: motion {motion.name} of {library.name}, {motion.duration_s:.2f} s; "
        f"goals {', '.join(goal.name for goal in scene.goals)}; run folder {folder}"
    )
    with NodeGroup(folder / "logs", free_domain_id()) as group:
        _start_nodes(group, options, bag, motion, model_path, folder)
        _follow(group, console)
    run = read_run(folder)
    summary = summarise(run)
    write_report(run, summary, folder / "report.html")
    (folder / "summary.json").write_text(summary.to_json(), encoding="utf-8")
    print_summary(summary, console)
    console.print(f"report  {folder / 'report.html'}\nbag     {folder / 'bag'}")
    return summary


def training_part(library: MotionLibrary, replayed: Motion, hold_out: int) -> MotionLibrary:
    """Return the library without the replayed motion and the first `hold_out` motions of every class.

    Raises:
        LibraryFormatError: nothing is left.
    """
    held_out = {motion.name for label in library.labels for motion in library.of_class(label)[:hold_out]}
    held_out.add(replayed.name)
    if held_out >= {motion.name for motion in library}:
        raise LibraryFormatError(
            f"library {library.name}: wanted motions to train on, got none when the first {hold_out} of every class "
            f"and {replayed.name} are held out; take a smaller --hold-out"
        )
    return library.select(lambda motion: motion.name not in held_out)


def period_of(motion: Motion, steps: int) -> float:
    """Return the length of a replanning step: `steps` of them make up the motion."""
    return motion.duration_s / steps


def _new_folder(options: DemoOptions, scene: Scene, motion: Motion) -> Path:
    if options.out:
        folder = Path(options.out)
        if folder.exists() and any(folder.iterdir()):
            raise UsageError(f"{folder} exists and is not empty; choose another folder with --out")
        if folder.exists():
            folder.rmdir()
        return folder
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    return Path("runs") / f"{stamp}-{scene.name}-{motion.name.replace('/', '_')}"


def _start_nodes(group: NodeGroup, options: DemoOptions, bag: Path, motion: Motion, model: Path, folder: Path) -> None:
    period_s = period_of(motion, options.steps)
    info = {
        "scene": options.scene,
        "library": options.library,
        "trajectory": motion.name,
        "seed": options.seed,
        "mode": "stepped" if options.stepped else "real_time",
        "rate": options.rate or "",
        "period_s": repr(period_s),
        "predictor": options.predictor,
        "classifier": options.classifier if uses_classifier(options.predictor) else "",
        "detect_onsets": options.detect_onsets,
        "threshold": repr(options.threshold),
        "package_version": __version__,
        "duration_s": repr(motion.duration_s),
        "hold_out": options.hold_out,
        "steps": options.steps,
        "evidence": options.evidence,
        "window_frames": options.window_frames,
        "model": options.model or "",
    }
    # With /clock published, stamps are simulated time; otherwise they are wall time, as on a real robot.
    simulated_time = options.rate != 1.0
    common: dict[str, ParameterValue] = {"use_sim_time": simulated_time}
    group.start(
        "run_recorder", {"output": str(folder / "bag"), "run_info": json.dumps(info), "markers": options.markers}
    )
    group.start("simulated_pr2", {**common, "scene": options.scene})
    group.start(
        "stomp_planner",
        {
            **common,
            "scene": options.scene,
            "period_s": period_s,
            "seed": options.seed,
            "lossless": options.stepped,
            "controller": "simulated_pr2",
            "listener": _TRACKER,
        },
    )
    group.start(
        "occupancy_predictor",
        {
            **common,
            "scene": options.scene,
            "model": str(model),
            "predictor": options.predictor,
            "human": name_of_human(motion.dof_names),
            "classifier": options.classifier,
            "detect_onsets": options.detect_onsets,
            "evidence": options.evidence,
            "window_frames": options.window_frames,
            "threshold": options.threshold,
            "lossless": options.stepped,
            "listener": "stomp_planner",
        },
    )
    group.start(
        _TRACKER,
        {
            "library": str(bag),
            "trajectory": motion.name,
            "mode": "stepped" if options.stepped else "real_time",
            "rate": options.rate or 1.0,
            "hold_last_s": options.hold_last_s,
            "wait_for": ",".join(_PEERS),
            "listener": "occupancy_predictor",
        },
    )


def _follow(group: NodeGroup, console: Console) -> None:
    """Show the planner's decisions as they come until the tracker has replayed everything."""
    tracker = next(node for node in group.nodes if node.name == _TRACKER)
    planner = next(node for node in group.nodes if node.name == "stomp_planner")
    lines = _new_lines(planner)
    with console.status("starting the nodes") as status:
        while tracker.running:
            group.check()
            for line in lines:
                if line is None:
                    break
                found = _LOG_LINE.match(line)
                if found:
                    status.update("human is moving, arm is working")
                    console.print(f"  {found.group(1)}", markup=False, highlight=False, soft_wrap=True)
            time.sleep(_POLL_S)
        group.check()
        time.sleep(_SETTLE_S)


def _new_lines(node: NodeProcess) -> Iterator[str | None]:
    """Yield complete new lines of a node's log, and None whenever there are none yet."""
    with node.log.open(encoding="utf-8", errors="replace") as stream:
        rest = ""
        while True:
            rest += stream.readline()
            if rest.endswith("\n"):
                line, rest = rest[:-1], ""
                yield line
            else:
                yield None
