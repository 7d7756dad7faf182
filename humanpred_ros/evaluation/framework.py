"""What every evaluation and benchmark shares: its settings, its report, how that is printed, written and drawn.

An evaluation is one file: a class of settings and `measure`, which the command line gives to `present`. For example::

    class SpeedSettings(LibrarySettings):
        percent: int = setting(60, "part of each motion that is looked at", unit="%", low=1, high=100)

    def measure(settings: SpeedSettings, begin: Begin) -> Report:
        library = settings.read_library()
        advance = begin("motions", len(library))
        speeds = map_processes(PeakSpeed(settings.percent), library.motions, settings.jobs, advance, settings.scheduler)
        table = Table(
            "Fastest moment of each motion",
            list(zip(library, speeds)),
            (
                Column("motion", lambda record: record[0].name),
                Column("palm speed", "1", ".2f", "m/s"),
            ),
        )
        figures = {"library": library_facts(library), "speed_mps": speeds}
        return Report(f"{library.name}: speeds", (table,), figures, draw=lambda: draw_speeds(speeds))

`present` shows the progress, prints the report, and writes what `--json`, `--csv` and `--plot` ask for. A table has a
record in each row and a figure in each column; how it is laid out on the screen depends on its size alone.
"""

from __future__ import annotations

import math
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table as ScreenTable
from rich.text import Text

from humanpred_ros import __version__
from humanpred_ros.errors import UsageError, printable
from humanpred_ros.evaluation.outputs import check_writable, machine_facts, plain, write_csv, write_json, write_plot
from humanpred_ros.motion.library_io import DEFAULT_FRAME_PERIOD_S, load_library
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.resources import locate
from humanpred_ros.settings import LARGEST_SEED, Settings, setting

#: Is called with the number of parts of the work that are done.
Advance: TypeAlias = Callable[[int], None]
#: Begins a line of progress, given what it counts and how much of it there is; returns what advances it.
Begin: TypeAlias = Callable[[str, int], Advance]
AnySettings = TypeVar("AnySettings", bound="OutputSettings")

_PLOT_SUFFIXES = (".png", ".svg", ".pdf")
#: Titles are broken into lines of no less than this before a table is split, in characters.
_LEAST_TITLE = 24
#: More figures than this are shown below each other where there is room for the records side by side.
_MANY_FIGURES = 12
_MISSING = "–"

with warnings.catch_warnings():
    # A model of pydantic has a deprecated method `json`, which nothing here calls.
    warnings.filterwarnings("ignore", message='Field name "json"', category=UserWarning)

    class OutputSettings(Settings):
        """Where the figures go, besides the screen."""

        json: Path | None = setting(None, "file to write every figure to, as JSON")  # type: ignore[assignment]
        csv: Path | None = setting(None, "file to write the tables to, as CSV: a row for each figure")
        plot: Path | None = setting(None, "file to draw the plot into (.png, .svg or .pdf)")

        def check_outputs(self) -> None:
            """Check that the files can be written; called before the work starts, so that hours of it are not lost.

            Raises:
                UsageError: with the name of the file.
            """
            for path in (self.json, self.csv):
                if path is not None:
                    check_writable(path)
            if self.plot is not None:
                check_writable(self.plot, *_PLOT_SUFFIXES)


class EvaluationSettings(OutputSettings):
    """How the work of an evaluation is done."""

    jobs: int | None = setting(None, "processes to work with; one for each core by default", low=1)
    scheduler: str | None = setting(
        None, "address of a Dask scheduler whose workers do the work instead, as in tcp://host:8786"
    )
    seed: int = setting(0, "seed of all that is drawn at random", low=0, high=LARGEST_SEED)


class LibrarySettings(EvaluationSettings):
    """Settings of an evaluation on a motion library."""

    library: str = setting(..., "motion library: a bag, a CSV folder, or the name of a shipped one")
    frame_period: float = setting(
        DEFAULT_FRAME_PERIOD_S, "time between frames where a CSV has no times", unit="s", low=1e-6
    )

    def read_library(self) -> MotionLibrary:
        """Return the library. Raises HumanPredError where there is none, or an unusable one."""
        return load_library(self.library_path, frame_period_s=self.frame_period)

    @property
    def library_path(self) -> Path:
        """Where the library lies; reference values may lie beside it."""
        return locate(self.library, "bags")


@dataclass(frozen=True)
class Column:
    """One figure of every record of a table."""

    title: str  #: of the figure, without its unit
    #: where the figure stands in a record, as keys and numbers with / between ("timing/update_us", also its place in
    #: the JSON file); or what returns it. None where a record has none.
    of: str | Callable[[Any], Any]
    spec: str = ""  #: format of numbers, as in ".3f"; with % at its end, as in ".1%", shares are shown in percent
    unit: str = ""  #: of the figure, "" if it has none
    factor: float = 1.0  #: by which it is multiplied

    def value(self, record: Any) -> Any:
        """Return the figure of a record, None if it has none."""
        if not isinstance(self.of, str):
            return self.of(record)
        for key in self.of.split("/"):
            if record is None:
                return None
            record = record[key] if isinstance(record, Mapping) else record[int(key)]
        return record if record is None or self.factor == 1.0 else self.factor * record

    @property
    def head(self) -> str:
        """Title and unit."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    def text(self, record: Any) -> str:
        """Return the figure of a record as it is shown."""
        value = self.value(record)
        if value is None or (isinstance(value, float) and math.isnan(value)):
            return _MISSING
        if isinstance(value, bool):
            return "yes" if value else "no"
        if isinstance(value, str) or not self.spec:
            return printable(str(value))
        if self.spec.endswith("%"):
            return f"{100.0 * value:{self.spec[:-1]}f} %"
        return f"{value:{self.spec}}"


@dataclass(frozen=True)
class Table:
    """Records, one in each row, with their figures, one in each column; the first column is the record's name.

    Columns in which no record has a figure are not shown.
    """

    title: str
    records: Sequence[Any]
    columns: Sequence[Column]
    note: str = ""

    @classmethod
    def of_rows(
        cls, title: str, heads: Sequence[str | tuple[str, ...]], rows: Iterable[Sequence[Any]], note: str = ""
    ) -> Table:
        """Return a table of plain rows; a head is a title, or (title, spec) or (title, spec, unit) as in `Column`."""
        full: list[tuple[Any, ...]] = [(head,) if isinstance(head, str) else head for head in heads]
        columns = [Column(head[0], str(k), *head[1:]) for k, head in enumerate(full)]
        return cls(title, list(rows), columns, note)


@dataclass(frozen=True)
class Report:
    """What an evaluation found."""

    title: str  #: names the evaluation and what it was made with
    tables: Sequence[Table]  #: for the screen and the CSV file
    #: for the JSON file, by name; whatever `outputs.plain` takes. Settings and machine are added.
    figures: dict[str, Any] = field(default_factory=dict)
    notes: Sequence[str] = ()  #: what a reader must know besides, a sentence or more each
    draw: Callable[[], Figure] | None = None  #: makes the plot; None if there is none


def present(settings: AnySettings, console: Console, measure: Callable[[AnySettings, Begin], Report]) -> int:
    """Evaluate, showing the progress; print the report and write the files that were asked for; return 0.

    Raises:
        UsageError: a file that cannot be written.
        HumanPredError: what `measure` raises.
    """
    settings.check_outputs()
    with progress_lines(console) as begin:
        report = measure(settings, begin)
    print_report(report, console)
    if settings.json is not None:
        write_json(
            settings.json, {"title": report.title, "settings": settings, "machine": machine_facts()} | report.figures
        )
        _say_where(console, "figures", settings.json)
    if settings.csv is not None:
        write_csv(settings.csv, ("table", "record", "figure", "unit", "value"), _csv_rows(report, settings))
        _say_where(console, "tables", settings.csv)
    if settings.plot is not None and report.draw is not None:
        write_plot(settings.plot, report.draw)
        _say_where(console, "plot", settings.plot)
    return 0


def print_report(report: Report, console: Console) -> None:
    """Print title, tables and notes."""
    _say(console, report.title, "bold")
    for table in report.tables:
        print_table(table, console)
    for text in report.notes:
        _say(console, text)


def print_table(table: Table, console: Console) -> None:
    """Print a table in the first layout that the console has room for; no cell is ever cut.

    Layouts: records downwards and figures across; figures downwards and records across (first, if there are many
    figures of few records); records downwards, with the figures in several tables below each other.
    """
    if table.title:
        _say(console, table.title, "bold")
    cells = [[column.head, *(column.text(record) for record in table.records)] for column in table.columns]
    cells = [line for k, line in enumerate(cells) if k == 0 or any(text != _MISSING for text in line[1:])]
    across = _Layout(cells)
    turned = _Layout([list(line) for line in zip(*[["", *cells[0][1:]], *cells[1:]], strict=True)])
    wanted = (turned, across) if len(cells) > max(_MANY_FIGURES, len(table.records)) else (across, turned)
    fitting = [layout for layout in wanted if layout.fits(console.width)]
    for layout in fitting[:1] or across.split(console.width):
        console.print(layout.table(console.width))
    if table.note:
        _say(console, table.note, "dim")


class _Layout:
    """Columns of cells, each with its head first; the first column names the rows."""

    def __init__(self, columns: Sequence[Sequence[str]]) -> None:
        self.columns = columns
        self._names = max(map(cell_len, columns[0]))

    def fits(self, width: int) -> bool:
        """Return whether there is room, if need be with names and heads in several lines."""
        return min(self._names, _LEAST_TITLE) + self._others(self._widths(narrow=True)) <= width

    def split(self, width: int) -> Iterator[_Layout]:
        """Give layouts of as many columns as fit, one at least."""
        chosen: list[Sequence[str]] = []
        for column in self.columns[1:]:
            if chosen and not _Layout([self.columns[0], *chosen, column]).fits(width):
                yield _Layout([self.columns[0], *chosen])
                chosen = []
            chosen.append(column)
        yield _Layout([self.columns[0], *chosen])

    def table(self, width: int) -> ScreenTable:
        widths = self._widths(narrow=False)
        if self._names + self._others(widths) > width:
            widths = self._widths(narrow=True)
        names = max(_LEAST_TITLE, width - self._others(widths))
        table = ScreenTable(box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column(_wrapped(self.columns[0][0], names), no_wrap=True)
        for column, column_width in zip(self.columns[1:], widths, strict=True):
            table.add_column(_wrapped(column[0].strip(), column_width), justify="right", no_wrap=True)
        for name, *others in zip(*(column[1:] for column in self.columns), strict=True):
            table.add_row(_wrapped(name, names, "  "), *map(Text, others))
        return table

    def _widths(self, narrow: bool) -> list[int]:
        """Return the width of each column but the first, with heads in as many lines as words, or in two lines."""
        return [
            max(_longest_word(head), 0 if narrow else cell_len(head) // 2 + 1, *map(cell_len, cells))
            for head, *cells in self.columns[1:]
        ]

    def _others(self, widths: Sequence[int]) -> int:
        """Return what the names leave free: two blanks between columns, and one at each side."""
        return sum(widths) + 2 * len(self.columns) + 1


def _wrapped(text: str, width: int, hanging: str = "") -> Text:
    indent = " " * (len(text) - len(text.lstrip()))
    return Text("\n".join(textwrap.wrap(text, width, subsequent_indent=indent + hanging)))


def _longest_word(text: str) -> int:
    return max(map(cell_len, text.split()), default=0)


def _csv_rows(report: Report, settings: OutputSettings) -> Iterator[tuple[str, Any, str, str, Any]]:
    for table in report.tables:
        name, *figures = table.columns
        for record in table.records:
            for column in figures:
                yield table.title, name.value(record), column.title.strip(), column.unit, column.value(record)
    for what, value in {"version": __version__, **plain(settings)}.items():
        yield "made with", what, "", "", value


def _say(console: Console, text: str, style: str | None = None) -> None:
    console.print(text, style=style, markup=False, highlight=False)


def _say_where(console: Console, what: str, path: Path) -> None:
    console.print(f"{what:<8} {path}", markup=False, highlight=False, soft_wrap=True)


@contextmanager
def progress_lines(console: Console) -> Iterator[Begin]:
    """Show how far the work is, and how long it will take, while the block runs; nothing stays behind."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        preparing = bar.add_task("preparing", total=None)

        def begin(what: str, total: int) -> Advance:
            bar.update(preparing, visible=False)
            line = bar.add_task(what, total=total)
            return lambda done: bar.update(line, completed=done)

        yield begin


def chosen_names(names: Sequence[str], known: Iterable[str], what: str) -> tuple[str, ...]:
    """Return names, each once; all known ones for "all".

    Raises:
        UsageError: an unknown name, or none; `what` says what they name.
    """
    known = tuple(known)
    if tuple(names) == ("all",):
        return known
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise UsageError(f"{what}: wanted all, or some of {', '.join(known)}, got {', '.join(unknown) or 'none'}")
    return tuple(dict.fromkeys(names))
