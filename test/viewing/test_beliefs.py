"""What movements of the human were taken for, and how probable it was that they are of no known class."""

from __future__ import annotations

import dataclasses
import io
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from humanpred_ros.viewing.analysis import RunSummary, analyse
from humanpred_ros.viewing.key_figures import print_summary
from humanpred_ros.viewing.recorded import PosteriorTrack
from humanpred_ros.viewing.run import Run, read_run

REACH_S = 1.65


def printed(summary: RunSummary) -> str:
    stream = io.StringIO()
    print_summary(summary, Console(file=stream, width=200, color_system=None))
    return stream.getvalue()


def test_what_was_believed_in_the_end_is_told_with_its_beginning(full: Run, full_summary: RunSummary) -> None:
    (belief,) = full_summary.beliefs
    of_reach = full.posterior.probability[full.posterior.t_s <= REACH_S + 1e-6]
    assert belief.best_class == full.posterior.labels[int(of_reach[-1].argmax())] == "3"
    assert belief.probability == of_reach[-1, 3]
    assert belief.until_s == pytest.approx(REACH_S)
    k = int(np.flatnonzero(full.posterior.t_s == belief.since_s)[0])
    assert (of_reach[k:].argmax(axis=1) == 3).all()
    assert of_reach[k - 1].argmax() != 3
    assert f"class 3, most probable from {belief.since_s:.2f} s on" in printed(full_summary)


def test_at_rest_afterwards_nothing_is_recognised(full: Run, full_summary: RunSummary) -> None:
    """A recogniser that starts anew when the person rests does not take its recognition back."""
    probability = full.posterior.probability.copy()
    probability[full.posterior.t_s > REACH_S + 1e-6] = np.linspace(0.2, 0.05, 8)
    fresh = dataclasses.replace(full, posterior=dataclasses.replace(full.posterior, probability=probability))
    summary = analyse(fresh).summary
    assert summary.beliefs == full_summary.beliefs
    assert summary.recognised == full_summary.recognised


def test_movements_with_rest_between_are_told_apart(full: Run) -> None:
    """At rest a stream's posterior is a prior that knows all classes as equal; the return is no reach any more."""
    t_s, probability = full.posterior.t_s, full.posterior.probability.copy()
    probability[(t_s < 0.3) | ((t_s > 0.9) & (t_s < 1.1))] = 1.0 / 8.0
    probability[t_s >= 1.1] = 0.01 * np.eye(8)[6] + 0.001
    run = dataclasses.replace(full, posterior=dataclasses.replace(full.posterior, probability=probability))
    summary = analyse(run).summary
    reach, back = summary.beliefs
    assert (reach.best_class, reach.rather_unknown) == ("3", False)
    assert 0.3 <= reach.from_s <= reach.since_s < reach.until_s <= 0.9
    assert (back.best_class, back.rather_unknown) == ("6", True)
    assert back.unknown == pytest.approx(1.0 - 0.018)
    assert back.from_s == back.since_s >= 1.1
    assert summary.recognised is not None
    assert summary.recognised.t_s == reach.since_s
    assert f"at most {100.0 * back.unknown_max:.0f} % at {back.unknown_max_s:.2f} s" in printed(summary)
    at_rest = next(row for row in summary.steps if row.t_s < 0.3)
    assert (at_rest.best_class, at_rest.best_probability) == (None, None)


def test_who_never_leaves_rest_is_not_recognised(full: Run) -> None:
    prior = np.full_like(full.posterior.probability, 1.0 / 8.0)
    summary = analyse(
        dataclasses.replace(full, posterior=dataclasses.replace(full.posterior, probability=prior))
    ).summary
    assert summary.beliefs == ()
    assert re.search(r"reach recognised +no +true class 3", printed(summary))


def test_many_movements_are_listed_in_short(full_summary: RunSummary) -> None:
    many = dataclasses.replace(full_summary, beliefs=full_summary.beliefs * 9, recognised=None)
    assert "class 3, class 3, class 3, …" in printed(many)
    assert "each of 9 movements" in printed(many)


def test_probability_of_no_class_is_what_the_classes_leave(make_run: Callable[..., Path]) -> None:
    summary = analyse(read_run(make_run(unknown=0.4))).summary
    (belief,) = summary.beliefs
    assert belief.unknown == pytest.approx(0.4, abs=0.01)
    assert belief.unknown_max == pytest.approx(0.8, abs=0.02)
    assert belief.unknown_max_s == pytest.approx(REACH_S / 2.0, abs=0.02)
    assert f"{100.0 * belief.unknown:.0f} %" in printed(summary)
    assert f"at most {100.0 * belief.unknown_max:.0f} %" in printed(summary)


def test_recordings_without_a_probability_of_no_class_have_none(full: Run, full_summary: RunSummary) -> None:
    assert not full.posterior.unknown.any()
    assert [(belief.unknown, belief.unknown_max) for belief in full_summary.beliefs] == [(0.0, 0.0)]
    assert "no known class" not in printed(full_summary)


@given(
    st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3).filter(lambda parts: sum(parts) > 0.0), st.floats(0.0, 1.0)
)
def test_probability_of_no_class_is_a_probability(parts: list[float], known: float) -> None:
    sent = (np.array([parts]) / sum(parts) * known).astype(np.float32).astype(np.float64)
    track = PosteriorTrack(np.zeros(1), (0, 1, 2), sent, np.zeros((3, 3)))
    (unknown,) = track.unknown
    assert 0.0 <= unknown <= 1.0
    assert unknown == pytest.approx(1.0 - known, abs=1.1e-6)


def test_without_a_posterior_nothing_is_believed(make_run: Callable[..., Path]) -> None:
    summary = analyse(read_run(make_run(without=("/human_goals",), n_postures=12, held=0))).summary
    assert summary.beliefs == ()
    assert "most probable" not in printed(summary)
