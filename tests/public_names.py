"""`python -m tests.public_names`: write what `operators` and `devices` offer by short names into their __init__ files; tests compare."""

from __future__ import annotations

from pathlib import Path

from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.system.names import module_of

HOUSE = Path(__file__).resolve().parent.parent
PACKAGES = ("operators", "devices")
TEMPLATE = """{docstring}

from typing import TYPE_CHECKING

from kinegraph.stream.system.lazy import offered

if __name__ != "kinegraph.{package}":
    raise ImportError("the package is kinegraph.{package}: write `from kinegraph.{package} import ...`")

if TYPE_CHECKING:
{imports}

__all__ = [
{names}
]

__getattr__, __dir__ = offered(
    __name__,
    {{
{places}
    }},
)
"""


def text_of(package: str) -> str:
    """The __init__ file of a package as it should be: its docstring stays, every source, operator and outlet is offered."""
    docstring = (HOUSE / package / "__init__.py").read_text(encoding="utf-8").split("\n", 1)[0]
    places = {use.rpartition(".")[2]: module_of(use.rpartition(".")[0]) for use in catalogue((package,))[0]}
    names = sorted(places)
    modules: dict[str, list[str]] = {}
    for name in names:
        modules.setdefault(places[name], []).append(name)
    return TEMPLATE.format(
        docstring=docstring,
        package=package,
        imports="\n".join(f"    from {module} import {', '.join(modules[module])}" for module in sorted(modules)),
        names="\n".join(f'    "{name}",' for name in names),
        places="\n".join(f'        "{name}": "{places[name]}",' for name in names),
    )


if __name__ == "__main__":
    for one in PACKAGES:
        (HOUSE / one / "__init__.py").write_text(text_of(one), encoding="utf-8")
