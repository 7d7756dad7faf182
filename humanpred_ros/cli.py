"""Early prediction of human reaches, and an arm that plans around them."""

from __future__ import annotations

import argparse
import importlib
import inspect
import io
import os
import re
import signal
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Literal, NoReturn, get_args, get_origin, get_type_hints

from rich.console import Console
from rich.text import Text

from humanpred_ros.errors import HumanPredError, SettingsError, UsageError, one_line, printable
from humanpred_ros.settings import Settings, facts_of, spelled

#: Width of tables that go to a file or another program.
_WIDTH_OF_FILES = 130
#: The words of each command, the function that carries it out (below this package), and what it does.
#: The function takes settings, whose class its annotation names, and a console; it returns the exit status. What an
#: evaluation measures is presented by `evaluation.framework`.
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("evaluation.demo:run", "replay, predict and plan over DDS, recorded to MCAP, with a report at the end"),
    "train": ("commands:train", "learn a model from a motion library"),
    "import": ("motion.commands:import_libraries", "turn motion libraries, or recordings of markers, into MCAP bags"),
    "record": ("nodes.record:record", "make a library of your own people, from the live tracker or a recording"),
    "generate": ("motion.commands:generate", "make a synthetic motion library by simulation"),
    "report": ("commands:report", "write the HTML report of a recorded run"),
    "view": ("viewing.playback:view", "play a recorded run in 3D in a browser"),
    "view live": ("nodes.live_view:run", "the running graph in 3D in a browser"),
    "replay": ("commands:replay", "feed a run's recorded occupancy to a fresh planner and compare its decisions"),
    "evaluate recognition": (
        "evaluation.recognition:measure",
        "how early and surely a reach is recognised (P1 Fig. 6)",
    ),
    "evaluate occupancy": ("evaluation.occupancy:measure", "predicted occupancy against the voxels really swept"),
    "evaluate streams": ("evaluation.streams:measure", "onsets, ends and recognition on long streams with pauses"),
    "evaluate interference": ("evaluation.interference:measure", "how much the arm disturbs the person (P1 Table I)"),
    "evaluate switching": ("evaluation.switching:measure", "when the arm changes its goal (P1 Fig. 9)"),
    "evaluate reaching": ("evaluation.reaching:measure", "predicted reaches against recorded (P2 Tables, Figs. 7, 10)"),
    "bench predictor": ("evaluation.predictor_bench:measure", "time per posture, and occupancies a second over DDS"),
    "bench planner": ("evaluation.planner_bench:measure", "time per goal beside the C++ floor"),
    "bench graph": ("evaluation.graph_bench:measure", "posture to trajectory over DDS at 30 Hz, per number of goals"),
    "bench link": ("evaluation.checkout_benches:link", "predictor and planner on two hosts, over a link that loses"),
    "bench tracker": ("nodes.tracker_bench:run", "how long a body tracker's points take to become a posture"),
    "bench view": ("evaluation.checkout_benches:view", "frames a second of the live view, and what it costs the nodes"),
    "bench soak": ("evaluation.checkout_benches:soak", "how the running graph holds out, with a fault now and then"),
    "bench faults": (
        "evaluation.checkout_benches:faults",
        "what the running graph does when something goes wrong",
    ),
    "bench fuzz": (
        "evaluation.checkout_benches:fuzz",
        "damaged files of every kind, damaged messages to every node",
    ),
    "robot check": ("evaluation.robot_check:run", "what an arm is made of, and how well its spheres cover its meshes"),
    "scene check": ("evaluation.scene_check:run", "plan every task of a scene once with nobody there, and draw it"),
    "scene schema": ("evaluation.scene_check:schema", "the JSON schema of scene files, for editors"),
    "doctor": ("nodes.doctor:run", "whether this machine has what is needed, and what to do about what it lacks"),
    "docs": ("viewing.documentation:docs", "show the documentation in a browser, without a network"),
    "completion": ("cli:completion", "completion of commands and flags for bash and zsh"),
    "bag check": ("commands:bag_check", "read a bag completely, with checksums"),
    "bag salvage": ("commands:bag_salvage", "copy what is intact in a damaged bag to a new one"),
}

Command = Callable[[Any, Console], int]


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return the exit status: 0 done, 1 a check found a problem, 2 bad input, 130 interrupted."""
    words = sys.argv[1:] if arguments is None else arguments
    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDTH_OF_FILES
    console = PlainConsole(width=width, markup=False, emoji=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not be text
    try:
        with _interruptible():
            if words[:1] in (["-h"], ["--help"], ["--version"]):
                print(_versions() if words[0] == "--version" else _overview(""))
                return 0
            run, settings = parse(words)
            return run(settings, console)
    except HumanPredError as error:
        print(f"humanpred: {error}", file=sys.stderr)
        return 2
    except (OSError, MemoryError) as error:  # of places to write that nobody checks, and of a machine that is full
        print(f"humanpred: {one_line(str(error)) or 'out of memory'}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("humanpred: interrupted", file=sys.stderr)
        return 130


class PlainConsole(Console):
    """A console that prints names and paths as they are: they may be a stranger's, and hold markup or commands."""

    def render_str(self, text: str, **how: Any) -> Text:
        return super().render_str(printable(text), **how)


def parse(words: Sequence[str]) -> tuple[Command, Any]:
    """Return the function that carries out a command line, and its settings; only its module is imported.

    Raises:
        UsageError: there is no such command; the message names those there are.
        SettingsError: a flag is unknown, has a value that cannot be used, or is missing.
        SystemExit: with status 0, after help was printed.
    """
    for length in (2, 1):
        name = " ".join(words[:length])
        if name in COMMANDS:
            return _parse_flags(name, COMMANDS[name][0], list(words[length:]))
    group = words[0] if words and any(name.startswith(f"{words[0]} ") for name in COMMANDS) else ""
    if group and words[1:2] in (["-h"], ["--help"]):
        print(_overview(group))
        raise SystemExit(0)
    known = sorted({name.removeprefix(group).split()[0] for name in COMMANDS if name.startswith(group)})
    got = words[len(group.split()) :][:1]
    raise UsageError(
        f"{group or 'command'}: wanted one of {', '.join(known)}, got {got[0] if got else 'none'}; "
        f"see {' '.join(['humanpred', *group.split(), '--help'])}"
    )


def _versions() -> str:
    from humanpred_ros.nodes.doctor import versions

    return versions()


def _overview(group: str) -> str:
    """Return the commands there are, with what they do, all or those of one group."""
    shown = {name: text for name, (_, text) in COMMANDS.items() if name.startswith(group)}
    width = max(map(len, shown))
    indent = " " * (width + 4)
    lines = [
        textwrap.fill(text, 80, initial_indent=f"  {name:{width}}  ", subsequent_indent=indent)
        for name, text in shown.items()
    ]
    usage = " ".join(["usage: humanpred", *group.split(), "COMMAND [FLAGS]"])
    return "\n".join([usage, *([] if group else ["", str(__doc__)]), "", *lines, "", "COMMAND --help lists its flags."])


def _parse_flags(name: str, where: str, words: list[str]) -> tuple[Command, Any]:
    module_name, function = where.split(":")
    module = importlib.import_module(f"humanpred_ros.{module_name}")
    named = getattr(module, function)
    # A module with one command says what it does; else each function does.
    text = inspect.getdoc(module if function in ("run", "measure") else named) or ""
    parser = _Parser(prog=f"humanpred {name}", description=text.partition("\n\nRaises:")[0], formatter_class=_Help)
    settings_type: type[Settings] = next(iter(get_type_hints(named).values()))
    add_flags(parser, settings_type)
    try:
        settings = settings_type(**vars(parser.parse_args(words)))
    except SettingsError as error:
        raise SettingsError(spelled(error, settings_type, lambda name: flag(settings_type, name))) from None
    return partial(_presented, named) if function == "measure" else named, settings


def _presented(measure: Any, settings: Any, console: Console) -> int:
    from humanpred_ros.evaluation.framework import present

    return present(settings, console, measure)


class _Help(argparse.HelpFormatter):
    """Keeps the paragraphs and the entries of lists in a docstring apart."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        parts = re.split(r"\n\n|\n(?=- )", text)
        return "\n\n".join(super(_Help, self)._fill_text(part, width, indent) for part in parts)


class _Parser(argparse.ArgumentParser):
    """Reports an error in one line, as every other error is."""

    def error(self, message: str) -> NoReturn:
        raise SettingsError(f"{message}; see {self.prog} --help")


def settings_of(name: str) -> type[Settings]:
    """Return the settings class of a command, by its words."""
    module, function = COMMANDS[name][0].split(":")
    hints = get_type_hints(getattr(importlib.import_module(f"humanpred_ros.{module}"), function))
    return next(kind for kind in hints.values() if isinstance(kind, type) and issubclass(kind, Settings))


def add_flags(parser: argparse.ArgumentParser, settings_type: type[Settings]) -> None:
    """Add a flag for every field of a settings class; what they are given is text, which the class converts.

    A field `hold_out` becomes `--hold-out N`; a bool becomes `--name` where it is off unless asked for, and also
    `--no-name` where it is on; a tuple takes several values, with spaces or commas between.
    """
    for name, field in settings_type.model_fields.items():
        facts, kinds = facts_of(field), (field.annotation, *get_args(field.annotation))
        text = field.description or ""
        if not field.is_required():
            text += f" (default: {shown(field.default)})"
        options: dict[str, Any] = {"help": text.replace("%", "%%"), "default": argparse.SUPPRESS}
        if field.annotation is bool:
            options["action"] = argparse.BooleanOptionalAction if field.default else "store_true"
        elif get_origin(field.annotation) is Literal:
            options["metavar"] = "{" + ",".join(kinds[1:]) + "}"
        else:
            options["metavar"] = (
                facts.get("unit") or "n" if int in kinds or float in kinds else name.rstrip("_")
            ).upper()
        if facts.get("bare") is not None:
            options.update(nargs="?", const=facts["bare"])
        elif any(get_origin(kind) is tuple for kind in kinds):
            options.update(nargs="+", action="store" if facts["positional"] else _Tuple)
        if facts.get("positional"):
            parser.add_argument(name, **options)
        else:
            parser.add_argument(flag(settings_type, name), dest=name, required=field.is_required(), **options)


class _Tuple(argparse.Action):
    """Takes several words, also of a flag given again, and splits each at its commas but for NAME=VALUE."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, values: Any, option_string: Any = None) -> None:
        words = [(value,) if "=" in value else value.split(",") for value in values]
        parts = [part.strip() for split in words for part in split]
        setattr(namespace, self.dest, (*getattr(namespace, self.dest, ()), *(part for part in parts if part)))


def flag(settings_type: type[Settings], name: str) -> str:
    """Return how a field is given on the command line."""
    field = settings_type.model_fields.get(name)
    if field is not None and facts_of(field).get("positional"):
        return name
    return f"--{name.rstrip('_').replace('_', '-')}"


def shown(default: Any) -> str:
    """Return a default as help shows it."""
    if isinstance(default, tuple):
        return ",".join(map(str, default)) or "none"
    if isinstance(default, bool):
        return "yes" if default else "no"
    if isinstance(default, float):
        return f"{default:g}"
    return "none" if default is None or default == "" else str(default)


class CompletionSettings(Settings):
    """Settings of `humanpred completion`."""


def completion(settings: CompletionSettings, console: Console) -> int:
    """Print what bash needs to complete commands and flags.

    For bash: `humanpred completion > ~/.local/share/bash-completion/completions/humanpred`; for zsh, after `autoload -U
    bashcompinit; bashcompinit`, read such a file with `source`.
    """
    del settings
    known: dict[str, set[str]] = {"": {"--help", "--version"}}
    for name in COMMANDS:
        first, _, second = name.partition(" ")
        known[""].add(first)
        known.setdefault(first, {"--help"}).update([second] if second else [])
        flags = {flag(settings_of(name), field) for field in settings_of(name).model_fields}
        known.setdefault(name, {"--help"}).update(one for one in flags if one.startswith("--"))
    cases = "\n".join(f'    "{name}") known="{" ".join(sorted(words))}";;' for name, words in known.items())
    console.out(_COMPLETION % cases, highlight=False)
    return 0


#: The longest beginning of the line that is a command, or the first word of some, says what may follow.
_COMPLETION = """_humanpred() {
  local known="" begun here="${COMP_WORDS[COMP_CWORD]}"
  for begun in "" "${COMP_WORDS[1]}" "${COMP_WORDS[1]} ${COMP_WORDS[2]}"; do case "$begun" in
%s
  esac; done
  COMPREPLY=($(compgen -W "$known" -- "$here") $(compgen -f -- "$here"))
}
complete -F _humanpred humanpred"""


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let Ctrl-C and a polite kill both raise KeyboardInterrupt, also where a shell had SIGINT ignored."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, signal.default_int_handler) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


if __name__ == "__main__":
    sys.exit(main())
