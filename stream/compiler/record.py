"""A state of many arrays as one argument of kernels: `record` makes a dataclass of arrays known to the compiler by its address.

Numba passes an array as eight or more arguments and counts the references to it at every call. Most of what had to be
compiled of a kernel that takes thirty arrays, and passes them on to others, was that. A record is one pointer, and nothing is counted: its
arrays live as long as the call from Python that it was passed to, so no kernel may return a view of one to Python.

A field `numbers`, if there is one, is a structured array of one element: its fields are attributes of the record, read and written.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir
from numba import typeof, types
from numba.core import cgutils as _cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
    typeof_impl,
    unbox,
)

from kinegraph.stream.compiler.fingerprint import fingerprint

T = TypeVar("T")
NUMBERS = "numbers"
cgutils: Any = _cgutils


class RecordType(types.Type):
    """Numba's type of a record: what it is called, and the types of its arrays by name."""

    def __init__(self, name: str, arrays: tuple[tuple[str, Any], ...]) -> None:
        self.arrays = dict(arrays)
        self.places = {field: place for place, field in enumerate(self.arrays)}
        self.struct = cast(Any, types).Tuple(tuple(self.arrays.values()))
        facts = f"{arrays} {fingerprint(_get)} {fingerprint(_set)}"
        cast(Any, super()).__init__(name=f"{name}_{hashlib.sha256(facts.encode()).hexdigest()[:12]}")

    def number(self, name: str) -> Any:
        """The type of a number; None where there is none of this name."""
        dtype = self.arrays[NUMBERS].dtype if NUMBERS in self.arrays else None
        return dtype.typeof(name) if dtype is not None and name in dtype.fields else None


@register_model(RecordType)
class _RecordModel(models.PointerModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        self._pointee_model = dmm.lookup(fe_type.struct)
        self._pointee_be_type = self._pointee_model.get_value_type()
        cast(Any, models.PrimitiveModel).__init__(self, dmm, fe_type, self._pointee_be_type.as_pointer())


@infer_getattr
class _RecordNames(AttributeTemplate):
    key = RecordType

    def generic_resolve(self, typ: Any, name: str) -> Any:  # type: ignore[override]
        return typ.arrays.get(name) or typ.number(name)


def _stored(context: Any, builder: Any, typ: Any, record: Any, name: str) -> Any:
    """The array of this name as it is kept in the record."""
    place = cgutils.gep_inbounds(builder, record, 0, typ.places[name])
    return context.make_array(typ.arrays[name])(context, builder, ref=place)


def _number(context: Any, builder: Any, typ: Any, record: Any, name: str) -> Any:
    """Where a number is kept."""
    begin = builder.bitcast(_stored(context, builder, typ, record, NUMBERS).data, cgutils.voidptr_t)
    place = cgutils.pointer_add(builder, begin, typ.arrays[NUMBERS].dtype.offset(name))
    return builder.bitcast(place, context.get_data_type(typ.number(name)).as_pointer())


def _get(context: Any, builder: Any, typ: Any, record: Any, name: str) -> Any:
    if (number := typ.number(name)) is not None:
        return context.unpack_value(builder, number, _number(context, builder, typ, record, name))
    kept, array = _stored(context, builder, typ, record, name), typ.arrays[name]
    view = context.make_array(array)(context, builder)
    for field in ("nitems", "data", "shape", "strides"):
        setattr(view, field, getattr(kept, field))
    view.itemsize = _itemsize(context, array)
    return view._getvalue()


def _itemsize(context: Any, array: Any) -> Any:
    return context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(array.dtype)))


def _set(context: Any, builder: Any, signature: Any, args: Any, name: str) -> None:
    typ, given = signature.args
    number = typ.number(name)
    value = context.cast(builder, args[1], given, number)
    context.pack_value(builder, number, value, _number(context, builder, typ, args[0], name))


cast(Any, lower_getattr_generic)(RecordType)(_get)
cast(Any, lower_setattr_generic)(RecordType)(_set)


@cast(Any, unbox)(RecordType)  # type: ignore[untyped-decorator]
def _unbox(typ: Any, value: Any, c: Any) -> Any:
    """The arrays of a dataclass from Python, in a place of the caller's."""
    record = cgutils.alloca_once(c.builder, c.context.get_data_type(typ.struct))
    failed = cgutils.false_bit
    signature = ir.FunctionType(ir.IntType(32), [c.pyapi.pyobj, cgutils.voidptr_t])
    adapt = c.pyapi._get_function(signature, name="numba_adapt_ndarray")
    for name in typ.arrays:
        kept = _stored(c.context, c.builder, typ, record, name)
        attribute = c.pyapi.object_getattr_string(value, name)
        place = c.builder.bitcast(kept._getpointer(), cgutils.voidptr_t)
        error = c.builder.call(adapt, (attribute, place))
        c.pyapi.decref(attribute)  # the dataclass holds it
        failed = c.builder.or_(failed, cgutils.is_not_null(c.builder, error))
        failed = c.builder.or_(
            failed, c.builder.icmp_unsigned("!=", kept.itemsize, _itemsize(c.context, typ.arrays[name]))
        )
    with cgutils.if_unlikely(c.builder, failed):
        c.pyapi.err_set_string("PyExc_TypeError", "a record's arrays are not those that it was compiled for")
    return cast(Any, NativeValue)(record, is_error=failed)


def record(cls: type[T]) -> type[T]:
    """Make a dataclass of arrays an argument of kernels. Every instance must have arrays of the same dtypes and dimensions."""

    made: list[Any] = []

    def type_of(value: Any, _context: Any) -> Any:
        if not made:
            arrays = tuple((field.name, cast(Any, typeof)(getattr(value, field.name))) for field in fields(value))
            made.append(cast(Any, RecordType)(cls.__name__, arrays))
            cast(Any, cls)._numba_type_ = made[0]  # looked up sooner than asked for here
        return made[0]

    typeof_impl.register(cls)(type_of)
    return cls


def numbers_of(described: type) -> np.dtype[Any]:
    """The dtype of `numbers` from a class of annotations (int, float or bool), and properties of the same names on that class."""
    kinds = {"int": np.int64, "float": np.float64, "bool": np.bool_}
    dtype = np.dtype([(name, kinds[kind]) for name, kind in _numbers(described)], align=True)
    for name in dtype.names or ():
        setattr(described, name, _property(name))
    return dtype


def _numbers(described: type) -> Iterator[tuple[str, str]]:
    """Names and kinds, the widest first, so that none is followed by a hole."""
    kinds = described.__annotations__
    yield from sorted(kinds.items(), key=lambda item: item[1] == "bool")


def _property(name: str) -> property:
    def get(self: Any) -> Any:
        return self.numbers[name].item()

    def put(self: Any, value: Any) -> None:
        self.numbers[name] = value

    return property(get, put)
