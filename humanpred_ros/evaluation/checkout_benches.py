"""What this package is put through: `humanpred bench fuzz`, `faults`, `soak`, `link` and `view`.

Damage, faults, bad links, browsers and what must follow are part of the repository's tests (`test/fuzz`, `test/faults`,
`test/link`, `test/view_bench.py`): these commands run from a checkout only.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from rich.console import Console

from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.evaluation.framework import OutputSettings, chosen_names
from humanpred_ros.planning.replanner_config import ReplannerConfig
from humanpred_ros.resources import share_directory
from humanpred_ros.settings import LARGEST_SEED, setting, setting_of

#: A link that was down: work again is asked for so soon after it is back, s.
AGAIN_S = 0.5
KINDS = ("scene", "library", "bag", "table", "people", "markers", "model", "weights", "urdf", "run", "setting")


class FuzzSettings(OutputSettings):
    """Settings of `humanpred bench fuzz`."""

    files: int = setting(1000, "damaged files", low=0)
    messages: int = setting(0, "mutated messages, spread over the nodes; 0 leaves them out", low=0)
    seed: int = setting(0, "of all damage", low=0)
    first: int = setting(0, "number of the first file", low=0)
    kinds: tuple[str, ...] = setting(tuple(KINDS), "kinds of files")
    jobs: int | None = setting(None, "processes to work with; one for each core by default", low=1)
    keep: Path = setting(Path("fuzz_failures"), "folder that files which failed are kept in; made if there are any")

    def check(self) -> None:
        """Refuse unknown kinds."""
        chosen_names(self.kinds, KINDS, "kinds")


class FaultBenchSettings(OutputSettings):
    """Settings of `humanpred bench faults`."""

    page: Path = setting(Path("docs/faults.md"), "page to write when every fault is tried")
    only: tuple[str, ...] = setting(("all",), "names of faults")
    short: bool = setting(False, "only a handful of faults, in less than a minute")
    keep: Path | None = setting(None, "new folder to keep logs and bags in")


class SoakSettings(OutputSettings):
    """Settings of `humanpred bench soak`."""

    minutes: float = setting(10.0, "length of the run", unit="min", low=0.5, high=1440.0)
    calm: float = setting(10.0, "mean time between one fault and the next", unit="s", low=1.0, high=3600.0)
    seed: int = setting(0, "of the faults' order and times", low=0, high=LARGEST_SEED)
    keep: Path | None = setting(None, "new folder to keep logs and bag in")


class LinkBenchSettings(OutputSettings):
    """Settings of `humanpred bench link`."""

    loss: tuple[float, ...] = setting((0.0, 0.01, 0.05), "shares of frames that get lost, each way", low=0.0, high=0.9)
    delay_ms: float = setting(20.0, "time that every frame takes", unit="ms", low=0.0, high=1000.0)
    seconds: float = setting(15.0, "length of the postures in every run", unit="s", low=4.0, high=600.0)
    down: float = setting(3.0, "the link is down for so long, from a third of the run on; 0: never", unit="s", low=0.0)
    period: float = setting_of(ReplannerConfig, "period_s", default=0.2)
    recorder: tuple[str, ...] = setting(
        ("planner", "predictor"), "whose host the recorder is on: one run each, of planner and predictor"
    )
    copies: int = setting(3, "how often each occupancy is sent", low=1, high=5)
    profile: bool = setting(True, "with config/fastdds_lossy_link.xml; false: DDS as it comes")
    keep: Path | None = setting(None, "new folder to keep bags and logs in")

    def check(self) -> None:
        """Refuse what leaves nothing to measure."""
        if not self.loss:
            raise SettingsError(f"{type(self).__name__} loss: wanted one or more shares, got none")
        if not self.recorder or not set(self.recorder) <= {"planner", "predictor"}:
            got = ", ".join(self.recorder) or "none"
            raise SettingsError(f"{type(self).__name__} recorder: wanted planner, predictor or both, got {got}")
        if self.seconds < 1.5 * (self.down + AGAIN_S) + 1.0:
            raise SettingsError(
                f"{type(self).__name__} seconds: wanted at least {1.5 * (self.down + AGAIN_S) + 1.0:g} s for a link "
                f"that is down for {self.down:g} s, got {self.seconds:g} s"
            )


class ViewBenchSettings(OutputSettings):
    """Settings of `humanpred bench view`."""

    voxels: int = setting(10_000, "voxels that are new in every moment", low=1, high=1_000_000)
    seconds: float = setting(5.0, "length of each stretch", unit="s", low=1.0, high=600.0)
    stretches: int = setting(3, "of the running graph without a view, and with one; none: only frames are counted")
    browser: str = setting("", "program to look with; empty: chromium or google-chrome, if there is one")


def fuzz(settings: FuzzSettings, console: Console) -> int:
    """Read damaged files and show damaged messages to the nodes; the exit status is 1 if anything failed."""
    return _run("fuzz.files", settings, console)


def faults(settings: FaultBenchSettings, console: Console) -> int:
    """Put every fault into the running graph; the exit status is 1 if it did not fail closed."""
    return _run("faults.bench", settings, console)


def soak(settings: SoakSettings, console: Console) -> int:
    """Let the graph run with a fault now and then; the exit status is 1 if something is not as asked."""
    return _run("faults.soak", settings, console)


def link(settings: LinkBenchSettings, console: Console) -> int:
    """Run the graph on two hosts with every loss."""
    return _run("link.bench", settings, console)


def view(settings: ViewBenchSettings, console: Console) -> int:
    """Count the live view's frames, and measure what it costs the nodes."""
    return _run("view_bench", settings, console)


def _run(module: str, settings: OutputSettings, console: Console) -> int:
    """Carry out `run` of one of the tests' modules.

    Raises:
        UsageError: no checkout of the repository.
    """
    folder = share_directory() / "test"
    if not folder.joinpath(*module.split(".")).with_suffix(".py").is_file():
        raise UsageError(f"wanted a checkout of the repository, whose tests hold this bench; there is no {folder}")
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    status: int = importlib.import_module(module).run(settings, console)
    return status
