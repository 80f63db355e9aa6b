"""Pages of the site that no file in docs/ holds: the README and its neighbours, the notebooks, and the reference, made from the code."""

from __future__ import annotations

import inspect
import io
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stdout, suppress
from html import escape
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from kinegraph.stream.cli.commands.components import accepted, shown
from kinegraph.stream.graph.components import catalogue, kind_of
from kinegraph.stream.operator import ANY, Operator
from kinegraph.stream.params import schema

HOUSE = Path(__file__).resolve().parents[2]
ROOT = {"index.md": "README.md", **{f"{n}.md": f"{n}.md" for n in ("CHANGELOG", "CONTRIBUTING", "SECURITY")}}
ROOT["CODE_OF_CONDUCT.md"] = ".github/CODE_OF_CONDUCT.md"
ENGINE = (
    ("kinegraph.stream.chunk", "Chunk StreamSpec grid empty"),
    ("kinegraph.stream.operator", "Operator Case"),
    ("kinegraph.stream.outlet", "Outlet"),
    ("kinegraph.stream.filter", "Filter SampleWise"),
    ("kinegraph.stream.source", "Source"),
    ("kinegraph.stream.params", "param"),
    ("kinegraph.stream.kernel", "kernel"),
    ("kinegraph.stream.recording", "Recording"),
    ("kinegraph.stream.batch.sessions", "open_session sessions_at JobRecording"),
)
ENTRY = re.compile(r"^([\w<>.,()/*\-\[\] ]{1,60}?)  +(\S.*)$")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add what is made."""
    for name, text in made():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links among the repository's files become links among the site's pages; what the site lacks becomes plain text."""
    here = "" if page.file.src_uri in ROOT else f"docs/{page.file.src_uri.rpartition('/')[0]}"
    if page.file.src_uri == "CHANGELOG.md":
        page.meta["search"] = {"exclude": True}  # it names everything once, and would be found in place of the page
    elif page.file.src_uri.startswith("lab/"):
        page.meta["search"] = {"boost": 0.2}
    if not here:
        markdown = markdown.replace("docs/pictures/", "pictures/")

    def link(match: re.Match[str]) -> str:
        text, target, anchor = match[1], match[2], match[3] or ""
        if "://" in target or target.startswith("mailto:"):
            return match[0]
        whole = os.path.normpath(f"{here}/{target}" if here else target)
        place = next((name for name, source in ROOT.items() if source == whole), whole.removeprefix("docs/"))
        place = f"{place.removesuffix('.ipynb')}.md" if place.endswith(".ipynb") else place
        if files.get_file_from_path(place) is None:
            return f"`{text.strip('`')}`"
        start = page.file.src_uri.rpartition("/")[0]
        return f"[{text}]({os.path.relpath(place, start or '.')}{anchor})"

    return re.sub(r"(?<!!)\[([^\]\n]*)\]\(([^)#\s]+)(#[^)\s]*)?\)", link, markdown)


def made() -> Iterator[tuple[str, str]]:
    """(name, text) of every page that is made."""
    for name, source in ROOT.items():
        yield name, (HOUSE / source).read_text(encoding="utf-8")
    for path in sorted((HOUSE / "docs" / "notebooks").glob("*.ipynb")):
        yield f"notebooks/{path.stem}.md", _notebook(path)
    parts, _ = catalogue()
    kinds: dict[str, Callable[[str, Any], bool]] = {
        "operators": lambda use, part: kind_of(part) == "operator",
        "devices": lambda use, part: kind_of(part) == "source" and not is_simulated(use),
        "simulators": lambda use, part: kind_of(part) == "source" and is_simulated(use),
        "outlets": lambda use, part: kind_of(part) == "outlet",
    }
    for kind, belongs in kinds.items():
        yield f"reference/{kind}.md", _parts(kind, {use: part for use, part in parts.items() if belongs(use, part)})
    import kinegraph

    face = [(name, getattr(kinegraph, name)) for name in kinegraph.__all__ if name != "__version__"]
    yield "reference/python.md", f"# import kinegraph\n\n```text\n{inspect.getdoc(kinegraph)}\n```\n\n" + _objects(face)
    of_engine = [(f"{m}.{n}", getattr(__import__(m, fromlist=[n]), n)) for m, names in ENGINE for n in names.split()]
    yield "reference/engine.md", "# For operators and devices of one's own\n\n" + _objects(of_engine)
    yield "reference/commands.md", _commands()
    graphs = sorted((HOUSE / "configs").glob("*.yaml"))
    listed = "\n".join(f"## {p.stem}\n\n```yaml\n{p.read_text(encoding='utf-8').rstrip()}\n```\n" for p in graphs)
    yield (
        "reference/configs.md",
        f"# Shipped graphs\n\n`kinegraph run NAME` runs one; `kinegraph configs NAME -o FOLDER` copies it.\n\n{listed}",
    )


def is_simulated(use: str) -> bool:
    """Whether a source stands in for a person or a device."""
    return ".people." in use or "imulat" in use or use.startswith("devices.mti.back_walker")


def _parts(title: str, parts: dict[str, Any]) -> str:
    """A table of components, then each with its ports, its docstring and its parameters."""
    rows = ["| component | outputs | what it does |", "|---|---|---|"]
    blocks = []
    for use, part in parts.items():
        name = use.rpartition(".")[2]
        first = (inspect.getdoc(part) or "").partition("\n\n")[0].replace("\n", " ")
        rows.append(f"| [{name}](#{use.lower().replace('.', '')}) | {', '.join(part.outputs)} | {_cell(first)} |")
        blocks.append(f"## {use}\n\n{_ports(part)}{paragraphs(inspect.getdoc(part) or '')}\n\n{_parameters(part)}")
    return "\n".join(
        [
            f"# {title.capitalize()}\n",
            f"{len(parts)} {title}, as `kinegraph components` lists them.\n",
            *rows,
            "",
            *blocks,
        ]
    )


def _ports(part: Any) -> str:
    lines = []
    if issubclass(part, Operator):
        ports = [f"`{name}`{' (optional)' if port.optional else ''}" for name, port in part.inputs.items()]
        lines.append(f"**Inputs** {'any number' if ANY in part.inputs else ', '.join(ports)}")
    if part.outputs:
        lines.append(f"**Outputs** {', '.join(f'`{p}`' for p in part.outputs)}")
    return "".join(f"{line}\n\n" for line in lines)


def _parameters(part: Any) -> str:
    described = schema(part)
    rows = []
    for name, entry in described.get("properties", {}).items():
        default = "must be given" if name in described.get("required", ()) else _cell(shown(entry.get("default")))
        rows.append(f"| `{name}` | {default} | {_cell(accepted(entry))} | {_cell(entry.get('description', ''))} |")
    return "\n".join(["| parameter | default | values | |", "|---|---|---|---|", *rows, ""]) if rows else ""


def _cell(text: str) -> str:
    return escape(text, quote=False).replace("|", "&#124;").replace("\n", " ").replace("*", "\\*").replace("_", "\\_")


def paragraphs(text: str) -> str:
    """A docstring as Markdown: paragraphs as they are, entries of a name and a text as a list, what is indented as code."""
    blocks = []
    for block in text.split("\n\n"):
        lines = block.split("\n")
        if block.startswith(">>>") or all(line.startswith("    ") for line in lines):
            blocks.append("```python\n" + inspect.cleandoc(block) + "\n```")
        elif any(ENTRY.match(line) for line in lines if not line.startswith(" ")):
            blocks.append(_entries(lines))
        else:
            blocks.append(_prose(" ".join(line.strip() for line in lines)))
    return "\n\n".join(blocks)


def _entries(lines: list[str]) -> str:
    out: list[str] = []
    for line in lines:
        if match := None if line.startswith(" ") else ENTRY.match(line):
            out.append(f"- **{_prose(match[1].strip())}** {_prose(match[2])}")
        elif line.startswith(" ") and out:
            out[-1] += " " + _prose(line.strip())
        else:
            out.append(("" if not out or not out[-1].startswith("-") else "\n") + _prose(line))
    return "\n".join(out)


def _prose(text: str) -> str:
    """Text whose signs mean nothing to Markdown, but for code between backticks."""
    pieces = text.split("`")
    for k in range(0, len(pieces), 2):
        pieces[k] = re.sub(r"([*_\[\]|])", r"\\\1", escape(pieces[k], quote=False))
    return "`".join(pieces)


def _objects(named: Iterable[tuple[str, Any]]) -> str:
    """Classes with their public methods, and functions."""
    out = []
    for name, one in named:
        out.append(f"## {name}\n\n{_signature(name, one)}{paragraphs(inspect.getdoc(one) or '')}\n")
        members = vars(one).items() if inspect.isclass(one) else ()
        for member, value in members:
            function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
            if member.startswith("_") or not inspect.isfunction(function) or not function.__doc__:
                continue
            call = "" if isinstance(value, property) else _signature(member, function)
            out.append(
                f"### {name.rpartition('.')[2]}.{member}\n\n{call}{paragraphs(inspect.getdoc(function) or '')}\n"
            )
    return "\n".join(out)


def _signature(name: str, one: Any) -> str:
    with suppress(ValueError, TypeError):
        text = str(inspect.signature(one)).replace("'", "")
        return f"```python\n{name.rpartition('.')[2]}{text}\n```\n\n"
    return ""


def _commands() -> str:
    """What `--help` prints, of every command."""
    import typer

    from kinegraph.stream.cli import main as cli
    from kinegraph.stream.cli import registry

    os.environ["COLUMNS"] = "110"
    blocks = ["# Commands\n", f"```text\n{registry.overview()}\n```\n"]
    for name in registry.names():
        command = registry.function_of(name)
        under = [c.name for c in command.registered_commands] if isinstance(command, typer.Typer) else []
        for words in [[name], *([name, str(sub)] for sub in under)]:
            text = io.StringIO()
            with redirect_stdout(text), suppress(SystemExit):
                cli.call(name, [*words[1:], "--help"])
            blocks.append(
                f"{'##' if len(words) == 1 else '###'} kinegraph {' '.join(words)}\n\n```text\n{text.getvalue().strip()}\n```\n"
            )
    return "\n".join(blocks)


def _notebook(path: Path) -> str:
    """A notebook's cells and what they printed."""
    out = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        out.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for result in cell.get("outputs", ()):
            shown = result.get("data", {})
            if "image/png" in shown:
                out.append(f"![what the cell draws](data:image/png;base64,{''.join(shown['image/png']).strip()})")
                continue
            text = "".join(result.get("text", ()) or shown.get("text/plain", ()))
            out += [f"```text\n{text.rstrip()}\n```"] if text else []
    return "\n\n".join(out)
