"""Other people's code: skeletons with tests that pass, and a package, built and installed on the spot, that adds a part of each kind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kinegraph.devices.commands.skeleton import FILES, write_skeleton
from kinegraph.stream.errors import KinegraphError
from tests.house.test_docs import HOUSE, blocks
from tests.support.browser import needs_browser
from tests.support.command_line import Command, kinegraph, refused
from tests.support.live_browser import live_browser
from tests.support.page_session import needs_page, page_process

__all__ = ["kinegraph"]

PROJECT = """[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "gait-lab"
version = "1.0"

[project.entry-points."kinegraph.parts"]
gait_lab = "gait_lab"
shaker = "shaker"

[project.entry-points."kinegraph.simulators"]
"shaker.Shaker" = "shaker_simulator:simulated"

[project.entry-points."kinegraph.commands"]
greet = "gait_lab.greet:greet"

[project.entry-points."kinegraph.panels"]
knee = "gait_lab.panels:KNEE"

[tool.hatch.build.targets.wheel]
include = ["gait_lab", "shaker*.py"]
"""
GREET = '''
from typing import Annotated

import typer

from kinegraph.stream.text.safe_text import say


def greet(name: Annotated[str, typer.Argument(help="whom")]) -> None:
    """Say good morning."""
    say(f"good morning, {name}")
'''
TALLY = '''"""A file with how many samples came."""

from dataclasses import dataclass
from pathlib import Path

from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param


@dataclass(slots=True)
class TallyState:
    count: int = 0


@dataclass(frozen=True, slots=True)
class Tally(Outlet[TallyState, None]):
    """Writes how many samples came into a file, at the end."""

    path: str = param(help="the file")

    def open(self, specs):
        self.set_state(TallyState())
        return {}

    def process(self, port, chunk):
        self.state.count += len(chunk)
        return None

    def close(self):
        Path(self.path).write_text(str(self.state.count))
        return None
'''
PANELS = 'from pathlib import Path\n\nKNEE = Path(__file__).with_name("knee.js")\n'


def run(site: Path, *command: object, cwd: Path, code: int = 0) -> str:
    environment = {**os.environ, "PYTHONPATH": str(site), "COLUMNS": "150"}
    done = subprocess.run([*map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == code, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the package is installed from its wheel."""
    pytest.importorskip("hatchling")
    place = tmp_path_factory.mktemp("gait-lab")
    write_skeleton("operator", "wander", place / "gait_lab")
    write_skeleton("device", "shaker", place)
    (place / "pyproject.toml").write_text(PROJECT)
    for name, text in {"__init__": "", "greet": GREET, "tally": TALLY, "panels": PANELS}.items():
        (place / "gait_lab" / f"{name}.py").write_text(text)
    (module,) = (text for _, name, text in blocks(HOUSE / "docs" / "extend" / "panel.md") if name == "bars.js")
    (place / "gait_lab" / "knee.js").write_text(module)
    run(place, sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", place / "dist", cwd=place)
    wheel = next((place / "dist").glob("*.whl"))
    pip = (sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--disable-pip-version-check")
    run(place, *pip, "--target", place / "site", wheel, cwd=place)
    return place / "site"


PROGRAM = Path(sys.executable).parent / "kinegraph"
GRAPH = """
nodes:
  shaker: {use: shaker.Shaker, port: /dev/serial/by-id/none}
  wander: {use: gait_lab.wander.Wander, from: shaker, window_s: 1}
  tally: {use: gait_lab.tally.Tally, from: wander, path: count.txt}
record: [wander]
"""


def test_an_installed_package_adds_its_parts_and_its_command(site: Path, tmp_path: Path) -> None:
    listed = run(site, PROGRAM, "components", cwd=tmp_path)
    for use, kind in (
        ("gait_lab.wander.Wander", "operator"),
        ("gait_lab.tally.Tally", "outlet"),
        ("shaker.Shaker", "source"),
    ):
        assert any(use in line and kind in line for line in listed.splitlines()), listed
    assert "Say good morning." in run(site, PROGRAM, "--help", cwd=tmp_path)
    assert "good morning, Ada" in run(site, PROGRAM, "greet", "Ada", cwd=tmp_path)


def test_its_device_is_simulated_its_operator_and_outlet_run(site: Path, tmp_path: Path) -> None:
    (tmp_path / "graph.yaml").write_text(GRAPH)
    run(site, PROGRAM, "run", "graph.yaml", "--simulate", "--for", 2, "-o", "s", "--view", "none", cwd=tmp_path)
    assert 100 < int((tmp_path / "count.txt").read_text()) < 260
    run(site, PROGRAM, "replay", "graph.yaml", "s", "--verify", "-q", cwd=tmp_path)
    (tmp_path / "graph.yaml").write_text(GRAPH.replace("wander.Wander", "wander.Wonder"))
    assert "did you mean" in run(site, PROGRAM, "check", "graph.yaml", cwd=tmp_path, code=2)


def test_its_panel_is_a_kind_of_the_page(site: Path, tmp_path: Path) -> None:
    (tmp_path / "graph.yaml").write_text(GRAPH + "page: {panels: [{kind: knee, of: wander}]}\n")
    run(site, PROGRAM, "check", "graph.yaml", cwd=tmp_path)
    run(tmp_path, PROGRAM, "check", "graph.yaml", cwd=tmp_path, code=2)


@needs_page
@needs_browser
def test_its_panel_is_drawn_in_a_browser(
    site: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The module of the docs' panel, from the installed package: no file of it lies beside the graph."""
    monkeypatch.setenv("PYTHONPATH", str(site))
    (tmp_path / "graph.yaml").write_text(GRAPH + "page: {panels: [{kind: knee, of: wander, title: knee}]}\n")
    with (
        live_browser(tmp_path_factory.mktemp("browser")) as browser,
        page_process(tmp_path, "run", "graph.yaml", "--simulate", "--view", "none", "--no-record") as process,
    ):
        browser.open(process.url)
        drawn = browser.wait("document.querySelector('.knee')?.dataset.drawn")
        browser.wait(f"document.querySelector('.knee').dataset.drawn > {drawn} + 2")
        assert browser.complaints == []


@pytest.mark.parametrize(("kind", "name"), [("operator", "my_filter"), ("device", "my_board")])
def test_a_skeleton_works_and_its_own_tests_pass(kind: str, name: str, tmp_path: Path, kinegraph: Command) -> None:
    code, output, _ = kinegraph("dev", "new", kind, name, "-o", "made")
    assert code == 0 and all(str(Path("made") / title.format(name)) in output for title in FILES[kind].values())
    output = run(tmp_path, sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "made", cwd=tmp_path)
    assert "3 passed" in output
    refused(kinegraph("dev", "new", kind, name, "-o", "made"), "already exists", "--out")


@pytest.mark.parametrize("name", ["MyFilter", "class", "json", "operators", "über"])
def test_a_name_that_cannot_be_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(KinegraphError, match=r"must be a module's name|choose another"):
        write_skeleton("operator", name, tmp_path)
