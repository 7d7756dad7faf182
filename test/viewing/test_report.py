"""The report is one sound HTML file, whatever the run was like."""

from __future__ import annotations

import csv
import dataclasses
import re
import shlex
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humanpred_ros import __version__
from humanpred_ros.errors import UsageError
from humanpred_ros.viewing.analysis import Analysis, RunSummary, analyse
from humanpred_ros.viewing.figures import goal_colours, report_style, svg_of
from humanpred_ros.viewing.key_figures import key_figures
from humanpred_ros.viewing.plots_decisions import cost_terms_plot, goal_costs_plot, posterior_plot
from humanpred_ros.viewing.plots_space import snapshots_plot, top_view_plot
from humanpred_ros.viewing.plots_time import occupancy_plot
from humanpred_ros.viewing.reliability import reliability_plot
from humanpred_ros.viewing.report import render_report, reproduce_command, write_report
from humanpred_ros.viewing.run import Run, read_run
from humanpred_ros.viewing.saved_figures import save_figures

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """Collects what a sound page must have, and fails on tags that do not match."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.references: list[str] = []
        self.tags: set[str] = set()
        self.words = ""
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in VOID:
            self._open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("href", "xlink:href", "src"):
                self.references.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self._open or self._open[-1] not in ("style", "script"):
            self.words += data


@pytest.fixture(scope="module")
def text(analysis: Analysis) -> str:
    return render_report(analysis)


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def test_page_needs_nothing_else(page: Page, text: str) -> None:
    assert not page.tags & {"script", "link", "iframe", "object"}
    assert all(reference.startswith(("#", "data:")) for reference in page.references)
    assert not re.search(r"@import|url\((?!#)", text)


def test_links_lead_somewhere_and_ids_are_unique(page: Page) -> None:
    assert len(page.ids) == len(set(page.ids))
    for reference in page.references:
        assert reference.startswith("data:") or reference[1:] in page.ids


def test_every_plot_is_well_formed_and_scales(text: str) -> None:
    plots = re.findall(r"<svg\b.*?</svg>", text, flags=re.DOTALL)
    assert len(plots) == 10
    for svg in plots:
        root = ElementTree.fromstring(svg)
        assert "viewBox" in root.attrib
        assert "width" not in root.attrib


def test_page_tells_decisions_facts_and_topics(page: Page, full: Run, full_summary: RunSummary) -> None:
    for topic in full.topics:
        assert topic.name in page.words
    for value in full.facts.values():
        assert value in page.words
    for row in full_summary.steps:
        assert f"{row.t_s:.3f}" in page.words
    assert "in collision with the table at waypoint 31" in page.words
    assert "1 of 28 missed" in page.words
    assert "not safety-rated" in page.words


def test_same_run_gives_the_same_report(text: str, full: Run) -> None:
    assert render_report(analyse(full)) == text


def test_recorded_text_cannot_become_markup(full: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("humanpred_ros.viewing.report.draw_plots", lambda *parts: ())  # slow, and tested above
    evil = "<script>alert(1)</script> & <b>"
    decisions = tuple(dataclasses.replace(d, reason=evil) if d.goals else d for d in full.decisions)
    run = dataclasses.replace(full, facts={**full.facts, "operator": evil, "trajectory": evil}, decisions=decisions)
    page = Page(render_report(analyse(run)))
    assert "script" not in page.tags
    assert evil in page.words


def test_empty_run_gives_a_report_that_says_so(make_run: Callable[..., Path], tmp_path: Path) -> None:
    run = read_run(make_run(n_postures=0))
    write_report(analyse(run), tmp_path / "report.html")
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "Nothing was recorded" in page.words
    assert "No replanning step was recorded" in page.words


def test_report_is_replaced_as_a_whole_or_not_at_all(
    analysis: Analysis, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rendered = "new \N{GREEK SMALL LETTER PI}"
    monkeypatch.setattr("humanpred_ros.viewing.report.render_report", lambda *run: rendered)
    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    write_report(analysis, path)
    assert path.read_text(encoding="utf-8") == rendered
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(UsageError, match="cannot be written"):
        write_report(analysis, tmp_path / "no" / "report.html")


def test_command_to_repeat_is_one_the_command_line_takes(full: Run) -> None:
    from humanpred_ros.cli import parse

    facts = {**full.facts, "mode": "stepped", "library": "my reaches; rm -rf"}
    words = shlex.split(reproduce_command(dataclasses.replace(full, facts=facts)))
    assert words[0] == "humanpred"
    _, options = parse(words[1:])
    assert (options.scene, options.library, options.trajectory) == ("face_to_face", "my reaches; rm -rf", "3/2")
    assert (options.seed, options.real_time, options.predictor) == (7, None, "swept_volume")


def test_bad_news_is_marked(full_summary: RunSummary) -> None:
    def alarms(summary: RunSummary) -> set[str]:
        return {figure.name for figure in key_figures(summary) if figure.alarming}

    assert alarms(full_summary) == {"replanning steps"}
    assert full_summary.closest is not None
    touching = dataclasses.replace(full_summary.closest, distance_m=-0.01)
    worse = dataclasses.replace(full_summary, closest=touching, reached=None, peak_velocity=1.2)
    assert alarms(worse) == {"replanning steps", "closest to human", "goal reached", "fastest joint"}


def test_probabilities_are_compared_with_what_happened(page: Page, full_summary: RunSummary) -> None:
    assert "calibration" in page.ids
    assert "humanpred evaluate occupancy" in page.words
    part = full_summary.calibration["human moving"]
    (tile,) = [figure for figure in key_figures(full_summary) if "calibration" in figure.name]
    assert tile.value == f"{part.error:.2f}"
    assert part.missed is not None
    assert f"{100.0 * part.missed:.1f} % of the swept voxels" in tile.remark
    for row in part.bins:
        assert (f"{row.low:.2f} to {row.high:.2f}" in page.words) == (row.count > 0)
        assert row.count == 0 or str(row.count) in page.words


def test_without_occupancy_the_comparison_is_left_out_with_its_reason(
    make_run: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("humanpred_ros.viewing.report.draw_plots", lambda *parts: ())  # slow, and tested above
    run = read_run(make_run(without=("/human_occupancy",)))
    page = Page(render_report(analyse(run)))
    assert "calibration" not in page.ids
    assert "no occupancy was recorded" in page.words
    assert not any("calibration" in figure.name for figure in key_figures(analyse(run).summary))


def test_probability_of_no_class_is_shown_where_there_is_any(make_run: Callable[..., Path], full: Run) -> None:
    for run, shown in ((read_run(make_run(unknown=0.3, held=5)), True), (full, False)):
        analysis = analyse(run)
        summary = analysis.summary
        labels = posterior_plot(analysis).axes[0].get_legend_handles_labels()[1]
        assert ("no known class" in labels) == shown
        tiles = [figure for figure in key_figures(summary) if "no known class" in figure.name]
        assert [(tile.value, tile.alarming) for tile in tiles] == ([("30 %", False)] if shown else [])


def test_a_motion_that_is_rather_of_no_class_is_bad_news(full_summary: RunSummary) -> None:
    (first,) = full_summary.beliefs
    second = dataclasses.replace(
        first, best_class="7", probability=0.3, unknown=0.6, unknown_max=0.7, unknown_max_s=1.2
    )
    worse = dataclasses.replace(full_summary, beliefs=(first, second), recognised=None)
    (tile,) = [figure for figure in key_figures(worse) if figure.name == "probability of no known class"]
    assert (tile.value, tile.alarming) == ("0 %, 60 %", True)
    assert "at most 70 % at 1.20 s" in tile.remark
    (tile,) = [figure for figure in key_figures(worse) if figure.name == "reach recognised"]
    assert tile.value == "class 3, none"
    endless = dataclasses.replace(worse, beliefs=(second,) * 20)
    assert {"none, none, none, …", "60 %, 60 %, 60 %, …"} <= {figure.value for figure in key_figures(endless)}


def test_reliability_plot_survives_few_bins(full_summary: RunSummary) -> None:
    part = full_summary.calibration["human moving"]
    bins = tuple(dataclasses.replace(row, count=0, probability=None, observed=None) for row in part.bins)
    empty = dataclasses.replace(part, bins=bins, voxels=0, error=None, missed=None)
    single = dataclasses.replace(part, bins=(*bins[:-1], part.bins[-1]), voxels=part.bins[-1].count)
    with report_style():
        for calibration in ({"human moving": empty}, {"human moving": single, "another part": part}):
            ElementTree.fromstring(svg_of(reliability_plot(calibration), "plot"))


def test_plots_survive_costs_that_are_zero_missing_or_alone(full: Run) -> None:
    step = full.steps[0]
    goals = tuple(dataclasses.replace(goal, selection_cost=float("nan"), valid=False) for goal in step.goals)
    free = tuple(dataclasses.replace(goal, selection_cost=0.0, terms={"obstacle": 0.0}) for goal in step.goals)
    for changed in ((dataclasses.replace(step, goals=goals),), (dataclasses.replace(step, goals=free, chosen=""),)):
        run = dataclasses.replace(full, decisions=changed)
        with report_style():
            for draw in (goal_costs_plot, cost_terms_plot):
                ElementTree.fromstring(svg_of(draw(analyse(run)), "plot"))


def test_plots_survive_a_run_without_its_scene_or_lattice(full: Run) -> None:
    bare = dataclasses.replace(full, facts={}, occupancy=dataclasses.replace(full.occupancy, grid=None))
    analysis = analyse(bare)
    with report_style():
        for figure in (
            top_view_plot(analysis),
            snapshots_plot(analysis),
            occupancy_plot(analysis),
        ):
            ElementTree.fromstring(svg_of(figure, "plot"))


@given(st.lists(st.text(alphabet="abcdefgh_ ", min_size=1), min_size=1, max_size=8, unique=True))
def test_goals_can_be_told_apart(names: list[str]) -> None:
    colours = goal_colours(names)
    assert list(colours) == names
    assert len(set(colours.values())) == len(names)


def test_goals_named_after_colours_have_them() -> None:
    colours = goal_colours(["red", "blue cup", "shelf"])
    rgb = {name: np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) for name, colour in colours.items()}
    assert rgb["red"].argmax() == 0
    assert rgb["blue cup"].argmax() == 2
    assert len(set(colours.values())) == 3


def test_figures_are_saved_for_a_paper_with_what_they_were_made_with(full_folder: Path, tmp_path: Path) -> None:
    save_figures(full_folder, tmp_path / "figures", "svg", 7.0)
    files = sorted((tmp_path / "figures").glob("*.svg"))
    assert len(files) == 10
    for file in files:
        width = float(re.findall(r'width="([0-9.]+)pt"', file.read_text(encoding="utf-8"))[0])
        assert 0.3 * 7.0 < width / 72.0 < 7.2
    rows = list(csv.reader((tmp_path / "figures" / "decisions.csv").open(encoding="utf-8")))
    steps = read_run(full_folder).steps
    assert [row[0] for row in rows[1 : len(steps) + 1]] == [str(step.step) for step in steps]
    assert ["made with", "version", __version__] in rows
    with pytest.raises(UsageError, match="--figures: wanted a folder"):
        save_figures(full_folder, full_folder / "bag" / "metadata.yaml" / "x", "svg", 7.0)
