"""A CSV file is read as it was meant, or refused with the place where it is wrong; never misread."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from humanpred_ros.errors import HumanPredError, LibraryFormatError
from humanpred_ros.motion.csv_files import read_table

NAMES = ("a", "b", "c")
ROWS = np.array([[0.0, 1.0, 2.0, 3.0], [0.01, 4.0, -5.0, 6e-3], [0.02, 7.0, 8.0, 9.0]])
TEXT = "t,a,b,c\n" + "".join(",".join(map(repr, row)) + "\n" for row in ROWS.tolist())


def read(folder: Path, content: str | bytes) -> np.ndarray:
    path = folder / "x.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    table = read_table(path, ("t", *NAMES))
    return np.stack([table[column] for column in ("t", *NAMES)], axis=1)


@pytest.mark.parametrize(
    "content",
    [
        TEXT,
        TEXT.replace("\n", "\r\n"),
        "\ufeff" + TEXT,
        TEXT.replace("\n", "\n\n"),
        TEXT.rstrip("\n"),
        TEXT.replace("t,a,b,c", ' t, "a",b ,c'.replace(' "a"', " a")),
        TEXT.replace("t,a,b,c", '"t","a","b","c"'),
        TEXT.replace(",", ";"),
        TEXT.replace(",", ";").replace(".", ","),
        TEXT.replace(",", "\t"),
        "# by somebody\n% it's a table\n" + TEXT.replace("\n", "\n// more\n"),
        TEXT.replace("\n", ",\n"),
        TEXT.replace("t,a,b,c", "T [s],A,B (m),c [rad]"),
        "\n".join(f"9,{line},x" if k else f"more,{line},last" for k, line in enumerate(TEXT.splitlines())),
    ],
)
def test_harmless_differences_do_no_harm(tmp_path: Path, content: str) -> None:
    np.testing.assert_array_equal(read(tmp_path, content), ROWS)


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.integers(2, 6).flatmap(
        lambda n: hnp.arrays(np.float64, (n, 4), elements=st.floats(allow_nan=False, allow_infinity=False))
    ),
    st.permutations(range(4)),
)
def test_numbers_come_back_exactly_in_any_order_of_columns(tmp_path: Path, rows: np.ndarray, order: list[int]) -> None:
    header = ["t", *NAMES]
    text = ",".join(header[k] for k in order) + "\n"
    text += "".join(",".join(repr(float(row[k])) for k in order) + "\n" for row in rows)
    np.testing.assert_array_equal(read(tmp_path, text), rows)


@pytest.mark.parametrize(
    ("said", "content"),
    [
        ("empty", ""),
        ("empty", "\ufeff"),
        ("empty", "\r\n\r\n"),
        ("rows of numbers below the header, got none", "t,a,b,c\n"),
        (":1: columns missing: b;", TEXT.replace("a,b,c", "a,Bee,c")),
        (":1: column b [furlong]: wanted a unit among m,", TEXT.replace("a,b,c", "a,b [furlong],c")),
        (":1: columns missing: t;", TEXT.replace("t,a", "time,a")),
        ("begins with '0.0': it has to be the header", TEXT.split("\n", 1)[1]),
        ("begins with 't a b c'", TEXT.replace(",", " ")),
        ("begins with 'by somebody'", "by somebody\n" + TEXT),
        (":1: columns twice: b", "\n".join(f"{line},{line.split(',')[2]}" for line in TEXT.split())),
        (":2: wanted 4 fields, got 5", TEXT.replace("3.0\n", "3.0,\n")),
        (":4: wanted 4 fields, got 5", TEXT.replace("0.02,", "0,0.02,")),
        (":4: wanted 4 fields, got 2", TEXT.split("0.02")[0] + "0.02,7.0"),
        (":3: column a: wanted a number, got 'soon'", TEXT.replace("4.0", "soon")),
        (":3: column a: wanted a number, got ''", TEXT.replace("4.0", "")),
        (":3: column a: wanted a number, got '4_0.0'", TEXT.replace("4.0", "4_0.0")),
        (":3: column a: wanted a finite number, got nan", TEXT.replace("4.0", "NaN")),
        (":3: column a: wanted a finite number, got inf", TEXT.replace("4.0", "1e999")),
        ("could not be read", TEXT.encode("utf-16")),
        ("could not be read", TEXT.replace("a", "\u00e4").encode("latin-1")),
        ("number, got", TEXT.replace("4.0", "4\0.0")),
    ],
)
def test_what_would_be_misread_is_refused_with_its_place(tmp_path: Path, said: str, content: str | bytes) -> None:
    with pytest.raises(LibraryFormatError) as found:
        read(tmp_path, content)
    if said == "number, got" and "could not be read" in str(found.value):
        return  # Python 3.10 refuses such bytes earlier
    assert said in str(found.value)
    assert str(found.value).startswith(str(tmp_path / "x.csv"))


@pytest.mark.parametrize("make", [Path.mkdir, lambda path: None])
def test_folders_and_missing_files_are_refused(tmp_path: Path, make: Callable[[Path], None]) -> None:
    path = tmp_path / "x.csv"
    make(path)
    with pytest.raises(LibraryFormatError, match=r"x\.csv: .*could not be read"):
        read_table(path, NAMES)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.one_of(st.binary(max_size=60), st.text(alphabet="t,abc\n\r\"'0.1-e nif\0\ufeff;", max_size=60)))
def test_no_content_whatever_gives_a_traceback(tmp_path: Path, content: str | bytes) -> None:
    with contextlib.suppress(HumanPredError):
        assert np.isfinite(read(tmp_path, content)).all()


def test_gaps_are_nan_where_they_are_allowed(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("t,a,other\n0.0,,word\n0.1,nan,\n0.2,3.0,x\n")
    np.testing.assert_array_equal(read_table(path, ("t", "a"), gaps=True)["a"], [np.nan, np.nan, 3.0])
    with pytest.raises(LibraryFormatError, match=r":1: columns unknown: other"):
        read_table(path, ("t",), optional=("a",), gaps=True)
    path.write_text("t,a\n0.0,much\n")
    with pytest.raises(LibraryFormatError, match=r":2: column a: wanted a number, got 'much'"):
        read_table(path, ("t", "a"), gaps=True)
