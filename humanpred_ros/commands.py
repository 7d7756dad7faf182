"""The commands of `humanpred` that only read, convert or write files: their settings and what they do."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from humanpred_ros.errors import UsageError
from humanpred_ros.plugins import SET, given_settings
from humanpred_ros.resources import locate
from humanpred_ros.settings import LARGEST_SEED, Settings, setting

if TYPE_CHECKING:
    from humanpred_ros.bags.salvage import BagReport

_FRAME_PERIOD_S = 1 / 60
NAMESPACE = "of the robot, as /robot1; only needed where the bag holds several"
#: Problems of a bag that are listed.
_LISTED = 50


class TrainSettings(Settings):
    """Settings of `humanpred train`."""

    library: str = setting(..., "bag, CSV folder, or the name of a shipped one", positional=True)
    out: Path = setting(..., "model file to write (.npz)")
    classifier: tuple[str, ...] = setting(("forest", "gmm"), "classifiers to train, by name; own ones, too")
    hold_out: int = setting(0, "first motions of each class not trained on", low=0)
    set: tuple[str, ...] = setting((), SET)
    leave_out: tuple[str, ...] = setting((), "classes not trained on")
    seed: int = setting(0, "of training", low=0, high=LARGEST_SEED)
    frame_period: float = setting(_FRAME_PERIOD_S, "time between frames where a CSV has no times", unit="s", low=1e-6)


def train(settings: TrainSettings, console: Console) -> int:
    """Learn a model from a motion library."""
    from humanpred_ros.human.model import human_with
    from humanpred_ros.motion.commands import require_units, told
    from humanpred_ros.motion.library_io import load_library
    from humanpred_ros.recognition.training import classifier_settings, save_model, train_model

    library = load_library(locate(settings.library, "bags"), frame_period_s=settings.frame_period)
    require_units(library, settings.library)
    for said in told(library):
        console.print(f"{settings.library}: {said}", highlight=False, soft_wrap=True)
    if unknown := set(settings.leave_out) - {str(label) for label in library.labels}:
        raise UsageError(f"--leave-out: wanted some of the classes {', '.join(map(str, library.labels))}, got "
                         f"{', '.join(sorted(unknown))}")  # fmt: skip
    if settings.leave_out:
        library = library.select(lambda motion: str(motion.label) not in settings.leave_out)
    if settings.hold_out:
        held_out = {m.name for label in library.labels for m in library.of_class(label)[: settings.hold_out]}
        library = library.select(lambda motion: motion.name not in held_out)
    given = given_settings(settings.set, settings.classifier)
    chosen = {name: classifier_settings(name, settings.seed, given) for name in settings.classifier}
    with console.status(escape(f"training on {len(library)} motions of {library.name}")):
        model = train_model(library, human_with(library.dof_names), chosen)
    save_model(model, settings.out)
    what = f"{', '.join(chosen)}; {len(library.labels)} classes from {len(library)} motions of {library.name}"
    console.print(f"{settings.out}: {what}")
    return 0


class ReportSettings(Settings):
    """Settings of `humanpred report`."""

    run: Path = setting(..., "folder of the run", positional=True)
    out: Path | None = setting(None, "HTML file; none: report.html in the run's folder")
    figures: Path | None = setting(None, "folder to write every plot to, one file each, and the decisions as CSV")
    format: Literal["pdf", "png", "svg"] = setting("pdf", "of these files")
    width: float = setting(
        7.0,
        "of these plots; a page of most journals is 7 wide; letters have 6 points then",
        unit="in",
        low=6.0,
        high=40.0,
    )
    namespace: str | None = setting(None, NAMESPACE)


def report(settings: ReportSettings, console: Console) -> int:
    """Write the HTML report of a recorded run, and its summary as JSON beside it."""
    from humanpred_ros.viewing.key_figures import print_summary
    from humanpred_ros.viewing.report import report_run

    out = settings.out or settings.run / "report.html"
    summary = report_run(settings.run, out, settings.namespace)
    print_summary(summary, console)
    if settings.figures is not None:
        from humanpred_ros.viewing.saved_figures import save_figures

        save_figures(settings.run, settings.figures, settings.format, settings.width, settings.namespace)
        console.print(f"figures {settings.figures}")
    console.print(f"report  {out}")
    return 0


class ReplaySettings(Settings):
    """Settings of `humanpred replay`."""

    run: Path = setting(..., "folder of the run", positional=True)
    out: Path | None = setting(None, "bag to write; none: replayed_bag in the run's folder")
    namespace: str | None = setting(None, NAMESPACE)


def replay(settings: ReplaySettings, console: Console) -> int:
    """Feed a run's recorded occupancy to a fresh planner; the exit status is 1 if its decisions differ."""
    from humanpred_ros.evaluation.reproduce import replay_run

    with console.status("feeding the recorded occupancy to a fresh planner"):
        comparison = replay_run(settings.run, settings.out or settings.run / "replayed_bag", settings.namespace)
    for difference in comparison.differing[:10]:
        console.print(difference, highlight=False)
    console.print(
        f"{comparison.n_decisions} decisions, {comparison.n_trajectories} trajectories: "
        + (f"{len(comparison.differing)} differ" if comparison.differing else "reproduced bit for bit")
    )
    return 1 if comparison.differing else 0


class BagCheckSettings(Settings):
    """Settings of `humanpred bag check`."""

    bag: Path = setting(..., "bag to read", positional=True)


class BagSalvageSettings(BagCheckSettings):
    """Settings of `humanpred bag salvage`."""

    out: Path = setting(..., "bag to write")


def bag_check(settings: BagCheckSettings, console: Console) -> int:
    """Read a bag completely, with checksums; the exit status is 1 if there is a problem."""
    from humanpred_ros.bags.salvage import check_bag

    found = check_bag(settings.bag)
    _print_bag(found, console)
    return 0 if found.ok else 1


def bag_salvage(settings: BagSalvageSettings, console: Console) -> int:
    """Copy what is intact in a damaged bag to a new one."""
    from humanpred_ros.bags.salvage import salvage_bag

    _print_bag(salvage_bag(settings.bag, settings.out), console)
    return 0


def _print_bag(found: BagReport, console: Console) -> None:
    table = Table(str(found.path), "messages", box=None)
    for topic, count in sorted(found.messages.items()):
        table.add_row(topic, str(count))
    console.print(table)
    for problem in found.problems[:_LISTED]:
        console.print(f"problem: {problem}", highlight=False, soft_wrap=True)
    if len(found.problems) > _LISTED:
        console.print(f"and {len(found.problems) - _LISTED} more problems")
    console.print("all is well" if found.ok else "not all is well")
