"""The files that are made from settings: config/nodes.yaml and docs/settings.md.

`python test/reference.py` writes them again; test/nodes/test_settings.py fails where they differ from the code.
"""

from __future__ import annotations

import importlib
import json
import pkgutil
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_type_hints

from humanpred_ros import nodes, plugins
from humanpred_ros.cli import COMMANDS, flag, shown
from humanpred_ros.occupancy.predictor import predictor_type
from humanpred_ros.recognition.classifier import classifier_type
from humanpred_ros.settings import Settings, facts_of
from humanpred_ros.stomp.costs import CostTerm

REPOSITORY = Path(__file__).resolve().parents[1]
YAML, MARKDOWN = REPOSITORY / "config" / "nodes.yaml", REPOSITORY / "docs" / "settings.md"


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
    found = {}
    for words, (where, _) in COMMANDS.items():
        module, function = where.split(":")
        hints = get_type_hints(getattr(importlib.import_module(f"humanpred_ros.{module}"), function))
        found[words] = next(iter(hints.values()))
    return found


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
    """Return the reference of all parameters and flags."""
    lines = [
        "# Settings",
        "",
        "Every parameter of the nodes and every flag of `humanpred`, made from the code by `python test/reference.py`.",
        "",
        "## Nodes",
        "",
        "Parameters are given as `--ros-args -p NAME:=VALUE`, or in a file like [nodes.yaml](../config/nodes.yaml).",
        "Those marked with * may be changed while the node runs.",
        "",
    ]
    for name, settings_type in node_settings().items():
        rows: list[tuple[str, ...]] = [("parameter", "default", "range", "what it is")]
        for key, field in settings_type.model_fields.items():
            mark = " *" if facts_of(field)["changeable"] else ""
            rows.append((f"`{key}`{mark}", f"`{json.dumps(field.default)}`", range_of(field), str(field.description)))
        lines += [f"### `{name}`", "", *table(rows)]
    lines += ["## Commands", ""]
    for words, settings_type in command_settings().items():
        rows = [("flag", "default", "range", "what it is")]
        for key, field in settings_type.model_fields.items():
            default = "" if field.is_required() else f"`{shown(field.default)}`"
            rows.append((f"`{flag(settings_type, key)}`", default, range_of(field), str(field.description)))
        lines += [f"### `humanpred {words}`", "", COMMANDS[words][1][:1].upper() + COMMANDS[words][1][1:] + ".", ""]
        lines += table(rows)
    lines += ["## Classifiers, predictors and cost terms", ""]
    lines += ["Set as `--set NAME.SETTING=VALUE` by `humanpred demo` and `train`, and as parameters of the nodes.", ""]
    for name, kind in plugin_settings().items():
        rows = [("setting", "default", "range", "what it is")]
        for path, default, field in flattened(kind, name):
            rows.append((f"`{path}`", f"`{shown(default)}`", range_of(field), str(field.description)))
        lines += [f"### `{name}`", "", *table(rows)]
    return "\n".join(lines).rstrip("\n") + "\n"


if __name__ == "__main__":
    YAML.write_text(nodes_yaml(), encoding="utf-8")
    MARKDOWN.write_text(settings_markdown(), encoding="utf-8")
