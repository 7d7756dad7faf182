"""Evaluations and benches are called alike: these are the options that several of them have, and what follows.

A command checks `Outputs.of(options)` first, so that hours of work are not lost to a misspelt folder, shows its work
with `progress_lines`, and ends with `Outputs.write`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from humanpred_ros.evaluation.outputs import check_writable, replacing, write_json
from humanpred_ros.evaluation.parallel import usable_cores
from humanpred_ros.motion.csv_library import DEFAULT_FRAME_PERIOD_S
from humanpred_ros.motion.library_io import load_library
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.resources import locate

#: Told how many parts of the work are done.
Advance: TypeAlias = Callable[[int], None]


def add_library(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    """Add --library, which is required unless there is a default, and --frame-period."""
    what = "bag, CSV folder, or the name of a shipped one"
    if default is None:
        parser.add_argument("--library", required=True, help=what)
    else:
        parser.add_argument("--library", default=default, help=f"{what} (the default)")
    parser.add_argument(
        "--frame-period",
        type=float,
        default=DEFAULT_FRAME_PERIOD_S,
        metavar="S",
        help="seconds between frames where a CSV has no times",
    )


def read_library(options: argparse.Namespace) -> tuple[Path, MotionLibrary]:
    """Return where the library of `add_library` lies, since reference values may lie beside it, and the library.

    Raises:
        HumanPredError: no such library, or an unusable one.
    """
    path = locate(options.library, "bags")
    return path, load_library(path, frame_period_s=options.frame_period)


def add_jobs(parser: argparse.ArgumentParser) -> None:
    """Add --jobs."""
    parser.add_argument("--jobs", type=int, default=usable_cores(), help="processes; default: one for each core")


def add_hold_out(parser: argparse.ArgumentParser, default: int) -> None:
    """Add --hold-out, for what is shown to predictors that learned from other motions of the same classes."""
    parser.add_argument(
        "--hold-out",
        type=int,
        default=default,
        metavar="N",
        help="motions of every class that are held out together; 5 first ones in P1",
    )


def add_outputs(parser: argparse.ArgumentParser, *, each: str = "", plot: str | None = None) -> None:
    """Add --json and, for commands that draw, --plot.

    Args:
        parser: of the command.
        each: what the JSON file has besides the figures.
        plot: what --plot does, in words; None where nothing is drawn.
    """
    parser.add_argument("--json", metavar="FILE", help="write every figure to FILE" + (each and f", {each}"))
    if plot is not None:
        parser.add_argument("--plot", metavar="FILE", help=plot)


@dataclass(frozen=True)
class Outputs:
    """The files that were asked for.

    Attributes:
        json: for the figures, None if not wanted.
        plot: for the picture, None if not wanted.
    """

    json: Path | None = None
    plot: Path | None = None

    @classmethod
    def of(cls, options: argparse.Namespace) -> Outputs:
        """Return the files of `add_outputs`; call it before the work starts.

        Raises:
            UsageError: a file that could not be written, or a plot that is no PNG.
        """
        plot = getattr(options, "plot", None)
        return cls(
            json=check_writable(options.json) if options.json else None,
            plot=check_writable(plot, ".png") if plot else None,
        )

    def write(self, console: Console, figures: Any, draw: Callable[[Path], None] | None = None) -> None:
        """Write what was asked for, each file whole or not at all, and say so.

        Args:
            console: to say it.
            figures: anything that `plain` makes JSON of.
            draw: draws the plot into the file it is given.

        Raises:
            UsageError: a file that cannot be written.
        """
        if self.json is not None:
            write_json(self.json, figures)
            _say_where(console, "figures", self.json)
        if self.plot is not None and draw is not None:
            with replacing(self.plot) as temporary:
                draw(temporary)
            _say_where(console, "plot", self.plot)


def _say_where(console: Console, what: str, path: Path) -> None:
    console.print(f"{what:<8} {path}", markup=False, highlight=False, soft_wrap=True)


def names_in(text: str, everything: Iterable[str] | None = None) -> tuple[str, ...]:
    """Return names that were given with commas between, each once; all of `everything` for "all".

    Whether there are such names is for the settings to say that they are given to.
    """
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    return tuple(everything) if everything is not None and names == ("all",) else names


@contextmanager
def progress_lines(console: Console) -> Iterator[Callable[[str, int], Advance]]:
    """Show how far the work is while the block runs; nothing stays behind.

    Gives a function that begins a line, from what it counts and how much of it there is in all, and returns what is
    to be told how much is done.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:

        def begin(what: str, total: int) -> Advance:
            line = bar.add_task(what, total=total)
            return lambda done: bar.update(line, completed=done)

        yield begin
