"""`python -m tests.constants [--write]`: the numbers that operators/ and stream/ declare, against those that are kept; what changed.

Kept are constants, defaults of functions, and defaults of dataclasses' fields: thresholds, table entries and sizes that no kernel has to be
compiled for to be compared. A number that changes on purpose is written again, and reviewers see it in the change.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import inspect
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

HOUSE = Path(__file__).resolve().parent.parent
KEPT = Path(__file__).with_name("laws") / "golden" / "constants.json"
PACKAGES = ("operators", "stream")
LONGEST = 80
"""What is longer is kept as a digest."""


def modules() -> list[str]:
    """The modules, by name; but for programs, which run when they are imported."""
    files = (
        path for package in PACKAGES for path in sorted((HOUSE / package).rglob("*.py")) if path.name != "__main__.py"
    )
    names = (str(path.relative_to(HOUSE).with_suffix("")).replace("/", ".").removesuffix(".__init__") for path in files)
    return list(names)


def declared(name: str) -> dict[str, str]:
    """The values that a module itself declares, by name. Texts are left out: other tests read them, and words may change."""
    module = importlib.import_module(name)
    found = {}
    for what, value in _values(module, ast.parse(Path(str(module.__file__)).read_bytes())):
        told = _told(value)
        if told is not None:
            found[what] = told if len(told) <= LONGEST else hashlib.sha256(told.encode()).hexdigest()[:16]
    return found


def _values(module: Any, tree: ast.Module) -> Iterator[tuple[str, Any]]:
    for node in tree.body:
        match node:
            case ast.Assign(targets=targets):
                names = [n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)]
            case ast.AnnAssign(target=ast.Name(id=one)):
                names = [one]
            case ast.FunctionDef() | ast.ClassDef():
                yield from _defaults(node.name, getattr(module, node.name, None))
                continue
            case _:
                continue
        yield from ((one, getattr(module, one)) for one in names if hasattr(module, one))


def _defaults(name: str, found: Any) -> Iterator[tuple[str, Any]]:
    """Defaults of a function's parameters or a dataclass's fields, and what else a class declares in capitals."""
    if is_dataclass(found):
        yield from ((f"{name}.{f.name}", f.default) for f in fields(found) if f.default is not MISSING)
    if inspect.isclass(found):
        for one, value in vars(found).items():
            if not one.startswith("__") and (inspect.isfunction(value) or not callable(value)):
                yield from (
                    _defaults(f"{name}.{one}", value) if inspect.isfunction(value) else [(f"{name}.{one}", value)]
                )
    else:
        function = getattr(found, "py_func", found)
        if inspect.isfunction(function):
            named = inspect.signature(function).parameters.values()
            yield from ((f"{name}({p.name})", p.default) for p in named if p.default is not p.empty)


def _told(value: Any) -> str | None:
    """A value as text, the same on every machine; None where there are no numbers in it."""
    match value:
        case bool() | int() | bytes():
            return repr(value)
        case float() | np.floating():
            return f"{value:.12g}"
        case np.dtype():
            return str(value.descr if value.names else value.str)
        case np.ndarray() if value.dtype.kind in "biuf":
            return f"{value.dtype.str} {value.shape} {' '.join(f'{one:.9g}' for one in value.ravel().tolist())}"
        case np.integer() | np.bool_():
            return str(value)
        case Mapping():
            return _several([*value.keys(), *value.values()], "{")
        case tuple() | list():
            return _several(list(value), "(")
        case set() | frozenset():
            return _several(sorted(value, key=repr), "{")
    return None


def _several(values: list[Any], mark: str) -> str | None:
    parts = [_told(one) for one in values]
    return (
        None if not parts or all(p is None for p in parts) else mark + ", ".join("_" if p is None else p for p in parts)
    )


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.constants", description=__doc__)
    parser.add_argument("--write", action="store_true", help="keep what is declared now")
    given = parser.parse_args()
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    now = {name: found for name in modules() if (found := declared(name))}
    changed = [
        f"{name}: {what}: {kept.get(name, {}).get(what)}  ->  {now.get(name, {}).get(what)}"
        for name in sorted({*kept, *now})
        for what in sorted({*kept.get(name, {}), *now.get(name, {})})
        if kept.get(name, {}).get(what) != now.get(name, {}).get(what)
    ]
    print("\n".join(changed) if changed else "nothing changed")
    if given.write:
        KEPT.write_text(json.dumps(now, indent=0, sort_keys=True, ensure_ascii=False) + "\n", encoding="utf-8")
    return 1 if changed and not given.write else 0


if __name__ == "__main__":
    sys.exit(main())
