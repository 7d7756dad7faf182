"""Whatever the evaluation: its tables fit the screen uncut, its files are whole or not there, settings are checked."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from csv_libraries import write_csv_library
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from rich.console import Console
from small_library import small_library

from humanpred_ros import __version__
from humanpred_ros.errors import SettingsError, UsageError
from humanpred_ros.evaluation.framework import (
    Begin,
    Column,
    LibrarySettings,
    OutputSettings,
    Report,
    Table,
    chosen_names,
    present,
    print_report,
    print_table,
    progress_lines,
)

pytestmark = pytest.mark.core


def shown(table: Table, width: int = 80) -> list[str]:
    text = io.StringIO()
    print_table(table, Console(file=text, width=width))
    return text.getvalue().splitlines()


def drawn() -> Figure:
    figure = Figure()
    figure.add_subplot().plot([1, 2])
    return figure


FIGURES = Table.of_rows(
    "Figures [b]of[/b] two",
    ("recording", ("share", ".1%"), ("time", ".2f", "s"), ("never", "d"), "good"),
    [("1/0", 0.5, 1.0, None, True), ("1/1", float("nan"), 0.25, None, "none")],
)


def report() -> Report:
    return Report("A title", (FIGURES,), {"curve": np.array([1.0, np.nan])}, ("A note [b].",), drawn)


def test_a_table_shows_every_figure_with_its_unit_and_format() -> None:
    title, *_, first, second, _ = shown(FIGURES)
    assert title == "Figures [b]of[/b] two"
    assert first.split() == ["1/0", "50.0", "%", "1.00", "yes"]
    assert second.split() == ["1/1", "–", "0.25", "none"]
    assert {"time", "(s)", "share"} <= set(" ".join(shown(FIGURES)).split())


def test_figures_that_no_record_has_are_not_shown() -> None:
    assert "never" not in "\n".join(shown(FIGURES))


@settings(max_examples=30)
@given(
    st.integers(1, 40),
    st.integers(1, 30),
    st.integers(60, 200),
    st.sampled_from(["share recognised from", "x", "milliseconds [per] posture"]),
)
def test_no_cell_is_cut_however_many_records_and_figures(
    n_records: int, n_figures: int, width: int, title: str
) -> None:
    columns = [Column("recording", lambda k: f"recording_{k}")]
    columns += [Column(f"{title} {j}", lambda k, j=j: 1000 * k + j) for j in range(n_figures)]  # type: ignore[misc]
    lines = shown(Table("", range(n_records), columns), width)
    words = " ".join(lines).split()
    assert {str(1000 * k + j) for k in range(n_records) for j in range(n_figures)} <= set(words)
    assert {f"recording_{k}" for k in range(n_records)} <= set(words)
    assert max(map(len, lines)) <= width


def test_many_recordings_run_downwards_and_many_figures_of_few_do() -> None:
    columns = [Column("name", str), *(Column(f"figure {j}", lambda k: k, ".3f") for j in range(12))]
    many = shown(Table("", range(30), columns))
    few = shown(Table("", range(3), columns))
    assert sum(line.strip().startswith("29 ") for line in many) > 1  # figures in several tables below each other
    assert any(line.strip().startswith("figure 11") for line in few)


def test_files_hold_the_figures_the_tables_and_the_plot(tmp_path: Path) -> None:
    files = {"json": tmp_path / "[b]f.json", "csv": tmp_path / "t.csv", "plot": tmp_path / "p.svg"}
    text = io.StringIO()

    def measure(settings: OutputSettings, begin: Begin) -> Report:
        begin("parts", 1)(1)
        return report()

    assert present(OutputSettings(**files), Console(file=text, width=60), measure) == 0
    assert all(str(path) in text.getvalue() for path in files.values())
    figures = json.loads(files["json"].read_text(encoding="utf-8"))
    assert figures["curve"] == [1.0, None]
    assert figures["settings"]["csv"] == str(files["csv"])
    assert figures["machine"]["usable_cores"] >= 1
    rows = list(csv.reader(files["csv"].open(encoding="utf-8")))
    assert ["Figures [b]of[/b] two", "1/1", "time", "s", "0.25"] in rows
    assert ["made with", "version", "", "", __version__] in rows
    assert ["made with", "csv", "", "", str(files["csv"])] in rows
    assert files["plot"].read_text(encoding="utf-8").startswith("<?xml")
    assert len(list(tmp_path.iterdir())) == 3


def test_a_plot_that_fails_leaves_the_old_one_and_keeps_the_figures(tmp_path: Path) -> None:
    figures, plot = tmp_path / "f.json", tmp_path / "p.png"
    plot.write_bytes(b"old")

    def fail() -> Figure:
        raise KeyboardInterrupt

    def measure(settings: OutputSettings, begin: Begin) -> Report:
        return Report("", (), {"a": 1}, draw=fail)

    with pytest.raises(KeyboardInterrupt):
        present(OutputSettings(json=figures, plot=plot), Console(file=io.StringIO()), measure)
    assert plot.read_bytes() == b"old"
    assert json.loads(figures.read_text(encoding="utf-8"))["a"] == 1
    assert {entry.name for entry in tmp_path.iterdir()} == {"f.json", "p.png"}


@pytest.mark.parametrize(
    ("option", "name", "reason"),
    [
        ("json", "missing/f.json", "folder that exists"),
        ("csv", "missing/f.csv", "folder that exists"),
        ("plot", "missing/p.png", "folder that exists"),
        ("plot", "p.jpg", r"\.png or \.svg or \.pdf"),
    ],
)
def test_files_that_cannot_be_written_are_refused_before_any_work(
    option: str, name: str, reason: str, tmp_path: Path
) -> None:
    def measure(settings: OutputSettings, begin: Begin) -> Report:
        pytest.fail("worked")

    with pytest.raises(UsageError, match=f"{Path(name).name}: .*{reason}"):
        present(OutputSettings(**{option: tmp_path / name}), Console(file=io.StringIO()), measure)


def test_nothing_is_written_unasked() -> None:
    text = io.StringIO()
    print_report(report(), Console(file=text, width=60))
    assert text.getvalue().startswith("A title\n")
    assert text.getvalue().endswith("A note [b].\n")


def test_a_library_is_read_with_the_frame_period_that_was_given(tmp_path: Path) -> None:
    write_csv_library(small_library(n_classes=2, n_motions=1, n_frames=4), tmp_path / "lib")
    library = LibrarySettings(library=str(tmp_path / "lib"), frame_period=0.5).read_library()
    assert (library.name, len(library)) == ("lib", 2)
    assert library.motions[0].duration_s == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("name", "values"),
    [("library", {}), ("jobs", {"library": "a", "jobs": 0}), ("seed", {"library": "a", "seed": -1})],
)
def test_impossible_settings_are_refused_by_name(name: str, values: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=name):
        LibrarySettings(**values)


def test_names_come_in_order_each_once_and_all_means_every_known_name() -> None:
    assert chosen_names(("b", "a", "b"), "abc", "predictor") == ("b", "a")
    assert chosen_names(("all",), ["a", "b"], "predictor") == ("a", "b")


@pytest.mark.parametrize("names", [("oracle",), ("a", "oracle"), ()])
def test_unknown_names_are_refused_with_the_valid_ones(names: tuple[str, ...]) -> None:
    with pytest.raises(UsageError, match=f"predictor: .*a, b.*got .*{'oracle' if names else 'none'}"):
        chosen_names(names, ["a", "b"], "predictor")


def test_progress_shows_each_part_from_the_start_and_leaves_nothing_behind() -> None:
    text = io.StringIO()
    with progress_lines(Console(file=text, force_terminal=True, width=100, color_system=None)) as begin:
        assert "preparing" in text.getvalue()
        begin("motions", 7)(3)
        begin("classes", 2)(2)
    assert all(part in text.getvalue() for part in ("motions", "3/7", "2/2"))
    last = io.StringIO()
    with progress_lines(Console(file=last, width=100)) as begin:
        begin("motions", 7)(7)
    assert last.getvalue().strip() == ""
