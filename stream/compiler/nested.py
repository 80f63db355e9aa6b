"""Kernels that other kernels call: made once without being optimised, and optimised once, with the kernel that Python calls.

Numba optimises every kernel and compiles it to machine code with all that it calls, which has been optimised before: a kernel below ten
others is optimised ten times, and so on below each of these. Only what Python calls needs machine code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

from llvmlite import binding as llvm
from numba.core import compiler, dispatcher, targetconfig, types
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import builtin_registry

_FunctionCompiler: Any = dispatcher._FunctionCompiler  # type: ignore[attr-defined]
_numba: Any = compiler
_unliteral: Any = types.unliteral


@cache
def _shorten_errors() -> None:
    """Leave out the shapes in the error of a slice that does not fit: numba compiles two seconds of text functions for it."""
    from numba.np import arrayobj

    long = getattr(arrayobj, "ol_raise_with_shape_context_cpu", None)
    for template in builtin_registry.functions:
        if long is not None and getattr(template, "_overload_func", None) is long:
            template._overload_func = staticmethod(lambda *_: None)


def names_only(names: Iterable[str]) -> bytes:
    """Bitcode in which functions have these names and do nothing: numba looks there for what an object file has."""
    text = "\n".join(f'define void @"{name}"() {{ ret void }}' for name in names)
    return llvm.parse_assembly(text).as_bitcode()  # type: ignore[no-any-return]


@cache
def _compare_flags_quickly() -> None:
    """By what was set: numba looks up every call by its flags, and reads all their defaults for it (7 % of the time that it compiles)."""
    flags: Any = targetconfig.TargetConfig

    def equal(one: Any, other: Any) -> bool:
        return one is other or (
            type(one) is type(other) and (one._values == other._values or one.values() == other.values())
        )

    flags.__eq__, flags.__hash__ = equal, lambda one: hash(type(one))


class _CalleeLibrary(JITCodeLibrary):
    """A function to be linked into another library: neither optimised as a whole nor compiled to machine code."""

    def finalize(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._finalized = True


class _Library(JITCodeLibrary):
    """The machine code of a kernel and of all that it calls."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)  # type: ignore[no-untyped-call]
        self.enable_object_caching()  # type: ignore[no-untyped-call]

    def add_linking_library(self, library: Any) -> None:
        if library not in self._linking_libraries:
            super().add_linking_library(library)  # type: ignore[no-untyped-call]
            if isinstance(library, _CalleeLibrary):
                for below in library._linking_libraries:
                    self.add_linking_library(below)

    def serialize_using_object_code(self) -> Any:
        """With the names of its functions only, not the bitcode that numba keeps for others to link: that is larger than all else.

        Others do not link it: only Python calls it.
        """
        self._ensure_finalized()  # type: ignore[no-untyped-call]
        names = [function.name for function in self._final_module.functions if not function.is_declaration]
        return self.name, "object", (self._get_compiled_object(), names_only(names))  # type: ignore[no-untyped-call]


class _Compiler(_FunctionCompiler):  # type: ignore[misc]
    def _compile(self, library: Any, args: Any, return_type: Any, **options: bool) -> Any:
        flags: Any = _numba.Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        for name, value in options.items():
            setattr(flags, name, value)
        return _numba.compile_extra(
            self.targetdescr.typing_context,
            self.targetdescr.target_context,
            self.py_func,
            args=args,
            return_type=return_type,
            flags=flags,
            locals=self.locals,
            library=library(self.targetdescr.target_context.codegen(), self.py_func.__qualname__),
            pipeline_class=self.pipeline_class,
        )

    def _compile_core(self, args: Any, return_type: Any) -> Any:
        _shorten_errors()
        _compare_flags_quickly()
        return self._compile(_Library, args, return_type)


class _CalleeCompiler(_Compiler):
    def _compile_core(self, args: Any, return_type: Any) -> Any:
        made = self._compile(
            _CalleeLibrary, args, return_type, no_compile=True, no_cpython_wrapper=True, no_cfunc_wrapper=True
        )
        self.targetdescr.target_context.insert_user_function(made.fndesc, made.fndesc, [made.library])
        return made


class _Callee(CPUDispatcher):
    """A kernel as other kernels call it. It has no address, so its description is what numba knows it by."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, {}, options)
        self._compiler = _CalleeCompiler(function, self.targetdescr, options, {}, compiler.Compiler)

    def add_overload(self, made: Any) -> None:
        self.overloads[tuple(made.signature.args)] = made

    def get_overload(self, args: Any) -> Any:
        return self.overloads[tuple(args)].fndesc  # type: ignore[attr-defined]


class KernelDispatcher(CPUDispatcher):
    """A kernel as Python calls it; kernels call its `_Callee`."""

    _callee: Any = None

    def __init__(self, function: Callable[..., Any], locals: dict[str, Any], options: dict[str, Any]) -> None:
        super().__init__(function, locals, options)
        self._compiler = _Compiler(function, self.targetdescr, options, locals, compiler.Compiler)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        if self._callee is None:
            self._callee = _Callee(self.py_func, self.targetoptions)
        plain = [_unliteral(arg) for arg in args]  # numba would make another one for every number that stands in a call
        return self._callee.get_call_template(plain, {name: _unliteral(arg) for name, arg in kws.items()})

    def get_overload(self, args: Any) -> Any:
        return self._callee.get_overload(args)
