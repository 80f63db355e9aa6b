"""Designs, remembered on the disk: scipy.signal takes a second to import, which the second start of a graph can do without.

What a design function gave is kept beside the compiled kernels, under a name made of the function's fingerprint, its arguments and the
versions of numpy and scipy. It comes back bit for bit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from importlib.metadata import version
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np

from kinegraph.stream.compiler.cache import cache_folder
from kinegraph.stream.compiler.fingerprint import fingerprint
from kinegraph.stream.data.bounded import arrays
from kinegraph.stream.system.atomic_file import complete, private_folder

P = ParamSpec("P")
R = TypeVar("R")
ONLY = "only"
"""The name of what is kept where it is no tuple."""


def remembered(design: Callable[P, R]) -> Callable[P, R]:
    """For a pure function of numbers, texts and arrays that returns an array, a number, or a tuple of these."""

    @wraps(design)
    def recall(*args: P.args, **kwargs: P.kwargs) -> R:
        path = _folder() / f"{design.__name__}-{_key(design, args, kwargs)}.npz"
        try:
            parts = {name: _plain(array) for name, array in arrays(path).items()}
        except (OSError, ValueError):
            result = design(*args, **kwargs)
            _keep(path, result)
            return result
        return cast(R, parts[ONLY] if ONLY in parts else tuple(parts.values()))

    return recall


def _keep(path: Path, result: object) -> None:
    """Write under another name first: another process may read, or do the same. A folder that cannot be written is no fault."""
    named = {str(i): part for i, part in enumerate(result)} if isinstance(result, tuple) else {ONLY: result}
    try:
        with complete(path, shared=True) as draft, draft.open("wb") as file:
            np.savez(file, **cast(Any, named))
    except OSError:
        return


def _plain(value: np.ndarray) -> Any:
    return value if value.ndim else value.item()


def _key(design: Callable[..., object], args: tuple[object, ...], kwargs: dict[str, object]) -> str:
    digest = hashlib.sha256(f"{design.__module__}.{design.__qualname__} {_source(design)}".encode())
    for value in (*_versions(), *args, *sorted(kwargs.items())):
        digest.update(value.tobytes() if isinstance(value, np.ndarray) else b"")
        digest.update(f"{value.shape}{value.dtype}".encode() if isinstance(value, np.ndarray) else repr(value).encode())
    return digest.hexdigest()[:24]


@cache
def _source(design: Callable[..., object]) -> str:
    return fingerprint(design)


@cache
def _versions() -> tuple[str, ...]:
    return tuple(version(name) for name in ("numpy", "scipy"))


@cache
def _folder() -> Path:
    folder = cache_folder() / "designs"
    with suppress(OSError):
        private_folder(folder)
    return folder
