"""The one compiler: `@kernel` turns a function of arrays into machine code, cached so that no stale code is ever used.

Numba's own disk cache watches one file, so an edit in a kernel that another file's kernel calls goes unseen, and an edit of a file compiles
all kernels in it. Here the folder in which a kernel is kept is named by its fingerprint (`stream.compiler.fingerprint`): a hash of all
that its code
depends on, of ours and of a user's; where its file lies and what else stands in it does not count. An edit opens new folders for the
kernels that it can change; folders that were not used for a month are removed.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, overload

import platformdirs
from numba.core import caching

from kinegraph.stream.compiler.fingerprint import fingerprint
from kinegraph.stream.compiler.nested import KernelDispatcher
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder
from kinegraph.stream.system.file_permissions import refuse_shared

FunctionCache: Any = caching.FunctionCache
CompileResultCacheImpl: Any = caching.CompileResultCacheImpl
P = ParamSpec("P")
R = TypeVar("R")

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
    cache_folder()
    options = {"nopython": True, "boundscheck": None, "nogil": nogil, "error_model": "numpy"}
    compiled: Any = KernelDispatcher(function, {}, options)
    compiled._cache = _Kept(function, nogil)
    return compiled  # type: ignore[no-any-return]


class _Kept:
    """Numba's cache of one kernel, opened at the first compilation: only then is all imported that the kernel depends on."""

    def __init__(self, function: Callable[..., Any], nogil: bool) -> None:
        self._function, self._nogil = function, nogil
        self._opened: Any = None

    def __getattr__(self, name: str) -> Any:
        if self._opened is None:
            _load_numba()
            self._opened = _KernelCache(self._function, self._nogil)
        return getattr(self._opened, name)


class _Place:
    """Where numba keeps a kernel: the folder of its fingerprint, which tells all that a file's age and a line's number would."""

    def __init__(self, function: Callable[..., Any], nogil: bool) -> None:
        name = f"{function.__module__}-{fingerprint(function)}{'-nogil' if nogil else ''}"
        folder = cache_folder() / name
        refuse_shared(private_folder(folder), "a folder of compiled kernels")
        os.utime(folder)
        self._folder, self._py_file = str(folder), function.__code__.co_filename

    def from_function(self, _function: Callable[..., Any], _file: str) -> _Place:
        """Asked by numba, which would otherwise choose among places."""
        return self

    def get_cache_path(self) -> str:
        return self._folder

    def ensure_cache_path(self) -> None:
        private_folder(Path(self._folder))

    def get_source_stamp(self) -> str:
        return ""

    def get_disambiguator(self) -> str:
        return "kernel"


class _KernelFiles(CompileResultCacheImpl):  # type: ignore[misc]
    def __init__(self, function: Callable[..., Any], nogil: bool) -> None:
        self._locator_classes = (_Place(function, nogil),)
        super().__init__(function)


class _KernelCache(FunctionCache):  # type: ignore[misc]
    def __init__(self, function: Callable[..., Any], nogil: bool) -> None:
        self._impl_class = partial(_KernelFiles, nogil=nogil)
        super().__init__(function)


@cache
def _load_numba() -> None:
    """Load what numba knows of numpy, without scipy.linalg, which takes a third of a second and only shows that there is a BLAS; code that
    calls one still loads it."""
    from numba.np import linalg

    asks, linalg.ensure_blas = linalg.ensure_blas, lambda: None
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = asks


@cache
def cache_folder() -> Path:
    """Where compiled kernels are kept, each in a folder of its own."""
    folder = Path(os.environ.get("KINEGRAPH_CACHE", platformdirs.user_cache_dir("kinegraph"))) / "kernels"
    try:
        private_folder(folder)
        os.utime(folder)
    except OSError as error:
        raise KinegraphError(
            f"compiled kernels cannot be kept in {folder}: {error.strerror}; set KINEGRAPH_CACHE to a folder that can be written"
        ) from None
    for shared in (folder.parent, folder):
        refuse_shared(shared, "the folder of compiled kernels")
    _forget_unused(folder)
    return folder


def _forget_unused(top: Path) -> None:
    for old in top.iterdir():
        with suppress(OSError):
            if time.time() - old.stat().st_mtime > _MONTH_S:
                shutil.rmtree(old)
