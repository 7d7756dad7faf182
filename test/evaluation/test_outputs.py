"""Results are written whole or not at all, as JSON that any program reads."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from small_library import small_library

from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.outputs import (
    check_writable,
    library_facts,
    machine_facts,
    plain,
    replacing,
    write_json,
)


@dataclass(frozen=True)
class Inner:
    curve: np.ndarray
    by_class: dict[int, float]


def test_plain_values_survive_json() -> None:
    value = {"a": Inner(np.array([[1.0, np.nan]]), {3: np.float64(0.5)}), "b": (np.int64(2), None, True, float("inf"))}
    expected = {"a": {"curve": [[1.0, None]], "by_class": {"3": 0.5}}, "b": [2, None, True, None]}
    assert plain(value) == expected
    assert json.loads(json.dumps(plain(value), allow_nan=False)) == expected


def test_json_is_readable_and_replaces_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    path.write_text("old", encoding="utf-8")
    value = {"curve": [0.25, -1e-7, None, 3], "names": ["1, 2", "x"], "nested": [[1, 2], [3, 4]]}
    write_json(path, value)
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == value
    assert "[ 0.25, -1e-07, null, 3 ]" in text
    assert [entry.name for entry in tmp_path.iterdir()] == ["figures.json"]


def test_a_failure_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    path = tmp_path / "plot.png"
    path.write_text("old", encoding="utf-8")

    def fail() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half", encoding="utf-8")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert path.read_text(encoding="utf-8") == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["plot.png"]


def test_where_nothing_can_be_written_is_said_beforehand(tmp_path: Path) -> None:
    assert check_writable(tmp_path / "a.json") == tmp_path / "a.json"
    with pytest.raises(UsageError, match="folder that exists"):
        check_writable(tmp_path / "no" / "a.json")
    with pytest.raises(UsageError, match="cannot"):
        check_writable(tmp_path)
    with pytest.raises(UsageError, match=r"\.png"):
        check_writable(tmp_path / "a.json", ".png")


def test_machine_facts_say_what_times_depend_on() -> None:
    assert set(machine_facts()) >= {"package_version", "python", "usable_cores"}


def test_library_facts_say_what_was_evaluated() -> None:
    library = small_library(n_classes=2, n_motions=3)
    facts = library_facts(library, held_out_together=5)
    assert list(facts) == ["name", "n_motions", "held_out_together", "provenance"]
    assert (facts["name"], facts["n_motions"], facts["held_out_together"]) == (library.name, 6, 5)
    assert library_facts(library, by_class=True)["motions_per_class"] == dict.fromkeys(library.labels, 3)
