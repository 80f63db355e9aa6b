"""Every command in README and docs is run, page by page, in order, as a reader would; every link leads somewhere. Records of the
laboratory (docs/lab) are not run.

```python name.py, ```yaml name.yaml    the block is saved under that name, as the page says
```sh, ```console                       each command is run; `# expect: 2` says that it must end with that exit code
```text                                 every line is part of what the commands since the last such block have printed
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from kinegraph.stream.graph import NodeOptions, RecordingOptions
from kinegraph.stream.graph.reading.load import SECTIONS, Settings, load_text
from tests.support.typed_commands import Typist

HOUSE = Path(__file__).resolve().parents[2]
LABORATORY = HOUSE / "docs" / "lab"
PAGES = sorted([*HOUSE.glob("*.md"), *(HOUSE / "docs").rglob("*.md")])
BLOCK = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
EXPECT = re.compile(r"#\s*expect:\s*(\d+)")
MAKE = re.compile(r"^make \w")
"""These are run by hand and by `.ci/run`; their names are looked up in the Makefile."""


def blocks(page: Path) -> list[tuple[str, str, str]]:
    """(language, name of the file, text) of every block of a page that a reader does something with."""
    found = [(kind, name.strip(), text) for kind, name, text in BLOCK.findall(page.read_text(encoding="utf-8"))]
    return [(kind, name, text) for kind, name, text in found if name or kind in ("sh", "console", "text")]


def commands(block: str) -> list[tuple[str, int]]:
    """The (command, expected exit code) pairs of a shell block."""
    found = []
    for line in block.replace("\\\n", " ").splitlines():
        command = line.removeprefix("$ ").strip()
        if command and not command.startswith("#"):
            code = EXPECT.search(command)
            found.append((EXPECT.sub("", command).strip(), int(code.group(1)) if code else 0))
    return found


def as_tested(command: str) -> str:
    """The command, ended after two seconds where a reader would press Ctrl-C."""
    endless = "--page" in command or command.startswith(("kinegraph view", "kinegraph motion map", "kinegraph demo"))
    command = re.split(" +# ", command)[0] if endless else command
    return f"{command} --for 2" if endless and "--for" not in command else command


def words(text: str) -> str:
    return " ".join(text.split())


FIRST_READ = {"README", "graphs", "python"}
"""The commands of these pages run before every change, those of all others every night."""
WITH_COMMANDS = [
    pytest.param(page, id=page.stem, marks=() if page.stem in FIRST_READ else pytest.mark.nightly)
    for page in PAGES
    if page.parent != LABORATORY and blocks(page)
]


@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_a_page_does_what_it_says(page: Path, tmp_path: Path) -> None:
    """In an empty folder, as outside a checkout."""
    shown = ""
    with Typist(tmp_path) as typist:
        for kind, name, text in blocks(page):
            if name:
                (tmp_path / name).write_text(text, encoding="utf-8")
            elif kind == "text":
                for line in filter(None, map(words, text.splitlines())):
                    assert line in words(shown), f"{page.name}: {line!r} is not in:\n{shown}"
                shown = ""
            else:
                for command, expected in commands(text):
                    if not MAKE.match(command):
                        code, printed = typist.type(as_tested(command))
                        assert code == expected, f"{command}\n{printed[-5000:]}"
                        shown += f"{printed} "


def test_every_target_of_make_that_a_page_names_exists() -> None:
    targets = {match[1] for page in PAGES for match in re.finditer(r"`?make ([a-z-]+)`", page.read_text())}
    makefile = (HOUSE / "Makefile").read_text(encoding="utf-8")
    assert targets and {name for name in targets if not re.search(rf"^{name}:", makefile, re.MULTILINE)} == set()


# how long the documentation may be -------------------------------------------------------------------------------------

RECORD = HOUSE / "docs" / "thesis.md"
"""The thesis's tables beside ours: a record like those of the laboratory."""
USER_PAGES = [page for page in PAGES if page.parent != LABORATORY and page != RECORD]


def word_count(page: Path) -> int:
    return len(page.read_text(encoding="utf-8").split())


def test_the_pages_for_users_are_short() -> None:
    """Records of the laboratory (docs/lab) may be as long as they like."""
    assert word_count(HOUSE / "README.md") <= 600
    assert {page.name: word_count(page) for page in USER_PAGES if word_count(page) > 2500} == {}
    assert sum(map(word_count, USER_PAGES)) <= 45_000


def test_no_page_for_users_holds_a_long_table_of_measurements() -> None:
    """At most twelve rows in which most cells are numbers."""
    for page in USER_PAGES:
        for table in re.findall(r"(?:^\|.*\n)+", page.read_text(encoding="utf-8"), re.MULTILINE):
            cells = [[cell.strip(" *<>~") for cell in row.split("|")[2:-1]] for row in table.splitlines()[2:]]
            measured = [row for row in cells if row and sum(cell[:1].isdigit() for cell in row) > len(row) / 2]
            assert len(measured) <= 12, (
                f"{page.name}: a table of {len(measured)} measurements; it belongs into docs/lab"
            )


def test_every_file_that_the_pages_on_extension_name_is_there() -> None:
    for page in (HOUSE / "docs" / "extend").glob("*.md"):
        text = page.read_text(encoding="utf-8")
        named = re.findall(r"`((?:stream|devices|operators|configs|tests)/[\w./]+?)/?`", text)
        assert [name for name in named if not (HOUSE / name).exists() and "NAME" not in name] == [], page.name
        for name in re.findall(r"^\| ((?:`[\w/.]+\.py`(?:, )?)+) \|", text, re.MULTILINE):
            for file in re.findall(r"`([^`]+)`", name):
                assert (HOUSE / "stream" / "engine" / file).exists(), f"{page.name}: {file}"


def test_every_graph_that_a_page_names_by_its_file_is_one_that_the_page_writes() -> None:
    """Shipped graphs are named as outside a checkout: `kinegraph run NAME`."""
    for page in USER_PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.findall(r"kinegraph [\w ]*configs/\w+\.yaml", text), page.name


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_the_links_of_a_page(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}, which does not exist"


def test_the_page_on_graphs_explains_every_key() -> None:
    text = (HOUSE / "docs" / "use" / "graphs.md").read_text(encoding="utf-8")
    for cls in (NodeOptions, RecordingOptions, Settings):
        for key in fields(cls):
            assert f"| `{key.name}` |" in text, f"docs/use/graphs.md does not explain {key.name!r}"
    assert all(f"| `{section}` |" in text for section in SECTIONS if section != "nodes")


def test_the_page_on_graphs_knows_what_is_taken_where_nothing_is_given() -> None:
    text = (HOUSE / "docs" / "use" / "graphs.md").read_text(encoding="utf-8")
    graph = load_text("nodes: {a: {use: stream.manual.Value, initial: 1}}")
    for key, given in re.findall(r"^\| `(\w+)` \| ([\d.]+) \|", text, re.MULTILINE):
        holders = [h for h in (graph.nodes["a"].options, graph.recording, graph) if hasattr(h, key)]
        assert [getattr(h, key) for h in holders] == [float(given)], key


# the table of attacks ------------------------------------------------------------------------------------------------

ATTACK = re.compile(r"^\| [^|]+ \| ([^|]+) \| `(?:(\w+=\w+) )?(pytest|python -m) ([^`]+)` \|$", re.MULTILINE)
CASES = re.compile(r"^(\d+) cases?$")


def attacks() -> list[tuple[str, str, str, list[str]]]:
    """(count, setting, program, its arguments) of every row of the table of what was tried."""
    text = (
        (HOUSE / "docs" / "lab" / "trust.md")
        .read_text(encoding="utf-8")
        .split("## What was tried")[1]
        .split("\n## ")[0]
    )
    rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| attack")]
    found = [(*match[:3], shlex.split(match[3])) for match in ATTACK.findall(text)]
    assert len(found) == len(rows), "a row of the table has no command that can be run"
    return found


def test_every_attack_of_the_table_is_there_to_be_run_and_counted() -> None:
    """Each command names tests that are there, as many as the row says; nothing of it is run here."""
    found = attacks()
    files = sorted({file for _, _, program, given in found if program == "pytest" for file in given if ".py" in file})
    collected = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "--collect-only",
            "-m",
            "nightly or not nightly",
            "-q",
            "-p",
            "no:cacheprovider",
            *files,
        ],
        cwd=HOUSE,
        capture_output=True,
        text=True,
        timeout=250,
    )
    assert collected.returncode == 0, collected.stdout[-2000:]
    names = [line for line in collected.stdout.splitlines() if "::" in line]
    for count, setting, program, given in found:
        if program == "python -m":
            assert given[0] == "tests.soak" and "--only" in given, given
            continue
        wanted = given[given.index("-k") + 1].split(" or ") if "-k" in given else [""]
        asked = [n for n in names if n.split("::")[0] in given and any(word in n for word in wanted)]
        assert asked, given
        cases = CASES.match(count)
        assert not cases or len(asked) == int(cases[1]), f"{given}: {len(asked)} cases"
        if setting:
            assert setting.split("=")[0] in (HOUSE / given[0]).read_text(encoding="utf-8")
