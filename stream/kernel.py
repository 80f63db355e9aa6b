"""The one compiler: `@kernel` turns a function of arrays into machine code, cached so that no stale code is ever used.

Numba's own disk cache watches one file, so an edit in a kernel that another file's kernel calls goes unseen. Here the cache's folder
is named by a hash of all sources of the three packages (and of the package that a user's own kernel lives in), so that an edit anywhere
opens a new folder; folders that were not used for a month are removed.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, overload

import numba
import platformdirs
from numba.core import config as numba_config

from stream.errors import KinegraphError

config: Any = numba_config
P = ParamSpec("P")
R = TypeVar("R")

_HOUSE = Path(__file__).resolve().parent.parent
_PACKAGES = ("stream", "devices", "operators")
_MONTH_S = 30 * 24 * 3600


@overload
def kernel(function: Callable[P, R], /) -> Callable[P, R]: ...
@overload
def kernel(*, nogil: bool = False) -> Callable[[Callable[P, R]], Callable[P, R]]: ...


def kernel(function: Callable[P, R] | None = None, /, *, nogil: bool = False) -> object:
    """Compile a plain function of arrays and scalars on its first call (without fastmath: outputs must not depend on chunking).

    `nogil` releases the interpreter lock; only for kernels that take more than about 50 us (frames, meshes): giving it up for less
    costs milliseconds beside a busy thread.
    """
    if function is None:
        return lambda f: _compile(f, nogil)
    return _compile(function, nogil)


def _compile(function: Callable[P, R], nogil: bool) -> Callable[P, R]:
    package = _package_of(function)
    folder = cache_folder(package)
    if package:  # what is kept names the module it came from, and a file of one's own may be imported by several names
        folder /= function.__module__
    with _kept_in(folder):
        compiled: Callable[P, R] = numba.njit(cache=True, nogil=nogil, error_model="numpy")(function)
    return compiled


def is_kernel(candidate: object) -> bool:
    """Whether it is a kernel that other compiled code can call by its name, and that keeps the interpreter's lock."""
    if not isinstance(candidate, numba.core.dispatcher.Dispatcher) or candidate.targetoptions.get("nogil"):
        return False
    return getattr(sys.modules.get(candidate.__module__), candidate.py_func.__name__, None) is candidate


def compile_written(name: str, signature: str, source: str, kernels: Sequence[Callable[..., Any]]) -> Any:
    """Compile the function `name` of a source that calls these kernels as step0, step1, ...; source and code are kept for the next time."""
    imports = "".join(f"from {k.__module__} import {k.__name__} as step{i}\n" for i, k in enumerate(kernels))
    folders = {str(cache_folder(_package_of(k.py_func))) for k in kernels}  # type: ignore[attr-defined]
    digest = hashlib.sha256("\n".join([*sorted(folders), imports, source]).encode()).hexdigest()[:20]
    module_name = f"kinegraph_row_{digest}"
    module = sys.modules.get(module_name)
    if module is None:
        path = _written_down(f"{module_name}.py", imports + source)
        spec = importlib.util.spec_from_file_location(module_name, path)
        assert spec and spec.loader
        module = sys.modules[module_name] = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
            with _kept_in(cache_folder()):
                setattr(module, name, numba.njit(signature, cache=True, error_model="numpy")(getattr(module, name)))
        except BaseException:
            del sys.modules[module_name]
            raise
    return getattr(module, name)


def _written_down(name: str, source: str) -> Path:
    """The file in the cache that holds this source."""
    folder = cache_folder() / "rows"
    path = folder / name
    try:
        folder.mkdir(exist_ok=True)
        if not path.exists():
            draft = path.with_suffix(f".{os.getpid()}")
            draft.write_text(source, encoding="utf-8")
            draft.replace(path)
    except OSError as error:
        raise KinegraphError(
            f"compiled kernels cannot be kept in {folder}: {error.strerror}; free some space there"
        ) from None
    return path


@contextmanager
def _kept_in(folder: Path) -> Iterator[None]:
    """Within: what numba compiles is kept in this folder."""
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        config.CACHE_DIR = before


@cache
def _package_of(function: Callable[..., object]) -> Path | None:
    """The folder of a user's own package, or of a file in none; None for ours."""
    path = Path(inspect.getfile(function)).resolve()
    if any(path.is_relative_to(_HOUSE / package) for package in _PACKAGES):
        return None
    folder = path.parent
    while (folder / "__init__.py").exists() and (folder.parent / "__init__.py").exists():
        folder = folder.parent
    return folder


@cache
def cache_folder(user: Path | None = None) -> Path:
    """Where compiled kernels are kept: named by a hash of all our sources and, if given, of a user's package (or folder of files)."""
    digest = hashlib.sha256()
    for root in [_HOUSE / package for package in _PACKAGES] + ([user] if user else []):
        deep = root != user or (root / "__init__.py").exists()
        for file in sorted(root.rglob("*.py") if deep else root.glob("*.py")):
            digest.update(str(file.relative_to(root)).encode())
            digest.update(file.read_bytes())
    top = Path(os.environ.get("KINEGRAPH_CACHE", platformdirs.user_cache_dir("kinegraph"))) / "kernels"
    folder = top / digest.hexdigest()[:20]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError as error:
        raise KinegraphError(
            f"compiled kernels cannot be kept in {top}: {error.strerror}; set KINEGRAPH_CACHE to a folder that can be written"
        ) from None
    _forget_unused(top)
    return folder


def _forget_unused(top: Path) -> None:
    for old in top.iterdir():
        with suppress(OSError):
            if time.time() - old.stat().st_mtime > _MONTH_S:
                shutil.rmtree(old)
