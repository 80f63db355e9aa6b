"""The house: which way imports point, modules named after an idea, nothing that knows this machine, a list of what is public."""

from __future__ import annotations

import ast
import re
import tomllib
from collections import Counter
from dataclasses import fields
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.source import Source

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("stream", "devices", "operators")
OFFERING = {"kinegraph.operators", "kinegraph.devices"}
MAY_IMPORT = {"stream": {"stream"}, "devices": {"devices", "stream"}, "operators": {"operators", "stream"}}
VAGUE = {"utils", "util", "common", "base", "helpers", "helper", "manager", "misc", "core", "tools"}
MACHINE = re.compile(r"\.\./shared|/work/|/root/|/home/[a-z]|/Users/|C:\\\\Users")
TEXTS = {".py", ".md", ".txt", ".yaml", ".yml", ".toml", ".j2", ".html", ".js", ".css", ".json", ".cfg", ""}
UNITS = re.compile(r"_(hz|s|ms|ns|min|per_min|uV|mV|V|N|m|mm|cm|g|kg|deg|rad|percent|pct|dB|samples|bytes|mb|kib)$")


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


PRODUCT = [path for package in PACKAGES for path in modules(package)]


def imported(path: Path) -> set[str]:
    """The top-level packages that a file imports, wherever in it, also by name at run time."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.removeprefix("kinegraph.").partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: line {node.lineno}: relative imports hide which way they point"
            found |= {
                f"{node.module}.{alias.name}".removeprefix("kinegraph.").partition(".")[0] for alias in node.names
            }
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__"):
                found.add(str(node.args[0].value).removeprefix("kinegraph.").partition(".")[0])
    return found


@pytest.mark.quick
def test_imports_point_one_way() -> None:
    for path in PRODUCT:
        assert imported(path) & set(PACKAGES) <= MAY_IMPORT[path.relative_to(ROOT).parts[0]], path


def test_a_module_is_named_after_its_subject_and_names_it_in_its_first_line() -> None:
    for path in PRODUCT:
        text = path.read_text(encoding="utf-8")
        assert path.stem not in VAGUE, path
        assert not text.strip() or ast.get_docstring(ast.parse(text)), f"{path}: the module needs a docstring"


def test_an_outlet_keeps_its_runtime_by_hold() -> None:
    """`set_state(state, runtime)` keeps what is not a parameter."""
    assert [
        path for path in PRODUCT if "outlets" in path.parts and "__setattr__" in path.read_text(encoding="utf-8")
    ] == []


def test_no_source_imports_a_simulator() -> None:
    """Simulators import the sources that they stand in for, and are found by their entry points."""
    for path in PRODUCT:
        if re.match(r"devices/(?!people).*source\.py", str(path.relative_to(ROOT))):
            found = [name for name in imports_of(path, later=True) if "simulat" in name or ".people." in name]
            assert not found, path


def test_the_installed_entry_points_are_those_of_the_project() -> None:
    """They are read from what was installed: after a change, install it again (`pip install --no-deps -e .`)."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    for group, entries in declared.items():
        assert {e.name: e.value for e in entry_points(group=group) if e.dist and e.dist.name == "kinegraph"} == entries


def test_only_kernel_compiles() -> None:
    """No numba but through `@kernel` (and what watches it), no fastmath, no pickle."""
    for path in PRODUCT:
        text = path.read_text(encoding="utf-8")
        if path != ROOT / "stream" / "kernel.py":
            assert not re.search(r"\b(njit|jit|vectorize|guvectorize)\(|@(numba\.)?n?jit\b", text), path
        assert not re.search(r"fastmath\s*=|allow_pickle\s*=\s*True", text), path
        assert not imported(path) & {"pickle", "cPickle", "dill", "joblib", "shelve", "marshal"}, path


@pytest.mark.quick
def test_kernels_take_at_most_12_arguments() -> None:
    kernels = [
        node
        for path in PRODUCT
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef) and any("kernel" in ast.unparse(made) for made in node.decorator_list)
    ]
    assert [node.name for node in kernels if len(node.args.args) > 12] == []


def texts() -> list[Path]:
    """Every file of the project that people read, and that is not made by a tool."""
    places = ["stream", "devices", "operators", "configs", "docs", "tests", "bench", ".ci"]
    found = [p for place in places for p in (ROOT / place).rglob("*") if p.is_file() and p.suffix in TEXTS]
    found += [p for p in ROOT.iterdir() if (p.is_file() and p.suffix in {".md", ".toml"}) or p.name == "Makefile"]
    return [p for p in found if "__pycache__" not in p.parts and p != Path(__file__).resolve()]


def test_no_file_knows_this_machine() -> None:
    rows = []
    for path in texts():
        for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
            if MACHINE.search(line):
                rows.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:100]}")
    assert not rows, "\n".join(rows)


PARTS, FAILED = catalogue(PACKAGES)
each_part = pytest.mark.parametrize("part", [pytest.param(part, id=use) for use, part in PARTS.items()])


def test_every_module_can_be_imported() -> None:
    assert not FAILED
    assert any(issubclass(part, Source) for part in PARTS.values())


@each_part
def test_a_part_says_what_it_does(part: Any) -> None:
    reported = part.__dict__.get("__doc__") or ""
    assert reported and not reported.startswith(f"{part.__name__}("), (
        "a part needs a docstring: what goes in, what comes out, delay, source"
    )


@each_part
def test_a_parameter_has_a_help_or_a_unit(part: Any) -> None:
    for f in fields(part):
        reported = f.metadata.get("kinegraph", {}).get("description") or UNITS.search(f.name)
        assert reported, f"{part.__name__}.{f.name} needs `help` in its param, or a unit in its name"


def module_of(path: Path) -> str:
    parts = ("kinegraph", *path.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for package in PACKAGES for path in modules(package)}


def imports_of(path: Path, *, later: bool = False, types: bool = False) -> set[str]:
    """Our modules that a file imports when it is imported itself, `later`, within functions, and where only `types` need them."""
    found: set[str] = set()
    todo: list[ast.AST] = list(ast.parse(path.read_text(encoding="utf-8")).body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            todo += [*node.orelse, *(node.body if types else [])]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            found |= {name if name in MODULES else node.module for name in names}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif later or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            todo += ast.iter_child_nodes(node)
    return (found & MODULES.keys()) - {module_of(path)}


def circles() -> list[list[str]]:
    """Modules that import one another, directly or by way of others, at once, within functions, or where only `types` need it."""
    graph = {name: imports_of(path, later=True, types=True) for name, path in MODULES.items()}
    reach: dict[str, set[str]] = {}
    for name in graph:
        seen, todo = set[str](), list(graph[name])
        while todo:
            if (at := todo.pop()) not in seen:
                seen.add(at)
                todo += graph.get(at, ())
        reach[name] = seen
    knots = {tuple(sorted(m for m in reach[name] if name in reach.get(m, ()))) for name in graph if name in reach[name]}
    return [list(knot) for knot in sorted(knots)]


@pytest.mark.quick
def test_no_module_imports_itself_by_way_of_others() -> None:
    assert circles() == []


def test_a_class_has_one_name_in_the_tree() -> None:
    names = [
        node.name for path in MODULES.values() for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]  # fmt: skip
    twice = {name for name in names if names.count(name) > 1}
    assert twice == {"Input"}, "a port of an operator, and `kinegraph.Input`, at which a graph in Python is fed"


def test_reset_gap_s_is_declared_in_one_place() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in MODULES.values()}
    assert not [path for path, text in texts.items() if re.search(r"reset_gap_s(: float)? = param\(", text)]


def folder_of(module: str) -> str:
    """The folder that a module is in; what lies in the root of stream, devices or operators counts by itself."""
    folder = module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]
    return module if folder.count(".") == 1 else folder


@pytest.mark.quick
def test_no_folder_imports_itself_by_way_of_others() -> None:
    """`kinegraph.operators` and `kinegraph.devices` offer everything by short names, and are left out."""
    arrows: dict[str, set[str]] = {}
    for name, path in MODULES.items():
        if name not in OFFERING:
            targets = imports_of(path, later=True) - OFFERING
            arrows.setdefault(folder_of(name), set()).update(map(folder_of, targets))
    for folder, targets in arrows.items():
        targets.discard(folder)
    order: list[str] = []
    while arrows:
        free = [folder for folder, targets in arrows.items() if not targets & arrows.keys()]
        assert free, f"these import one another: {sorted(arrows)}"
        order += free
        for folder in free:
            del arrows[folder]


def test_no_folder_holds_more_than_20_files() -> None:
    count = Counter(path.parent for path in MODULES.values())
    assert {str(folder.relative_to(ROOT)): files for folder, files in count.items() if files > 20} == {}


def test_the_root_of_stream_holds_what_authors_of_parts_import() -> None:
    assert len(list((ROOT / "stream").glob("*.py"))) <= 10


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_is_not_imported_under_its_bare_name(package: str) -> None:
    found = spec_from_file_location(package, ROOT / package / "__init__.py")
    assert found is not None and found.loader is not None
    with pytest.raises(ImportError, match=f"from kinegraph.{package} import"):
        found.loader.exec_module(module_from_spec(found))


COMMANDS = {"commands", "evaluation", "setup"}
"""Folders within operators/ with modules that read and write files: commands, and what only commands use."""
FILES = {"open", "read_text", "read_bytes", "write_text", "write_bytes", "savez", "savefig", "fromfile"}
READERS = (
    "kinegraph.stream.recording",
    "kinegraph.stream.data.tables",
    "kinegraph.stream.data.csv_writer",
    "kinegraph.stream.system.atomic_file",
    "json",
    "csv",
    "os",
    "io",
    "tempfile",
)


def opens_files(path: Path) -> list[str]:
    """What a module does with files: readers that it imports, and calls of what opens one."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom | ast.Import):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names]
            found += [name for name in names if name in READERS or name.startswith("kinegraph.stream.recording.")]
        elif isinstance(node, ast.Call):
            of_path = isinstance(node.func, ast.Attribute) and node.func.attr in FILES - {"open"}
            if of_path or ast.unparse(node.func) in ("open", "np.load"):
                found.append(ast.unparse(node.func))
    return found


def test_operators_open_no_files() -> None:
    """Commands do, and the readers in stream/; an operator gets what was read."""
    live = [p for p in modules("operators") if not COMMANDS & set(p.parts)]
    assert {str(p.relative_to(ROOT)): found for p in live if (found := opens_files(p))} == {}


def test_tests_lie_in_rooms() -> None:
    """By subject: tests/gait/test_contacts.py, with what several rooms use in tests/support."""
    flat = [p.name for p in (ROOT / "tests").glob("test_*.py")]
    assert not flat, (
        f"{flat} belong into one of {sorted(p.parent.name for p in (ROOT / 'tests').glob('*/__init__.py'))}"
    )
    stems = [p.stem for p in (ROOT / "tests").rglob("test_*.py") if p.parent.name != "replay"]
    assert len(stems) == len(set(stems)), "a name stands once"


def test_every_shipped_graph_has_its_replay() -> None:
    """tests/replay/test_NAME.py for configs/NAME.yaml, and no other."""
    graphs = {p.stem for p in (ROOT / "configs").glob("*.yaml")}
    assert {p.stem.removeprefix("test_") for p in (ROOT / "tests" / "replay").glob("test_*.py")} == graphs
