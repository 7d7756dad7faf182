"""Whatever the experiment: files are refused before the work, written whole or not at all, and names are checked."""

from __future__ import annotations

import argparse
import importlib
import io
import json
from pathlib import Path

import numpy as np
import pytest
from csv_libraries import write_csv_library
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from small_library import small_library

from humanpred_ros import evaluation
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.options import (
    Outputs,
    add_library,
    add_outputs,
    names_in,
    progress_lines,
    read_library,
)

COMMANDS = sorted(path.parent.name for path in Path(evaluation.__path__[0]).glob("*/command.py"))
#: What a command cannot do without; the folders do not exist, so looking into them is an error of its own.
NEEDED = {"--library": "no/such/library", "--demos": "no/such/demos"}


def options_of(command: str, *given: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    importlib.import_module(f"humanpred_ros.evaluation.{command}.command").add_arguments(parser)
    known = parser.format_help()
    needed = [part for name, value in NEEDED.items() if name in known for part in (name, value)]
    return parser.parse_args([*needed, *given])


def run(command: str, options: argparse.Namespace) -> None:
    importlib.import_module(f"humanpred_ros.evaluation.{command}.command").run(options, Console(file=io.StringIO()))


def outputs_of(*given: str) -> Outputs:
    parser = argparse.ArgumentParser()
    add_outputs(parser, plot="draw it")
    return Outputs.of(parser.parse_args(given))


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_in_no_folder_is_refused_before_any_work(command: str, tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    with pytest.raises(UsageError, match="folder that exists"):
        run(command, options_of(command, "--json", str(missing / "figures.json")))
    if hasattr(options_of(command), "plot"):
        with pytest.raises(UsageError, match="folder that exists"):
            run(command, options_of(command, "--plot", str(missing / "plot.png")))
        with pytest.raises(UsageError, match=r"ends with \.png"):
            run(command, options_of(command, "--plot", str(tmp_path / "plot.jpg")))


def test_what_was_asked_for_is_written_and_named(tmp_path: Path) -> None:
    text, figures, plot = io.StringIO(), tmp_path / "[b]figures.json", tmp_path / "plot.png"

    def draw(path: Path) -> None:
        assert path != plot, "the plot has its name only when it is whole"
        path.write_bytes(b"drawn")

    outputs = outputs_of("--json", str(figures), "--plot", str(plot))
    outputs.write(Console(file=text, width=20), {"curve": np.array([1.0, np.nan])}, draw)
    assert text.getvalue() == f"figures  {figures}\nplot     {plot}\n"
    assert json.loads(figures.read_text(encoding="utf-8")) == {"curve": [1.0, None]}
    assert plot.read_bytes() == b"drawn"
    assert len(list(tmp_path.iterdir())) == 2


def test_nothing_is_written_unasked(tmp_path: Path) -> None:
    text = io.StringIO()
    outputs_of().write(Console(file=text), {}, lambda path: pytest.fail("drawn unasked"))
    assert text.getvalue() == ""


def test_a_plot_that_fails_leaves_the_old_one_and_keeps_the_figures(tmp_path: Path) -> None:
    figures, plot, text = tmp_path / "figures.json", tmp_path / "plot.png", io.StringIO()
    plot.write_bytes(b"old")

    def fail(path: Path) -> None:
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        outputs_of("--json", str(figures), "--plot", str(plot)).write(Console(file=text), {"a": 1}, fail)
    assert plot.read_bytes() == b"old"
    assert json.loads(figures.read_text(encoding="utf-8")) == {"a": 1}
    assert "plot" not in text.getvalue().replace(str(figures), "")
    assert {entry.name for entry in tmp_path.iterdir()} == {"figures.json", "plot.png"}


def test_a_command_that_draws_nothing_has_no_plot() -> None:
    parser = argparse.ArgumentParser()
    add_outputs(parser)
    assert Outputs.of(parser.parse_args([])) == Outputs(None, None)
    with pytest.raises(SystemExit):
        parser.parse_args(["--plot", "plot.png"])


def test_a_library_is_read_with_the_frame_period_that_was_given(tmp_path: Path) -> None:
    folder = tmp_path / "lib"
    write_csv_library(small_library(n_classes=2, n_motions=1, n_frames=4), folder)
    parser = argparse.ArgumentParser()
    add_library(parser)
    path, library = read_library(parser.parse_args(["--library", str(folder), "--frame-period", "0.5"]))
    assert (path, library.name, len(library)) == (folder, "lib", 2)
    assert library.motions[0].duration_s == pytest.approx(1.5)


def test_a_library_is_required_unless_one_is_the_default() -> None:
    required, optional = argparse.ArgumentParser(), argparse.ArgumentParser()
    add_library(required)
    add_library(optional, "synthetic_reaches")
    with pytest.raises(SystemExit):
        required.parse_args([])
    assert optional.parse_args([]).library == "synthetic_reaches"


@given(st.lists(st.text("abc_", min_size=1), max_size=6))
def test_names_come_in_order_each_once_whatever_blanks(names: list[str]) -> None:
    assert names_in(" , ".join(names)) == names_in(f",{','.join(names * 2)} ,") == tuple(dict.fromkeys(names))


def test_all_means_everything_where_there_is_an_everything() -> None:
    assert names_in(" all", {"a": 1, "b": 2}) == ("a", "b")
    assert names_in("b", {"a": 1, "b": 2}) == ("b",)
    assert names_in("all") == ("all",)


def test_progress_shows_each_part_and_leaves_nothing_behind() -> None:
    text = io.StringIO()
    with progress_lines(Console(file=text, force_terminal=True, width=100, color_system=None)) as begin:
        begin("motions", 7)(3)
        begin("classes", 2)(2)
    shown = text.getvalue()
    assert "motions" in shown
    assert "3/7" in shown
    assert "2/2" in shown
    last = io.StringIO()
    with progress_lines(Console(file=last, width=100)) as begin:
        begin("motions", 7)(7)
    assert last.getvalue().strip() == ""
