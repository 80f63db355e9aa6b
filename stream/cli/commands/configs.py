"""`kinegraph configs`: the graphs that come with kinegraph, listed, or copied to be changed."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.graph.shipped import shipped, shipped_parts, summary


def configs(
    names: Annotated[list[str] | None, typer.Argument(metavar="NAME", help="the graphs to copy")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FOLDER", help="where the copies go")] = Path(),
    as_json: AsJson = False,
) -> None:
    """List the graphs that come with kinegraph; with names, copy these into a folder, to be changed there.

    They run by name as they are: `kinegraph run treadmill_emg`. A file of that name in the current folder comes first. Parts, which
    other graphs use as nodes, are found by every graph; a copy beside a graph comes first.
    """
    parts = shipped_parts()
    there = shipped() | parts
    if not there:
        raise KinegraphError("no graphs are installed with kinegraph; install it from a wheel, or work in a checkout")
    if not names and as_json:
        print_json([{"name": name, "path": path, "what": summary(path)} for name, path in there.items()])
        return
    if not names:
        width = max(map(len, there))
        for name, path in there.items():
            print(f"{name:<{width}}  {summary(path)}")
        return
    for name in names:
        if name not in parts and Path(name).stem not in there:
            raise KinegraphError(f"there is no shipped graph {name!r}; {nearest(name, there)}")
    chosen = [
        (there[name], name) if name in parts else (there[Path(name).stem], Path(name).stem + ".yaml") for name in names
    ]
    copies = {path: out / name for path, name in chosen}
    for copy in copies.values():
        if copy.exists():
            raise KinegraphError(f"{copy} already exists; choose another --out, or delete it first")
    for path, copy in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
        if not as_json:
            print(copy)
    if as_json:
        print_json([*copies.values()])
