"""What nodes tell of their inputs: ages, rates, refusals that are recent, and a line of log once per change."""

from __future__ import annotations

import pytest

from humanpred_ros.nodes import inputs
from humanpred_ros.nodes.inputs import Change, Input, Refusals, kind_of


def test_age_rate_and_latency_are_of_the_last_seconds() -> None:
    heard = Input("/joints", max_age_s=0.5)
    assert heard.facts(100.0) == {"age_s": "none came"}
    assert not heard.silent(100.0), "what never came is waited for before a node is ready, not after"
    for k in range(1000):
        heard.handled(10.0 + 0.01 * k, 0.05 if k < 500 else 0.002)
    facts = heard.facts(20.0)
    assert float(facts["age_s"]) == pytest.approx(0.01)
    assert float(facts["rate_hz"]) == pytest.approx(100.0, rel=0.01)
    assert (facts["latency_ms"], facts["latency_largest_ms"]) == ("2.00", "2.00")
    assert not heard.silent(20.0)
    assert heard.silent(20.6)
    assert float(heard.facts(21.0)["rate_hz"]) < 70.0
    assert heard.facts(30.0) == {"age_s": "10.010", "rate_hz": "0.0"}


def test_silence_names_whether_somebody_publishes() -> None:
    heard = Input("/joints", max_age_s=0.5)
    assert "nobody publishes" in heard.silence()
    heard.publishers = lambda: 1
    assert "its publisher is there, but nothing has arrived" in heard.silence()
    assert heard.silence(0.5).endswith(f"for longer than {0.5 * heard.max_age_s:g} s")


def come(heard: Input, begin_s: float, end_s: float, clock_s: float, way_s: float = 0.02) -> None:
    """Let 30 messages a second come over a way with jitter from a host whose clock is ahead by `clock_s`."""
    for k in range(round(30 * (end_s - begin_s))):
        sent_s = begin_s + k / 30
        came_s = sent_s + way_s + 0.01 * (k % 3)
        heard.came(came_s, round((1e6 + sent_s + clock_s) * 1e9), round((1e6 + came_s) * 1e9))


def test_the_clock_of_another_host_is_measured_and_named() -> None:
    heard = Input("/joints")
    come(heard, 0.0, 3.0, 0.0)
    assert heard.clock() == ""
    come(heard, 3.0, 6.0, 0.8)
    assert heard.clock() == "the clock of the host that publishes /joints is 0.78 s ahead of this host's"
    heard.handled(6.0, 0.0)
    assert heard.facts(6.1)["delay_by_clocks_ms"] == "-780.00"
    come(heard, 6.0, 9.0, -0.8)
    assert "0.82 s behind this host's, or its messages take so long" in heard.clock()
    come(heard, 9.0, 12.0, 0.0)
    assert heard.clock() == "", "it was set right"


def test_a_message_that_waited_or_came_while_a_clock_was_set_says_nothing_of_clocks() -> None:
    heard = Input("/joints")
    heard.came(0.0, round(1e15), round(1e15) + 3600 * 10**9)  # latched an hour ago
    assert heard.clock() == ""
    come(heard, 0.0, 3.0, 0.0)
    heard.came(3.0, round(1e15 + 8e9), round(1e15 + 3e9))
    come(heard, 3.0, 6.0, 0.0)
    assert heard.clock() == ""


def test_refusals_are_logged_when_they_begin_again_and_counted_always(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(inputs.time, "monotonic", lambda: now[0])
    refusals = Refusals()
    lines = []
    for second in range(10):
        now[0] = float(second)
        lines.append(refusals.add(f"stamp ahead: {second} s"))
        lines.append(refusals.add("not finite: NaN") if second == 4 else "")
    assert [line for line in lines if line] == ["refused stamp ahead: 0 s", "refused not finite: NaN"]
    assert refusals.recent()
    now[0] = 14.5
    assert not refusals.recent()
    assert refusals.add("stamp ahead: 7 s") == "refused stamp ahead: 7 s (after 9 others of this kind, not logged)"
    assert refusals.counts == {"stamp ahead": 11, "not finite": 1}


def test_a_kind_has_no_numbers_and_no_foreign_control_characters() -> None:
    assert kind_of("trajectory point 17: wanted 7 positions, got 3") == "trajectory point #"
    assert kind_of("red costs 0.12e-3, blue -4") == "red costs #, blue #"
    assert kind_of("a\nb\x1b[31mc: d").isprintable()
    assert len(kind_of("x " * 10**6)) < 3000


def test_a_change_is_told_once_and_flickering_not_at_all() -> None:
    change = Change()
    kinds = "aaabbbaab" + "c"
    assert [change.to(kind, 0.1 * k) for k, kind in enumerate(kinds)] == [
        kind in "abc" and k in (0, 3, 9) for k, kind in enumerate(kinds)
    ]
    assert change.to("a", 5.0)
    assert not change.to("a", 50.0)
    assert change.to("b", -5.0), "a clock that was set back hides nothing"
