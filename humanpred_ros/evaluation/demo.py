"""The main job: a recorded reach is replayed, predicted and planned around over DDS, and recorded.

Five processes do it: a tracker that replays the motion, the predictor of the space that the person is going to need,
the planner, a simulated arm, and a recorder. The next posture waits for the decision on the last, so that a run is the
same on any machine; with `--real-time` it is played at the recorded speed. The predictor has not learned from the
motion that is replayed. The run's folder gets bag, model, logs, summary.json and report.html.
"""

from __future__ import annotations

import json
import re
import shutil
import threading
import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.text import Text

from humanpred_ros import __version__, plugins
from humanpred_ros.errors import LibraryFormatError, UsageError
from humanpred_ros.evaluation.processes import (
    ONE_PROCESS,
    NodeGroup,
    NodeProcess,
    ParameterValue,
    address_of,
    chosen_domain_id,
    in_one_process,
    view_command,
)
from humanpred_ros.human.model import human_with, name_of_human
from humanpred_ros.motion.bag_library import write_library_bag
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import Motion, MotionLibrary
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.plugins import DEFAULT_CLASSIFIER, DEFAULT_PREDICTOR, SET, Given, given_settings, parameters_of
from humanpred_ros.resources import locate, replacing
from humanpred_ros.robot.scene_file import keep_scene, read_scene_file, scene_with_robot
from humanpred_ros.settings import LARGEST_SEED, Settings, setting, setting_of

if TYPE_CHECKING:
    from humanpred_ros.viewing.analysis import RunSummary

_LOG_LINE = re.compile(r"^\[\w+\] \[[\d.]+\] \[stomp_planner\]: (.*)$")
_DECISION = re.compile(r" *[\d.]+ s ")
_COLUMNS = 80
_TRACKER = "skeleton_tracker_replay"
#: Named wherever something is sent: a recorder that is not yet matched would miss the first of it.
_RECORDER = "run_recorder"
_LOOK_LIMIT_S = 30.0
_PEERS = ("occupancy_predictor", "stomp_planner", "simulated_arm", _RECORDER)


class DemoSettings(Settings):
    """What a demo run replays, where, and how: settings of `humanpred demo`."""

    scene: str = setting("four_places", "scene name in config/scenes, or a YAML file")
    robot: str | None = setting(
        None,
        "robot instead of the scene's: its name in config/robots, or a YAML file; the scene's start_state and goals "
        "must be possible for it",
    )
    library: str = setting("synthetic_reaches", "bag, CSV folder, or the name of a shipped one")
    trajectory: str = setting("3/2", "motion to replay: class/index, or the running number over sorted classes")
    model: str | None = setting(None, "model file made by `humanpred train`; none: train now")
    hold_out: int = setting(5, "first motions of each class not trained on", low=0)
    predictor: str = setting(
        DEFAULT_PREDICTOR,
        "forecast, swept_volume (P1), reaching (P2), or a baseline: current, current_accumulated, constant_velocity",
    )
    classifier: str = setting(DEFAULT_CLASSIFIER, "forest, or gmm (P1)")
    onsets: bool = setting(True, "find where the motion begins and ends; else the first posture begins it, as in P1")
    cost_terms: tuple[str, ...] = setting_of(ReplannerConfig, "cost_terms")
    set: tuple[str, ...] = setting((), SET)
    seed: int = setting(0, "of the planner and of training", low=0, high=LARGEST_SEED)
    steps: int = setting(20, "replanning steps in the human motion", low=1)
    threshold: float = setting(0.001, "voxels at or below this probability are not published", low=0.0, high=1.0)
    hold_last_s: float = setting(
        6.0, "the last posture is repeated this long, for the arm to finish", unit="s", low=0.0, high=600.0
    )
    one_process: bool = setting(False, "run predictor and planner in one process; they decide the same")
    markers: bool = setting(False, "record markers too, for viewers; costs the nodes time")
    real_time: float | None = setting(
        None,
        "do not wait for the planner after every posture: play at this many times the recorded speed (1)",
        low=0.1,
        high=20.0,
        bare=1.0,
    )
    view: bool = setting(False, "show it in 3D in a browser; waits until the browser has come, or half a minute")
    out: str | None = setting(None, "folder of the run; none: a new one below runs/")

    @property
    def stepped(self) -> bool:
        """Whether the next posture waits for the decision on the last, so that a run is the same on any machine."""
        return self.real_time is None


def run(settings: DemoSettings, console: Console) -> int:
    """Carry out `humanpred demo`."""
    run_demo(settings, console)
    return 0


def run_demo(settings: DemoSettings, console: Console) -> RunSummary:
    """Run the graph once and return the summary; everything else lies in the run's folder.

    What takes long is done side by side: the nodes start as soon as what each is given is known, while the input is
    still being looked at; what the report needs is imported while the arm works, and the nodes end while it is drawn.

    Raises:
        HumanPredError: unusable input (nothing is left behind), or a node that failed.
    """
    plugins.check_name(plugins.PREDICTORS, settings.predictor)
    given = given_settings(settings.set, (settings.classifier, settings.predictor, *settings.cost_terms))
    read_scene_file(settings.scene)
    library = load_library(locate(settings.library, "bags"), points=False)
    motion = library.find(settings.trajectory)
    ReplannerConfig(period_s=period_of(motion, settings.steps))  # said before a node is started
    folder = _new_folder(settings, motion)
    domain_id = chosen_domain_id()
    console.print(f"ROS domain {domain_id}, this machine only: look on with ROS_DOMAIN_ID={domain_id}")
    with NodeGroup(folder / "logs", domain_id) as group:
        with _removed_on_failure(folder, group):
            if settings.robot is not None:
                scene = scene_with_robot(settings.scene, settings.robot, folder)
                settings = settings.replaced(scene=str(scene))
            _start(group, settings, given, library, motion, folder, console)
        _follow(group, console)
        group.end("run_recorder")
        from humanpred_ros.viewing.key_figures import print_summary
        from humanpred_ros.viewing.report import report_run

        summary = report_run(folder)
    print_summary(summary, console)
    console.print(f"report  {folder / 'report.html'}\nbag     {folder / 'bag'}")
    return summary


@contextmanager
def _removed_on_failure(folder: Path, group: NodeGroup) -> Iterator[None]:
    """Make a folder that is there only if the block succeeds; else the nodes are ended first."""
    made = [folder, *(parent for parent in folder.parents if not parent.exists())]
    folder.mkdir(parents=True)
    try:
        yield
    except BaseException:
        group.stop(gently=False)  # nothing of theirs is kept
        shutil.rmtree(made[-1], ignore_errors=True)
        raise


def _start(
    group: NodeGroup,
    settings: DemoSettings,
    given: Given,
    library: MotionLibrary,
    motion: Motion,
    folder: Path,
    console: Console,
) -> None:
    """Start the nodes; find or train the model, and check the scene, while they are starting."""
    # With /clock published, stamps are simulated time; otherwise they are wall time, as on a real robot.
    common: dict[str, ParameterValue] = {"use_sim_time": settings.real_time != 1.0, "scene": settings.scene}
    period_s = period_of(motion, settings.steps)
    planner: dict[str, ParameterValue] = {
        **common,
        "period_s": period_s,
        "seed": settings.seed,
        "cost_terms": list(settings.cost_terms),
        **parameters_of(given, settings.cost_terms),
        "lossless": settings.stepped,
        "controller": "simulated_arm",
        "listener": f"{_TRACKER},{_RECORDER}",
    }
    if not settings.one_process:
        group.start("stomp_planner", planner)
    group.start("simulated_arm", common)
    keep_scene(settings.scene, folder)
    model = _model(settings, given, library, motion, folder / "model.npz", console)
    predictor: dict[str, ParameterValue] = {
        **common,
        "model": str(model.resolve()),
        "predictor": settings.predictor,
        "human": name_of_human(motion.dof_names),
        "classifier": settings.classifier,
        "detect_onsets": settings.onsets,
        **parameters_of(given, (settings.classifier, settings.predictor)),
        "threshold": settings.threshold,
        "lossless": settings.stepped,
        "listener": f"stomp_planner,{_RECORDER}",
    }
    if settings.one_process:
        group.start(ONE_PROCESS, in_one_process(planner, predictor))
    else:
        group.start("occupancy_predictor", predictor)
    if settings.view:
        _show(group, console, "--scene", settings.scene, "--human", name_of_human(motion.dof_names))
    replayed = MotionLibrary(f"motion_{motion.name.replace('/', '_')}", (motion,), library.provenance)
    group.start(
        _TRACKER,
        {
            "library": str(write_library_bag(replayed, folder / replayed.name)),
            "trajectory": motion.name,
            "mode": "stepped" if settings.stepped else "real_time",
            "rate": settings.real_time or 1.0,
            "hold_last_s": settings.hold_last_s,
            "wait_for": ",".join(_PEERS),
            "listener": f"occupancy_predictor,{_RECORDER}",
        },
    )
    info = json.dumps(_facts(settings, motion, period_s))
    group.start(
        _RECORDER, {"output": str(folder / "bag"), "stay": False, "run_info": info, "markers": settings.markers}
    )
    from humanpred_ros.robot.scene import load_scene

    scene = load_scene(settings.scene)
    console.print(
        f"{scene.name}: motion {motion.name} of {library.name}, {motion.duration_s:.2f} s; "
        f"goals {', '.join(goal.name for goal in scene.goals)}; run folder {folder}"
    )


def _show(group: NodeGroup, console: Console, *arguments: str) -> None:
    """Open a live view, and wait until somebody looks at it, for some time."""
    from humanpred_ros.viewing.space import LOOKED_AT

    view = group.run("view", view_command(*arguments))
    told, until_s = "", time.monotonic() + _LOOK_LIMIT_S
    with console.status("opening the view"):
        while LOOKED_AT not in view.tail() and time.monotonic() < until_s:
            group.check()
            if not told and (told := address_of(view)):
                console.print(f"open {told} in a browser", highlight=False)
                webbrowser.open(told)
                until_s = time.monotonic() + _LOOK_LIMIT_S
            time.sleep(0.1)


def _model(
    settings: DemoSettings, given: Given, library: MotionLibrary, motion: Motion, path: Path, console: Console
) -> Path:
    """Return the model's file: the one told, or a copy at `path` of the one found or trained now, if one is needed."""
    # Imported here: it takes a second, in which the first nodes are starting already.
    from humanpred_ros.occupancy.predictor import check_predictor, needed_classifiers, predictor_type
    from humanpred_ros.recognition.training import classifier_settings, load_model, model_of

    check_predictor(settings.predictor, settings.classifier)
    human = human_with(library.dof_names)
    if settings.model:
        if known := load_model(settings.model, human).learned_from(motion):
            console.print(
                f"{settings.model} was trained on this motion ({known}): what is shown is not how it predicts new "
                "ones; train without it (--leave-out, --hold-out), or leave --model out",
                highlight=False,
                soft_wrap=True,
            )
        return Path(settings.model)
    if predictor_type(settings.predictor).needs_model:
        training = training_part(library, motion, settings.hold_out)
        names = needed_classifiers(settings.predictor, settings.classifier)
        with console.status(escape(f"training on {len(training)} motions of {library.name}")):
            found = model_of(training, human, {name: classifier_settings(name, settings.seed, given) for name in names})
        with replacing(path) as part:
            shutil.copyfile(found, part)
    return path


def _facts(settings: DemoSettings, motion: Motion, period_s: float) -> dict[str, object]:
    """Return what the run's bag tells about the run."""
    from humanpred_ros.occupancy.predictor import predictor_type

    told = ("scene", "library", "seed", "predictor", "hold_out", "steps")
    return {
        **{name: getattr(settings, name) for name in told},
        "trajectory": motion.name,
        "mode": "stepped" if settings.stepped else "real_time",
        "rate": settings.real_time or "",
        "period_s": repr(period_s),
        "classifier": settings.classifier if predictor_type(settings.predictor).classifiers != () else "",
        "detect_onsets": settings.onsets,
        "threshold": repr(settings.threshold),
        "package_version": __version__,
        "duration_s": repr(motion.duration_s),
        "cost_terms": " ".join(settings.cost_terms),
        "set": json.dumps(settings.set),
        "model": settings.model or "",
    }


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


def _new_folder(settings: DemoSettings, motion: Motion) -> Path:
    if settings.out:
        folder = Path(settings.out)
        if folder.exists() and any(folder.iterdir()):
            raise UsageError(f"{folder} exists and is not empty; choose another folder with --out")
        if folder.exists():
            folder.rmdir()
        return folder
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    return Path("runs") / f"{stamp}-{Path(settings.scene).stem}-{motion.name.replace('/', '_')}"


def _follow(group: NodeGroup, console: Console) -> None:
    """Show the planner's decisions as they come until the tracker has replayed everything."""
    nodes = {node.name: node for node in group.nodes}
    lines = _new_lines(nodes.get(ONE_PROCESS) or nodes["stomp_planner"])
    # The report's libraries take a second to import; while the arm works there is time.
    importing = threading.Thread(target=import_module, args=("humanpred_ros.viewing.report",), daemon=True)

    def show_decisions() -> None:
        for line in lines:
            if line is None:
                return
            found = _LOG_LINE.match(line)
            if found:
                if not importing.ident:
                    importing.start()
                    status.update("human is moving, arm is working")
                told = Text(f"  {found[1]}")
                if _DECISION.match(found[1]):  # the whole reason is in the report
                    told.truncate(_COLUMNS, overflow="ellipsis")
                console.print(told, highlight=False, soft_wrap=True)

    console.print("starting the nodes; the first start on a machine compiles for a minute or two")
    with console.status("waiting for the nodes") as status:
        group.wait_for(nodes[_TRACKER], show_decisions)
        show_decisions()


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
