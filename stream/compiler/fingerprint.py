"""What a function or a class depends on, as a hash: a function's code, and what its names stand for, in its own file and in others.

Kernels are cached under it, so an edit recompiles the kernels that it can change and no others, in the file that was edited, too. Names are
followed to the values that they have when the fingerprint is taken: through functions, kernels, intrinsics and modules, of ours and of a
user's; constants count by value. Anything else (a class, an object) is hashed by its source file, a library's object
by the file that names it. Of a class files alone count, so that nothing that a program changes while it runs can change the hash.
"""

from __future__ import annotations

import hashlib
import sys
import sysconfig
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

OURS = ("kinegraph",)
_PLAIN = (int, float, complex, str, bytes, type(None), np.dtype, np.generic)
_LIBRARIES = tuple(
    str(Path(path).resolve()) for name, path in sysconfig.get_paths().items() if name in ("stdlib", "platstdlib")
)


def fingerprint(function: Callable[..., Any]) -> str:
    """A hash of the code and constants that `function` depends on. Take it when the function's module is imported whole."""
    home = function.__module__.partition(".")[0]
    facts: set[str] = set()
    waiting: list[object] = [function]
    seen: list[object] = []  # kept, so that no id is given out twice
    known: set[int] = set()
    while waiting:
        thing = waiting.pop()
        if id(thing) in known:
            continue
        known.add(id(thing))
        seen.append(thing)
        if isinstance(thing, FunctionType):
            facts.add(_code_of(thing))
            found = dict(_reached(thing))
            facts.update(
                f"{thing.__module__}.{thing.__qualname__} {name} = {_told(value)}" for name, value in found.items()
            )
            if not all(_is_known(value, home) for value in found.values()):
                facts.add(_source(thing))
        else:
            found = {"": thing}
        for value in found.values():
            if constant := _constant(value):
                facts.add(constant)
            elif isinstance(value, tuple | list | frozenset | set):
                waiting += value
            elif _is_followed(value, home):
                waiting += _inside(value)
                if _function_in(value) is None:
                    facts.add(_file(_module_of(value)))
    return hashlib.sha256("\n".join(sorted(facts)).encode()).hexdigest()[:20]


def fingerprint_of_class(cls: type) -> str:
    """A hash of the files that a class's methods, those of its bases, and the functions and classes that they name stand in."""
    home = cls.__module__.partition(".")[0]
    files: set[str] = set()
    waiting: set[object] = {cls}
    known: set[object] = set()
    while waiting:
        known.add(thing := waiting.pop())
        found, led = _leads(thing, home)
        files |= found
        waiting |= led - known
    return hashlib.sha256("\n".join(sorted(files)).encode()).hexdigest()[:20]


def kernels_of(cls: type) -> set[Any]:
    """The kernels that a class's methods, and the functions and classes that they name, may call; not those within kernels."""
    home = cls.__module__.partition(".")[0]
    waiting: set[object] = {cls}
    known: set[object] = set()
    while waiting:
        known.add(thing := waiting.pop())
        if isinstance(thing, Dispatcher):
            continue
        waiting |= _leads(thing, home)[1] - known
        if isinstance(thing, type) and _is_followed(thing, home):
            waiting |= {value for value in vars(thing).values() if isinstance(value, Dispatcher)} - known
    return {thing for thing in known if isinstance(thing, Dispatcher)}


@cache
def size_of(kernel: Any) -> int:
    """How much a compiler has to do for a kernel: the bytes of its code and of all kernels in it."""
    inside: set[Any] = set()
    waiting = {kernel}
    while waiting:
        inside.add(found := waiting.pop())
        waiting |= {value for _, value in _reached(found.py_func) if isinstance(value, Dispatcher)} - inside
    return sum(len(found.py_func.__code__.co_code) for found in inside)


@cache
def _leads(thing: object, home: str) -> tuple[frozenset[str], frozenset[object]]:
    """The hashes of the files that a class, a function or a kernel stands in, or imports when it runs; and which ones it names."""
    if not _is_followed(thing, home):
        return frozenset(), frozenset()
    if isinstance(thing, FunctionType):
        later = (_hash_of(path) for path in _imported_later(thing, home))
        named = (value for _, value in _reached(thing) if isinstance(value, FunctionType | type | Dispatcher))
        return frozenset((_source(thing), *later)), frozenset(named)
    if isinstance(thing, type):
        members = (getattr(m, "__func__", None) or getattr(m, "fget", m) for m in vars(thing).values())
        methods = (member for member in members if isinstance(member, FunctionType))
        return frozenset((_file(thing.__module__),)), frozenset((*thing.__mro__, *methods))
    return frozenset(), frozenset(_inside(thing))


def _imported_later(function: FunctionType, home: str) -> Iterator[str]:
    """The files of modules that a function's code imports when it runs, or may: of the dotted names in it, those of ours and of its own."""
    for name in _names(function.__code__):
        top, _, rest = name.partition(".")
        if rest and top in (*OURS, home) and (found := getattr(sys.modules.get(top), "__file__", None)):
            place = Path(found).parent.joinpath(*rest.split("."))
            yield str(place / "__init__.py" if place.is_dir() else place.with_suffix(".py"))


def _reached(function: FunctionType) -> Iterator[tuple[str, object]]:
    """What the names in a function's code, defaults and closure stand for. A module's names are those that the code asks of modules."""
    names = set(_names(function.__code__))
    for name in names & function.__globals__.keys():
        value = function.__globals__[name]
        yield name, value
        if isinstance(value, ModuleType) and not _is_library(value):
            yield from ((f"{name}.{n}", vars(value)[n]) for n in names & vars(value).keys())
    yield from ((f"default {k}", value) for k, value in enumerate(function.__defaults__ or ()))
    yield from ((f"default {name}", value) for name, value in (function.__kwdefaults__ or {}).items())
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    yield from ((f"closure {name}", cell.cell_contents) for name, cell in cells)


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _constant(value: object) -> str | None:
    """A constant as it counts; None for what has to be followed."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    return f"{type(value).__name__} {value!r}" if isinstance(value, _PLAIN) else None


def _told(value: object) -> str:
    """Which value a name stands for: a constant itself, of others what they are called; no address, and no order of a set."""
    if constant := _constant(value):
        return constant
    if isinstance(value, tuple | list):
        return f"{type(value).__name__}({', '.join(map(_told, value))})"
    if isinstance(value, frozenset | set):
        return f"set({', '.join(sorted(map(_told, value)))})"
    function = _function_in(value)
    named = value if function is None else function
    return f"{_module_of(named)}.{getattr(named, '__qualname__', type(named).__qualname__)}"


def _is_known(value: object, home: str) -> bool:
    """Whether all that can change of a value is found by its name, its constants, its functions, or the file that it stands in."""
    if isinstance(value, tuple | list | frozenset | set):
        return all(_is_known(v, home) for v in value)
    named = isinstance(value, ModuleType | type | FunctionType | BuiltinFunctionType | Dispatcher | np.ufunc)
    return named or _constant(value) is not None or _is_followed(value, home)


def _function_in(value: object) -> FunctionType | None:
    """The function in a kernel or an intrinsic, or the function itself."""
    function = getattr(value, "py_func", None) or getattr(value, "_defn", None) or value
    return function if isinstance(function, FunctionType) else None


def _inside(value: object) -> list[object]:
    """The function in a kernel or intrinsic, or the function itself; of any other object, the constants of its module.

    Names like `__file__` are left out: the path of a module does not matter.
    """
    if (function := _function_in(value)) is not None:
        return [function]
    module = sys.modules.get(_module_of(value))
    named = {} if module is None else vars(module)
    return [v for k, v in named.items() if isinstance(v, (*_PLAIN, np.ndarray)) and not k.startswith("__")]


def _module_of(value: object) -> str:
    if isinstance(value, ModuleType):
        return value.__name__
    return str(getattr(value, "__module__", None) or type(value).__module__)


def _is_followed(value: object, home: str) -> bool:
    name = _module_of(value)
    module = sys.modules.get(name)
    return name.partition(".")[0] in (*OURS, home) or (module is not None and not _is_library(module))


def _is_library(module: ModuleType) -> bool:
    """Whether a module is Python's own or an installed package of somebody else's."""
    if module.__name__.partition(".")[0] in OURS:
        return False
    path = getattr(module, "__file__", None)
    return path is None or "site-packages" in path or "dist-packages" in path or path.startswith(_LIBRARIES)


def _source(function: FunctionType) -> str:
    """The hash of a function's file; of its code alone, where there is no file (a notebook's cell)."""
    return _hash_of(function.__code__.co_filename) or _code_of(function)


@cache
def _code_of(function: FunctionType) -> str:
    """A function's code, wherever it stands: what it does, in which names and numbers."""
    return f"{function.__module__}.{function.__qualname__} {hashlib.sha256(_written(function.__code__).encode()).hexdigest()}"


def _written(code: CodeType) -> str:
    constants = (
        _written(c) if isinstance(c, CodeType) else repr(sorted(map(repr, c))) if isinstance(c, frozenset) else repr(c)
        for c in code.co_consts
    )
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    return f"{code.co_code.hex()} {code.co_flags} {code.co_argcount} {names} ({', '.join(constants)})"


def _file(name: str) -> str:
    path = getattr(sys.modules.get(name), "__file__", None)
    return _hash_of(path) if path else name


@cache
def _hash_of(path: str) -> str:
    """The hash of a file, empty where it cannot be read."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return ""
