"""What says the same in several places of the project says the same."""

from __future__ import annotations

import re
import subprocess

import pytest
from paths import REPOSITORY

from humanpred_ros import __version__

TEXTS = (".py", ".md", ".rst", ".yaml", ".yml", ".xml", ".cfg", ".toml", ".cff", ".txt", ".urdf", ".j2")


def tracked_texts() -> list[str]:
    listed = subprocess.run(["git", "ls-files"], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout")
    return [name for name in listed.stdout.split("\n") if name.endswith(TEXTS) and (REPOSITORY / name).is_file()]


def text_of(name: str) -> str:
    return (REPOSITORY / name).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("setup.py", r'version="(\S+)"'),
        ("package.xml", r"<version>(\S+)</version>"),
        ("CITATION.cff", r"^version: (\S+)"),
        ("CHANGELOG.rst", r"^(\d+\.\d+\.\d+) \("),
    ],
)
def test_the_version_is_the_same_everywhere(file: str, pattern: str) -> None:
    found = re.search(pattern, text_of(file), flags=re.MULTILINE)
    assert found is not None
    assert found.group(1) == __version__


def test_the_newest_version_of_the_changelog_has_the_date_of_the_citation() -> None:
    date = re.search(r"date-released: (\S+)", text_of("CITATION.cff"))
    assert date is not None
    assert f"{__version__} ({date.group(1)})" in text_of("CHANGELOG.rst")


def test_what_is_cited_is_in_the_repository() -> None:
    """The notes the project began with are not part of it: docs/papers.md is what docstrings cite."""
    outside = re.compile(r"facts,? (?:sections? )?\d|DESIGN\.md|facts: i")
    citing = [name for name in tracked_texts() if name.startswith("humanpred_ros/") and outside.search(text_of(name))]
    assert citing == []


def test_no_path_of_a_machine_is_committed() -> None:
    machine = re.compile(r"(?<![\w.])/(?:work|farm|root)/|/home/[a-z]")
    naming = [name for name in tracked_texts() if name != "test/test_project.py" and machine.search(text_of(name))]
    assert naming == []
