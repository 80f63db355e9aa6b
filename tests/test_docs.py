"""Every command in README and docs is run, page by page, in order, as a reader would; every link leads somewhere."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HOUSE = Path(__file__).resolve().parent.parent
PAGES = sorted([HOUSE / "README.md", *(HOUSE / "docs").glob("*.md")])
BLOCK = re.compile(r"^```(?:sh|console)\n(.*?)^```", re.MULTILINE | re.DOTALL)
EXPECT = re.compile(r"#\s*expect:\s*(\d+)")
MAKE = re.compile(r"^make (demo|test|bench)\b")


def commands(page: Path) -> list[tuple[str, int]]:
    """The (command, expected exit code) pairs of a page's shell blocks; `# expect: 2` says that one must fail so."""
    found = []
    for block in BLOCK.findall(page.read_text()):
        for line in block.replace("\\\n", " ").splitlines():
            command = line.removeprefix("$ ").strip()
            if command and not command.startswith("#"):
                code = EXPECT.search(command)
                found.append((EXPECT.sub("", command).strip(), int(code.group(1)) if code else 0))
    return found


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """A folder as a reader has it: the checkout's configs and docs, and nothing of what commands leave behind."""
    for name in ("configs", "docs", "Makefile", "pyproject.toml", "README.md"):
        if (HOUSE / name).is_dir():
            shutil.copytree(HOUSE / name, tmp_path / name)
        elif (HOUSE / name).exists():
            shutil.copy(HOUSE / name, tmp_path / name)
    return tmp_path


@pytest.mark.timeout(600)
@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=lambda p: p.stem)
def test_the_commands_of_a_page(page: Path, desk: Path) -> None:
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "COLUMNS": "120"}
    for command, code in commands(page):
        if MAKE.match(command):
            targets = subprocess.run(["make", "-n", command.split()[1]], cwd=HOUSE, capture_output=True, text=True)
            assert targets.returncode == 0, targets.stderr  # `make demo` and `make test` themselves are run by .ci/run
            continue
        done = subprocess.run(
            command,
            shell=True,
            cwd=desk,
            env=environment,
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=300,
        )
        assert done.returncode == code, f"{page.name}: {command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_the_links_of_a_page(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}, which does not exist"
