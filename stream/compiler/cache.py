"""Where machine code is kept: in the package itself, and in the cache of whoever runs kinegraph.

Numba's disk cache watches one file, so an edit in a kernel that another file's kernel calls goes unseen, and an edit of a file compiles
all kernels in it. Here the folder of a kernel is named by its fingerprint (`stream.compiler.fingerprint`): a hash of all that its code
depends on, of ours and of a user's; where its file lies and what else it holds does not count. An edit opens new folders for the kernels
that it can change; folders that were not used for a month are removed.

In the folder is one file for each set of argument types and kind of processor. It is written as soon as that code is compiled, under a name
that only this code can have, so that several processes may compile into one cache.

A platform wheel holds kernels compiled for a level of processors (`tests/platform_wheel.py` puts them there). They are used where numba,
llvmlite, numpy and Python are those that made them and the processor has the level; they give the same bits as what is compiled here, since
nothing is compiled with fastmath or with a library of vector functions. All else is compiled here, for this processor.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from hashlib import blake2b
from pathlib import Path
from typing import Any

import llvmlite
import numpy as np
import platformdirs

os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")  # numba takes that library where it finds it, and so other bits
import numba
import zstandard
from numba.cloudpickle import loads
from numba.core import compiler, serialize, sigutils
from numba.core.errors import NumbaWarning

from kinegraph.stream.compiler.fingerprint import fingerprint
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import complete, private_folder
from kinegraph.stream.system.file_permissions import refuse_shared

_numba_result: Any = compiler.CompileResult
_dumps: Any = serialize.dumps
_types_of: Any = sigutils.normalize_signature

_MONTH_S = 30 * 24 * 3600
_SIZE = 16
"""Bytes of the hash before the code in a file: a file that a power cut has left half written is compiled again."""
MADE_BY = "-".join(
    (
        f"numba-{numba.__version__}",
        f"llvmlite-{llvmlite.__version__}",
        f"numpy-{np.__version__.rpartition('.')[0]}",
        str(sys.implementation.cache_tag),
        *(("svml",) if numba.config.USING_SVML else ()),  # type: ignore[attr-defined]
    )
)
"""Who has compiled."""
SUFFIX = ".nbz"
SHIPPED = Path(__file__).parents[2] / "compiled"
"""The package's own machine code: in a folder for each level, in one named by who has compiled."""
_LEVEL_2 = frozenset(("cx16", "popcnt", "sahf", "sse3", "sse4.1", "sse4.2", "ssse3"))
LEVELS = {
    "x86-64-v3": _LEVEL_2 | {"avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"},
    "x86-64-v2": _LEVEL_2,
}
"""Kinds of processors by LLVM's names, and the features that they have; the best first."""

_at_miss: list[Callable[[], None]] = []


class KernelCache:
    """The machine code of one kernel, as numba asks for it and gives it. Nothing is read before the first call."""

    def __init__(self, function: Callable[..., Any], nogil: bool) -> None:
        self._function, self._nogil = function, nogil

    @cached_property
    def name(self) -> str:
        """The kernel's folder."""
        return f"{self._function.__module__}-{fingerprint(self._function)}{'-nogil' if self._nogil else ''}"

    @property
    def cache_path(self) -> str:
        """Asked by numba for its statistics."""
        return str(cache_folder() / self.name)

    @property
    def is_kept(self) -> bool:
        """Whether there is code of it, for whatever types of arguments."""
        for top in (*(SHIPPED / MADE_BY / level for level in levels()), cache_folder()):
            with suppress(OSError):
                if any(entry.endswith(SUFFIX) for entry in os.listdir(top / self.name)):  # noqa: PTH208
                    return True
        return False

    def load_overload(self, signature: Any, target: Any) -> Any:
        """The code for these types of arguments; None if it must be compiled. Asked by numba, which holds its lock meanwhile."""
        _load_numba()
        target.refresh()
        found = self._found(signature, target)
        if found is None and _at_miss:
            _at_miss.pop()()
            found = self._found(signature, target)
        if found is None:
            self._folder()  # an error before the compiler's work, not after it
        return found

    def save_overload(self, signature: Any, code: Any) -> None:
        """Keep what has been compiled."""
        if code.library.has_dynamic_globals or not all(lifted.can_cache for lifted in code.lifted):
            warnings.warn(
                f"the machine code of {self._function.__qualname__} cannot be kept", NumbaWarning, stacklevel=2
            )
            return
        content = zstandard.compress(_dumps(code._replace(type_annotation="")._reduce()))
        path = self._folder() / _file(signature, code.codegen.magic_tuple())
        try:
            with complete(path, shared=True) as draft:
                draft.write_bytes(_hash(content) + content)
        except OSError as error:
            raise KinegraphError(
                f"compiled kernels cannot be kept in {path.parent}: {error.strerror}; free some space there"
            ) from None

    def flush(self) -> None:
        """Numba's `recompile` forgets what was kept."""
        shutil.rmtree(self.cache_path, ignore_errors=True)

    def _found(self, signature: Any, target: Any) -> Any:
        processor = target.codegen().magic_tuple()
        for level in levels():
            content = _checked(SHIPPED / MADE_BY / level / self.name / _file(signature, (processor[0], level, "")))
            if content is not None:
                return _numba_result._rebuild(target, *loads(content))
        folder = cache_folder() / self.name
        if folder.exists():
            refuse_shared(folder, "a folder of compiled kernels")
        content = _checked(folder / _file(signature, processor))
        if content is None:
            return None
        with suppress(OSError):
            os.utime(folder)
        return _numba_result._rebuild(target, *loads(content))

    def _folder(self) -> Path:
        folder = cache_folder() / self.name
        try:
            refuse_shared(private_folder(folder), "a folder of compiled kernels")
        except OSError as error:
            raise KinegraphError(
                f"compiled kernels cannot be kept in {folder.parent}: {error.strerror}; "
                "set KINEGRAPH_CACHE to a folder that can be written"
            ) from None
        return folder


@contextmanager
def at_first_miss(act: Callable[[], None]) -> Iterator[None]:
    """Within: `act` is called once, before the first kernel is compiled; what it brings into the cache is then used."""
    _at_miss[:] = [act]
    try:
        yield
    finally:
        _at_miss.clear()


@cache
def levels() -> tuple[str, ...]:
    """The levels of which the package holds machine code that this process can use, the best first."""
    made = [level for level in LEVELS if (SHIPPED / MADE_BY / level).is_dir()]
    if not made or numba.config.CPU_NAME is not None:  # type: ignore[attr-defined]
        return ()  # somebody wants code for a processor of another kind
    here = {name for name, is_there in llvmlite.binding.get_host_cpu_features().items() if is_there}
    return tuple(level for level in made if here >= LEVELS[level])


@cache
def cache_folder() -> Path:
    """Where compiled kernels are kept, each in a folder of its own. It is made here if it can be made: not everyone has to write to it."""
    folder = Path(os.environ.get("KINEGRAPH_CACHE", platformdirs.user_cache_dir("kinegraph"))) / "kernels"
    with suppress(OSError):
        private_folder(folder)
        os.utime(folder)
    for shared in (folder.parent, folder):
        if shared.exists():
            refuse_shared(shared, "the folder of compiled kernels")
    _forget_unused(folder)
    return folder


def kept_count() -> int:
    """How many pieces of machine code the cache holds."""
    return sum(1 for _ in cache_folder().glob(f"*/*{SUFFIX}"))


def _forget_unused(top: Path) -> None:
    with suppress(OSError):
        for old in list(top.iterdir()):
            with suppress(OSError):
                if time.time() - old.stat().st_mtime > _MONTH_S:
                    shutil.rmtree(old)


def _file(signature: Any, target: tuple[str, ...]) -> str:
    """Named by the types of arguments, the processor, and who has compiled."""
    types = _types_of(signature)
    return blake2b(f"{types} {target} {MADE_BY}".encode(), digest_size=_SIZE).hexdigest() + SUFFIX


def _hash(content: bytes) -> bytes:
    return blake2b(content, digest_size=_SIZE).digest()


def _checked(path: Path) -> bytes | None:
    """What a file of machine code holds; None if there is none, or not the whole of it."""
    try:
        found = path.read_bytes()
    except OSError:
        return None
    content = found[_SIZE:]
    return zstandard.decompress(content) if found[:_SIZE] == _hash(content) else None


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
