"""Every dataclass has slots, and is frozen unless something writes into it: a state, which is restored, or what code assigns to."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from tests.public_names import HOUSE

ROOMS = ("stream", "devices", "operators")


@dataclass(frozen=True, slots=True)
class Declared:
    """A dataclass of the tree: its module, what its decorator says, its fields, the names that their types and its bases mention, and what
    it holds as an operator or outlet does: the types in `Operator[...]`."""

    name: str
    module: str
    said: dict[str, bool]
    fields: frozenset[str]
    mentions: frozenset[str]
    holds: frozenset[str]


@cache
def trees() -> dict[str, ast.Module]:
    files = [path for room in ROOMS for path in sorted((HOUSE / room).rglob("*.py"))]
    return {_module(path): ast.parse(path.read_text(encoding="utf-8")) for path in files}


def _module(path: Path) -> str:
    return ".".join(path.relative_to(HOUSE).with_suffix("").parts).removesuffix(".__init__")


@cache
def declared() -> tuple[Declared, ...]:
    return tuple(
        Declared(
            node.name,
            module,
            {k.arg: bool(getattr(k.value, "value", False)) for k in call.keywords if k.arg},
            frozenset(
                s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)
            ),
            frozenset(_names([s.annotation for s in node.body if isinstance(s, ast.AnnAssign)] + node.bases)),
            frozenset(_names([base.slice for base in node.bases if isinstance(base, ast.Subscript)])),
        )
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for call in node.decorator_list
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "dataclass"
    )


def _names(nodes: list[ast.expr]) -> Iterator[str]:
    yield from (n.id for node in nodes for n in ast.walk(node) if isinstance(n, ast.Name))


@cache
def states() -> frozenset[str]:
    """States, and what they are made of: named so, held by an operator or outlet, or the type of a field of one."""
    found = {c.name for c in declared() if c.name.endswith("State")}.union(*(c.holds for c in declared()))
    while more := {name for c in declared() if c.name in found for name in c.mentions} - found:
        found |= more
    return frozenset(found)


@cache
def _assigned(module: str) -> frozenset[str]:
    """The attributes that a module writes to."""
    return frozenset(
        n.attr for n in ast.walk(trees()[module]) if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)
    )


@cache
def _imported(module: str) -> frozenset[str]:
    found: set[str] = set()
    for node in ast.walk(trees()[module]):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(found)


@cache
def _importers(module: str) -> frozenset[str]:
    return frozenset(m for m in trees() if module in _imported(m))


def written(one: Declared) -> bool:
    """Whether code in the class's module, or in one that imports it or such a module, assigns to an attribute that is called as a field."""
    near = {one.module, *_importers(one.module)}
    return any(one.fields & _assigned(m) for m in near.union(*(_importers(m) for m in near)))


@pytest.mark.parametrize("room", ROOMS)
def test_a_dataclass_has_slots(room: str) -> None:
    assert [c.name for c in declared() if c.module.partition(".")[0] == room and not c.said.get("slots")] == []


@pytest.mark.parametrize("room", ROOMS)
def test_a_dataclass_that_nothing_writes_to_is_frozen(room: str) -> None:
    open_ = [c for c in declared() if c.module.partition(".")[0] == room and not c.said.get("frozen")]
    assert [f"{c.module}.{c.name}" for c in open_ if c.fields and c.name not in states() and not written(c)] == []
