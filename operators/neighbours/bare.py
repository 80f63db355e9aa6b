"""How kernels see an index: every name of a `BareIndex` (layout.py), found by numba in the two arrays that hold it.

A bare array is the place where its numbers begin. Numba counts the references to an array with every call that passes it on, and asks of
every index whether it counts from the end; in loops as short as ours that was half of the time. `ix.next` is a load from `books`;
`ix.reach[slot]` is a load of where that array begins, and one of the number.
"""

from __future__ import annotations

from typing import Any, cast

import numba
from numba import types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    infer_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
)

from kinegraph.operators.neighbours.layout import HEAD, BareIndex
from kinegraph.operators.neighbours.vectors import primitive
from kinegraph.stream.compiler.fingerprint import fingerprint

_int: Any = cast(Any, numba).int64
_pointers: Any = {
    "Floats": cast(Any, types).CPointer(cast(Any, numba).float32),
    "Times": cast(Any, types).CPointer(_int),
}


class BareType(types.Type):
    """Numba's type of a `BareIndex`: where `floats` and `books` begin."""


@register_model(BareType)
class _BareModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        cast(Any, super()).__init__(dmm, fe_type, [("floats", _pointers["Floats"]), ("books", _pointers["Times"])])


@infer_getattr
class _BareNames(AttributeTemplate):
    key = BareType

    def generic_resolve(self, typ: Any, name: str) -> Any:  # type: ignore[override]
        kind = BareIndex.__annotations__.get(name)
        return _int if kind == "int" else _pointers.get(kind)


def _base(context: Any, builder: Any, typ: Any, index: Any, name: str) -> Any:
    """Where `floats` or `books` begins."""
    return getattr(context.make_helper(builder, typ, value=index), name)


def _number(context: Any, builder: Any, typ: Any, index: Any, name: str) -> Any:
    """Where a number of the head stands."""
    place = context.get_constant(types.intp, (HEAD.names or ()).index(name))
    return builder.gep(_base(context, builder, typ, index, "books"), [place])


def _get(context: Any, builder: Any, typ: Any, index: Any, name: str) -> Any:
    kind = BareIndex.__annotations__[name]
    if name in ("floats", "books"):
        return _base(context, builder, typ, index, name)
    if kind == "int":
        return builder.load(_number(context, builder, typ, index, name))
    begins = builder.load(_number(context, builder, typ, index, f"{name}_at"))
    return builder.gep(_base(context, builder, typ, index, "floats" if kind == "Floats" else "books"), [begins])


def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
    value = context.cast(builder, args[1], signature.args[1], _int)
    builder.store(value, _number(context, builder, signature.args[0], args[0], name))


_bare: Any = cast(Any, BareType)(name=f"BareIndex_{fingerprint(_get)}")
"""Named after its sources, so that no kernel is used that was compiled when the names stood elsewhere."""
cast(Any, lower_getattr_generic)(BareType)(_get)
cast(Any, lower_setattr_generic)(BareType)(_set)


@primitive
def bare_index(typing: Any, floats: Any, books: Any) -> Any:
    """The index that these two arrays are, as a `BareIndex`."""

    def make(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        made = context.make_helper(builder, _bare)
        for name, typ, array in zip(("floats", "books"), signature.args, args, strict=True):
            setattr(made, name, context.make_array(typ)(context, builder, array).data)
        return made._getvalue()

    return _bare(floats, books), make
