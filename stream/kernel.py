"""The one compiler: `@kernel` turns a function of arrays into machine code, which is kept (`stream.compiler.cache`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, overload

from kinegraph.stream.compiler.cache import KernelCache
from kinegraph.stream.compiler.nested import KernelDispatcher

P = ParamSpec("P")
R = TypeVar("R")


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
    options = {"nopython": True, "boundscheck": None, "nogil": nogil, "error_model": "numpy"}
    compiled: Any = KernelDispatcher(function, {}, options)
    compiled._cache = KernelCache(function, nogil)
    return compiled  # type: ignore[no-any-return]
