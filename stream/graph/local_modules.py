"""Code beside a graph: imported for nodes that name it and for what that imports itself, from files that other users cannot write.

Other imports do not find it. A library that tries whether another one is installed does not run a file of that name beside a graph; with
`--trusted-only` nothing does.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Iterable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import FrameType, ModuleType

from kinegraph.stream.system.file_permissions import refuse_shared

WHY = "what a graph runs"
_IMPORT = ("<frozen importlib", importlib.__file__)
_NAMERS = (str(Path(__file__).with_name("components.py")),)
"""The modules that may import code beside a graph."""

folders: list[str] = []
"""The graph's own folder, and the one that the command was called in; those that are on Python's search path in any case are left out."""
closed = False
"""Whether nothing in them is run."""


def open_to(wanted: Iterable[str], *, trusted_only: bool) -> None:
    """From now on, these folders are looked into; with `trusted_only`, they only are for `found` to say what is there."""
    global closed
    closed = trusted_only
    folders[:] = [folder for folder in dict.fromkeys(wanted) if folder not in sys.path]
    for i, finder in ((0, _PARTS), (len(sys.meta_path), _TOPS)):
        if finder not in sys.meta_path:
            sys.meta_path.insert(i, finder)
    importlib.invalidate_caches()


def found(top: str) -> Path | None:
    """The file or folder in them that importing this module or package runs; None for what is installed, or is nowhere."""
    try:
        spec = None if PathFinder.find_spec(top) else PathFinder.find_spec(top, folders)
    except (ImportError, ValueError):
        return None
    return next(iter(_places(spec)), None) if spec else None


def _places(spec: ModuleSpec) -> list[Path]:
    origin = [spec.origin] if spec.origin and spec.has_location else []
    return [Path(place) for place in (*origin, *(spec.submodule_search_locations or ()))]


def _checked(spec: ModuleSpec | None) -> ModuleSpec | None:
    """The spec, if other users cannot write what it runs: the file, what Python compiled it to, and their folders."""
    if spec is None:
        return None
    compiled = [Path(spec.cached)] if spec.cached else []
    for place in (*_places(spec), *compiled):
        for one in (place.parent, place):
            if one.exists():
                refuse_shared(one, WHY)
    return spec


def _within(path: str) -> bool:
    """Whether a file is in one of the folders, and not in a place of installed packages that lies in it, as an environment may."""
    return (here := _depth(path, folders)) > 0 and here > _depth(path, sys.path)


def _depth(path: str, places: Iterable[str]) -> int:
    """How long the longest of the places is that a file is in."""
    return max(
        (len(place) for place in places if path == place or path.startswith(place.rstrip(os.sep) + os.sep)), default=0
    )


def _asks() -> bool:
    """Whether the import under way is one of a graph's, or of a file in the folders."""
    frame: FrameType | None = sys._getframe(2)
    while frame and frame.f_code.co_filename.startswith(_IMPORT):
        frame = frame.f_back
    return frame is not None and (frame.f_code.co_filename in _NAMERS or _within(frame.f_code.co_filename))


class _TopsBeside(MetaPathFinder):
    """Finds modules and packages in the folders, after everything that is installed."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if path is not None or closed or not folders or not _asks():
            return None
        return _checked(PathFinder.find_spec(name, folders))


class _PartsBeside(MetaPathFinder):
    """Finds what packages in the folders hold, before Python would without a look at who may write it."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if path is None or not folders or not any(map(_within, path)):
            return None
        return _checked(PathFinder.find_spec(name, path))


_PARTS, _TOPS = _PartsBeside(), _TopsBeside()
