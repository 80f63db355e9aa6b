"""What `pip install` gives: a wheel, in an environment that holds no checkout, has the commands, the shipped graphs and the Python face."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from stream.graph.load import load
from stream.graph.shipped import resolve, shipped, shipped_folder, summary

HOUSE = Path(__file__).resolve().parent.parent
NAMES = {p.stem for p in (HOUSE / "configs").glob("*.yaml")}


def run(*command: object, cwd: Path, code: int = 0) -> str:
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment = {**kept, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run([*map(str, command)], cwd=cwd, env=environment, capture_output=True, text=True, timeout=200)
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
    (home / "around.pth").write_text("\n".join(around), encoding="utf-8")
    return place / "env" / "bin"


@pytest.mark.timeout(250)
def test_the_readme_works_from_a_wheel(site: Path, tmp_path: Path) -> None:
    inside = run(
        site / "python", "-c", "import stream, os; print(os.path.dirname(stream.__file__))", cwd=tmp_path
    ).strip()
    assert Path(inside).is_relative_to(site.parent)
    listed = run(site / "kinegraph", "configs", cwd=tmp_path)
    assert {line.split()[0] for line in listed.splitlines()} == NAMES
    assert "treadmill" in run(site / "kinegraph", "check", "treadmill_emg", cwd=tmp_path)
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


def test_the_wheel_holds_the_service_file_of_the_bedside_too(site: Path) -> None:
    (folder,) = (site.parent / "lib").glob("python3*/site-packages/stream/configs")
    of_a_graph = {".yaml", ".service"}
    shipped, there = ({p.name for p in f.iterdir() if p.suffix in of_a_graph} for f in (HOUSE / "configs", folder))
    assert there == shipped


def test_in_a_checkout_the_graphs_beside_pyproject_are_found() -> None:
    assert shipped_folder() == HOUSE / "configs"
    assert set(shipped()) == NAMES


def test_the_package_comes_first_and_a_folder_without_a_project_is_none_of_ours(tmp_path: Path) -> None:
    package = tmp_path / "stream"
    (package / "configs").mkdir(parents=True)
    (tmp_path / "configs").mkdir()
    assert shipped_folder(package) == package / "configs"
    (package / "configs").rmdir()
    assert shipped_folder(package) is None
    (tmp_path / "pyproject.toml").touch()
    assert shipped_folder(package) == tmp_path / "configs"


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
