"""A state goes to plain arrays and back whole: what lies in it, how deep it lies, and what a new instance lacks."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.stream.chunk import FOREVER, NEVER, Array
from kinegraph.stream.data.state import StateError, pack, size_of, unpack


@dataclass(slots=True)
class Ring:
    rows: Array
    head: int = 0


@dataclass(frozen=True, slots=True)
class Mark:
    onset: int
    name: str


@dataclass(slots=True)
class State:
    z: Array = field(default_factory=lambda: np.zeros((2, 3)))
    count: int = 0
    mean: float = 0.0
    side: str = ""
    ready: bool = False
    anchor: int | None = None
    small: np.int32 = np.int32(0)  # noqa: RUF009
    ring: Ring = field(default_factory=lambda: Ring(np.zeros(4)))
    spare: Ring | None = None
    rings: list[Ring] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    curves: list[Array] = field(default_factory=list)
    nested: list[list[float]] = field(default_factory=list)
    maybe: list[Ring] | None = None


def through_file(arrays: dict[str, Array]) -> dict[str, Array]:
    file = io.BytesIO()
    np.savez(file, **{f"a/{k}": v for k, v in arrays.items()})
    file.seek(0)
    with np.load(file, allow_pickle=False) as found:
        return {name[2:]: found[name] for name in found.files}


def same(one: Any, other: Any) -> bool:
    """Equal packed, bit for bit, with the same names."""
    a, b = pack(one), pack(other)
    return a.keys() == b.keys() and all(a[k].dtype == b[k].dtype and a[k].tobytes() == b[k].tobytes() for k in a)


numbers = st.floats(allow_nan=True)
rings = st.builds(Ring, st.lists(numbers, max_size=5).map(np.array), st.integers(NEVER, FOREVER))
states = st.builds(
    State,
    z=st.lists(numbers, min_size=6, max_size=6).map(lambda v: np.array(v).reshape(2, 3)),
    count=st.integers(NEVER, FOREVER),
    mean=numbers,
    side=st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=8),
    ready=st.booleans(),
    anchor=st.none() | st.integers(NEVER, FOREVER),
    small=st.integers(-5, 5).map(np.int32),
    ring=rings,
    spare=st.none() | rings,
    rings=st.lists(rings, max_size=3),
    marks=st.lists(st.builds(Mark, st.integers(0, 9), st.sampled_from(["left", ""])), max_size=3),
    curves=st.lists(st.lists(numbers, max_size=3).map(np.array), max_size=3),
    nested=st.lists(st.lists(numbers, max_size=2), max_size=2),
    maybe=st.none() | st.lists(rings, max_size=2),
)


@given(old=states, new=states)
def test_any_state_takes_over_any_other(old: State, new: State) -> None:
    unpack(new, through_file(pack(old)))
    assert same(old, new)
    assert type(new.small) is np.int32
    assert [type(m) for m in new.marks] == [Mark] * len(old.marks)


@given(old=states)
def test_a_fresh_state_takes_over_what_it_has_no_example_of(old: State) -> None:
    new = State()
    unpack(new, pack(old))
    assert same(old, new)


def test_neither_shares_memory_with_the_snapshot() -> None:
    old, new = State(rings=[Ring(np.ones(3))]), State()
    arrays = pack(old)
    before = {name: a.copy() for name, a in arrays.items()}
    unpack(new, arrays)
    for state in (old, new):
        state.z += 1
        state.ring.rows += 1
        state.rings[0].rows += 1
    assert all(np.array_equal(arrays[name], before[name]) for name in before)


def test_arrays_of_the_same_shape_keep_their_memory() -> None:
    new = State()
    z, rows = new.z, new.ring.rows
    unpack(new, pack(State(z=np.ones((2, 3)))))
    assert new.z is z
    assert new.ring.rows is rows
    assert z[0, 0] == 1.0


def test_no_state_packs_to_nothing() -> None:
    assert pack(None) == {}
    unpack(None, {})


def test_size_counts_every_array() -> None:
    assert size_of(State(curves=[np.zeros(100)])) - size_of(State()) == 800


@dataclass(slots=True)
class Holds:
    thing: Any


@pytest.mark.parametrize("thing", [{}, (1, 2), {1}, b"x", object(), np.array([{}]), 2**80, [{"a": 1}]])
def test_what_is_no_plain_state_is_refused_by_name(thing: object) -> None:
    with pytest.raises(TypeError, match="thing"):
        pack(Holds(thing))


def test_a_state_that_is_no_dataclass_is_refused() -> None:
    with pytest.raises(TypeError, match="dict"):
        pack({"z": 1})


@pytest.mark.parametrize("missing", ["z", "ring.head", "rings[]", "rings[0].rows"])
def test_a_snapshot_that_lacks_something_is_refused(missing: str) -> None:
    arrays = pack(State(rings=[Ring(np.ones(3))]))
    del arrays[missing]
    with pytest.raises(StateError, match=r"another version"):
        unpack(State(), arrays)
