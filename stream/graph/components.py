"""The classes that a graph can name: found by dotted path (`use: operators.emg.Envelope`), or all of them, for editors.

Nothing is registered anywhere: a new source, operator or outlet is a class in a file that Python can import, ours or anyone's; a file
beside the graph will do.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from dataclasses import is_dataclass
from difflib import get_close_matches
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias, TypeGuard

from kinegraph.stream.errors import KinegraphError, asked_to_end, explain, nearest
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.graph import local_modules as own
from kinegraph.stream.graph.moved import today
from kinegraph.stream.operator import Operator
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.source import Source
from kinegraph.stream.system import names

PACKAGES = ("operators", "devices", "stream.manual")
GROUP = "kinegraph.parts"
"""Entry points by which an installed package says where its sources, operators and outlets are: `gait_lab = "gait_lab.operators"`."""
OURS = ("kinegraph", *names.PACKAGES)
"""Tops of dotted names that are never a user's own file."""

Part: TypeAlias = type[Source] | type[Operator[Any]]


class UseError(KinegraphError):
    """A `use` that leads to no source, operator or outlet."""


def import_from(folder: Path, *, trusted_only: bool = False) -> None:
    """Let graphs name modules in `folder` (the graph's own) and in the current one; installed packages come first.

    A module of the same name that another graph's folder had brought in is forgotten. With `trusted_only`, only what is installed is run.
    """
    wanted = [str(folder.absolute()), str(Path().absolute())]
    for old in [entry for entry in own.folders if entry not in wanted]:
        for name in [n for n in sys.modules if _is_beside(n.partition(".")[0], Path(old))]:
            if any((Path(new) / f"{name.partition('.')[0]}{end}").exists() for new in wanted for end in (".py", "")):
                del sys.modules[name]
    own.open_to(wanted, trusted_only=trusted_only)


def _is_beside(top: str, folder: Path) -> bool:
    """Whether the imported module or package `top` is one of `folder`'s own (never one of ours)."""
    file = getattr(sys.modules.get(top), "__file__", None)
    return bool(file) and top not in OURS and Path(str(file)) in (folder / f"{top}.py", folder / top / "__init__.py")


def is_ours(part: object) -> bool:
    """Whether a part's class comes with kinegraph; whatever else a graph names is from outside, and trusted with less."""
    return names.is_ours(type(part).__module__)


def find(use: str) -> Part:
    """The class at a dotted path; raises UseError with the nearest that exists."""
    use = today(use)
    module_name, _, name = use.rpartition(".")
    if not module_name or not all(part.isidentifier() for part in use.split(".")):
        raise UseError(f"use is {use!r}; it must be a dotted path to a class{_similar(use)}")
    module = _import(names.module_of(module_name), use)
    found = getattr(module, name, None)
    if is_part(found):
        return found
    here = [n for n, member in vars(module).items() if is_part(member)]
    if found is None:
        raise UseError(f"{module_name} has no {name!r}; {nearest(name, here)}{_shadowed(module_name)}")
    fault = "it is not a dataclass" if isinstance(found, type) and issubclass(found, Source | Operator) else "it is not"
    hint = f"; {nearest(name, here)}" if here else ""
    raise UseError(f"{use} must be a source, an operator or an outlet (a dataclass), but {fault}{hint}")


def registered(use: str) -> Part | None:
    """The class at a dotted path, if it is ours or in a package registered under `kinegraph.parts`; nothing else is imported."""
    module, _, name = use.rpartition(".")
    known = any(module == package or module.startswith(f"{package}.") for package in packages())
    if not known or not all(part.isidentifier() and not part.startswith("_") for part in use.split(".")):
        return None
    try:
        found = getattr(importlib.import_module(module), name, None)
    except BaseException as error:
        if asked_to_end(error):
            raise
        return None
    return found if is_part(found) else None


def _shadowed(module: str) -> str:
    """A user's own file that an installed module of the same name comes before."""
    top = module.partition(".")[0]
    taken = getattr(sys.modules.get(top), "__file__", None)
    for folder in own.folders:
        mine = Path(folder) / f"{top}.py"
        if mine.exists() and taken and Path(taken).resolve() != mine.resolve():
            return f"; {mine} is ignored, because a module {top!r} is installed ({taken}): rename your file"
    return ""


def is_part(candidate: object) -> TypeGuard[Part]:
    """Whether it is a class that a graph can use, and not one that others are derived from."""
    if not isinstance(candidate, type) or not is_dataclass(candidate):
        return False
    if issubclass(candidate, Source):
        return candidate.read is not Source.read
    if issubclass(candidate, SampleWise):
        return candidate.begin is not SampleWise.begin
    return issubclass(candidate, Operator) and candidate.open is not Operator.open


def kind_of(part: Part) -> str:
    return "source" if issubclass(part, Source) else "outlet" if issubclass(part, Outlet) else "operator"


def packages() -> tuple[str, ...]:
    """Where components are listed from: ours, and those that installed packages name in the entry-point group `kinegraph.parts`."""
    named = sorted({entry.value for entry in entry_points(group=GROUP)})
    return (*PACKAGES, *(name for name in named if name not in PACKAGES))


def catalogue(packages: tuple[str, ...] = PACKAGES) -> tuple[dict[str, Part], dict[str, str]]:
    """All parts in these packages by their shortest dotted path, and the modules that could not be imported, with the reason."""
    found: dict[Part, str] = {}
    failed: dict[str, str] = {}
    for package in packages:
        for name in _modules(names.module_of(package), failed):
            try:
                module = importlib.import_module(name)
            except BaseException as error:  # a broken module must not hide the others; it is reported
                if asked_to_end(error):
                    raise
                failed[name.removeprefix(names.ROOT)] = explain(error)
                continue
            for attribute, member in vars(module).items():
                path = f"{name}.{attribute}".removeprefix(names.ROOT)
                if (
                    is_part(member)
                    and not attribute.startswith("_")
                    and member.__module__.startswith(names.module_of(package))
                ):
                    found[member] = min(found.get(member, path), path, key=partial(_rank, member))
    return {path: part for part, path in sorted(found.items(), key=lambda item: item[1])}, failed


def _rank(part: Part, path: str) -> tuple[int, bool, str]:
    """How good a name is: the shortest, then the one where the class is defined rather than imported."""
    return path.count("."), names.module_of(path.rpartition(".")[0]) != part.__module__, path


def _modules(package: str, failed: dict[str, str]) -> list[str]:
    """The package and everything in it, without importing more than packages."""
    try:
        root = importlib.import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:
            failed[package] = explain(error)
        return []
    except BaseException as error:
        if asked_to_end(error):
            raise
        failed[package] = explain(error)
        return []
    names = [package]
    for info in pkgutil.iter_modules(getattr(root, "__path__", ()), package + "."):
        if not info.name.rpartition(".")[2].startswith("_"):
            names += _modules(info.name, failed) if info.ispkg else [info.name]
    return names


def beside(use: str) -> Path | None:
    """The file beside a graph that naming this class runs; None for what is installed, or cannot be found."""
    top = use.partition(".")[0]
    if not top.isidentifier() or top in OURS:
        return None
    return own.found(top)


def _import(name: str, use: str) -> ModuleType:
    if own.closed and (file := beside(name)):
        raise UseError(
            f"{file} stands beside the graph and is not installed; --trusted-only, as for graphs of other users, does not run it. "
            "Read it; then copy the graph and its files, to be yours, or install it as a package"
        )
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(error.name + ".")):
            raise UseError(f"there is no module {error.name.removeprefix(names.ROOT)!r}{_similar(use)}") from None
        raise UseError(f"{name} could not be imported: {explain(error)}") from error
    except KinegraphError as error:
        raise UseError(str(error)) from error
    except BaseException as error:
        if asked_to_end(error):
            raise
        raise UseError(f"{name} could not be imported: {explain(error)}") from error


def _similar(use: str) -> str:
    """What `use` may have been meant to be."""
    top = use.partition(".")[0]
    known = packages()
    paths = [*catalogue((*known, top) if top not in known and top in sys.modules else known)[0]]
    by_name = {path.rpartition(".")[2].lower(): path for path in paths}
    close = get_close_matches(use, paths, n=1, cutoff=0.75)
    if not close:
        close = [by_name[n] for n in get_close_matches(use.rpartition(".")[2].lower(), by_name, n=1, cutoff=0.75)]
    if close:
        return f"; did you mean {close[0]!r}?"
    mine = sorted({f.stem for d in own.folders for f in Path(d).glob("*.py")})
    close = get_close_matches(top, mine, n=1, cutoff=0.6)
    if close == [use]:
        return f", as in '{use}.MyClass'"
    if close:
        return f"; did you mean {'.'.join([close[0], *use.split('.')[1:]])!r}?"
    theirs = f"; your own files next to the graph are {', '.join(mine)}" if mine else ""
    return f"{theirs}; `kinegraph components` lists all components"
