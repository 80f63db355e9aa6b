"""Which test files are a module's own: those with its name, those that take what few others take, and those that reach it by the fewest
imports."""

from __future__ import annotations

import ast
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

HOUSE = Path(__file__).resolve().parents[2]
OURS = ("stream", "devices", "operators", "tests")
MOST = 10
"""At most so many test files for one module: the nearest first, among these the ones with the fewest imports of their own."""
NAMESAKES = 3
"""Of more modules than these a name says nothing: `report`, `train`."""
AKIN, RARE, SPREAD = 8, 3, 20
"""At most so many test files for names that they and the module import (or that stand in it); of names that at most so many test files
import at all, and at most so many modules: `kernel` and `Times` say nothing of either."""
FARTHEST = 6
"""Imports between a test and what it tests."""
OPERATORS = 3
"""The golden answers of at most so many operators are asked for a module: of those that reach it by the fewest imports."""
SAMPLE = ("operators.gate.Gate", "operators.iir.Lowpass", "operators.sleep.scorer.SleepScorer")
"""Whose golden answers are asked for a module that is part of no operator, but of how answers are made."""
COMMANDS = 2
"""The same for golden answers of commands."""
EVERYTHING = (
    "test_laws",
    "test_golden_answers",
    "test_golden_commands",
    "test_architecture",
    "test_face",
    "test_docs",
    "test_installed",
)
"""Tests of all modules at once are none's own."""
OWN = {
    "stream.face.": ("tests/study/test_face.py", "tests/study/test_notebook.py"),
    "stream.graph.": ("tests/engine/test_load.py",),
}
"""What is tried first for modules whose names begin so: it reaches them by more imports than other tests."""
CALLS = ("kinegraph", "call")
"""What tests call with the words of a command."""
WORDS = (("kinegraph.commands",), ("kinegraph.evaluations", "kinegraph.trainings"))
"""The entry points that a command's first and second word may name."""


def own_tests(module: str) -> list[str]:
    """The test files of a module, as paths from the tree's root; none if no test comes near it."""
    reached, near = {module}, list[Path]()
    for _ in range(FARTHEST):
        found = [p for p in _tests() if p not in near and reached & _imports(p)]
        near += sorted(found, key=lambda p: (len(_imports(p)), p))
        if len(near) >= MOST:
            break
        reached |= {other for other, path in _modules().items() if reached & _imports(path)}
    own = [path for begins, paths in OWN.items() if module.startswith(begins) for path in paths]
    found = [str(p.relative_to(HOUSE)) for p in (*_akin(module), *near[:MOST])]
    return list(dict.fromkeys([*_named_after(module), *own, *found]))


def _akin(module: str) -> list[Path]:
    """The test files that import names which the module has or imports, and hardly any other test; the most such names first.

    What raises `PromiseError`, say, is best known to those who expect one, by however many imports they come to it.
    """
    if (path := _modules().get(module)) is None:
        return []
    told = {name for name in _names(path) if _users()[name] <= SPREAD}
    rare = {name for name in (*told, *_defined(path)) if _takers()[name] <= RARE}
    by_test = {p: sum(1.0 / _takers()[name] for name in rare & _names(p)) for p in _tests()}
    near = sorted((p for p, much in by_test.items() if much), key=lambda p: (-by_test[p], p))
    return near[:AKIN]


@cache
def _names(path: Path) -> frozenset[tuple[str, str]]:
    """The names that a file imports from our packages, each with the module in which it stands."""
    imports = [node for node in ast.walk(ast.parse(path.read_bytes())) if isinstance(node, ast.ImportFrom)]
    ours = [node for node in imports if (node.module or "").partition(".")[0] in OURS]
    return frozenset((_home(node.module or "", a.name), a.name) for node in ours for a in node.names)


def _defined(path: Path) -> Iterator[tuple[str, str]]:
    for node in ast.parse(path.read_bytes()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield _name(path), node.name


@cache
def _takers() -> Counter[tuple[str, str]]:
    """How many test files import each name."""
    return Counter(name for p in _tests() for name in _names(p))


@cache
def _users() -> Counter[tuple[str, str]]:
    """How many modules import each name."""
    return Counter(name for p in _modules().values() for name in _names(p))


def _named_after(module: str) -> list[str]:
    """The test files that have the module's name, where few other modules have it: they may reach it through a command, by no import."""
    stem = module.rpartition(".")[2]
    if sum(other.rpartition(".")[2] == stem for other in _modules()) > NAMESAKES:
        return []
    return [str(p.relative_to(HOUSE)) for p in _tests() if p.stem in (f"test_{stem}", f"test_{stem}s")]


def own_operators(module: str, found: Mapping[str, str]) -> list[str]:
    """The operators (by `use`, with the module of each in `found`) that a module is part of: those in it, else those nearest to it."""
    return _nearest(module, found, OPERATORS) or [use for use in SAMPLE if module in _trial()]


def own_commands(module: str, found: Mapping[str, str]) -> list[str]:
    """The same for golden answers of commands, by their names, with the command's module of each in `found`."""
    return _nearest(module, found, COMMANDS)


def _nearest(module: str, found: Mapping[str, str], most: int) -> list[str]:
    """Those whose module reaches this one by the fewest imports, of these those of its own package first; those in the module itself have
    none beside them."""
    reached, near = {module}, list[str]()
    for k in range(FARTHEST):
        new = [name for name, home in found.items() if home in reached and name not in near]
        near += sorted(new, key=lambda name: (not same_package(found[name], module), name))
        if len(near) >= most or (near and not k):
            break
        reached |= {other for other, path in _modules().items() if reached & _imports(path)}
    return near[:most]


def same_package(one: str, other: str) -> bool:
    return one.rpartition(".")[0] == other.rpartition(".")[0]


@cache
def _trial() -> frozenset[str]:
    """The modules that operators are tried with, directly or not."""
    reached, new = set[str](), _imports(HOUSE / "tests" / "golden.py")
    while new:
        reached |= new
        new = frozenset[str]().union(*(_imports(_modules()[m]) for m in new if m in _modules())) - reached
    return frozenset(reached)


@cache
def _tests() -> list[Path]:
    return [p for p in sorted((HOUSE / "tests").rglob("test_*.py")) if p.stem not in EVERYTHING]


@cache
def _modules() -> dict[str, Path]:
    files = [p for package in OURS[:3] for p in sorted((HOUSE / package).rglob("*.py"))]
    return {_name(p): p for p in files if p.stem != "__init__"}


def _name(path: Path) -> str:
    return ".".join(path.relative_to(HOUSE).with_suffix("").parts).removesuffix(".__init__")


@cache
def _imports(path: Path) -> frozenset[str]:
    """The modules in which the names stand that a file imports, and the commands that it runs by name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {_home(node.module, alias.name) for alias in node.names}
        elif isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) in CALLS:
            found |= set(_commands(node))
    return frozenset(found)


def _commands(call: ast.Call) -> Iterator[str]:
    """The modules of the command that a call names, and of its subcommands: `train`, `pose`."""
    given = [word for a in call.args for word in (a.elts if isinstance(a, ast.List) else [a])][:2]
    words = [str(a.value) if isinstance(a, ast.Constant) else "" for a in given]
    if words and words[0]:
        yield from (f"stream.commands.{words[0]}", f"stream.commands.{words[0]}_", "stream.cli")
        for word, groups in zip(words, WORDS, strict=False):
            yield from (_entry_points()[group][word] for group in groups if word in _entry_points()[group])


@cache
def _entry_points() -> dict[str, dict[str, str]]:
    """By group and name, the module that stands for it."""
    groups = tomllib.loads((HOUSE / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"]
    return {group: {name: at.partition(":")[0] for name, at in points.items()} for group, points in groups.items()}


@cache
def _home(module: str, name: str) -> str:
    """The module in which a name stands that is imported from `module`: a module of a package, or what its __init__ takes it from."""
    if module.partition(".")[0] not in OURS:
        return module
    folder = HOUSE.joinpath(*module.split("."))
    if (folder / f"{name}.py").exists() or (folder / name).is_dir():
        return f"{module}.{name}"
    if (folder / "__init__.py").exists():
        for node in ast.walk(ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and name in {a.asname or a.name for a in node.names}:
                return _home(node.module, name)
    return module
