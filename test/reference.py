"""The files that are made from the code: config/nodes.yaml and the reference pages in docs/.

`python test/reference.py` writes them again; test/nodes/test_settings.py fails where they differ from the code.
"""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
import re
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

import humanpred_ros as hp
from humanpred_ros import nodes, plugins, topics
from humanpred_ros.cli import COMMANDS, flag, settings_of, shown
from humanpred_ros.human.skeletons import Skeleton
from humanpred_ros.occupancy.predictor import predictor_type
from humanpred_ros.recognition.classifier import classifier_type
from humanpred_ros.robot.robot_file import RobotFile
from humanpred_ros.robot.scene_file import SceneFile
from humanpred_ros.robot.sections import Section
from humanpred_ros.settings import Settings, facts_of
from humanpred_ros.stomp.costs import CostTerm

REPOSITORY = Path(__file__).resolve().parents[1]
MADE = "Made from the code by `python test/reference.py`."


def node_settings() -> dict[str, type[Settings]]:
    """Return the settings class of every node, by the name of its executable."""
    found = {}
    for info in pkgutil.iter_modules(nodes.__path__):
        module = importlib.import_module(f"{nodes.__name__}.{info.name}")
        settings = getattr(module, f"{info.name.title().replace('_', '')}Settings", None)
        if hasattr(module, "main") and settings is not None:  # an executable of several nodes has none of its own
            found[info.name] = settings
    return found


def command_settings() -> dict[str, type[Settings]]:
    """Return the settings class of every command of `humanpred`, by its words."""
    return {words: settings_of(words) for words in COMMANDS}


def plugin_settings() -> dict[str, type[Settings]]:
    """Return the settings class of every built-in classifier, predictor and cost term that has settings, by name."""
    found = {name: classifier_type(name).settings_type for name in plugins.names(plugins.CLASSIFIERS)}
    found |= {name: predictor_type(name).settings_type for name in plugins.names(plugins.PREDICTORS)}
    for name in plugins.names(plugins.COST_TERMS):
        found[name] = plugins.load(plugins.COST_TERMS, name, CostTerm).settings_type
    return {name: kind for name, kind in found.items() if kind.model_fields}


def flattened(settings: type[Settings] | Settings, prefix: str) -> Iterator[tuple[str, Any, Any]]:
    """Give path, default and field of each setting; those of settings within settings with a longer path."""
    kind = settings if isinstance(settings, type) else type(settings)
    for key, field in kind.model_fields.items():
        default = field.default if isinstance(settings, type) else getattr(settings, key)
        if isinstance(default, Settings):
            yield from flattened(default, f"{prefix}.{key}")
        else:
            yield f"{prefix}.{key}", default, field


def range_of(field: Any) -> str:
    """Return the range of a field in words, empty if it has none."""
    low, high = (
        value if value is None else f"{value:.10g}" for value in (facts_of(field)["low"], facts_of(field)["high"])
    )
    if low is None or high is None:
        return f"from {low}" if low else f"to {high}" if high else ""
    return f"{low} to {high}"


def nodes_yaml() -> str:
    """Return a parameter file with every parameter of every node, its default and what it is."""
    lines = [
        "# Every parameter of every node with its default, made from the code by: python test/reference.py",
        "# Use: ros2 run humanpred_ros stomp_planner --ros-args --params-file nodes.yaml",
    ]
    for name, settings_type in node_settings().items():
        lines += ["", f"{name}:", "  ros__parameters:"]
        for key, field in settings_type.model_fields.items():
            text = str(field.description)
            if range_of(field):
                text += f"; {range_of(field)}"
            if facts_of(field)["changeable"]:
                text += "; may be changed while the node runs"
            lines += textwrap.wrap(text, 112, initial_indent="    # ", subsequent_indent="    # ")
            lines.append(f"    {key}: {json.dumps(field.default)}")
    return "\n".join(lines) + "\n"


def table(rows: list[tuple[str, ...]]) -> list[str]:
    """Return rows as a Markdown table, the first as its head."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:], ""]


def settings_markdown() -> str:
    """Return the reference of all parameters, and of what plug-ins may be told."""
    lines = [
        "# Settings",
        "",
        f"{MADE} The flags of `humanpred` are on the page of [commands](commands.md).",
        "",
        "## Nodes",
        "",
        "Parameters are given as `--ros-args -p NAME:=VALUE`, or in a file like `config/nodes.yaml`.",
        "Those marked with * may be changed while the node runs.",
        "",
    ]
    for name, settings_type in node_settings().items():
        rows: list[tuple[str, ...]] = [("parameter", "default", "range", "what it is")]
        for key, field in settings_type.model_fields.items():
            mark = " *" if facts_of(field)["changeable"] else ""
            rows.append((f"`{key}`{mark}", f"`{json.dumps(field.default)}`", range_of(field), str(field.description)))
        lines += [f"### `{name}`", "", *table(rows)]
    lines += ["## Classifiers, predictors and cost terms", ""]
    lines += ["Set as `--set NAME.SETTING=VALUE` by `humanpred demo` and `train`, and as parameters of the nodes.", ""]
    for name, kind in plugin_settings().items():
        rows = [("setting", "default", "range", "what it is")]
        for path, default, field in flattened(kind, name):
            rows.append((f"`{path}`", f"`{shown(default)}`", range_of(field), str(field.description)))
        lines += [f"### `{name}`", "", *table(rows)]
    return "\n".join(lines).rstrip("\n") + "\n"


def commands_markdown() -> str:
    """Return the reference of all commands and their flags."""
    rows: list[tuple[str, ...]] = [("command", "what it does")]
    for words, (_, text) in COMMANDS.items():
        rows.append((f"[`humanpred {words}`](#humanpred-{words.replace(' ', '-')})", text))
    lines = ["# Commands", "", MADE, "", *table(rows)]
    lines += [
        "Exit status: 0 done, 1 a check found a problem, 2 bad input (one line says what was wanted, what came and",
        "what to do), 130 interrupted. `--json FILE` and `--csv FILE` write tables, `--plot FILE` pictures.",
        "",
    ]
    for words, settings_type in command_settings().items():
        rows = [("flag", "default", "range", "what it is")]
        for key, field in settings_type.model_fields.items():
            default = "" if field.is_required() else f"`{shown(field.default)}`"
            rows.append((f"`{flag(settings_type, key)}`", default, range_of(field), str(field.description)))
        lines += [f"## `humanpred {words}`", "", COMMANDS[words][1][:1].upper() + COMMANDS[words][1][1:] + ".", ""]
        lines += table(rows) if len(rows) > 1 else []
    return "\n".join(lines).rstrip("\n") + "\n"


#: A publisher made in a node: the type of its messages, and the name or function in `topics`.
_PUBLISHER = re.compile(r"create_publisher\(\s*(\w+),\s*topics\.(\w+)(\(\w+\))?")
#: Nodes that damage, measure or look on.
_NOT_OURS = ("fault_", "bench", "live_view", "fuzzing", "occupancy_replay")


def topics_markdown() -> str:
    """Return the reference of what the nodes publish, found where they make their publishers."""
    found: dict[str, tuple[str, set[str]]] = {}
    for source in sorted(Path(next(iter(nodes.__path__))).glob("*.py")):
        if any(part in source.stem for part in _NOT_OURS):
            continue
        module = importlib.import_module(f"{nodes.__name__}.{source.stem}")
        for kind, name, of_body in _PUBLISHER.findall(source.read_text(encoding="utf-8")):
            named = getattr(topics, name)
            message = getattr(module, kind)
            where = found.setdefault(
                named("<id>") if of_body else named, (f"{message.__module__.split('.')[0]}/{message.__name__}", set())
            )
            where[1].add(source.stem)
    rows: list[tuple[str, ...]] = [("topic", "type", "made in")]
    rows += [
        (f"`{topic}`", kind, ", ".join(f"`nodes/{one}.py`" for one in sorted(where)))
        for topic, (kind, where) in sorted(found.items())
    ]
    head = "Relative names stand below the node's namespace. [The graph](graph.md) says what each is for."
    return "\n".join(["# Topics and types", "", MADE, head, "", *table(rows)]).rstrip("\n") + "\n"


def files_markdown() -> str:
    """Return the reference of scene, robot and skeleton files."""
    lines = [
        "# Files",
        "",
        MADE,
        "Angles stand under `NAME_rad` or `NAME_deg`, never both; unknown keys are refused.",
        "",
    ]
    kinds: tuple[tuple[str, type[Section] | type[Settings], str], ...] = (
        ("Scenes", SceneFile, "`config/scenes/*.yaml`, or your own; `humanpred scene schema` prints it for editors."),
        ("Robots", RobotFile, "`config/robots/*.yaml`, or your own; checked by `humanpred robot check FILE`."),
        (
            "Skeletons of trackers",
            Skeleton,
            "`config/skeletons/*.yaml`, or your own; `like: NAME` takes what is left out.",
        ),
    )
    for title, kind, text in kinds:
        lines += [f"## {title}", "", text, ""]
        waiting: list[tuple[str, Any]] = [("", kind)]
        while waiting:
            where, section = waiting.pop(0)
            rows: list[tuple[str, ...]] = [("key", "needed", "what it is")]
            for key, field in section.model_fields.items():
                inner = next(_sections(field.annotation), None)
                told = str(field.description or (inspect.getdoc(inner) if inner else "") or "").split("\n\n")[0]
                if inner is not None:
                    waiting.append((f"{where}.{key}".lstrip("."), inner))
                rows.append((f"`{key}`", "yes" if field.is_required() else "", told))
            if where:
                lines += [f"### {title}: `{where}`", "", str(inspect.getdoc(section)).split("\n\n")[0], ""]
            lines += table(rows)
    return "\n".join(lines).rstrip("\n") + "\n"


def _sections(kind: Any) -> Iterator[type[Section]]:
    """Give the sections within a type."""
    if isinstance(kind, type) and issubclass(kind, Section):
        yield kind
    for part in get_args(kind) if get_origin(kind) is not None or get_args(kind) else ():
        yield from _sections(part)


def api_markdown() -> str:
    """Return the reference of the public names, with what their docstrings say of shapes and units."""
    lines = [
        "# Python interface",
        "",
        MADE,
        "`import humanpred_ros as hp`; arrays are NumPy's, lengths metres, angles radians.",
        "",
    ]
    for name in hp.__all__:
        thing = getattr(hp, name)
        lines += [f"## `{name}`", "", *_code(f"hp.{name}", thing), *_told(thing), ""]
        for key, member in inspect.getmembers(thing) if inspect.isclass(thing) else ():
            own = any(key in vars(base) for base in thing.__mro__ if base.__module__.startswith("humanpred_ros"))
            if key.startswith("_") or not own or not inspect.getdoc(member):
                continue
            if callable(member):
                lines += [f"### `{name}.{key}`", "", *_code(key, member), *_told(member), ""]
            elif isinstance(member, property):
                lines += [f"### `{name}.{key}`", "", *_told(member), ""]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(lines)).rstrip("\n") + "\n"


def _code(name: str, thing: Any) -> list[str]:
    try:
        signature = str(inspect.signature(thing))
    except (TypeError, ValueError):
        return []
    if " object at 0x" in signature or len(signature) > 1500:
        return []
    plain = re.sub(r"(: |-> )'([^']*)'", r"\1\2", f"{name}{signature}")
    return [
        "```python",
        re.sub(r"(numpy\.typing|collections\.abc|humanpred_ros(\.\w+)*)\.(?=\w)", "", plain),
        "```",
        "",
    ]


def _told(thing: Any) -> list[str]:
    """Return a docstring as Markdown: its sections become lists."""
    lines = []
    for line in (inspect.getdoc(thing) or "").split("\n"):
        if re.fullmatch(r"(Args|Returns|Raises|Attributes|Yields):", line):
            lines += ["", f"**{dict(Args='Arguments').get(line[:-1], line[:-1])}**", ""]
        elif re.match(r"    [\w, ]+: ", line):
            what, _, text = line.strip().partition(": ")
            lines.append(f"- `{what}`: {text}")
        else:
            lines.append(re.sub(r"^    +", "  ", line))
    return lines


#: What is made, and by what.
FILES: dict[Path, Callable[[], str]] = {
    REPOSITORY / "config" / "nodes.yaml": nodes_yaml,
    REPOSITORY / "docs" / "settings.md": settings_markdown,
    REPOSITORY / "docs" / "commands.md": commands_markdown,
    REPOSITORY / "docs" / "topics.md": topics_markdown,
    REPOSITORY / "docs" / "files.md": files_markdown,
    REPOSITORY / "docs" / "api.md": api_markdown,
}

if __name__ == "__main__":
    for path, make in FILES.items():
        path.write_text(make(), encoding="utf-8")
