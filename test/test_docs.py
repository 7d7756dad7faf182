"""The pages in docs/ do what they say: their programs run, their commands exist, the messages they quote are said."""

from __future__ import annotations

import ast
import re
import shlex
from pathlib import Path

import pytest
from paths import REPOSITORY

from humanpred_ros import cli

DOCS = REPOSITORY / "docs"
PAGES = [REPOSITORY / "README.md", *sorted(DOCS.rglob("*.md"))]
#: A fenced block: whether a comment before it says that it is run, its language, and the name of the file that it is.
_BLOCK = re.compile(r"(<!-- runs -->\n)?^ *```(\w+)(?: ([\w.]+))?\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
_LINK = re.compile(r"\]\(([^)#\s]*)(#[^)\s]*)?\)")


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def commands_in(text: str) -> list[str]:
    """Return the command lines of `humanpred` in blocks and in running text."""
    text = text.replace("\\\n", " ")
    return sorted(set(re.findall(r"(?:^ *(?:\.venv/bin/)?|`)humanpred ([a-z][^`#\n]*)", text, flags=re.MULTILINE)))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_commands_are_understood_and_links_lead_somewhere(page: Path) -> None:
    for command in commands_in(text_of(page)):
        if "..." not in command and command.strip() not in {name.split()[0] for name in cli.COMMANDS} - {*cli.COMMANDS}:
            shown = re.sub(r" -- .*|\{png,svg,pdf\}", "", command)
            assert named(shown), f"humanpred {command}"
    for target, anchor in _LINK.findall(text_of(page)):
        if "://" not in target:
            there = (page.parent / target) if target else page
            assert there.exists(), target
            if anchor:
                assert anchor[1:] in anchors(there), f"{target}{anchor}"


def named(command: str) -> bool:
    """Return whether a command line can be read; one that is only named, without what it needs, must exist."""
    words = shlex.split(command)
    if " ".join(words[:2]) in cli.COMMANDS or words[0] in cli.COMMANDS:
        rest = words[2:] if " ".join(words[:2]) in cli.COMMANDS else words[1:]
        return not rest or callable(cli.parse(words)[0])
    return False


def anchors(page: Path) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", text_of(page), flags=re.MULTILINE)
    return {re.sub(r"[\s]+", "-", re.sub(r"[^\w\s-]", "", title.lower().strip())) for title in titles}


def test_readme_is_short_and_begins_with_the_two_commands() -> None:
    readme = text_of(REPOSITORY / "README.md")
    assert len(readme.splitlines()) <= 150
    first, second = re.findall(r"^```bash (\w+)\n(.+?)\n```", readme, flags=re.MULTILINE | re.DOTALL)[:2]
    assert first[0] == "demo"
    assert first[1].endswith("humanpred demo")
    assert second[0] == "test"
    assert second[1].endswith("pytest")


def test_every_node_and_topic_is_on_the_page_of_the_graph() -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: install the `ros` extra")
    from humanpred_ros import topics

    page = text_of(DOCS / "graph.md")
    for source in (REPOSITORY / "humanpred_ros" / "nodes").glob("*.py"):
        if "main = entry_point(" in source.read_text(encoding="utf-8"):
            assert f"`{source.stem}`" in page
    published = ("OCCUPANCY", "VOXEL_GRID", "HUMAN_GOALS", "JOINT_STATES", "TRAJECTORY", "DECISION")
    for name in (*published, "CANDIDATES", "ROLLOUTS"):
        assert f"`{getattr(topics, name)}`" in page
    for topic in (topics.human_joint_states("<id>"), topics.human_urdf("<id>"), topics.human_markers("<id>")):
        assert f"`{topic}`" in page


TUTORIALS = [
    page for page in sorted((DOCS / "tutorials").glob("*.md")) if re.search(r"```python|<!-- runs", text_of(page))
]


@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_tutorials_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks of a page are one session: Python, files, and the commands that are marked."""
    monkeypatch.chdir(tmp_path)
    session: dict[str, object] = {"__name__": "tutorial"}
    for runs, language, file, code in _BLOCK.findall(text_of(page)):
        if file:
            Path(file).write_text(code, encoding="utf-8")
        elif language == "python":
            exec(compile(code, str(page), "exec", dont_inherit=True), session)
        elif runs:
            for command in re.findall(r"^humanpred (.*)$", code, flags=re.MULTILINE):
                assert cli.main(shlex.split(command, comments=True)) == 0, command


def said_in_the_code() -> str:
    """Return all texts of the package's code, one per line; what is filled in is left out."""
    said = []
    for source in (REPOSITORY / "humanpred_ros").rglob("*.py"):
        for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = (part.value if isinstance(part, ast.Constant) else "\0" for part in node.values)
                said.append("".join(str(part) for part in parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                said.append(node.value)
    return "\n".join(said)


def test_quoted_messages_are_still_said() -> None:
    said = said_in_the_code()
    quoted = re.findall(r"^### `(.*)`$", text_of(DOCS / "troubleshooting.md"), flags=re.MULTILINE)
    assert len(quoted) > 20
    for message in quoted:
        missing = [part.strip() for part in message.split("...") if part.strip() not in said]
        assert not missing, f"{message}: {missing}"
