"""A platform wheel starts every shipped graph without compiling, where nothing can be written; what was edited is compiled.

`KINEGRAPH_WHEEL=dist/NAME.whl pytest -m nightly tests/house/test_platform_wheel.py` tries one that `make dist` has built.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import venv
from pathlib import Path
from typing import Any

import pytest

from kinegraph.stream.compiler.cache import LEVELS, MADE_BY
from tests.house.test_installed import HOUSE, run
from tests.platform_wheel import compiled, with_kernels

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.xdist_group("installed"),
    pytest.mark.skipif((sys.platform, platform.machine()) != ("linux", "x86_64"), reason="these wheels are for Linux"),
]

BUILT = os.environ.get("KINEGRAPH_WHEEL", "")
STARTS = """
import json, sys, tempfile
from pathlib import Path
from numba.core import event
from kinegraph.stream.compiler import cache
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.graph.shipped import shipped

class Compiled(event.Listener):
    names = []
    def on_start(self, e):
        self.names.append(str(e.data["dispatcher"]))
    def on_end(self, e):
        pass

event.register("numba:compile", Compiled())
assert "site-packages" in cache.__file__
found = {}
for name in sys.argv[1:] or shipped():
    Compiled.names = []
    try:
        with tempfile.TemporaryDirectory() as folder:
            Session(load(Path(name)), Path(folder) / "session").compile()
        found[name] = Compiled.names
    except KinegraphError as error:
        found[name] = str(error)
print(json.dumps({"levels": cache.levels(), "found": found}))
"""
"""Starts graphs (all that the package has) as `kinegraph run` does, up to the opening of devices; which kernels were compiled for each."""
LAWS = """
import hashlib, json, logging, random, sys
from numba.core import event
from kinegraph.stream.compiler import cache
from kinegraph.stream.compiler.fingerprint import kernels_of
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.laws import checks, trials
from kinegraph.stream.laws.case_samples import tapes_of
from kinegraph.stream.laws.chunking import whole
from kinegraph.stream.laws.play import Player
from kinegraph.stream.operator import Operator

which, most = sys.argv[1], int(sys.argv[2])
cache.levels = lambda: () if which == "home" else (which,)

class Compiled(event.Listener):
    names = []
    def on_start(self, e):
        self.names.append(str(e.data["dispatcher"]))
    def on_end(self, e):
        pass

event.register("numba:compile", Compiled())
assert "site-packages" in cache.__file__
packages = {}
for use, part in sorted(catalogue(("operators",))[0].items()):
    if issubclass(part, Operator) and kernels_of(part):
        packages.setdefault(use.split(".")[1], []).append((use, part))
digests = {}
for use, part in (one for parts in packages.values() for one in parts[:most]):
    for k, case in enumerate(part.cases()):
        digest = hashlib.sha256()
        for name, output in sorted(Player(case).play(whole(tapes_of(case))).outputs.items()):
            digest.update(name.encode() + output.time.tobytes() + output.data.tobytes())
        digests[f"{use} {k}"] = digest.hexdigest()
    for make in trials(part) if which != "home" else ():
        trial = make()
        for check in checks(trial).values():
            check()
        trial.attempt(random.Random(1).randint)
print(json.dumps({"digests": digests, "compiled": Compiled.names}))
"""
"""What operators of every folder give, some of each, by the wheel's kernels of a level, or by those compiled at home; and the laws on the
former (tests/laws holds them on the latter)."""
READ_ONLY = {"HOME": "/proc", "XDG_CACHE_HOME": "", "KINEGRAPH_CACHE": ""}
"""Where not even root can make a folder; empty variables are left out."""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with the platform wheel, and what it depends on from the environment in which the tests run."""
    place = tmp_path_factory.mktemp("platform")
    if BUILT:
        wheel = Path(BUILT).absolute()
    else:
        run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", place, cwd=HOUSE)
        kernels = {level: compiled(level, place / level) for level in LEVELS}
        wheel = with_kernels(next(place.glob("*-any.whl")), kernels)
    venv.create(place / "env", with_pip=False, symlinks=True)
    install = (sys.executable, "-m", "pip", "--python", place / "env", "install", "-q", "--no-deps", "--no-index")
    run(*install, wheel, cwd=place)
    home = next((place / "env" / "lib").glob("python3*")) / "site-packages"
    (home / "around.pth").write_text("\n".join(p for p in sys.path if p.endswith("site-packages")), encoding="utf-8")
    return place / "env" / "bin" / "python"


def started(
    python: Path, graphs: list[str], cwd: Path, **environment: str
) -> tuple[list[str], dict[str, list[str] | str]]:
    """The levels that were used, and for each graph what was compiled, or why it cannot start here."""
    given = [f"{name}={value}" for name, value in {**READ_ONLY, **environment}.items() if value]
    unset = [word for name, value in READ_ONLY.items() if not value for word in ("-u", name)]
    answer = run("env", *unset, *given, python, "-c", STARTS, *graphs, cwd=cwd).splitlines()[-1]
    found = json.loads(answer)
    return found["levels"], found["found"]


@pytest.mark.timeout(3000)
def test_every_shipped_graph_starts_without_compiling(python: Path, tmp_path: Path) -> None:
    levels, found = started(python, [], tmp_path)
    assert len(found) > 30
    assert levels and set(levels) <= set(LEVELS)
    lacking = {name for name, why in found.items() if isinstance(why, str)}
    assert lacking <= {"avatar_oak", "body_markers"}, "their networks are not part of kinegraph"
    assert {name: names for name, names in found.items() if names and name not in lacking} == {}


@pytest.mark.timeout(3000)
def test_operators_keep_the_laws_and_give_the_same_bits_as_compiled_at_home(python: Path, tmp_path: Path) -> None:
    def of(which: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(
            run(python, "-c", LAWS, which, 3, cwd=tmp_path, timeout_s=1500).splitlines()[-1]
        )
        return found

    home = of("home")["digests"]
    assert len(home) > 60
    for level in LEVELS:
        found = of(level)
        assert found["compiled"] == [], level
        assert found["digests"] == home, level


def test_what_was_edited_is_compiled(python: Path, tmp_path: Path) -> None:
    (site,) = (python.parent.parent / "lib").glob("python3*/site-packages/kinegraph")
    edited = site / "operators" / "filters" / "threshold.py"
    assert (site / "compiled" / MADE_BY).is_dir()
    before = edited.read_text(encoding="utf-8")
    try:
        edited.write_text(before.replace("    made = 0\n", "    made = int(0)\n", 1), encoding="utf-8")
        _, found = started(python, ["myoware"], tmp_path, KINEGRAPH_CACHE=str(tmp_path / "cache"))
    finally:
        edited.write_text(before, encoding="utf-8")
    (compiled_here,) = (name for name in found["myoware"] if name.startswith("KernelDispatcher"))
    assert "crossings" in compiled_here, "and what it calls, in it"
