"""The commands of `kinegraph`: fifteen at top level, the others in groups, and what other packages add to both."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Sequence
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from itertools import takewhile
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import Any

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.entry_points import loaded
from kinegraph.stream.system.names import is_ours

COMMANDS = {
    "demo": ("kinegraph.stream.cli.commands.demo:demo", "Show a simulated session in the browser."),
    "run": ("kinegraph.stream.cli.commands.run:run", "Run a graph on live devices; record the session."),
    "replay": ("kinegraph.stream.cli.commands.replay:replay", "Run a graph on a recording; same results, bit for bit."),
    "batch": ("kinegraph.stream.cli.commands.batch:batch", "Replay a graph over many recordings, into Parquet tables."),
    "check": ("kinegraph.stream.cli.commands.check:check", "Check a graph; print its streams, delays and memory."),
    "draw": ("kinegraph.stream.cli.commands.draw:draw", "Draw a graph in the terminal, or as Mermaid or DOT."),
    "components": (
        "kinegraph.stream.cli.commands.components:components",
        "List what a graph can use: sources, operators, outlets, their parameters.",
    ),
    "configs": (
        "kinegraph.stream.cli.commands.configs:configs",
        "List the graphs that come with kinegraph; copy them.",
    ),
    "info": ("kinegraph.stream.cli.commands.info:info", "Show what a recording holds."),
    "recover": ("kinegraph.stream.cli.commands.recover:recover", "Complete a recording left by a killed process."),
    "dev compile": (
        "kinegraph.stream.engine.compile_command:compile_",
        "Compile kernels now, for graphs that start later.",
    ),
    "dev try": ("kinegraph.stream.cli.commands.try_:try_", "Check an operator of your own against the laws."),
    "dev completion": (
        "kinegraph.stream.cli.completion:completion",
        "Print what makes bash, zsh or fish complete commands.",
    ),
    "dev schema": ("kinegraph.stream.cli.commands.schema:schema", "Write the JSON Schema of graphs, for editors."),
}
"""The engine's commands. Packages add theirs by the entry-point group `kinegraph.commands`; `emg.compare` is `kinegraph emg compare`."""

GROUPS = {
    "emg": "Calibrate amplitudes, check electrodes, compare sessions, train models.",
    "sleep": "Check the camera over a bed, list and report nights, compare with hypnograms.",
    "motion": "Name exercises, explore recorded motion on a map, train models, compare with annotations.",
    "motion train": "Train a model on recordings.",
    "files": "Import and export files of other programs, compare clocks, download models.",
    "files fetch": "Download what kinegraph uses but does not contain.",
    "dev": "Write and test operators and devices, simulate devices.",
}
"""Descriptions for the help; the group of another package is described by its commands."""

RENAMED = {
    "parts": "components",
    "schema": "dev schema",
    "try": "dev try",
    "new": "dev new",
    "simulate": "dev simulate",
    "import": "files import",
    "export": "files export",
    "pulses": "files compare-clocks",
    "fetch": "files fetch",
    "calibrate": "emg calibrate",
    "check-electrodes": "emg check-electrodes",
    "compare": "emg compare",
    "sessions": "emg sessions",
    "train emg-model": "emg train-model",
    "train": "motion train",
    "teach": "motion label",
    "map": "motion map",
    "evaluate segmentation": "motion evaluate",
    "evaluate sleep": "sleep evaluate",
    "bedside": "sleep setup",
    "bedside check": "sleep check",
    "nights": "sleep nights",
}
"""Names of former versions; they do not work any more, but the refusal gives the present one."""

UNLIMITED = 1000
"""Columns of what is no terminal."""
MAX_WORDS = 3
"""Words of the longest command: a group, a group in it, a name."""

USAGE = """usage: kinegraph COMMAND [ARGUMENTS]

A real-time engine for motion and biosignal devices: graphs in YAML, live or replayed bit for bit.
"""


def names() -> list[str]:
    """Every command, with its group: `run`, `emg calibrate`, `motion train pose`."""
    return [*COMMANDS, *(name for name in _added() if name not in COMMANDS)]


def command_in(arguments: Sequence[str]) -> str | None:
    """The command that a command line begins with. Entry points are read only where it is not one of the engine's."""
    words = [*takewhile(lambda word: " " not in word, arguments[:MAX_WORDS])]
    beginnings = [" ".join(words[:n]) for n in range(1, len(words) + 1)]
    if name := next(filter(COMMANDS.__contains__, beginnings), None):
        return name
    return next(filter(_added().__contains__, beginnings), None)


def group_in(arguments: Sequence[str]) -> str:
    """The longest group that a command line begins with; empty for the top level."""
    groups = _groups(names())
    words = 0
    while words < len(arguments) and " ".join(arguments[: words + 1]) in groups:
        words += 1
    return " ".join(arguments[:words])


def function_of(name: str) -> Any:
    """A command's function, or the Typer app that a package has added. Raises KinegraphError."""
    if name in COMMANDS:
        module, _, function = COMMANDS[name][0].partition(":")
        return getattr(importlib.import_module(module), function)
    return loaded(_added()[name], "command")


def unknown(arguments: Sequence[str]) -> KinegraphError:
    """The refusal of a command line that begins with no command: it gives the present name, or a similar one."""
    for words in (2, 1):
        old = " ".join(arguments[:words])
        if old in RENAMED:
            return KinegraphError(f"kinegraph {old} is now kinegraph {RENAMED[old]}")
    group = group_in(arguments)
    name = " ".join(arguments[: len(group.split()) + 1])
    known = names()
    known += sorted(_groups(known))
    close = get_close_matches(name, [*known, *(other.split()[-1] for other in known)], n=1)
    meant = [f"'kinegraph {other}'" for other in known if close and close[0] in (other, other.split()[-1])]
    where = f"kinegraph {group} --help" if group else "kinegraph --help"
    hint = f"did you mean {' or '.join(meant)}?" if meant else f"`{where}` lists all commands"
    return KinegraphError(f"there is no command {name!r}; {hint}")


def overview(group: str = "") -> str:
    """The text of `kinegraph --help`, or of `kinegraph GROUP --help`; only the commands that it lists are loaded."""
    before = f"{group} " if group else ""
    known = [name for name in names() if name.startswith(before)]
    rows, broken = dict[str, str](), list[str]()
    for name in known:
        if " " not in name.removeprefix(before):
            try:
                rows[name.removeprefix(before)] = COMMANDS[name][1] if name in COMMANDS else _summary(name)
            except KinegraphError as error:
                broken.append(f"\n{error}\n")
    groups = {name.removeprefix(before).split()[0]: "" for name in known if " " in name.removeprefix(before)}
    for inner in groups:
        inside = f"{before}{inner} "
        listed = ", ".join(dict.fromkeys(n.removeprefix(inside).split()[0] for n in known if n.startswith(inside)))
        groups[inner] = GROUPS.get(f"{before}{inner}", listed)
    width = max(map(len, (*rows, *groups)), default=0)
    about = (
        f"usage: kinegraph {group} COMMAND [ARGUMENTS]\n\n{GROUPS.get(group, '')}".rstrip() + "\n" if group else USAGE
    )
    parts = [about]
    for title, listing in (("commands", rows), ("groups of commands", groups)):
        if listing:
            parts.append(f"{title}:\n" + "".join(_row(name, text, width) for name, text in listing.items()))
    parts += broken
    return "\n".join([*parts, f"`kinegraph {before}COMMAND --help` describes a command and its options."])


def _row(name: str, text: str, width: int) -> str:
    """A command and what it does, as wide as the terminal; what is no terminal is as wide as it takes."""
    columns = get_terminal_size((UNLIMITED, 24)).columns
    return (
        fill(text, max(columns, width + 30), initial_indent=f"  {name:<{width}} ", subsequent_indent=" " * (width + 3))
        + "\n"
    )


def _groups(commands: Sequence[str]) -> set[str]:
    """`motion` and `motion train` for the command `motion train pose`."""
    split = [name.split() for name in commands]
    return {" ".join(words[:n]) for words in split for n in range(1, len(words))}


def _added() -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group="kinegraph.commands"):
        found.setdefault(entry.name.replace(".", " "), entry)
    return found


def _summary(name: str) -> str:
    """The first sentence of a command's help. A module of ours is not loaded for it: some load numba."""
    entry = _added()[name]
    text = _documentation(entry) if is_ours(entry.module) else None
    if text is None:
        function = function_of(name)
        callback = getattr(getattr(function, "registered_callback", None), "callback", function)
        text = callback.__doc__ or ""
    paragraph = " ".join(text.strip().partition("\n\n")[0].split())
    first, end, _ = paragraph.partition(". ")
    return first + end.strip()


def _documentation(entry: EntryPoint) -> str | None:
    """The docstring of the function that an entry point names, as its file has it; None where there is none."""
    file = Path(__file__).parents[2].joinpath(*entry.module.split(".")[1:]).with_suffix(".py")
    try:
        body = ast.parse(file.read_bytes()).body
    except (OSError, SyntaxError):
        return None
    return next((ast.get_docstring(f) for f in body if isinstance(f, ast.FunctionDef) and f.name == entry.attr), None)
